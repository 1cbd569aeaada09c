"""What lies off a surface: counted where it is nearest, against counts by hand, and left out of comparisons."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ivy_wall import IVY, processed

from monitor.comparison import CompareSettings, compare
from monitor.measured import RawScan
from monitor.simulation.campaign import write_extent
from monitor.strays import FINEST, N_STEPS, REACH, share_of_strays, usual_sigma
from projects.errors import ComparisonError
from projects.model import Floats, NotAssessed, Registration, Surface

SIDE, EDGE = 21, 0.01
MIDDLE = SIDE * SIDE // 2


def plate(side: int = SIDE, **known: Floats) -> Surface:
    """Return a level grid of side x side vertices, EDGE apart, about the origin."""
    i = np.arange((side - 1) * side).reshape(side - 1, side)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + side, i + 1], np.c_[i + 1, i + side, i + side + 1]])
    x, y = np.divmod(np.arange(side * side), side) - np.array([[side // 2], [side // 2]])
    return Surface(np.c_[EDGE * x, EDGE * y, np.zeros(x.shape)], faces, **known)


def above(surface: Surface, vertex: int, heights: Floats) -> Floats:
    """Return points at heights above a vertex, a thousandth of an edge beside it."""
    return surface.vertices[vertex] + np.c_[np.full((len(heights), 2), 1e-3 * EDGE), heights]


def around(vertex: int) -> set[int]:
    """Return a vertex and its six neighbours."""
    return {vertex, *(vertex + d for d in (1, -1, SIDE, -SIDE, SIDE - 1, 1 - SIDE))}


def shares(surface: Surface, points: Floats, noise: float = 1e-5) -> Floats:
    found = share_of_strays(surface, [RawScan(noise, [points])])
    assert found is not None
    return found


def test_points_count_where_their_foot_is_and_for_those_two_edges_around() -> None:
    surface = plate()
    share = shares(surface, above(surface, MIDDLE, np.array([0.0, 1e-3, -1e-3, 8e-3])))
    reached = set().union(*(around(v) for v in around(MIDDLE)))
    assert set(np.flatnonzero(np.isfinite(share))) == reached
    assert len(reached) == 19
    np.testing.assert_allclose(share[list(reached)], 0.25)


def test_nearer_points_count_more_often() -> None:
    surface = plate()
    on, off = above(surface, MIDDLE + 1, np.zeros(1)), above(surface, MIDDLE, np.array([8e-3]))
    share = shares(surface, np.vstack([on, off]))
    # a vertex is reached from itself in 7 ways of two steps or fewer, from a neighbour in 4 (stay twice, two shared)
    assert share[MIDDLE] == pytest.approx(7.0 / 11.0)
    assert share[MIDDLE + 1] == pytest.approx(4.0 / 11.0)
    assert share[MIDDLE - 2] == 1.0  # two edges from the one, three from the other
    assert share[MIDDLE + 3] == 0.0


@pytest.mark.parametrize(("height", "noise", "share"), [
    (0.24 * EDGE, 1e-5, 0.0), (0.26 * EDGE, 1e-5, 0.5), (-0.26 * EDGE, 1e-5, 0.5),
    (0.39 * EDGE, 0.1 * EDGE, 0.0), (0.41 * EDGE, 0.1 * EDGE, 0.5),  # four sigmas of noise
    (2.4 * EDGE, 1e-5, 0.5), (2.6 * EDGE, 1e-5, 0.0),  # farther it is of something else
    (3.1 * EDGE, 0.4 * EDGE, 0.5), (3.3 * EDGE, 0.4 * EDGE, 0.0),  # than twice what is off
])  # fmt: skip
def test_off_is_farther_than_a_quarter_edge_and_four_sigmas_within_reach(
    height: float, noise: float, share: float
) -> None:
    surface = plate()
    found = shares(surface, above(surface, MIDDLE, np.array([0.0, height])), noise)
    assert found[MIDDLE] == pytest.approx(share)


def test_what_lies_beside_the_surface_is_not_off_it() -> None:
    surface = plate()
    rim = -(SIDE // 2) * EDGE
    beside = np.array([[rim - 5e-3, 0.0, 4e-3], [rim - 4e-3, 1e-3, 0.0], [rim + 1e-3, 0.0, 0.0]])
    share = shares(surface, beside)
    assert np.nanmax(share) == 0.0
    assert np.isfinite(share).sum() == 12  # within two edges of one vertex on the rim


def test_scans_add_up_each_by_its_own_noise() -> None:
    surface = plate()
    scans = [RawScan(1e-5, [above(surface, MIDDLE, np.array([0.0, 3.5e-3]))]),
             RawScan(1e-3, [above(surface, MIDDLE, np.array([0.0, 3.5e-3]))])]  # fmt: skip
    share = share_of_strays(surface, scans)
    assert share is not None
    assert share[MIDDLE] == pytest.approx(0.25)


def known_motion(n: int) -> Registration:
    return Registration(np.eye(4), np.eye(6) * 1e-14, np.zeros(3), True, is_stable=np.ones(n, bool))


def compared(own: Floats | None, other: Floats | None, most: float = 0.5):
    n = SIDE * SIDE
    rng = np.random.default_rng(5)
    surfaces = []
    for share in (own, other):
        level = plate(sigma=np.full(n, 1e-4), stray_share=share)
        height = 1e-4 * rng.normal(size=n)
        surfaces.append(replace(level, vertices=level.vertices + np.c_[np.zeros((n, 2)), height]))
    return compare(*surfaces, known_motion(n), CompareSettings(max_stray_share=most, search_limit=5e-3))


def at(vertex: int, share: float) -> Floats:
    out = np.zeros(SIDE * SIDE)
    out[vertex] = share
    return out


@pytest.mark.parametrize(("own", "other", "most", "reason"), [
    (0.9, 0.12, 0.5, NotAssessed.NO_ONE_SURFACE), (0.12, 0.9, 0.5, NotAssessed.NO_ONE_SURFACE),
    (0.9, 0.08, 0.5, NotAssessed.UNEXPLAINED), (0.08, 0.9, 0.5, NotAssessed.UNEXPLAINED),
    (0.5, 0.2, 0.5, NotAssessed.ASSESSED), (0.9, 0.9, 1.0, NotAssessed.ASSESSED),
    (0.9, None, 0.5, NotAssessed.ASSESSED), (None, 0.9, 0.5, NotAssessed.ASSESSED),
    (0.9, np.nan, 0.5, NotAssessed.ASSESSED),
])  # fmt: skip
def test_where_most_lies_off_both_surfaces_neither_side_is_assessed(
    own: float | None, other: float | None, most: float, reason: NotAssessed
) -> None:
    """Where it lies off one of them alone, and nothing is told to have changed, nobody knows what it shows."""
    vertex, is_left_out = MIDDLE + 3, reason != NotAssessed.ASSESSED
    found = compared(*(None if share is None else at(vertex, share) for share in (own, other)), most)
    for side in (found.on_reference, found.on_compared):
        told = (NotAssessed.NO_ONE_SURFACE, NotAssessed.UNEXPLAINED)
        assert np.flatnonzero(np.isin(side.reasons, told)).tolist() == [vertex] * is_left_out
        assert side.reasons[vertex] == reason
        assert np.isnan(side.distances[vertex]) == is_left_out
        assert (side.assessment[vertex] == 0) == is_left_out
    assert found.statistics["not_assessed"]["no_one_surface"] == (reason == NotAssessed.NO_ONE_SURFACE)
    assert found.statistics["not_assessed"]["unexplained"] == (reason == NotAssessed.UNEXPLAINED)


def test_where_nothing_is_of_one_surface_the_refusal_says_so() -> None:
    everywhere = np.full(SIDE * SIDE, 0.9)
    with pytest.raises(ComparisonError, match=r"no_one_surface 289.*compare\.max_stray_share"):
        compared(everywhere, everywhere)


@pytest.mark.parametrize("is_wide", [True, False])
def test_what_scatters_widely_is_the_materials_own_what_scatters_narrowly_is_not(
    rng: np.random.Generator, is_wide: bool
) -> None:
    side, sigma, each = 120, 0.5 * EDGE, 8
    surface = plate(side)
    x, y = surface.vertices[:, :2].T
    way = np.hypot(x, y)
    is_dark = x < 0.0 if is_wide else way < 5.0 * EDGE
    inner = x < -30.0 * EDGE if is_wide else way < 2.0 * EDGE
    beside = rng.uniform(-0.4, 0.4, (each * side**2, 2)) * EDGE
    heights = rng.normal(size=each * side**2) * np.repeat(np.where(is_dark, sigma, 0.01 * EDGE), each)
    share = shares(surface, np.repeat(surface.vertices, each, axis=0) + np.c_[beside, heights])
    assert np.nanmax(share[(x > 15.0 * EDGE)]) == 0.0
    if is_wide:
        assert np.mean(share[inner]) < 1e-3  # beyond four sigmas, as they are there
    else:
        assert np.mean(share[inner]) == pytest.approx(0.617, abs=0.03)  # beyond half a sigma, which is a quarter edge


def test_what_is_usual_is_told_by_the_median_of_the_blocks_around() -> None:
    surface = plate(60)
    x = surface.vertices[:, 0]
    distances = np.where(x < 0.0, 1e-3, 4e-3)
    found = usual_sigma(surface.vertices, [(np.arange(len(x)), distances, 0.0)], EDGE)
    step = (2.0 * REACH / FINEST) ** (1.0 / (N_STEPS - 1))  # its distances are told in steps
    assert np.all(found[x < -0.15] >= 1.4826e-3)
    assert np.all(found[x < -0.15] <= 1.4826e-3 * step)
    assert np.all(found[x > 0.15] >= 4 * 1.4826e-3)
    assert np.all(found[x > 0.15] <= 4 * 1.4826e-3 * step)


def test_feet_on_invented_faces_do_not_count() -> None:
    surface = plate()
    points = above(surface, MIDDLE, np.array([0.0, 8e-3]))
    is_invented = np.zeros(len(surface.faces), bool)
    is_invented[(surface.faces == MIDDLE).any(axis=1)] = True
    assert np.isfinite(shares(surface, points)).any()
    assert share_of_strays(replace(surface, face_invented=is_invented), [RawScan(1e-5, [points])]) is None


def test_without_a_scan_nothing_is_known() -> None:
    assert share_of_strays(plate(), []) is None
    assert share_of_strays(plate(), [RawScan(1e-5, [np.array([[0.0, 0.0, 1.0]])])]) is None  # a metre away


def test_the_chain_counts_what_each_scan_measured(tmp_path: Path) -> None:
    surface = processed(tmp_path).get("wall", "e1", "surface")
    way = np.linalg.norm(surface.vertices[:, :2] - IVY, axis=1)
    assert surface.stray_share is not None
    assert np.mean(surface.stray_share[way < 0.02] > 0.5) > 0.9
    assert np.nanmax(surface.stray_share[way > 0.045]) == 0.0


@pytest.mark.parametrize(("top", "least", "most"), [(0.011, 0.0, 0.0), (0.05, 0.2, 1.0)])
def test_what_lies_outside_of_the_extent_is_no_stray(tmp_path: Path, top: float, least: float, most: float) -> None:
    box = write_extent(tmp_path / "box.json", np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, top]]))
    surface = processed(tmp_path, extent=box).get("wall", "e1", "surface")
    assert surface.stray_share is not None
    way = np.linalg.norm(surface.vertices[:, :2] - IVY, axis=1)
    assert least <= np.nanmax(surface.stray_share[way < 0.012]) <= most


def test_repeated_scans_drift_and_are_not_asked(tmp_path: Path) -> None:
    assert processed(tmp_path, "--repeated").get("wall", "e1", "surface").stray_share is None


def test_a_region_ends_where_the_points_are_of_no_one_surface() -> None:
    side, depth, half = 81, 2e-3, 8
    n, rng = side * side, np.random.default_rng(3)
    x, y = np.divmod(np.arange(n), side) - np.array([[side // 2], [side // 2]])
    raised = (np.abs(x) <= half) & (np.abs(y) <= half)
    share = np.where(raised & (y > 0), 0.9, 0.0)
    surfaces = []
    for lifted in (np.zeros(n), depth * raised):
        level = plate(side, sigma=np.full(n, 3e-5), stray_share=share)
        height = lifted + 3e-5 * rng.normal(size=n)
        surfaces.append(replace(level, vertices=level.vertices + np.c_[np.zeros((n, 2)), height]))
    found = compare(*surfaces, known_motion(n), CompareSettings(search_limit=5e-3))
    assert len(found.regions) == 1
    assert np.isnan(found.regions.volume_m3[0])  # how far it goes on where nothing is assessed is not known
    assert found.regions.area_m2[0] == pytest.approx((2 * half + 1) * (half + 1) * EDGE**2, rel=0.15)
    assert found.regions.mean_m[0] == pytest.approx(depth, rel=0.05)
