"""Parts that moved are found where surfaces err by more than the registration is unsure, and ground does not bend them.

Errors are as a comparison learns them: at edges and where scans disagree they are many times those of smooth places.
"""

from dataclasses import replace

import numpy as np
import pytest
from body_with_parts import WAYS, N, shift_part
from bumpy_body import NOISE, correlated_noise, noisy_cloud, unit
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from monitor.registration import register
from monitor.registration.motion.covariance import about
from monitor.registration.motion.sides import Side, prepare_side
from monitor.registration.part_growth import Field, Piece, fit
from monitor.registration.parts import (
    MovedParts,
    PartSettings,
    _measure,
    _prepare,
    _sharpen,
    covariance_between,
    find_parts,
    motion_between,
)
from monitor.simulation.scenes import grid_faces
from projects.model import Bools, Floats, PointCloud, Registration, Surface
from projects.transforms import apply, invert, perturb

ERRORS, REACH = 5e-4, 0.01  # m, of the part's surface in the later epoch, alike over this far
SPACING, BUMPS = 0.001, 0.002  # m, of the plaque
SIGMA, ALIKE = 3e-5, 0.006  # m, of its errors, alike over this far
AT_EDGES = 1.5e-4  # m, that points of the boss's edges lie off
RADIUS, HEIGHT, WALL, RIBS = 0.024, 0.008, 0.006, 0.0015  # m, of the boss
SLID = np.array([0.0, 0.0, 0.09, 0.003, -0.0025, 0.0])  # rad, m: it turned about its axis, z, and slid aside


def errors_of(found: MovedParts, T: Floats) -> tuple[Floats, float]:
    """Return the error (6,) of the only part's motion, which is truly T, and its square by the covariance."""
    (part,) = found.parts
    truth = np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), apply(T, part.centre) - part.centre])
    error = part.motion - truth
    return error, float(error @ np.linalg.solve(part.covariance, error))


def test_a_part_whose_surface_errs_by_more_than_the_rest_is_found_by_what_is_known_of_its_errors() -> None:
    rng = np.random.default_rng(6)
    reference, later = (noisy_cloud(N, np.random.default_rng(k)) for k in (1, 2))
    later, is_part, T = shift_part(later, "knob")
    off = np.where(is_part, correlated_noise(later.points, rng, ERRORS, REACH), 0.0)
    later = PointCloud(later.points + off[:, None] * later.normals, later.normals)
    motion = register(later, reference)
    sigma = np.where(is_part, np.hypot(ERRORS, NOISE), NOISE)
    assert find_parts(later, reference, motion).parts == ()  # nothing fits to what the registration is sure of
    error, squared = errors_of(find_parts(later, reference, motion, sigma=sigma), T)
    assert squared < chi2.ppf(0.999, 6)
    assert np.linalg.norm(error[3:]) < 1e-3  # m, of 2.4 mm


def plaque(rng: np.random.Generator, T: Floats) -> tuple[Surface, Bools]:
    """Return the surface of bumpy ground and a ribbed boss on it, moved by T; and which vertices are of the boss."""
    n = int(0.2 / SPACING)
    grid = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
    xy = (grid + rng.uniform(-0.5, 0.5, grid.shape)) * SPACING - 0.1

    def height(xy: Floats) -> tuple[Floats, Floats]:
        ground = BUMPS * np.sin(xy[:, 0] / 0.03) * np.cos(xy[:, 1] / 0.04)
        u, v = apply(invert(T), np.column_stack([xy, np.zeros(len(xy))]))[:, :2].T
        away = np.hypot(u, v)
        ribs = RIBS * np.cos(5.0 * np.arctan2(v, u)) * np.minimum(away / RADIUS, 1.0)
        boss = HEIGHT * np.clip((RADIUS - away) / WALL, -1.0, 1.0) + ribs
        return np.maximum(ground, boss), boss > ground

    step = 0.5 * SPACING
    slopes = [(height(xy + d)[0] - height(xy - d)[0]) / (2.0 * step) for d in (np.array([step, 0.0]), [0.0, step])]
    normals = np.column_stack([-slopes[0], -slopes[1], np.ones(len(xy))])
    normals = unit(normals)
    z, is_boss = height(xy)
    points = np.column_stack([xy, z])
    points += normals * correlated_noise(points, rng, SIGMA, ALIKE)[:, None]
    normals = unit(normals + rng.normal(0.0, 0.01, normals.shape))
    return Surface(points, grid_faces(n, n), normals=normals, sigma=np.full(len(points), SIGMA)), is_boss


