"""Volumes between surfaces that are not 2.5-D: pieces broken off obliquely, overhangs, open patches, slits."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from rounded_block import NOISE, block

from monitor.comparison import compare
from monitor.comparison.between import stand_between
from monitor.comparison.detection.detect import detect
from monitor.comparison.distances.mesh_tree import build_tree
from monitor.comparison.distances.offsets import signed_offsets
from monitor.comparison.epochs import CompareSettings, Question, measure
from monitor.comparison.regions.closing import border_edges, close_gap, cone_volume
from monitor.comparison.regions.enclosure import is_one_sided, measure_body
from monitor.simulation.solid import contour
from projects.model import ComparedSurface, Registration, Surface


def enclosed(points: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume that faces and their closing surface enclose."""
    closing = close_gap(points, border_edges(faces))
    assert closing is not None
    return cone_volume(points[faces]) + cone_volume(closing.triangles, closing.weights)


def test_a_hole_is_closed_by_a_flat_cap_and_the_origin_does_not_matter() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    snapped = ball.vertices.copy()
    level = np.abs(snapped[:, 2] - 0.3) < 0.04  # a border that lies in a plane
    snapped[level, 2] = 0.3
    snapped[level, :2] *= np.sqrt(1 - 0.3**2) / np.linalg.norm(snapped[level, :2], axis=1)[:, None]
    faces = ball.faces[(snapped[:, 2] >= 0.3)[ball.faces].all(axis=1)]
    truth = np.pi * 0.7**2 * (3 - 0.7) / 3
    assert enclosed(snapped, faces) == pytest.approx(truth, rel=0.01)  # a polyhedron of edges 0.07 in a ball of 1
    assert enclosed(snapped + np.array([3.0, -4.0, 5.0]), faces) == pytest.approx(enclosed(snapped, faces), rel=1e-9)


def test_a_strip_joins_borders_that_run_side_by_side(rng: np.random.Generator) -> None:
    def bowl(n: int, shift: float, depth: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.meshgrid((np.arange(n) + shift) / n, (np.arange(n) + shift) / n, indexing="ij")
        r = np.hypot(x - 0.5, y - 0.5)
        z = -depth * np.where(r < 0.3, 0.5 * (1 + np.cos(np.pi * r / 0.3)), 0) + rng.normal(0, 1e-3, x.shape)
        i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
        a = (i * n + j).ravel()
        faces = np.vstack([np.column_stack([a, a + n, a + n + 1]), np.column_stack([a, a + n + 1, a + 1])])
        return np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces[(r.ravel() < reach)[faces].all(axis=1)]

    (before, down), (after, up) = bowl(80, 0.0, 0.0, 0.38), bowl(75, 0.4, 0.1, 0.36)
    volume = enclosed(np.vstack([before, after]), np.vstack([down[:, ::-1], up + len(before)]))
    assert volume == pytest.approx(-0.1 * np.pi * 0.3**2 * (0.5 - 2 / np.pi**2), rel=0.01)


def test_a_slit_is_sewn_up_and_not_bridged_to_elsewhere() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0)).subdivide().subdivide().subdivide()
    slit = (np.abs(box.triangles_center[:, 0]) < 0.1) & (box.triangles_center[:, 2] > 0.49)
    assert slit.sum() > 20
    assert enclosed(box.vertices, box.faces[~slit]) == pytest.approx(1.0, rel=1e-9)


def test_border_edges_that_are_no_delaunay_edges_still_close() -> None:
    zigzag = np.array([[0, 0, 0], [10, 0, 0], [10, 1, 0], [5, 0.05, 0], [0, 1, 0]], dtype=float)
    apex = np.array([[5.0, 0.5, 2.0]])
    points = np.vstack([zigzag, apex])
    faces = np.array([[k, (k + 1) % 5, 5] for k in range(5)])
    shifted = enclosed(points + np.array([7.0, 8.0, 9.0]), faces)
    area = 0.5 * float(np.linalg.norm(sum(np.cross(zigzag[k], zigzag[(k + 1) % 5]) for k in range(5))))
    assert shifted == pytest.approx(enclosed(points, faces), rel=1e-9)
    assert abs(shifted) == pytest.approx(area * 2.0 / 3.0, rel=1e-6)


@pytest.mark.parametrize("looks_away", [False, True])
def test_the_side_is_known_over_a_surface_whichever_way_it_looks_but_not_beside_it(looks_away: bool) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    tree = build_tree(Surface(vertices, faces[:, ::-1] if looks_away else faces), np.zeros(3), 1.0)
    points = np.array([[0.5, 0.5, 0.1], [0.5, 0.5, -0.1], [1.05, 0.5, 0.1], [1.2, 0.5, 0.1], [0.5, 0.5, 0.6]])
    found = signed_offsets(points, tree, 0.5)
    sign = -1.0 if looks_away else 1.0
    truth = sign * np.array([0.1, -0.1, np.hypot(0.05, 0.1), np.hypot(0.2, 0.1)])
    np.testing.assert_allclose(found.distances[:4], truth)
    np.testing.assert_array_equal(found.is_known, [True, True, True, False, False])
    assert np.isnan(found.distances[4])
    assert found.faces[4] == -1


