"""What changed plainly does not teach the noise: a boss that moved, whose edges are all there are, is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.epochs import make_shells, measure_sides
from monitor.comparison.plain_change import changed_plainly
from monitor.reconstruction import reconstruct
from monitor.registration import register
from projects.model import Assessment, Comparison, PointCloud, Registration, Surface

WIDE, SPACING, NOISE = 0.12, 1e-3, 3e-4  # m, of the sheet with the boss and of its points
ROUND, HIGH, WALL, MOVED = 0.015, 0.006, 0.004, 0.002  # m, of the boss: its radius, height, slope, and how far it moved
N, EDGE = 101, 2e-3  # vertices along the sheets of the places, m between them
RADIUS, DEPTH, SURE = 0.008, 0.0006, 5e-5  # m, of places that changed, by how much, up and down in turn; sigma
MIDDLES = [(0.05, 0.05), (0.05, 0.15), (0.15, 0.05), (0.15, 0.15)]  # m
LIMITS = (0.02, np.radians(60.0))  # m, rad


def scan_boss(rng: np.random.Generator, at: float) -> PointCloud:
    """Return what was measured from above of a bumpy sheet with a boss, `at` (m) from the middle."""
    n = round(WIDE / SPACING)
    g = (np.arange(n) + 0.5 - n / 2) * SPACING
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, n * n) for a in np.meshgrid(g, g))
    boss = HIGH * np.clip((ROUND - np.hypot(x - at, y)) / WALL, 0.0, 1.0)
    z = 0.002 * np.sin(x / 0.02) * np.cos(y / 0.03) + boss + NOISE * rng.normal(size=len(x))
    return PointCloud(np.c_[x, y, z], origins=np.array([0.0, 0.0, 2.0]))


def compare_bosses(rng: np.random.Generator, moved: float, shown: float) -> Comparison:
    """Compare two epochs of the boss, of which the surfaces say that it `moved` (m), and the points that it did so by
    what is `shown` (m)."""
    clouds = scan_boss(rng, 0.0), scan_boss(rng, moved)
    before, after = (reconstruct(cloud) for cloud in clouds)
    measured = clouds[0].points, clouds[1].points if shown == moved else scan_boss(rng, shown).points
    return compare(before, after, register(after, before), points=lambda: measured)


@pytest.mark.parametrize("seed", [5, 6])
def test_a_boss_that_moved_is_told_though_no_other_edges_tell_how_edges_err(seed: int) -> None:
    found = compare_bosses(np.random.default_rng(seed), MOVED, MOVED).regions.sort_values("mean_m")
    assert len(found) == 2
    lost, gained = found.iloc[0], found.iloc[1]
    crescent = 0.72 * (ROUND - 0.5 * WALL)  # the middle of an arc of 150 degrees halfway up the slope
    assert lost["x"] == pytest.approx(0.5 * MOVED - crescent, abs=0.0015)
    assert gained["x"] == pytest.approx(0.5 * MOVED + crescent, abs=0.0015)
    steep = MOVED * np.sin(np.arctan(HIGH / WALL))  # along the normal of its slope
    for region in (lost, gained):
        assert abs(region["extreme_m"]) == pytest.approx(steep, abs=4e-4)


@pytest.mark.parametrize(("moved", "shown"), [(0.0, 0.0), (MOVED, 0.0)])
def test_what_stands_still_or_is_not_in_the_points_is_no_change(moved: float, shown: float) -> None:
    found = compare_bosses(np.random.default_rng(5), moved, shown)
    assert not len(found.regions)
    assert not (found.on_compared.assessment == Assessment.CHANGED).any()


def change_at(places: np.ndarray) -> np.ndarray:
    """Return the change (n,) [m] at places (n, 2)."""
    away = np.stack([np.hypot(places[:, 0] - x, places[:, 1] - y) for x, y in MIDDLES])
    return np.where(away.min(axis=0) < RADIUS, DEPTH * (-1.0) ** away.argmin(axis=0), 0.0)


def sheet(rng: np.random.Generator, share: float) -> Surface:
    """Return a sheet on which so large a share of the change has happened."""
    x, y = (a.ravel() * EDGE for a in np.meshgrid(np.arange(N), np.arange(N), indexing="ij"))
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])
    z = share * change_at(np.c_[x, y]) + 0.5 * SURE * rng.normal(size=len(x))
    return Surface(np.c_[x, y, z], faces, sigma=np.full(len(x), SURE))


def points(rng: np.random.Generator, share: float, height: float = 0.0) -> np.ndarray:
    places = rng.uniform(0.0, EDGE * (N - 1), (20_000, 2))
    return np.c_[places, height + share * change_at(places) + 2.0 * SURE * rng.normal(size=len(places))]


@pytest.mark.parametrize("height", [0.0, 0.004])
def test_plain_is_what_changed_and_not_what_moved_with_the_whole(rng: np.random.Generator, height: float) -> None:
    """The later sheet as a whole lies higher, by more than any place changed, and the distances hold it."""
    T = np.eye(4)
    T[2, 3] = -height
    before, after = sheet(rng, 0.0), sheet(rng, 1.0)
    raised = dataclasses.replace(after, vertices=after.vertices + np.array([0.0, 0.0, height]))
    known = Registration(T, np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(len(before.vertices), dtype=bool))  # fmt: skip
    sides = measure_sides(make_shells(before, raised, LIMITS), known, known if height else None)
    found = changed_plainly(sides, lambda: (points(rng, 0.0), points(rng, 1.0, height)), LIMITS)
    for side, is_plain in zip(sides, found, strict=True):
        there = change_at(side.surface.vertices[:, :2]) != 0.0
        assert is_plain[there & side.is_assessed].all()
        assert is_plain[~there].mean() < 0.02  # the slopes around
    for earlier, later in ((0.0, 0.0), (1.0, 1.0), (0.0, 0.4)):
        shown = points(rng, earlier), points(rng, later, height)
        assert not any(p.any() for p in changed_plainly(sides, lambda shown=shown: shown, LIMITS)), (earlier, later)
    assert not any(p.any() for p in changed_plainly(sides, lambda: (None, points(rng, 1.0, height)), LIMITS))