@pytest.mark.parametrize("seed", [1, 2])
def test_a_boss_that_slid_on_bumpy_ground_has_the_motion_that_it_made(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = perturb(np.eye(4), np.zeros(3), SLID)
    (before, _), (after, is_boss) = plaque(rng, np.eye(4)), plaque(rng, T)
    found = find_parts(after, before, register(after, before), sigma=np.where(is_boss, AT_EDGES, 2.0 * SIGMA))
    _, squared = errors_of(found, T)
    assert squared < chi2.ppf(0.999, 6)
    assert np.mean(found.part_of[is_boss] == 1) > 0.7


@pytest.mark.parametrize("seed", [3, 4])
def test_ground_that_passes_for_a_part_does_not_bend_its_motion(seed: int) -> None:
    """Ground that fits both motions tells nothing of the part's; where it is counted to it, it pulls at it."""
    rng, T = np.random.default_rng(seed), perturb(np.eye(4), np.zeros(3), SLID)
    (before, _), (after, _) = plaque(rng, np.eye(4)), plaque(rng, T)
    sides = prepare_side(after, np.zeros(3)), prepare_side(before, np.zeros(3))
    sigma = np.full(len(after.vertices), 2.0 * SIGMA)
    field = _prepare(sides, np.eye(4), (SIGMA, sigma), PartSettings(), blended=0)
    away = np.linalg.norm(field.samples.points[:, :2] - T[:2, 3], axis=1)
    members = np.flatnonzero(away < 1.4 * RADIUS)
    with_ground = Piece(fit(field, members, invert(T), fine=True)[0], members)
    off, left = (motion_between(piece.T, np.eye(4), np.zeros(3)) - SLID
                 for piece in (with_ground, _sharpen(field, with_ground)))  # fmt: skip
    assert abs(left[5]) < 0.4 * abs(off[5])  # m, outwards, which the ground does not let it slide without
    assert abs(left[5]) < 3e-5 < abs(off[5])


def test_a_parts_motion_is_as_sure_as_it_scatters_however_far_it_turned() -> None:
    """What the poses of the part and of the rest err by is carried over to where the part is now."""
    rng, middle, centre = np.random.default_rng(6), np.array([1.0, 2.0, 0.0]), np.array([0.2, -0.1, 0.3])
    T_stable = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.1, 0.0, 0.0, 0.3, 0.0]))
    T_part = perturb(T_stable, centre, np.array([0.2, 0.0, -1.4, 0.02, 0.0, 0.01]))
    own, rest = (
        np.diag(sigma) ** 2 for sigma in ([1e-4, 3e-4, 2e-4, 1e-3, 1e-4, 2e-4], [4e-4, 1e-4, 1e-4, 1e-4, 5e-4, 1e-4])
    )
    found = [
        motion_between(perturb(T_part, centre, off), perturb(T_stable, middle, of_rest), centre)
        for off, of_rest in zip(*(rng.multivariate_normal(np.zeros(6), C, 4000) for C in (own, rest)), strict=True)
    ]
    stated = covariance_between(T_part, T_stable, centre, own, lambda place: about(rest, place - middle))
    assert np.sqrt(np.diag(stated)) == pytest.approx(np.std(found, axis=0), rel=0.05)