def test_a_face_without_area_has_no_side() -> None:
    """It ended as an error of ours: beside its free edges a normal without length was divided by."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 5], [1, 0, 5], [0, 1, 5]], dtype=float)
    tree = build_tree(Surface(vertices, np.array([[0, 1, 2], [1, 1, 2], [3, 4, 5]])), np.zeros(3), 1.0)
    found = signed_offsets(np.array([[0.5, 0.1, 0.0], [2.1, 0.0, 0.1], [0.2, 0.2, 5.1]]), tree, 0.5)
    np.testing.assert_allclose(np.abs(found.distances), [0.1, np.hypot(0.1, 0.1), 0.1])
    np.testing.assert_array_equal(found.is_known, [False, False, True])


CHEST = trimesh.creation.box((0.8, 0.5, 0.7)).subdivide().subdivide().subdivide()


@pytest.mark.parametrize(
    ("seen", "one_sided"),
    [
        ([[0, 0, 1], [0, 1, 0], [1, 0, 0]], True),  # top, front and one side, no floor: a film over the mouth
        ([[0, 0, 1], [0, 1, 0]], True),
        ([[0, 0, 1], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, -1, 0]], False),  # but for the floor
        ([[0, 0, 1], [0, 0, -1]], False),  # lid and floor: what closes them are the sides all around
    ],
)
@pytest.mark.parametrize("is_matched", [False, True])
def test_what_was_seen_from_one_side_alone_encloses_nothing(
    seen: list[list[int]], one_sided: bool, is_matched: bool
) -> None:
    faces = CHEST.faces[(CHEST.face_normals @ np.array(seen).T > 0.9).any(axis=1)]
    closing = close_gap(CHEST.vertices, border_edges(faces))
    assert closing is not None
    everywhere = np.full(len(CHEST.vertices), is_matched)  # surface that both epochs have
    assert is_one_sided(closing, everywhere, CHEST.vertices[faces]) == (one_sided and not is_matched)


def known(surface: Surface) -> Registration:
    return Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(len(surface.vertices), dtype=bool))  # fmt: skip


def area_of_region(side: ComparedSurface) -> float:
    """Return the area [m2] that anyone finds who sums up the vertices of region 1, of the surface as it is stored."""
    of_face = trimesh.Trimesh(side.surface.vertices, side.surface.faces, process=False).area_faces
    return float(((side.region == 1)[side.surface.faces].mean(axis=1) * of_face).sum())


def area_beyond(surface: Surface, plane: np.ndarray) -> float:
    """Return the area [m2] of what lies beyond a plane, normal and offset."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    return float(mesh.area_faces[mesh.triangles_center @ plane[:3] > plane[3]].sum())


@pytest.mark.parametrize("is_open", [False, True])
def test_a_corner_broken_off_obliquely_has_its_volume(rng: np.random.Generator, is_open: bool) -> None:
    n = np.array([0.62, -0.55, 0.56]) / np.linalg.norm([0.62, -0.55, 0.56])
    cut = np.append(n, n @ [0.06, -0.05, 0.04] - 0.025)
    before, after = block(rng, None, is_open), block(rng, cut, is_open)
    closed = [block(np.random.default_rng(1), c, False) for c in (None, cut)]
    truth = float(np.diff([trimesh.Trimesh(s.vertices, s.faces, process=False).volume for s in closed])[0])
    for reference, compared, sign in ((before, after, 1.0), (after, before, -1.0)):
        found = compare(reference, compared, known(compared))
        table = found.regions
        assert len(table) == 1
        gone = found.on_reference if sign > 0 else found.on_compared
        assert table.area_m2[0] == pytest.approx(area_of_region(gone))
        assert table.area_m2[0] == pytest.approx(area_beyond(before, cut), rel=0.06)
        assert table.area_m2[0] == pytest.approx(area_beyond(before, cut), abs=1.96 * table.sigma_area_m2[0])
        assert table.sigma_area_m2[0] < 0.1 * table.area_m2[0]  # its border is known to a spacing
        assert table.kind[0] == ("lost" if sign > 0 else "added")
        assert table.volume_m3[0] == pytest.approx(sign * truth, rel=0.02)
        assert 0.0 < table.sigma_volume_m3[0] < 0.02 * abs(truth)


