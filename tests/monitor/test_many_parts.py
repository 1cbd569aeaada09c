"""Many parts that moved at once, as of a stove put together again from its pieces: each with its six parameters."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from monitor.registration import register
from monitor.registration.motion.icp import doubt_majority
from monitor.registration.parts import MovedParts, find_parts
from projects.model import Floats, Ints, PointCloud
from projects.transforms import apply, perturb, rotate

N_ACROSS, N_UP, PIECE = 5, 4, 0.3  # pieces of 30 cm
N = 60_000
NOISE = 3e-4  # m
MOVED = (1, 3, 5, 9, 10, 14, 16, 18)  # eight of twenty


def scan_stove(rng: np.random.Generator) -> tuple[PointCloud, Ints]:
    """Return a wall of pieces with relief 20 mm deep, new points on each call, and the piece of each point."""
    x, y = rng.uniform(0, N_ACROSS * PIECE, N), rng.uniform(0, N_UP * PIECE, N)
    shape = np.random.default_rng(5)
    z, dx, dy = np.zeros(N), np.zeros(N), np.zeros(N)
    for u, v in shape.normal(size=(8, 2)) * 40.0:
        phase = u * x + v * y + shape.uniform(0, 6.28)
        z, dx, dy = z + 0.004 * np.sin(phase), dx + 0.004 * u * np.cos(phase), dy + 0.004 * v * np.cos(phase)
    normals = np.column_stack([-dx, -dy, np.ones(N)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    piece = (x // PIECE).astype(int) + N_ACROSS * (y // PIECE).astype(int)
    return PointCloud(np.column_stack([x, y, z]) + normals * rng.normal(0, NOISE, (N, 1)), normals), piece


def move_pieces(cloud: PointCloud, piece: Ints, moved: Sequence[int] = MOVED) -> tuple[PointCloud, dict[int, Floats]]:
    """Return the cloud with some pieces moved by about 2 mm and 5 mrad, and the motion (4, 4) of each."""
    rng, points, normals, motions = np.random.default_rng(8), cloud.points.copy(), cloud.normals.copy(), {}
    for k in moved:
        which = piece == k
        motions[k] = perturb(np.eye(4), points[which].mean(axis=0), rng.normal(0, [0.005] * 3 + [0.002] * 3))
        points[which], normals[which] = apply(motions[k], points[which]), rotate(motions[k], normals[which])
    return PointCloud(points, normals), motions


@pytest.fixture(scope="module")
def found() -> tuple[MovedParts, dict[int, Floats], Ints]:
    rng = np.random.default_rng(1)
    before, _ = scan_stove(rng)
    after, piece = scan_stove(rng)
    after, motions = move_pieces(after, piece)
    registration = register(after, before)
    assert registration.converged, registration.reason
    assert not registration.doubt
    return find_parts(after, before, registration), motions, piece


def test_each_of_many_pieces_is_a_part_of_its_own(found: tuple[MovedParts, dict[int, Floats], Ints]) -> None:
    parts, motions, piece = found
    numbers = [int(np.bincount(parts.part_of[piece == k]).argmax()) for k in motions]
    assert 0 not in numbers
    assert len(set(numbers)) == len(numbers) == len(parts.parts)
    for k, number in zip(motions, numbers, strict=True):
        assert np.mean(parts.part_of[piece == k] == number) > 0.8
        assert np.mean(parts.part_of[piece != k] == number) < 0.01


def test_each_part_has_its_six_parameters_within_its_covariance(
    found: tuple[MovedParts, dict[int, Floats], Ints],
) -> None:
    parts, motions, piece = found
    squared = []
    for k, T in motions.items():
        part = parts.parts[int(np.bincount(parts.part_of[piece == k]).argmax()) - 1]
        truth = np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), apply(T, part.centre) - part.centre])
        error = part.motion - truth
        squared.append(float(error @ np.linalg.solve(part.covariance, error)))
        assert np.abs(error[3:]).max() < 2e-4  # m, of 2 mm
        assert np.abs(error[:3]).max() < 1e-3  # rad, of 5 mrad
    assert np.median(squared) < 12.6  # 95 % of chi2 of 6


def test_where_most_pieces_moved_the_motion_is_that_of_where_the_user_says_nothing_did(
    rng: np.random.Generator,
) -> None:
    before, _ = scan_stove(rng)
    after, piece = scan_stove(rng)
    after, _ = move_pieces(after, piece, range(14))  # the six pieces of the upper right stay
    left, floor = 4 * PIECE, 3 * PIECE
    told = register(after, before, within=lambda p: (p[:, 1] > floor) | ((p[:, 0] > left) & (p[:, 1] > floor - PIECE)))
    assert told.converged, told.reason
    middle = np.array([[3 * PIECE, 3.3 * PIECE, 0.0]])
    assert np.linalg.norm(apply(told.T_target_source, middle) - middle) < 5e-5  # alone it comes out 0.2 to 0.4 mm off
    assert told.is_stable is not None
    assert not told.is_stable[after.points[:, 1] < floor - PIECE - 0.01].any()


def test_without_a_majority_no_motion_is_that_of_the_stable_areas() -> None:
    assert doubt_majority(0.55) == ""
    assert "only 41 % of the surface follows one motion" in doubt_majority(0.41)


@pytest.mark.parametrize("n_moved", [13, 20])
def test_where_most_pieces_moved_each_its_own_way_the_motion_found_is_doubted(
    rng: np.random.Generator, n_moved: int
) -> None:
    before, _ = scan_stove(rng)
    after, piece = scan_stove(rng)
    found = register(move_pieces(after, piece, np.random.default_rng(n_moved).permutation(20)[:n_moved])[0], before)
    assert not found.converged or "or all of it moved, in pieces" in found.doubt


def test_what_most_pieces_do_alike_is_the_motion_of_the_whole(rng: np.random.Generator) -> None:
    before, _ = scan_stove(rng)
    after, piece = scan_stove(rng)
    most = piece < 14
    T = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.0, 0.0, 0.0008, 0.0, 0.002]))
    points = after.points.copy()
    points[most] = apply(T, points[most])
    found = register(PointCloud(points, after.normals), before)
    assert found.converged, found.reason
    assert found.stable_share == pytest.approx(0.7, abs=0.05)
    assert apply(found.T_target_source @ T, points).mean(axis=0) == pytest.approx(points.mean(axis=0), abs=5e-5)
    assert found.is_stable is not None
    assert found.is_stable[~most].mean() < 0.1
