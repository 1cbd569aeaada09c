"""Two planes around a vertex: which points count, when there is none, and what each figure of its row is."""

from __future__ import annotations

import numpy as np
import pytest
from edges_between_planes import edge_cloud

from monitor.reconstruction.roof_evidence import (
    ACTIVE,
    BOW,
    CHI2,
    CREST,
    GAIN,
    HIDDEN,
    N_VALUES,
    OTHER,
    OVER,
    ROUNDED,
    SUPPORT,
    TURN,
    UNIT,
    look_for_roof,
)
from monitor.reconstruction.two_planes import carried_over, window_room
from projects.model import Floats

TURN_60 = np.radians(60.0)
VERTEX = np.array([0.001, 0.0, 0.0])
RADIUS, WIDTH, NOISE = 0.008, 0.0012, 1e-4


@pytest.fixture
def ridge(monkeypatch: pytest.MonkeyPatch) -> Floats:
    """Return points (n, 3) of a ridge of 60 degrees along y without noise, 1 mm apart."""
    monkeypatch.setattr("edges_between_planes.NOISE", 0.0)
    return edge_cloud(np.random.default_rng(1), TURN_60).points


def looks_of(points: Floats, way: float = 0.5 * TURN_60) -> Floats:
    """Return normals (n, 3) that look `way` (rad) to the side of x on which each point lies."""
    x = points[:, 0]
    return np.column_stack([np.sign(x) * np.sin(way), np.zeros(len(x)), np.full(len(x), np.cos(way))])


def on_own_side(x: Floats, y: Floats) -> Floats:
    """Return points (n, 3) of the side beyond x = 0, `x` along its slope."""
    return np.column_stack([x * np.cos(0.5 * TURN_60), y, -x * np.sin(0.5 * TURN_60)])


def row_of(
    points: Floats, normals: Floats, up: tuple[float, float, float] = (0.0, 0.0, 1.0), count: float = 1.0,
    vertex: Floats = VERTEX,
) -> Floats:  # fmt: skip
    """Return the row of two planes around a vertex that looks `up`; each point stands for `count`."""
    values = np.column_stack([points, normals, np.full(len(points), count)]).T.copy()
    row, n = np.full(N_VALUES, np.nan), len(points)
    look_for_roof(values, n, vertex, np.array(up), (RADIUS, WIDTH), NOISE, window_room(n), row)
    return row


def test_a_sheet_behind_that_looks_away_is_none_of_the_surface(ridge: Floats) -> None:
    alone = row_of(ridge, looks_of(ridge))
    behind = ridge - np.array([0.0, 0.0, 0.003])
    both = row_of(np.concatenate([ridge, behind]), np.concatenate([looks_of(ridge), -looks_of(ridge)]))
    np.testing.assert_array_equal(both, alone)


