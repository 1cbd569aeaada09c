"""Cones of normals in the tree: they hold what lies below, and stay narrow where a surface is rough."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.comparison.distances.feet import NO_FOOT, find_feet
from monitor.comparison.distances.mesh_tree import BORDERED, FACES_PER_LEAF, MeshTree, build_tree
from monitor.comparison.distances.stars import angle_weighted_normals, make_mesh
from monitor.morton import point_order
from projects.model import Floats, Surface


def rough_sheet(rng: np.random.Generator, k: int, noise: float, hole: bool = False) -> Surface:
    """Return a torus of k x k squares, which has no border, with noise along its normals; edges are near 1."""
    u, v = (2.0 * np.pi * a.ravel() / k for a in np.meshgrid(np.arange(k), np.arange(k), indexing="ij"))
    large, small = k / np.pi, k / (2.0 * np.pi)
    small = small + noise * rng.normal(size=k * k)
    vertices = np.column_stack([(large + small * np.cos(v)) * np.cos(u), (large + small * np.cos(v)) * np.sin(u),
                                small * np.sin(v)])  # fmt: skip
    i, j = (a.ravel() for a in np.meshgrid(np.arange(k), np.arange(k), indexing="ij"))
    a, b, c, d = i * k + j, (i + 1) % k * k + j, (i + 1) % k * k + (j + 1) % k, i * k + (j + 1) % k
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])[1 if hole else 0 :]
    return Surface(vertices, faces.astype(np.int32))


def leaves_below(tree: MeshTree, node: int) -> list[int]:
    """Return the leaves below a node, from left to right."""
    if node >= tree.n_leaves - 1:
        return [node - tree.deepest if node >= tree.deepest else node - tree.deepest + tree.n_leaves]
    return leaves_below(tree, 2 * node + 1) + leaves_below(tree, 2 * node + 2)


@pytest.mark.parametrize(("noise", "hole"), [(0.0, False), (0.3, True), (0.5, False)])
def test_cones_hold_all_normals_around_what_lies_below(rng: np.random.Generator, noise: float, hole: bool) -> None:
    tree = build_tree(rough_sheet(rng, 30, noise, hole), np.zeros(3), np.pi / 3)
    corners = tree.vertices[tree.faces]
    normals: Floats = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    n_bordered = 0
    for node, values in enumerate(tree.nodes.astype(float)):
        places = np.array(leaves_below(tree, node))[:, None] * FACES_PER_LEAF + np.arange(FACES_PER_LEAF)
        own = places[places < len(tree.faces)]
        vertices = np.unique(tree.faces[own])
        around = np.flatnonzero(np.isin(tree.faces, vertices).any(axis=1))
        assert (values[:3] <= corners[own].min(axis=(0, 1))).all()
        assert (values[3:6] >= corners[own].max(axis=(0, 1))).all()
        half = np.arccos(np.clip((normals[own] @ values[6:9]).min(), -1.0, 1.0))
        assert values[9] <= (np.cos(half + np.pi / 3) if half + np.pi / 3 < np.pi else -1.0)
        is_bordered = tree.is_border[vertices].any()
        n_bordered += is_bordered
        assert (values[10] == np.float32(BORDERED)) == is_bordered
        if not is_bordered:
            assert values[10] >= np.arccos(np.clip((normals[around] @ values[6:9]).min(), -1.0, 1.0))
    assert (n_bordered > 0) == hole


def test_cones_of_a_rough_surface_stay_below_a_right_angle_far_up_the_tree(rng: np.random.Generator) -> None:
    tree = build_tree(rough_sheet(rng, 120, 0.35), np.zeros(3), np.pi / 3)
    shares = [(tree.nodes[2**n - 1 : 2 ** (n + 1) - 1, 10] < 0.5 * np.pi).mean() for n in (9, 10)]
    assert shares[0] > 0.85  # nodes of 56 faces, asked themselves; 0.13 where angles are added up
    assert shares[1] > 0.9  # of 28, from those above


def test_what_stands_over_nothing_is_found_to_do_so_with_narrow_cones_and_with_none(rng: np.random.Generator) -> None:
    other, surface = rough_sheet(rng, 40, 0.5), rough_sheet(rng, 40, 0.5)
    tree = build_tree(other, np.zeros(3), np.pi / 3)
    nodes = tree.nodes.copy()
    nodes[:, 10] = np.pi  # nothing is passed by
    points, looks = surface.vertices, angle_weighted_normals(make_mesh(surface.vertices, surface.faces))
    both = [find_feet(t, points, looks, point_order(points), (8.0, 0.5)) for t in (tree, tree._replace(nodes=nodes))]
    for one, two in zip(*both, strict=True):
        np.testing.assert_array_equal(one, two)
    assert (both[0][3] == NO_FOOT).sum() > 5
