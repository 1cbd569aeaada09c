"""Regions of change that a moved part explains are called so; its six parameters stand in the statistics."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bumpy_body import NOISE
from scipy.spatial import ConvexHull

from monitor.cli import run
from monitor.comparison import compare
from monitor.comparison.regions.beside_parts import changed_beside, tell_apart
from monitor.comparison.regions.moved_parts import doubt_which_stood, goes_along, tell_moved
from monitor.registration import register
from monitor.registration.parts import MovedPart, MovedParts, find_parts
from monitor.simulation.scenes import grid_faces
from projects import Project
from projects.errors import ParameterError
from projects.formats import write_ply_mesh
from projects.model import Z95, Assessment, ComparedSurface, Comparison, Floats, Registration, Surface
from projects.transforms import apply, perturb
from reports.facts import EpochFacts
from reports.wholemotion import parts_table

TOWARDS, HALF = np.array([0.94, 0.19, 0.28]) / np.linalg.norm([0.94, 0.19, 0.28]), 0.5
WORN = np.array([-0.34, -0.86, 0.38]) / np.linalg.norm([-0.34, -0.86, 0.38])
MOTION = np.array([0.01, -0.02, 0.015, 1e-3, 2e-3, -1e-3])


def body(n: int, rng: np.random.Generator, later: bool, worn: Floats = WORN, reach: float = 0.4,
         noise: float = NOISE) -> Surface:  # fmt: skip
    """Return a bumpy body of 0.6 m; later one part of it moved, and another place lost 3 mm, so far around [rad]."""
    shape = np.random.default_rng(5)
    waves, phases = shape.normal(size=(12, 3)) * 4, shape.uniform(0, 6.28, 12)
    d = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    radius = 0.3 * np.linalg.norm(d * [1.0, 0.8, 1.2], axis=1) + 0.008 * np.cos(d @ waves.T + phases).sum(axis=1)
    faces = ConvexHull(d).simplices
    inward = np.einsum("ij,ij->i", np.cross(d[faces[:, 1]] - d[faces[:, 0]], d[faces[:, 2]] - d[faces[:, 0]]),
                       d[faces[:, 0]]) < 0  # fmt: skip
    faces[inward] = faces[inward, ::-1]
    points = d * (radius + rng.normal(0, noise, n))[:, None]
    if later:
        angle = np.arccos(np.clip(d @ worn, -1, 1))
        points -= d * np.where(angle < reach, 1.5e-3 * (1 + np.cos(np.pi * angle / reach)), 0.0)[:, None]
        part = d @ TOWARDS > np.cos(HALF)
        points[part] = apply(perturb(np.eye(4), points[part].mean(axis=0), MOTION), points[part])
    return Surface(points, faces, sigma=np.full(n, noise))


@pytest.fixture(scope="module")
def measured() -> tuple[Comparison, MovedParts, Floats]:
    before, after = (body(12_000, np.random.default_rng(k), k > 0) for k in (0, 1))
    motion = register(after, before)
    found = compare(before, after, motion)
    parts = find_parts(after, before, motion, is_changed=found.on_compared.region > 0)
    return found, parts, after.vertices


@pytest.fixture(scope="module")
def told(measured: tuple[Comparison, MovedParts, Floats]) -> Comparison:
    return tell_moved(*measured)


def test_regions_of_the_part_are_called_moved_and_the_worn_place_lost(told: Comparison) -> None:
    places = told.regions[["x", "y", "z"]].to_numpy()
    towards = places / np.linalg.norm(places, axis=1)[:, None]
    kinds = told.regions["kind"].to_numpy()
    assert (kinds[towards @ TOWARDS > np.cos(HALF)] == "moved").all()
    assert (kinds[towards @ WORN > np.cos(0.4)] == "lost").all()
    assert {"moved", "lost"} <= set(kinds)


def test_a_region_set_apart_from_the_part_by_a_groove_is_its_motion_and_the_worn_place_is_not(
    told: Comparison, measured: tuple[Comparison, MovedParts, Floats]
) -> None:
    found, parts, vertices = measured
    (part,) = told.statistics["parts"]
    smallest = min(part["regions"], key=lambda number: found.regions["area_m2"][number - 1])
    apart = replace(parts, part_of=np.where(found.on_compared.region == smallest, 0, parts.part_of))
    again = tell_moved(found, apart, vertices)
    assert again.regions["kind"].tolist() == told.regions["kind"].tolist()
    assert again.statistics["parts"][0]["regions"] == part["regions"]


def test_the_part_stands_in_the_statistics_with_its_motion_and_regions(told: Comparison) -> None:
    (part,) = told.statistics["parts"]
    sigma: Floats = np.sqrt(np.diag(part["covariance"]))
    assert (np.abs(np.array(part["motion"])[:3] - MOTION[:3]) < 4 * sigma[:3] + 2e-4).all()
    moved = told.regions.loc[told.regions["kind"] == "moved", "region"].tolist()
    assert sorted(part["regions"]) == sorted(moved)


def test_a_part_is_no_surer_of_its_place_than_the_scans_that_saw_it(
    told: Comparison, measured: tuple[Comparison, MovedParts, Floats]
) -> None:
    found, parts, vertices = measured

    def stating(side: ComparedSurface, sigma: float) -> ComparedSurface:
        """Return a side whose scans disagree by so much [m] where the part is, and by ten times as much elsewhere."""
        towards = side.surface.vertices / np.linalg.norm(side.surface.vertices, axis=1)[:, None]
        shared = np.where(towards @ TOWARDS > np.cos(1.5 * HALF), sigma, 10.0 * sigma)
        return replace(side, surface=replace(side.surface, sigma_shared=shared))

    scans = {"error_scales_scans": [0.5], "error_steps_scans_m": [0.0]}
    sides = {"on_reference": stating(found.on_reference, 3e-4), "on_compared": stating(found.on_compared, 4e-4)}
    stated = replace(found, **sides, statistics={**found.statistics, **scans})
    (before,), (after,) = told.statistics["parts"], tell_moved(stated, parts, vertices).statistics["parts"]
    added = np.array(after["covariance"]) - before["covariance"]
    centre = np.array(before["centre"])
    width2 = np.mean(np.sum((found.on_compared.surface.vertices - centre) ** 2, axis=1))
    turn, shift = np.sqrt(np.diag(added)).reshape(2, 3)
    np.testing.assert_allclose(shift, 0.5 * 5e-4, rtol=1e-6)
    np.testing.assert_allclose(turn, 0.5 * 5e-4 / np.sqrt(width2), rtol=0.02)
    np.testing.assert_allclose(added - np.diag(np.diag(added)), 0.0, atol=1e-15)


def test_the_report_lists_the_part_with_its_shift_and_turn(told: Comparison) -> None:
    epochs = (EpochFacts("e1", "", "", "earlier"), EpochFacts("e2", "", "", "later"))
    table = parts_table(told, *epochs)
    assert table is not None
    (row,) = table.rows
    assert row[2].endswith("mm")
    still = body(12_000, np.random.default_rng(1), False).vertices  # as it stood before the part moved
    part = (still / np.linalg.norm(still, axis=1)[:, None]) @ TOWARDS > np.cos(HALF)
    centre = np.array(told.statistics["parts"][0]["centre"])
    shift = apply(perturb(np.eye(4), still[part].mean(axis=0), MOTION), centre) - centre
    value, _, margin, _ = row[2].split("\u00a0")
    assert float(value) == pytest.approx(1e3 * np.linalg.norm(shift), abs=2.0 * float(margin))  # about four sigmas
    assert float(margin) < 0.6
    assert float(row[6].split("°")[0]) == pytest.approx(np.degrees(np.linalg.norm(MOTION[:3])), abs=0.15)


def test_that_the_rest_stood_still_is_in_doubt_where_a_wide_part_moved(
    told: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a radian about a direction is 6 % of a sphere, 0.8 are 15 %."""
    assert doubt_which_stood(told).registration.doubt == told.registration.doubt
    monkeypatch.setattr(sys.modules[__name__], "HALF", 0.8)
    before, after = (body(12_000, np.random.default_rng(1 + k), k > 0) for k in range(2))
    motion = register(after, before)
    found = compare(before, after, replace(motion, doubt="scales differ"))
    parts = find_parts(after, before, motion, None, found.on_compared.is_changed, found.on_compared.lod95 / Z95)
    doubt = doubt_which_stood(tell_moved(found, parts, after.vertices)).registration.doubt
    before_it, of_it = doubt.split("; ")[:2]
    assert before_it == "scales differ"
    assert 10.0 <= float(of_it.split(" %")[0]) < 16.0  # all but what slid along itself
    assert "the other way round two epochs alone cannot tell" in doubt