def coarse_body(dents: bool, turn: float) -> Surface:
    """Return a bumpy body of some 0.7 m as a mesh of 10 000 vertices, turned within its shape, perhaps with a dent
    14 mm deep, which is as deep as an edge is long."""
    sphere = trimesh.creation.icosphere(subdivisions=5)
    sphere.apply_transform(trimesh.transformations.rotation_matrix(turn, [1, 2, 3]))
    u = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1)[:, None]
    radius = 0.35 + 0.04 * np.sin(3 * u[:, 0] + 1) * np.cos(4 * u[:, 1]) + 0.03 * np.sin(5 * u[:, 2] + u[:, 0])
    radius += 0.012 * np.sin(11 * u[:, 0] * u[:, 1] + 7 * u[:, 2])
    if dents:
        way = np.array([1.0, -0.2, 0.3]) / np.linalg.norm([1.0, -0.2, 0.3])
        angle = np.minimum(np.arccos(np.clip(u @ way, -1.0, 1.0)), 0.2)
        radius -= 0.014 * (0.5 + 0.5 * np.cos(np.pi * angle / 0.2))
    vertices = u * radius[:, None] * [1.0, 0.8, 1.3]
    vertices += np.random.default_rng(int(dents)).normal(0.0, 3e-5, vertices.shape)
    return Surface(vertices, sphere.faces.astype(np.int32))


def test_a_patch_that_ends_before_the_others_where_both_have_surface_makes_no_volume() -> None:
    """One side's patch has twice the area of the other's: the film from border to border once told -550 cm3."""
    before, after = coarse_body(dents=False, turn=0.0), coarse_body(dents=True, turn=0.3)
    truth = float(np.diff([trimesh.Trimesh(s.vertices, s.faces, process=False).volume for s in (before, after)])[0])
    found = compare(before, after, known(after))
    assert len(found.regions) == 1
    assert found.regions.volume_m3[0] == pytest.approx(truth, rel=0.05)


def test_a_patch_whose_ground_the_other_side_counts_to_another_region_has_its_own_volume() -> None:
    """Margins spread from what each side found: a bevel that two meshes round in two ways is a gain on one side and a
    loss on the other. The film over a patch without its counterpart told 6.2 cm3 of half a millimetre on 11 cm2."""
    before, after = coarse_body(dents=False, turn=0.0), coarse_body(dents=True, turn=0.3)
    truth = float(np.diff([trimesh.Trimesh(s.vertices, s.faces, process=False).volume for s in (before, after)])[0])
    asked = Question(stand_between(known(after), None, "relative"), (0.05, np.radians(60.0)), 0.05, None, None, None)
    sides, beyond = measure(before, after, asked, CompareSettings())
    found = detect(sides, known(after), 0.05, 0)
    way = np.array([1.0, -0.2, 0.3]) * [1.0, 0.8, 1.3]
    is_near = [s.surface.vertices @ way > 0.85 * np.linalg.norm(s.surface.vertices, axis=1) * np.linalg.norm(way)
               for s in sides]  # fmt: skip
    margins = is_near[0] * np.int32(1), is_near[1] * np.int32(2)
    for number in (1, 2):
        body = measure_body(number, sides, margins, found, known(after), beyond)
        assert body is not None
        assert body.volume == pytest.approx(truth, rel=0.05)


def test_a_hole_through_a_plate_is_one_loss_with_the_volume_of_what_was_drilled_out(rng: np.random.Generator) -> None:
    """Its mouths were regions of their own, each closed by a film inside the hole: a twelfth of what is gone."""

    def plate(radius: float, noise: float) -> Surface:
        def field(p: np.ndarray) -> np.ndarray:
            q = np.abs(p) - np.array([0.05, 0.05, 0.01])[:, None] + 0.004
            body = np.linalg.norm(np.maximum(q, 0.0), axis=0) + np.minimum(q.max(axis=0), 0.0) - 0.004
            return np.maximum(body, radius - np.hypot(p[0], p[1]))

        vertices, faces = contour(field, np.array([[-0.06, -0.06, -0.02], [0.06, 0.06, 0.02]]), cell=0.0015)
        normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
        return Surface(vertices + normals * rng.normal(0, noise, (len(vertices), 1)), faces,
                       sigma=np.full(len(vertices), NOISE))  # fmt: skip

    truth = float(np.diff([trimesh.Trimesh(s.vertices, s.faces, process=False).volume
                           for s in (plate(-1.0, 0.0), plate(0.006, 0.0))])[0])  # fmt: skip
    assert truth == pytest.approx(-np.pi * 0.006**2 * 0.02, rel=0.03)
    before, after = plate(-1.0, NOISE), plate(0.006, NOISE)
    region = compare(before, after, known(after)).regions
    assert list(region.kind) == ["lost"]
    assert region.volume_m3[0] == pytest.approx(truth, rel=0.01)
    assert region.sigma_volume_m3[0] < 0.01 * abs(truth)
    assert region.area_m2[0] == pytest.approx(2.0 * np.pi * 0.006**2, rel=0.2)  # both mouths, to half an edge
    assert np.linalg.norm(region[["x", "y", "z"]].to_numpy()[0]) < 1e-3