def test_the_other_side_of_a_wedge_counts_though_it_looks_more_than_a_right_angle_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A vertex sees 120 degrees; the sides of this wedge look 110 degrees apart."""
    monkeypatch.setattr("edges_between_planes.NOISE", 0.0)
    half = np.radians(55.0)
    wedge = edge_cloud(np.random.default_rng(2), 2.0 * half).points
    up, vertex = (float(np.sin(half)), 0.0, float(np.cos(half))), np.array([0.001, 0.0, -0.0014])
    assert row_of(wedge, looks_of(wedge, half), up, vertex=vertex)[TURN] == pytest.approx(np.cos(2.0 * half), abs=1e-9)


def test_points_whose_normals_say_the_wrong_side_go_where_they_lie(ridge: Floats) -> None:
    """Of those within 3 mm of the edge, whose neighbourhoods reach over it, three in ten look as the other side."""
    rng, normals = np.random.default_rng(3), looks_of(ridge)
    wrong = (np.abs(ridge[:, 0]) < 0.003) & (rng.random(len(ridge)) < 0.3)
    assert wrong.sum() > 80
    normals[wrong, 0] *= -1.0
    row = row_of(ridge, normals)
    assert row[TURN] == pytest.approx(np.cos(TURN_60), abs=1e-9)
    assert row[OVER] == pytest.approx(VERTEX[0] * np.sin(0.5 * TURN_60), abs=1e-9)


def test_points_on_a_line_make_no_plane(ridge: Floats) -> None:
    """One scan line beside the edge, straight to a tenth of a micrometre."""
    line = on_own_side(0.003 + 1e-7 * np.random.default_rng(4).normal(size=40), np.linspace(-0.02, 0.02, 40))
    points = np.concatenate([ridge[ridge[:, 0] < 0.0], line])
    assert np.isnan(row_of(points, looks_of(points))).all()


@pytest.mark.parametrize(("n_beyond", "is_roof"), [(5, False), (8, True)])
def test_a_side_needs_six_points(ridge: Floats, n_beyond: int, is_roof: bool) -> None:
    beyond = np.flatnonzero((ridge[:, 0] > 0.0) & (np.linalg.norm(ridge - VERTEX, axis=1) < 0.006))
    some = beyond[:: len(beyond) // n_beyond][:n_beyond]
    points = np.concatenate([ridge[ridge[:, 0] < 0.0], ridge[some]])
    row = row_of(points, looks_of(points))
    assert np.isfinite(row[TURN]) == is_roof
    in_strip = points[-len(some) :, 0] / np.cos(0.5 * TURN_60) < carried_over(np.cos(TURN_60), NOISE)
    assert not is_roof or row[SUPPORT] == n_beyond - in_strip.sum()  # of the plane under the vertex alone
    assert np.isnan(row_of(ridge[beyond[:11]], looks_of(ridge[beyond[:11]]))).all()


@pytest.mark.parametrize("count", [1.0, 4.0])
@pytest.mark.parametrize(("begins", "is_roof"), [(0.002, True), (0.0025, False)])
def test_a_plane_is_not_extrapolated_to_more_than_four_times_its_error(
    ridge: Floats, begins: float, is_roof: bool, count: float
) -> None:
    """40 points over 2 mm of slope: under the vertex their plane errs by 3.6 or 4.2 times what their mean does."""
    rng = np.random.default_rng(5)
    own = on_own_side(rng.uniform(begins, begins + 0.002, 40), np.random.default_rng(6).uniform(-0.004, 0.004, 40))
    points = np.concatenate([ridge[ridge[:, 0] < 0.0], own])
    row = row_of(points, looks_of(points), count=count)
    assert np.isfinite(row[TURN]) == is_roof
    assert not is_roof or row[UNIT] * np.sqrt(40.0 * count) == pytest.approx(3.6, abs=0.1)


def test_one_point_far_off_counts_as_one_of_three_sigmas(ridge: Floats) -> None:
    """It lies 26 sigmas off: its square alone would make the mean of 200 points more than four."""
    rng = np.random.default_rng(7)
    noisy = ridge + NOISE * rng.normal(size=(len(ridge), 1)) * looks_of(ridge)
    near = np.flatnonzero((np.linalg.norm(ridge - VERTEX, axis=1) < 0.004) & (ridge[:, 0] > 0.0015))[0]
    off = noisy.copy()
    off[near, 2] += 0.003
    before, after = row_of(noisy, looks_of(ridge)), row_of(off, looks_of(ridge))
    assert before[CHI2] == pytest.approx(1.0, abs=0.25)
    assert after[CHI2] < 1.8
    assert after[GAIN] == pytest.approx(before[GAIN], rel=0.2)  # nor does it speak for either


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_either_side_that_bows_is_told(ridge: Floats, side: float) -> None:
    """To a radius of 30 mm about an axis along the edge."""
    slope = np.abs(ridge[:, 0]) / np.cos(0.5 * TURN_60)
    inwards = np.where(side * ridge[:, 0] > 0.0, -(slope**2) / 0.06, 0.0)
    bowed = ridge + inwards[:, None] * looks_of(ridge)
    assert row_of(ridge, looks_of(ridge))[BOW] < 1e-6
    assert row_of(bowed, looks_of(ridge))[BOW] > 3.0


def test_how_round_an_edge_may_be_unseen_is_told_by_the_points_near_it_and_beside(ridge: Floats) -> None:
    """Three times the root of 1 / near + 1 / beside + 1 / beside, `near` within 1.2 mm of the edge along the slopes."""
    row = row_of(ridge, looks_of(ridge))
    inside = ridge[np.linalg.norm(ridge - VERTEX, axis=1) < RADIUS]
    slope = np.abs(inside[:, 0]) / np.cos(0.5 * TURN_60)
    n_near = np.sum(slope < WIDTH)
    beside = [np.sum((slope >= WIDTH) & (side * inside[:, 0] > 0.0)) for side in (-1.0, 1.0)]
    assert row[HIDDEN] == pytest.approx(3.0 * np.sqrt(1.0 / n_near + 1.0 / beside[0] + 1.0 / beside[1]), rel=1e-9)
    assert abs(row[ROUNDED]) < 1e-6


def test_where_nearly_all_of_a_side_lies_at_the_edge_nobody_knows_whether_it_is_round(ridge: Floats) -> None:
    """Three points are left beside it: fewer than make a plane."""
    rng = np.random.default_rng(8)
    own = on_own_side(np.append(rng.uniform(1e-4, 0.001, 30), [0.003, 0.004, 0.0035]), rng.uniform(-0.003, 0.003, 33))
    points = np.concatenate([ridge[ridge[:, 0] < 0.0], own])
    row = row_of(points, looks_of(points))
    assert np.isfinite(row[TURN])
    assert row[ROUNDED] == np.inf


def test_the_planes_of_the_row_are_those_of_all_points(ridge: Floats) -> None:
    """How round the edge is was told by planes of the points beside it: these are put back."""
    noisy = ridge + NOISE * np.random.default_rng(9).normal(size=(len(ridge), 1)) * looks_of(ridge)
    row = row_of(noisy, looks_of(ridge))
    assert row[ACTIVE] @ row[CREST] == pytest.approx(-row[OVER], abs=1e-12)
    along = np.cross(row[ACTIVE], row[OTHER])
    assert row[CREST] @ along == pytest.approx(0.0, abs=1e-12)


def test_a_wave_is_followed_by_the_smooth_patch_across_its_crest() -> None:
    """12 mm long and 1 mm high: of second degree across, and of fourth along, the patch leaves 155 variances more."""
    rng, steps = np.random.default_rng(3), np.arange(-0.01, 0.01, 0.001)
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, a.size) for a in np.meshgrid(steps, steps))
    k = 2.0 * np.pi / 0.012
    normals = np.column_stack([0.001 * k * np.sin(k * x), np.zeros(len(x)), np.ones(len(x))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    values = np.column_stack([x, y, 0.001 * np.cos(k * x) - 0.001, normals, np.ones(len(x))]).T.copy()
    row, up = np.full(N_VALUES, np.nan), np.array([0.0, 0.0, 1.0])
    look_for_roof(values, len(x), np.array([3e-4, 0.0, 0.0]), up, (0.005, WIDTH), 2e-5, window_room(len(x)), row)
    assert row[GAIN] < -150.0


@pytest.mark.parametrize("degrees", [60.0, 90.0])
def test_noise_of_several_spacings_does_not_lift_the_planes(degrees: float) -> None:
    """Points that it carries over the edge, 1 mm apart with 3 mm of noise, lifted them by 0.11 and 0.24 mm, 1.9 and 2.6
    times what was stated."""
    half, noise = 0.5 * np.radians(degrees), 0.003
    vertex, up = 0.004 * np.array([np.cos(half), 0.0, -np.sin(half)]), np.array([np.sin(half), 0.0, np.cos(half)])
    over, sigma = [], []
    for seed in range(24):
        rng = np.random.default_rng(500 + seed)
        s, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(-0.05, 0.05, 0.001)] * 2))
        s, y = (values + rng.uniform(-3e-4, 3e-4, s.size) for values in (s, y))
        looks = np.column_stack([np.sign(s) * np.sin(half), np.zeros_like(s), np.full_like(s, np.cos(half))])
        points = np.column_stack([s * np.cos(half), y, -np.abs(s) * np.sin(half)])
        points += noise * rng.normal(size=(len(s), 1)) * looks
        values, row = np.column_stack([points, looks, np.ones(len(s))]).T.copy(), np.full(N_VALUES, np.nan)
        look_for_roof(values, len(s), vertex, up, (0.04, 0.012), noise, window_room(len(s)), row)
        over.append(-row[OVER])
        sigma.append(row[UNIT] * noise)
    assert abs(np.mean(over)) < 0.09e-3
    assert np.sqrt(np.mean(np.square(over)) / np.mean(np.square(sigma))) < 1.3
