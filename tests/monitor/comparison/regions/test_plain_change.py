"""What changed plainly does not teach the noise: a boss that moved, whose edges are all there are, is told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from monitor.comparison import compare
from monitor.comparison.distances.both_ways import make_shells, measure_sides
from monitor.comparison.distances.side import Side
from monitor.comparison.regions.plain_change import changed_plainly
from monitor.reconstruction import reconstruct
from monitor.registration import register
from projects.model import Assessment, Comparison, NotAssessed, PointCloud, Registration, Surface

WIDE, SPACING, NOISE = 0.12, 1e-3, 3e-4  # m, of the sheet with the boss and of its points
ROUND, HIGH, WALL, MOVED = 0.015, 0.006, 0.004, 0.002  # m, of the boss: its radius, height, slope, and how far it moved
N, EDGE = 101, 2e-3  # vertices along the sheets of the places, m between them
RADIUS, SURE = 0.008, 5e-5  # m, of places that changed; one sigma as stated of each surface
MIDDLES = {
    "deep": (0.04, 0.04), "half up, half less down": (0.04, 0.1), "just plain": (0.04, 0.16), "spike": (0.1, 0.04),
    "not quite": (0.1, 0.1), "high, scans disagree": (0.1, 0.16), "seen once": (0.16, 0.1),
}  # m  # fmt: skip
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
    assert list(found["kind"]) == ["moved", "moved"]
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


def disc(places: np.ndarray, middle: tuple[float, float], radius: float = RADIUS) -> np.ndarray:
    """Return which places (n, 2) lie about a middle."""
    return np.hypot(places[:, 0] - middle[0], places[:, 1] - middle[1]) < radius


def change_at(places: np.ndarray) -> np.ndarray:
    """Return the change (n,) [m] at places (n, 2), named as in `MIDDLES`."""
    right = places[:, 0] > MIDDLES["half up, half less down"][0]
    out = 8.0 * disc(places, MIDDLES["deep"]) - 8.0 * disc(places, MIDDLES["high, scans disagree"])
    out += np.where(right, 4.0, -2.4) * disc(places, MIDDLES["half up, half less down"])
    out += 3.6 * disc(places, MIDDLES["just plain"]) + 2.4 * disc(places, MIDDLES["not quite"])
    out += 8.0 * disc(places, MIDDLES["spike"], 0.6 * EDGE) + 8.0 * disc(places, MIDDLES["seen once"])
    return np.sqrt(2.0) * SURE * out


def sheet(rng: np.random.Generator, share: float) -> Surface:
    """Return a sheet on which so large a share of the change has happened."""
    x, y = (a.ravel() * EDGE for a in np.meshgrid(np.arange(N), np.arange(N), indexing="ij"))
    z = share * change_at(np.c_[x, y]) + 0.2 * SURE * rng.normal(size=len(x))
    shared = np.where(disc(np.c_[x, y], MIDDLES["high, scans disagree"], 2.0 * RADIUS), 8.0 * SURE, 0.0)
    return Surface(np.c_[x, y, z], faces_of_sheet(), sigma=np.full(len(x), SURE), sigma_shared=shared)


def faces_of_sheet() -> np.ndarray:
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    return np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])


def points(rng: np.random.Generator, share: float, height: float = 0.0) -> np.ndarray:
    places = rng.uniform(0.0, EDGE * (N - 1), (40_000, 2))
    return np.c_[places, height + share * change_at(places) + SURE * rng.normal(size=len(places))]


def known_motion(T: np.ndarray) -> Registration:
    return Registration(T, np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(N * N, dtype=bool))  # fmt: skip


def measured(before: Surface, after: Surface, height: float) -> tuple[Side, Side]:
    """Return both sides, what was seen once left out of the first; a height that all was lifted by stays in them."""
    T = np.eye(4)
    T[2, 3] = -height
    left = known_motion(T) if height else None
    first, second = measure_sides(make_shells(before, after, LIMITS), known_motion(T), left)
    hidden = disc(first.surface.vertices[:, :2], MIDDLES["seen once"], 2.0 * RADIUS)
    unknown = dataclasses.replace(first, sigma_surfaces=np.where(hidden, np.nan, first.sigma_surfaces))
    return unknown.without(hidden, NotAssessed.NOT_SEEN), second


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("height", [0.0, 0.004])
def test_plain_is_what_changed_and_not_what_moved_with_the_whole(rng: np.random.Generator, height: float) -> None:
    """The later sheet as a whole lies higher, by more than any place changed, and the distances hold it."""
    before, after = sheet(rng, 0.0), sheet(rng, 1.0)
    raised = dataclasses.replace(after, vertices=after.vertices + np.array([0.0, 0.0, height]))
    sides = measured(before, raised, height)
    found = changed_plainly(sides, lambda: (points(rng, 0.0), points(rng, 1.0, height)), LIMITS)
    for side, is_plain in zip(sides, found, strict=True):
        places = side.surface.vertices[:, :2]
        share = {name: is_plain[disc(places, middle)].mean() for name, middle in MIDDLES.items()}
        assert min(share[name] for name in ("deep", "just plain")) > 0.95, share
        half = disc(places, MIDDLES["half up, half less down"]), places[:, 0] > MIDDLES["deep"][0] + 0.5 * EDGE
        assert is_plain[half[0] & half[1]].mean() > 0.95
        assert not is_plain[half[0] & ~half[1]].any()
        assert max(share[name] for name in ("not quite", "high, scans disagree", "spike", "seen once")) == 0.0, share
        assert not is_plain[np.all([~disc(places, m, 1.5 * RADIUS) for m in MIDDLES.values()], axis=0)].any()
    for earlier, later in ((0.0, 0.0), (1.0, 1.0), (0.0, 0.4)):
        shown = points(rng, earlier), points(rng, later, height)
        assert not any(p.any() for p in changed_plainly(sides, lambda shown=shown: shown, LIMITS)), (earlier, later)
    assert not any(p.any() for p in changed_plainly(sides, lambda: (None, points(rng, 1.0, height)), LIMITS))


def erring(rng: np.random.Generator, error: np.ndarray, sigma: np.ndarray | None) -> tuple[Surface, np.ndarray]:
    """Return a flat sheet that errs by `error` (N, N) [m], in its surface and in the points that it was made of."""
    axis = np.arange(N) * EDGE
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    places = rng.uniform(0.0, axis[-1], (40_000, 2))
    high = RegularGridInterpolator((axis, axis), error)(places) + SURE * rng.normal(size=len(places))
    z = error.ravel() + 0.5 * SURE * rng.normal(size=len(x))
    return Surface(np.c_[x, y, z], faces_of_sheet(), sigma=sigma), np.c_[places, high]


def compare_erring(rng: np.random.Generator, errors: tuple[np.ndarray, np.ndarray], states: bool = True) -> Comparison:
    """Compare two sheets on which nothing changed but their errors (N, N) [m]."""
    sigma = np.full(N * N, SURE) if states else None
    (before, first), (after, second) = (erring(rng, error, sigma) for error in errors)
    return compare(before, after, known_motion(np.eye(4)), points=lambda: (first, second))


@pytest.mark.parametrize(("times", "states"), [(2.0, True), (5.0, True), (2.0, False)])
def test_what_scans_err_by_is_no_plain_change_where_it_is_more_than_stated(
    rng: np.random.Generator, times: float, states: bool
) -> None:
    """It is in the points as well, and agrees over several vertices."""
    fields = [gaussian_filter(rng.normal(size=(N, N)), 2.0, mode="wrap") for _ in range(2)]
    found = compare_erring(rng, tuple(f * times * SURE / f.std() for f in fields), states)
    assert not len(found.regions)
    level = 1.96 * np.sqrt(2.0) * SURE * np.hypot(times, 0.5)
    assert found.statistics["lod95_median_m"] == pytest.approx(level, rel=0.15)


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_what_is_lifted_all_over_or_on_much_of_an_object_still_teaches(rng: np.random.Generator, share: float) -> None:
    """Nothing tells it from an error of the motion, or of a scan."""
    lifted = np.where(np.arange(N)[:, None] < share * N, 8.0 * SURE, 0.0) * np.ones(N)
    surface, first = erring(rng, np.zeros((N, N)), np.full(N * N, SURE))
    raised, second = erring(rng, lifted, np.full(N * N, SURE))
    sides = measure_sides(make_shells(surface, raised, LIMITS), known_motion(np.eye(4)))
    assert not any(is_plain.any() for is_plain in changed_plainly(sides, lambda: (first, second), LIMITS))


def test_what_is_small_is_plain_beside_a_piece_that_is_not_for_being_wide(rng: np.random.Generator) -> None:
    """A crust that was taken off three tenths of an object teaches, the hole that was filled beside it does not."""
    axis = np.arange(N) * EDGE
    x, y = np.meshgrid(axis, axis, indexing="ij")
    wide, hole = x < 0.3 * axis[-1], np.hypot(x - 0.14, y - 0.1) < 1.5 * RADIUS
    surface, first = erring(rng, np.zeros((N, N)), np.full(N * N, SURE))
    changed, second = erring(rng, np.where(wide, -8.0 * SURE, 0.0) + np.where(hole, 12.0 * SURE, 0.0),
                             np.full(N * N, SURE))  # fmt: skip
    sides = measure_sides(make_shells(surface, changed, LIMITS), known_motion(np.eye(4)))
    for is_plain in changed_plainly(sides, lambda: (first, second), LIMITS):
        assert is_plain[hole.ravel()].mean() > 0.9
        assert not is_plain[wide.ravel()].any()