def body_worn_beside(seed: int, away: float, reach: float, noise: float) -> tuple[Surface, Surface, Floats]:
    """Return a body before and after it was worn so far from its part's border [rad], where the part's own motion takes
    surface inwards too, and the worn direction (3,)."""
    aside = MOTION[3:] - (MOTION[3:] @ TOWARDS) * TOWARDS
    worn = np.cos(HALF + away) * TOWARDS - np.sin(HALF + away) * aside / np.linalg.norm(aside)
    before, after = (body(12_000, np.random.default_rng(seed + k), k > 0, worn, reach, noise) for k in (0, 1))
    return before, after, worn


def worn_beside(
    seed: int, away: float, reach: float, noise: float
) -> tuple[Comparison, Comparison, MovedParts, Floats]:
    """Return such a body as it is compared, what `tell_apart` makes of it, its parts, and the worn direction (3,)."""
    before, after, worn = body_worn_beside(seed, away, reach, noise)
    motion = register(after, before)
    found = compare(before, after, motion)
    parts = find_parts(after, before, motion, is_changed=found.on_compared.region > 0)
    again = tell_apart(found, parts, after.vertices, lambda apart: compare(before, after, motion, apart=apart))
    return found, tell_moved(again, parts, after.vertices), parts, worn


@pytest.mark.parametrize(("seed", "noise"), [(0, NOISE), (0, 1e-4), (2, 1e-4), (6, 1e-4)])
def test_wear_that_hangs_together_with_the_part_is_told_apart_from_it(seed: int, noise: float) -> None:
    """As one region both were lost, or both moved."""
    found, again, parts, worn = worn_beside(seed, 0.2, 0.4, noise)
    assert len(found.regions) == 2
    assert sorted(again.regions["kind"]) == ["lost", "moved", "moved"]
    (place,) = again.regions.loc[again.regions["kind"] == "lost", ["x", "y", "z"]].to_numpy()
    assert np.linalg.norm(place - 0.3 * worn) < 0.05
    for side, first in zip(
        (again.on_reference, again.on_compared), (found.on_reference, found.on_compared), strict=True
    ):
        assert np.sum(first.is_changed & ~side.is_changed) < 0.02 * np.sum(first.is_changed)
        d = side.surface.vertices / np.linalg.norm(side.surface.vertices, axis=1)[:, None]
        is_lost = side.changed_region == 1 + again.regions["kind"].tolist().index("lost")
        assert np.mean(d[is_lost] @ TOWARDS < np.cos(HALF)) > 0.97  # next to nothing of the part
        assert is_lost[(d @ worn > np.cos(0.2)) & (d @ TOWARDS < np.cos(HALF + 0.15))].mean() > 0.95
    rim = found.on_compared.surface.vertices @ TOWARDS < np.cos(0.9 * HALF) * np.linalg.norm(
        found.on_compared.surface.vertices, axis=1)  # fmt: skip
    few = replace(parts, part_of=np.where(rim, parts.part_of, 0))
    assert changed_beside(found, few, found.on_compared.surface.vertices) is None  # little of a region is a part's


