"""A region is one where the measured points show it: bumps of which the points of either epoch know, or do not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from monitor.comparison import compare
from monitor.comparison.regions import borne_out
from monitor.registration.motion.weights import draw_in, weighted_median
from projects.model import Assessment, Comparison, NotAssessed, Registration, Surface

SIDE, EDGE, HIGH, WIDE = 91, 2e-3, 2e-3, 0.016  # m: of the sheets; of the bump, its height and its radius
THICK = 5e-3  # m, of a plate
MIDDLE = 0.5 * (SIDE - 1) * EDGE


def bump(places: np.ndarray) -> np.ndarray:
    r2 = np.sum((places[:, :2] - MIDDLE) ** 2, axis=1) / WIDE**2
    return HIGH * np.clip(1.0 - r2, 0.0, None)


def grid(n: int, edge: float) -> np.ndarray:
    x, y = np.divmod(np.arange(n * n), n)
    return np.c_[edge * x, edge * y, np.zeros(n * n)]


def sheet(rng: np.random.Generator, height: float) -> Surface:
    """Return a sheet with a bump of so many times `HIGH`."""
    i = np.arange((SIDE - 1) * SIDE).reshape(SIDE - 1, SIDE)[:, :-1].ravel()
    vertices = grid(SIDE, EDGE)
    vertices[:, 2] = height * bump(vertices) + rng.normal(0.0, 5e-5, len(vertices))
    faces = np.vstack([np.c_[i, i + SIDE, i + 1], np.c_[i + 1, i + SIDE, i + SIDE + 1]])
    return Surface(vertices, faces, sigma=np.full(len(vertices), 5e-5))


def points(rng: np.random.Generator, height: float, sigma: float = 2e-4, hole: float = 0.0) -> np.ndarray:
    """Return what was measured, a point a square of 2.8 mm, none within `hole` (m) of the middle."""
    out = grid(64, 2.8e-3) + rng.normal(0.0, 3e-4, (64 * 64, 3)) * [1, 1, 0]
    out[:, 2] = height * bump(out) + rng.normal(0.0, sigma, len(out))
    return out[np.linalg.norm(out[:, :2] - MIDDLE, axis=1) >= hole]


MOTION = np.array([[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])


def compared_with(rng: np.random.Generator, clouds: tuple[np.ndarray | None, np.ndarray | None]) -> Comparison:
    """Compare a flat sheet with one that has a bump 2 mm high; the latter and its points lie elsewhere."""
    flat, bumpy = sheet(rng, 0.0), sheet(rng, 1.0)
    away = Surface(bumpy.vertices - MOTION[:3, 3], bumpy.faces, sigma=bumpy.sigma)
    known = Registration(MOTION, np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(len(flat.vertices), dtype=bool))  # fmt: skip
    before, after = clouds
    after = None if after is None else after - MOTION[:3, 3]
    return compare(flat, away, known, points=lambda: (before, after))


def test_a_bump_that_the_points_of_both_epochs_show_is_a_region(rng: np.random.Generator) -> None:
    found = compared_with(rng, (points(rng, 0.0), points(rng, 1.0)))
    assert list(found.regions["kind"]) == ["added"]
    truth = np.pi * WIDE**2 * HIGH / 2.0
    assert found.regions["volume_m3"][0] == pytest.approx(truth, rel=0.05)


@pytest.mark.parametrize(("case", "clouds"), [
    ("the points around lie on the reference", (0.0, 0.0, 0.0)),
    ("they show a third of it", (0.0, 1.0 / 3.0, 0.0)),
    ("no point of the later epoch lies there", (0.0, 1.0, 1.1 * WIDE)),
    ("the earlier epoch's points show the bump too", (1.0, 1.0, 0.0)),
])  # fmt: skip
def test_a_bump_that_the_points_do_not_show_is_no_region_and_not_assessed(
    rng: np.random.Generator, case: str, clouds: tuple[float, float, float]
) -> None:
    before, after, hole = clouds
    found = compared_with(rng, (points(rng, before), points(rng, after, hole=hole)))
    assert not len(found.regions), case
    for side in (found.on_reference, found.on_compared):
        there = np.linalg.norm(side.surface.vertices[:, :2] - MIDDLE, axis=1) < 0.7 * WIDE
        assert (side.assessment[there] == Assessment.NOT_ASSESSABLE).all()
        assert (side.reasons[there] == NotAssessed.TOO_UNCERTAIN).all()
        assert np.isnan(side.distances[there]).all()
        assert not side.region.any()
        assert (side.assessment == Assessment.UNCHANGED).mean() > 0.88
    assert found.statistics["n_changed"] == 0


def test_two_thirds_of_a_bump_bear_it_out(rng: np.random.Generator) -> None:
    assert len(compared_with(rng, (points(rng, 0.0), points(rng, 2.0 / 3.0))).regions) == 1


def test_an_epoch_without_points_is_not_asked(rng: np.random.Generator) -> None:
    assert len(compared_with(rng, (None, points(rng, 1.0))).regions) == 1
    assert len(compared_with(rng, (None, None)).regions) == 1
    assert not len(compared_with(rng, (None, points(rng, 0.0))).regions)


def test_stray_points_do_not_decide(rng: np.random.Generator) -> None:
    after = points(rng, 1.0)
    inside = np.flatnonzero(np.linalg.norm(after[:, :2] - MIDDLE, axis=1) < WIDE)
    strays = rng.choice(inside, len(inside) // 5, replace=False)
    after[strays, 2] -= 3e-3
    assert len(compared_with(rng, (points(rng, 0.0), after)).regions) == 1


def test_points_of_the_back_of_a_plate_say_nothing_of_its_front(rng: np.random.Generator) -> None:
    def both(surface: Surface) -> Surface:
        back = surface.vertices * [1, 1, 0] - [0, 0, THICK]
        faces = np.vstack([surface.faces, surface.faces[:, ::-1] + SIDE**2])
        return Surface(np.vstack([surface.vertices, back]), faces, sigma=np.full(2 * SIDE**2, 5e-5))

    before, after, on_back = points(rng, 0.0), points(rng, 1.0), grid(150, 1.2e-3) - [0, 0, THICK]
    known = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0)
    clouds = tuple(np.vstack([cloud, on_back]) for cloud in (before, after))
    found = compare(both(sheet(rng, 0.0)), both(sheet(rng, 1.0)), known, points=lambda: (clouds[0], clouds[1]))
    assert list(found.regions["kind"]) == ["added"]


def test_points_are_not_asked_for_where_nothing_has_changed(rng: np.random.Generator) -> None:
    def ask() -> tuple[None, None]:
        raise AssertionError("asked")

    known = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0)
    found = compare(sheet(rng, 0.0), sheet(rng, 0.0), known, points=ask)
    assert not len(found.regions)


def test_points_that_lie_off_their_own_surface_alike_in_both_epochs_hide_nothing(rng: np.random.Generator) -> None:
    for off in (-1e-3, 1e-3):  # as much as the bump changes on average: pits, or grains
        before, after = (points(rng, height) + np.array([0.0, 0.0, off]) for height in (0.0, 1.0))
        found = compared_with(rng, (before, after))
        assert len(found.regions) == 1, off


def test_points_on_two_sheets_in_both_epochs_bear_no_change_of_sheet_out(rng: np.random.Generator) -> None:
    """Spray, leaves, a joint: the earlier surface follows one sheet of what was measured, the later one the other."""
    both = tuple(np.vstack([points(rng, 0.0), points(rng, 1.0)]) for _ in range(2))
    assert not len(compared_with(rng, (both[0], both[1])).regions)


def rough(rng: np.random.Generator, height: float, n_side: int) -> np.ndarray:
    """Return points 6 mm apart on stone whose relief, 1.5 mm, no surface of theirs holds."""
    out = grid(n_side, 6e-3) + rng.uniform(-2e-3, 2e-3, (n_side**2, 3)) * [1, 1, 0]
    out[:, 2] = height * bump(out) + rng.normal(0.0, 1.5e-3, len(out))
    return out


def test_what_few_points_on_rough_stone_show_may_be_chance(rng: np.random.Generator) -> None:
    """Some 22 points an epoch show 1 mm in the mean, with 0.45 mm of standard error; a hundred times as many tell."""
    few = [len(compared_with(rng, (rough(rng, 0.0, 30), rough(rng, 1.0, 30))).regions) for _ in range(6)]
    assert sum(few) <= 3
    many = [np.vstack([rough(rng, height, 30) for _ in range(100)]) for height in (0.0, 1.0)]
    assert len(compared_with(rng, (many[0], many[1])).regions) == 1


def test_the_share_that_points_show_scatters_as_it_says(rng: np.random.Generator) -> None:
    areas, claim = rng.uniform(0.5, 2.0, 60), rng.uniform(0.5, 1.5, 60) * np.where(np.arange(60) < 50, 1.0, -1.0)
    vertex = np.repeat(np.arange(60), rng.integers(1, 6, 60))
    found = [borne_out._share_of(vertex, 0.8 * claim[vertex] + rng.normal(0.0, 2.0, len(vertex)), claim, areas)
             for _ in range(400)]  # fmt: skip
    share, variance = np.array(found).T
    assert share.mean() == pytest.approx(0.8, abs=4.0 * share.std() / 20.0)
    assert share.std() == pytest.approx(np.sqrt(variance.mean()), rel=0.12)
    assert borne_out._share_of(np.array([3]), np.array([1.0]), claim, areas)[1] == np.inf


def test_a_change_far_below_the_noise_of_single_points_is_borne_out_by_many(rng: np.random.Generator) -> None:
    """2 mm of bump, 4 mm of noise, 120 points a square centimetre."""

    def many(height: float) -> np.ndarray:
        return np.vstack([points(rng, height, sigma=4e-3) for _ in range(10)])

    assert len(compared_with(rng, (many(0.0), many(1.0))).regions) == 1
    assert not len(compared_with(rng, (many(0.0), many(0.0))).regions)


def test_where_points_are_dense_does_not_decide(rng: np.random.Generator) -> None:
    before, after = points(rng, 0.0), points(rng, 1.0)
    dense = MIDDLE + rng.uniform(-4e-3, 4e-3, (4000, 2)) + [0.6 * WIDE, 0.0]  # on a third of the bump, and flat there
    more = np.c_[dense, rng.normal(0.0, 2e-4, len(dense))]
    away = np.linalg.norm(after[:, :2] - MIDDLE - [0.6 * WIDE, 0.0], axis=1) > 6e-3
    assert len(compared_with(rng, (before, np.vstack([after[away], more]))).regions) == 1


def test_a_part_whose_counterpart_is_gone_was_lost_or_added(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(borne_out, "name_moved", lambda table, sides, regions: list(table["kind"]))
    table = pd.DataFrame({"kind": ["moved", "cleaned", "moved"], "mean_m": [-1e-3, -1e-3, 1e-3]})
    named = borne_out.name_anew(table, (None, None), (None, None))  # type: ignore[arg-type]
    assert list(named["kind"]) == ["lost", "cleaned", "added"]


def test_strays_are_drawn_in_to_three_sigmas() -> None:
    values = np.array([0.9, 1.0, 1.0, 1.1, 9.0])
    assert draw_in(values) == pytest.approx([0.9, 1.0, 1.0, 1.1, 1.0 + 3.0 * 1.4826 * 0.1])
    assert draw_in(np.array([1.0, 1.0, 1.0, 2.0])) == pytest.approx([1.0] * 4)  # no scatter is known


def test_half_of_the_weight_lies_below_the_median() -> None:
    assert weighted_median(np.array([1.0, 0.1, 0.8]), np.array([1.0, 2.0, 3.0])) == 0.8
    assert weighted_median(np.array([1.0, 0.1, 0.8]), np.array([1.0, 9.0, 3.0])) == 0.1
