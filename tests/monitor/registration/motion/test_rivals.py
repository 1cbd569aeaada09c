"""Surfaces that fit as well one step, one period or one flute away: told by the poses as given, or refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bumpy_body import move, noisy_cloud, unit
from network_of_caps import bumpy_cap, displaced

from monitor.registration import register
from monitor.registration.anywhere.coarse import register_from_anywhere
from monitor.registration.motion.held import Frames
from monitor.registration.network.adjustment import adjust_scans
from projects.model import Floats, PointCloud
from projects.transforms import apply, invert, perturb

PERIOD, HEIGHT = 0.05, 0.003  # m, of a relief 1.0 x 0.7 m wide
TREAD, RISE, N_STEPS = 0.28, 0.17, 10
N_FLUTES, RADIUS, DEPTH = 24, 0.2, 0.008
N = 15_000


def measured(points: Floats, normals: Floats, rng: np.random.Generator) -> PointCloud:
    """Return a cloud with noise of 0.3 mm."""
    lift = rng.normal(0, 3e-4, len(points))
    return PointCloud(points + normals * lift[:, None], unit(normals + rng.normal(0, 0.03, normals.shape)))


def relief(rng: np.random.Generator) -> PointCloud:
    """Return bosses every 50 mm on a panel."""
    xy, k = rng.uniform([0, 0], [1.0, 0.7], (N, 2)), 2 * np.pi / PERIOD
    x, y = xy.T * k
    slope = -HEIGHT * k * np.column_stack([np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)])
    points = np.column_stack([xy, HEIGHT * np.sin(x) * np.sin(y)])
    return measured(points, unit(np.column_stack([slope, np.ones(N)])), rng)


def stairs(rng: np.random.Generator, first: int = 0) -> PointCloud:
    """Return ten steps between two strings, from the step `first` on."""
    k, share, along = rng.integers(first, first + N_STEPS, N), rng.random((N, 2)), rng.uniform(0, 1.5, N)
    kind = rng.integers(0, 3, N)  # riser, tread, string
    x = TREAD * (k + np.where(kind == 0, 0.0, share[:, 0]))
    z = RISE * (k + np.where(kind == 1, 1.0, share[:, 1]))
    normals = np.array([[-1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])[kind]
    return measured(np.column_stack([x, np.where(kind == 2, 0.0, along), z]), normals, rng)


def column(rng: np.random.Generator) -> PointCloud:
    """Return a fluted drum of a column with its upper face."""
    turn, z = rng.uniform(0, 2 * np.pi, N), rng.uniform(0, 1.0, N)
    r, slope = RADIUS + DEPTH * np.cos(N_FLUTES * turn), -DEPTH * N_FLUTES * np.sin(N_FLUTES * turn)
    c, s = np.cos(turn), np.sin(turn)
    points, normals = np.column_stack([r * c, r * s, z]), np.column_stack([r * c + slope * s, r * s - slope * c, 0 * z])
    n = N // 6
    turn, r = rng.uniform(0, 2 * np.pi, n), (RADIUS - DEPTH) * np.sqrt(rng.uniform(0, 1, n))
    top = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.ones(n)])
    both = np.concatenate([points, top]), np.concatenate([unit(normals), np.tile([0.0, 0.0, 1.0], (n, 1))])
    return measured(*both, rng)


def shift(x: float, y: float, z: float) -> Floats:
    return perturb(np.eye(4), np.zeros(3), np.array([0, 0, 0, x, y, z]))


def flutes(n: float) -> Floats:
    return perturb(np.eye(4), np.zeros(3), np.array([0, 0, n * 2 * np.pi / N_FLUTES, 0.001, 0, 0]))


@pytest.mark.parametrize("share", [0.6, 1.0])
def test_a_relief_that_slips_by_a_period_is_refused(rng: np.random.Generator, share: float) -> None:
    found = register(move(relief(rng), shift(share * PERIOD, 0, 0.001)), relief(rng))
    assert not found.converged
    assert np.isnan(found.covariance).all()
    assert "local minimum" in found.reason
    assert "50 mm off, by a slide along (1.00, 0.00, 0.00)" in found.reason


def test_a_relief_given_within_half_a_period_is_registered_without_doubt(rng: np.random.Generator) -> None:
    truth, given = relief(rng), shift(0.4 * PERIOD, 0, 0.001)
    found = register(move(truth, given), relief(rng))
    assert found.converged
    assert not found.doubt
    assert np.abs(apply(found.T_target_source @ given, truth.points) - truth.points).max() < 3e-4


@pytest.mark.parametrize("share", [0.6, 1.0])
def test_a_stair_that_slid_by_a_step_is_refused_and_one_given_near_is_not(
    rng: np.random.Generator, share: float
) -> None:
    reference, compared = stairs(rng), stairs(rng)
    slid = register(move(compared, shift(share * TREAD, 0, share * RISE)), reference)
    assert not slid.converged
    assert "328 mm off, by a slide along (0.85, 0.00, 0.52)" in slid.reason
    near = register(move(compared, shift(0.01, 0, 0.01)), reference)
    assert near.converged
    assert not near.doubt


def test_control_tells_steps_apart_where_more_of_them_would_fit_elsewhere(rng: np.random.Generator) -> None:
    reference, compared = stairs(rng), stairs(rng, first=2)  # two steps down all ten of them fit, and wrongly so
    given = move(compared, shift(0.004, 0, 0.006))
    assert "655 mm off" in register(given, reference).reason
    frames = Frames(np.diag(np.array([1e-3, 1e-3, 1e-3, 0.002, 0.002, 0.002]) ** 2), np.array([1.4, 0.7, 0.8]))
    held = register(given, reference, frames=frames)
    assert held.converged, held.reason
    assert np.allclose(held.T_target_source, invert(shift(0.004, 0, 0.006)), atol=3e-4)


def test_flutes_are_told_by_the_pose_as_given_only_where_it_lies_near(rng: np.random.Generator) -> None:
    reference, compared = column(rng), column(rng)
    near = register(move(compared, flutes(0.04)), reference)
    assert near.converged
    assert "poses as given alone" in near.doubt
    assert "50 mm off, by a turn about the axis (0.00, 0.00, 1.00)" in near.doubt
    far = register(move(compared, flutes(0.6)), reference)
    assert not far.converged
    assert "ambiguous" in far.reason


def test_no_pose_as_given_tells_flutes_apart_where_the_start_was_found_otherwise(rng: np.random.Generator) -> None:
    reference, compared = column(rng), move(column(rng), shift(40.0, 3.0, 1.0))
    found = register(compared, reference, T_target_source=shift(-40.0, -3.0, -1.0), T_given=np.eye(4))
    assert not found.converged
    assert "the poses as given do not tell which is right" in found.reason
    by_shape, _ = register_from_anywhere(compared, reference)
    assert not by_shape.converged
    assert "poses as given alone" not in by_shape.doubt


def test_a_body_that_repeats_nothing_has_no_rival(rng: np.random.Generator) -> None:
    given = perturb(np.eye(4), np.zeros(3), np.array([0.03, 0.02, 0.01, 0.01, 0.0, 0.0]))
    found = register(move(noisy_cloud(N, rng), given), noisy_cloud(N, rng))
    assert found.converged
    assert not found.doubt


def two_scans(rng: np.random.Generator, steps: float) -> list[PointCloud]:
    """Return scans of the lower and the upper ten of fourteen steps, the second off by so many of them."""
    upper = shift(steps * TREAD + 0.002, 0.001, steps * RISE)
    return [stairs(rng), move(stairs(rng, first=4), upper)]


def test_a_scan_that_came_to_lie_a_step_off_is_refused_with_its_reason(rng: np.random.Generator) -> None:
    found = adjust_scans(two_scans(rng, 0.6))
    assert not found.converged
    assert not found.applied
    assert re.match("scan [12] fits the others as well elsewhere", found.reason)  # of two, either may have moved
    assert "328 mm off, by a slide along (0.85, 0.00, 0.52)" in found.reason


def test_a_scan_given_near_its_step_is_fitted_and_the_doubt_told(rng: np.random.Generator) -> None:
    found = adjust_scans(two_scans(rng, 0.0))
    assert found.applied
    way = found.motions[0][:3, 3] - found.motions[1][:3, 3]
    assert np.allclose(way, [0.002, 0.001, 0.0], atol=3e-4)
    assert "328 mm off" in found.doubt


def test_scans_that_repeat_nothing_have_no_doubt(rng: np.random.Generator) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0003) for turn in (0.0, 0.8, 1.6)]
    clouds[1] = displaced(clouds[1], shift(0.003, 0.0, 0.002))
    found = adjust_scans(clouds)
    assert found.applied
    assert not found.doubt