@pytest.mark.parametrize("reach", [0.15, 0.2])
def test_wear_too_small_to_stand_beside_a_part_stays_changed(reach: float) -> None:
    found, again, _, _ = worn_beside(0, 0.05, reach, 1e-4)
    assert sorted(again.regions["kind"]) == ["moved", "moved"]
    for side, first in zip(
        (again.on_reference, again.on_compared), (found.on_reference, found.on_compared), strict=True
    ):
        assert (side.is_changed == first.is_changed).all()


def test_wear_beside_a_part_is_told_apart_on_the_command_line(tmp_path: Path) -> None:
    project = str(tmp_path / "project")
    assert run(["init", project]) == 0
    assert run(["add-object", project, "body"]) == 0
    for year, surface in zip((2021, 2022), body_worn_beside(2, 0.2, 0.4, 1e-4)[:2], strict=True):
        write_ply_mesh(tmp_path / f"e{year}.ply", Surface(surface.vertices, surface.faces))
        mesh = ["--mesh", str(tmp_path / f"e{year}.ply")]
        assert run(["add-epoch", project, "body", f"e{year}", "--date", f"{year}-05-01", *mesh]) == 0
    assert run(["process", project]) == 0
    assert run(["compare", project, "body", "e2021", "e2022"]) == 0
    found = Project.open(project).get("body", "e2022", "comparison-e2021")
    assert sorted(found.regions["kind"]) == ["lost", "moved", "moved"]


