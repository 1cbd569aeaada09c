"""Ground under a panel whose sides were not seen: part of the body, though what is nearest to it is elsewhere; a wall
behind a figure that changed: not part of it, though the change is what is nearest to it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.distances.mesh_tree import build_tree
from monitor.comparison.distances.search import DEPTH, first_crossing
from monitor.comparison.distances.stars import gather_neighbours, make_mesh, vertex_areas
from monitor.comparison.regions.covered import take_covered
from monitor.tuples import less
from projects.model import NotAssessed, Registration, Surface

NOISE, SPACING = 2e-5, 0.004  # m
HALF, DEEP = np.array([0.08, 0.06]), 0.02  # m, of the panel
UNSEEN = 0.004  # m, of the ground around the panel


def plane(rng: np.random.Generator, half: tuple[float, float], z: float) -> Surface:
    """Return a plane of twice `half` [m] that looks along z, at so much of it."""
    x, y = (np.linspace(-h, h, round(2 * h / SPACING) + 1) for h in half)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), z)], axis=-1).reshape(-1, 3)
    a = (np.arange(len(x) - 1)[:, None] * len(y) + np.arange(len(y) - 1)).ravel()
    faces = np.vstack([np.column_stack([a, a + len(y), a + len(y) + 1]), np.column_stack([a, a + len(y) + 1, a + 1])])
    points[:, 2] += rng.normal(0, NOISE, len(points))
    return Surface(points, faces)


def both(first: Surface, second: Surface) -> Surface:
    return Surface(np.vstack([first.vertices, second.vertices]),
                   np.vstack([first.faces, second.faces + len(first.vertices)]))  # fmt: skip


def without(surface: Surface, half: np.ndarray) -> Surface:
    """Return a surface without what lies within `half` [m] of its middle."""
    is_kept = (np.abs(surface.vertices[:, :2]) > half).any(axis=1)
    faces = surface.faces[is_kept[surface.faces].all(axis=1)]
    used, numbers = np.unique(faces, return_inverse=True)
    return Surface(surface.vertices[used], numbers.reshape(-1, 3))


def held(surface: Surface) -> Registration:
    return Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(len(surface.vertices), dtype=bool))  # fmt: skip


@pytest.mark.parametrize("came", [True, False])
def test_a_panel_of_which_only_the_front_was_seen_has_its_volume(rng: np.random.Generator, came: bool) -> None:
    bare = plane(rng, (0.4, 0.3), 0.0)
    clad = both(without(plane(rng, (0.4, 0.3), 0.0), HALF + UNSEEN), plane(rng, (HALF[0], HALF[1]), DEEP))
    reference, compared = (bare, clad) if came else (clad, bare)
    table = compare(reference, compared, held(compared)).regions
    assert len(table) == 1
    truth = (1.0 if came else -1.0) * 4.0 * HALF.prod() * DEEP
    assert table["volume_m3"][0] == pytest.approx(truth, rel=0.06)  # not known while the ground below it was of nothing
    assert table["sigma_volume_m3"][0] == pytest.approx(0.23 * abs(truth), rel=0.2)  # what its sides may be off by


def with_boss(sheet: Surface, height: float) -> Surface:
    """Return a sheet with a boss, a truncated cone, in its middle."""
    vertices = sheet.vertices.copy()
    vertices[:, 2] += height * np.clip((0.03 - np.hypot(vertices[:, 0], vertices[:, 1])) / 0.01, 0.0, 1.0)
    return Surface(vertices, sheet.faces)


@pytest.mark.parametrize("came", [True, False])
def test_a_wall_behind_a_figure_that_changed_is_not_buried_by_it(rng: np.random.Generator, came: bool) -> None:
    """One epoch saw it, the other did not; its volume was not known, and its middle lay behind the figure."""
    wall, far = plane(rng, (0.25, 0.25), 0.0), 0.05
    figure = plane(rng, (0.07, 0.07), far)
    bare = both(wall, figure)
    grown = both(without(plane(rng, (0.25, 0.25), 0.0), HALF), with_boss(plane(rng, (0.07, 0.07), far), 0.015))
    reference, compared = (bare, grown) if came else (grown, bare)
    table = compare(reference, compared, held(compared)).regions
    assert len(table) == 1
    truth = (1.0 if came else -1.0) * np.pi / 3.0 * 0.015 * (0.03**2 + 0.03 * 0.02 + 0.02**2)
    assert table["volume_m3"][0] == pytest.approx(truth, rel=0.03)
    assert table["z"][0] > far - NOISE
    assert table["area_m2"][0] < 1.5 * np.pi * 0.03**2


def side_of(surface: Surface, is_assessed: np.ndarray) -> Any:
    """Return what is asked of a side of a comparison: its mesh, and where a perpendicular was found."""
    mesh = make_mesh(surface.vertices, surface.faces)
    normals = np.broadcast_to([0.0, 0.0, 1.0], surface.vertices.shape)
    reasons = np.where(is_assessed, NotAssessed.ASSESSED, NotAssessed.SHEET_BETWEEN)
    return SimpleNamespace(surface=surface, is_assessed=is_assessed, reasons=reasons, normals=normals,
                           areas=vertex_areas(mesh), distances=np.where(is_assessed, DEEP, np.nan),
                           neighbours=gather_neighbours(mesh))  # fmt: skip


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_covered_hangs_together_with_the_region_and_lies_on_its_side(
    rng: np.random.Generator, sign: float
) -> None:
    """A wall far behind a chest that gained is under it too, and no end of what came."""
    ground, wall = plane(rng, (0.2, 0.15), 0.0), plane(rng, (0.2, 0.15), -0.06 * sign)
    reference, front = both(ground, wall), plane(rng, (HALF[0], HALF[1]), DEEP * sign)
    within = (np.abs(reference.vertices[:, :2]) < HALF - 1e-9).all(axis=1)
    is_ground = np.arange(len(within)) < len(ground.vertices)
    is_seed = is_ground & (np.abs(reference.vertices[:, :2]) < 0.5 * HALF).all(axis=1)
    sides = side_of(reference, is_seed | ~within), side_of(front, np.ones(len(front.vertices), dtype=bool))
    regions = is_seed.astype(np.int32), np.ones(len(front.vertices), dtype=np.int32)
    unknown: Any = SimpleNamespace(change=tuple(np.full(len(s.areas), np.nan) for s in sides))
    own, other = take_covered(sides, regions, np.array([0.0, sign]), unknown)
    np.testing.assert_array_equal(own, (within & is_ground).astype(np.int32))
    np.testing.assert_array_equal(other, regions[1])
    on_the_other_side = take_covered(sides, regions, np.array([0.0, -sign]), unknown)
    np.testing.assert_array_equal(on_the_other_side[0], regions[0])
    for side in sides:
        side.distances[:] *= 0.5  # the front is farther off than anything changed
    np.testing.assert_array_equal(take_covered(sides, regions, np.array([0.0, sign]), unknown)[0], regions[0])


def test_the_first_face_on_a_way_is_found_as_by_trying_all(rng: np.random.Generator) -> None:
    corners = rng.uniform(-1, 1, (60, 1, 3)) + rng.uniform(-0.4, 0.4, (60, 3, 3))
    tree = build_tree(Surface(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3)), np.zeros(3), np.pi)
    points, ways = rng.uniform(-2, 2, (2, 400, 3))
    met = 0
    for p, way in zip(points, ways, strict=True):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        system = np.stack([b - a, c - a, np.broadcast_to(-way, a.shape)], axis=2)
        u, v, t = np.linalg.solve(system, (p - a)[..., None])[..., 0].T
        hits = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t < 1))
        expected = hits[t[hits].argmin()] if len(hits) else -1
        found = first_crossing(
            tree, less(p[None], 0, tree.shift), tuple(way), (0.0, 1.0), np.empty(DEPTH, dtype=np.int64)
        )
        assert (tree.order[found] if found >= 0 else -1) == expected
        met += expected >= 0
    assert met > 20
