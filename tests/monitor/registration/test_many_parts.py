"""Many parts that moved at once, as of a stove put together again from its pieces: each with its six parameters."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from wall_of_pieces import PIECE, move_pieces, scan_stove

from monitor.registration import register
from monitor.registration.motion.conclusion import doubt_majority
from monitor.registration.parts import MovedParts, find_parts
from projects.model import Floats, Ints, PointCloud
from projects.transforms import apply, perturb


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