def test_nothing_lies_beside_a_part_whose_wear_is_elsewhere(measured: tuple[Comparison, MovedParts, Floats]) -> None:
    found, parts, vertices = measured
    assert changed_beside(found, parts, vertices) is None
    assert changed_beside(found, replace(parts, parts=()), vertices) is None


def test_masks_that_are_not_of_the_surfaces_are_refused() -> None:
    before, after = (body(3000, np.random.default_rng(k), k > 0) for k in (0, 1))
    with pytest.raises(ParameterError, match=r"bool \(3000,\) and bool \(7,\): give one mask of bool"):
        compare(before, after, apart=(np.zeros(3000, dtype=bool), np.zeros(7, dtype=bool)))


def strip_beside(change: Floats) -> Comparison:
    """Return a comparison of two flat sheets, 0.1 m wide, whose strip at x above 0.06 m changed by `change` (n,) m."""
    xy = np.stack(np.meshgrid(np.arange(50), np.arange(50), indexing="ij"), axis=-1).reshape(-1, 2) * 0.002
    sheet = Surface(np.column_stack([xy, np.zeros(len(xy))]), grid_faces(50, 50))
    region = (xy[:, 0] > 0.06).astype(np.int32)
    states = np.where(region, Assessment.CHANGED, Assessment.UNCHANGED).astype(np.uint8)
    side = ComparedSurface(sheet, change * region, np.full(len(xy), 1e-4), states, region, np.zeros(len(xy), np.uint8))
    table = pd.DataFrame({"region": [1], "kind": ["added"]})
    return Comparison(side, side, table, Registration(np.eye(4), np.eye(6) * 1e-10, np.zeros(3), True), "relative", {})


@pytest.mark.parametrize(("tilt", "expected"), [(0.02, 1), (0.0, 0)])
def test_a_strip_goes_along_with_a_part_unless_an_even_layer_would_do_as_much(tilt: float, expected: int) -> None:
    """Where a part came forward evenly, a strip of plaster as thick beside it looks the same."""
    motion = np.array([0.0, -tilt, 0.0, 0.0, 0.0, 2e-3])
    x = strip_beside(np.zeros(2500)).on_compared.surface.vertices[:, 0]
    found = strip_beside(2e-3 + tilt * (x - 0.05) + np.random.default_rng(1).normal(0.0, 2e-5, len(x)))
    part_of = (x < 0.056).astype(np.int32)
    parts = MovedParts((MovedPart(np.eye(4), motion, np.eye(6), np.array([0.05, 0.05, 0.0]), 1000),), part_of)
    assert goes_along(found, parts, (part_of, part_of)).tolist() == [expected]
