"""A bar before a plate, which one epoch has no surface of: lost where a scan looked on to the plate, else not seen."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.sight.stations import StationSight, gather_sight
from monitor.simulation.scenes import grid_faces
from projects.model import Assessment, NotAssessed, Registration, Surface

NOISE = 1e-4  # m
GAP = 0.03  # m, of the bar before the plate
KNOWN = Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-5] * 3) ** 2, np.zeros(3), True, stable_share=1.0)


def sheet(rng: np.random.Generator, half: tuple[float, float], height: float) -> Surface:
    """Return a rectangle of 2 `half` [m] that looks along z, its vertices every 4 mm."""
    x, y = (np.arange(-h, h + 1e-9, 0.004) for h in half)
    u, v = (g.ravel() for g in np.meshgrid(x, y, indexing="ij"))
    z = height + rng.normal(0.0, NOISE, len(u))
    return Surface(np.column_stack([u, v, z]), grid_faces(len(x), len(y)), sigma=np.full(len(u), NOISE))


def with_bar(rng: np.random.Generator) -> Surface:
    """Return the plate with a bar of 80 x 200 mm before it, behind which nothing is known of the plate."""
    plate, bar = sheet(rng, (0.3, 0.2), 0.0), sheet(rng, (0.04, 0.1), GAP)
    hidden = (np.abs(plate.vertices[:, :2]) < [0.041, 0.101]).all(axis=1)
    kept = plate.faces[~hidden[plate.faces].any(axis=1)]
    return Surface(np.concatenate([plate.vertices, bar.vertices]),
                   np.concatenate([kept, bar.faces + len(plate.vertices)]),
                   sigma=np.full(len(plate.vertices) + len(bar.vertices), NOISE))  # fmt: skip


def look(at: float, before: float | None) -> StationSight:
    """Return the sight of a station 2 m before the plate, `at` [m] beside: of the plate, and of something 0.25 x 0.4 m
    `before` it, if any."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-0.5, 0.5, 0.002), np.arange(-0.3, 0.3, 0.002)))
    origin = np.array([at, 0.0, 2.0])
    points = np.column_stack([x, y, np.zeros(len(x))])
    if before is not None:
        nearer = origin + (points - origin) * (1.0 - before / 2.0)
        points = np.where((np.abs(nearer[:, :2]) < [0.125, 0.2]).all(axis=1)[:, None], nearer, points)
    sight = gather_sight(origin, [points])
    assert sight is not None
    return sight


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(("before", "n_regions"), [(None, 1), (GAP, 0), (0.1, 0)])
def test_a_bar_is_gone_only_where_a_scan_looked_on(rng, before, n_regions, swapped) -> None:
    """Its points were dropped in the other epoch (something was measured at the bar), or something hid it."""
    epochs, sights = (with_bar(rng), sheet(rng, (0.3, 0.2), 0.0)), ([look(0.0, GAP)], [look(0.3, before)])
    if swapped:
        epochs, sights = epochs[::-1], sights[::-1]
    result = compare(*epochs, KNOWN, sights=sights)
    assert result.regions.kind.tolist() == ["added" if swapped else "lost"] * n_regions
    if n_regions:  # with its rim, which has no counterpart
        assert result.regions.area_m2[0] == pytest.approx(0.08 * 0.2, rel=0.02)
    side = result.on_compared if swapped else result.on_reference
    middle = (np.abs(side.surface.vertices[:, :2]) < [0.03, 0.09]).all(axis=1) & (side.surface.vertices[:, 2] > 0.02)
    state, reason = (
        (Assessment.CHANGED, NotAssessed.ASSESSED) if n_regions else (Assessment.NOT_ASSESSABLE, NotAssessed.NOT_SEEN)
    )
    assert (side.assessment[middle] == state).all()
    assert (side.reasons[middle] == reason).all()


def test_without_sights_what_lies_behind_stands_for_what_is_left(rng) -> None:
    assert compare(with_bar(rng), sheet(rng, (0.3, 0.2), 0.0), KNOWN).regions.kind.tolist() == ["lost"]