def boss_at_rest(height: float, wall: float, ribs: float) -> tuple[Field, Piece]:
    """Return the field of a plaque with one boss that did not move, round with ribs, or rectangular without, and the
    boss as a piece of it that is held to have slid and sunk, so that all of it tells."""
    n = int(0.12 / SPACING)

    def away_from_middle(at: Floats) -> Floats:
        return np.hypot(at[:, 0], at[:, 1]) if ribs else np.maximum(np.abs(at[:, 0]), 1.2 * np.abs(at[:, 1]))

    def heights(xy: Floats) -> Floats:
        wall_height = height * np.clip((RADIUS - away_from_middle(xy)) / wall, 0.0, 1.0)
        return wall_height + ribs * np.cos(5.0 * np.arctan2(xy[:, 1], xy[:, 0]))

    def scanned(rng: np.random.Generator) -> Side:
        grid = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
        xy = (grid + rng.uniform(-0.5, 0.5, grid.shape)) * SPACING - 0.06
        slopes = [(heights(xy + d) - heights(xy - d)) / 4e-4 for d in (np.array([2e-4, 0.0]), np.array([0.0, 2e-4]))]
        normals = unit(np.column_stack([-slopes[0], -slopes[1], np.ones(n * n)]) + rng.normal(0.0, 0.01, (n * n, 3)))
        points = np.column_stack([xy, heights(xy) + rng.normal(0.0, SIGMA, n * n)])
        return prepare_side(
            Surface(points, grid_faces(n, n), normals=normals, sigma=np.full(n * n, SIGMA)), np.zeros(3)
        )

    after, before = (scanned(np.random.default_rng(k)) for k in (5, 6))
    T_stable = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.0, 0.0, 2e-4, -2e-4, 3e-4]))
    field = _prepare((after, before), T_stable, (SIGMA, np.full(len(after), SIGMA)), PartSettings(), blended=2)
    boss = np.flatnonzero(away_from_middle(field.samples.points) < RADIUS)
    return field, Piece(np.eye(4), boss)


def sigmas_of(field: Field, piece: Piece, blended: int) -> Floats:
    """Return one sigma (6,) of a piece's motion, so many rings at its border held to be blended."""
    part = _measure(replace(field, blended=blended), piece, 1, lambda _: np.zeros((6, 6)))
    assert part is not None
    return np.sqrt(np.diag(part.covariance))


def test_how_sure_a_motion_is_is_told_within_what_fits_blend_at_its_border() -> None:
    """A round boss: its ribs hold how high it lies and its tilt less firmly than the foot of its wall does."""
    field, boss = boss_at_rest(0.004, 0.004, 0.001)
    alone, two = (sigmas_of(field, boss, blended) for blended in (0, 2))
    assert (1.5 * alone[[0, 1, 5]] < two[[0, 1, 5]]).all()
    assert (alone <= two * (1.0 + 1e-6)).all()


def test_what_was_fitted_is_blended_at_borders_and_what_was_measured_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr("monitor.registration.parts.find_pieces", lambda field, _: seen.append(field.blended) or [])
    surface, _ = plaque(np.random.default_rng(7), np.eye(4))
    still = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True, sigma=SIGMA)
    for noun in (surface, replace(surface, normals=None), PointCloud(surface.vertices, surface.normals)):
        find_parts(noun, noun, still)
    assert seen == [2, 0, 0]


def test_rings_are_left_out_as_long_as_the_rest_holds_the_motion() -> None:
    """Within two rings a flat-topped boss is flat; its covariance was no longer positive definite."""
    field, boss = boss_at_rest(0.003, 0.001, 0.0)
    alone, one, two = (sigmas_of(field, boss, blended) for blended in (0, 1, 2))
    assert two == pytest.approx(one)
    assert (alone < one).all()
    assert (one < 2.0 * alone).all()


def test_a_layer_that_came_off_along_a_sharp_border_is_no_part() -> None:
    """What is left is the shape that was there before, deeper in: as if it had been pushed in."""
    towards = WAYS["knob"][0]

    def came_off(d: Floats) -> Floats:
        return np.where(d @ towards > np.cos(0.35), -1.5e-3, 0.0)

    reference, worn = noisy_cloud(N, np.random.default_rng(1)), noisy_cloud(N, np.random.default_rng(3), came_off)
    found = find_parts(worn, reference, register(worn, reference), sigma=np.full(N, NOISE))
    assert found.parts == ()
