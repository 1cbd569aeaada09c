"""Meshes whose sheets touch, made two-manifold."""

import numpy as np
import trimesh

from monitor.simulation.manifold import split_touching_sheets
from monitor.simulation.scenes import make_box


def merged(*boxes):
    """Return boxes (low, high) as one mesh in which equal corners are one vertex."""
    bodies = [make_box("box", np.array(low, dtype=float), np.array(high, dtype=float)) for low, high in boxes]
    corners = np.concatenate([b.vertices[b.faces].reshape(-1, 3) for b in bodies])
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int32)


def count_faces_of_edges(faces):
    """Return how many faces each edge has."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def test_two_boxes_that_touch_in_an_edge_become_two_bodies():
    vertices, faces = merged(((0, 0, 0), (1, 1, 1)), ((1, 1, 0), (2, 2, 1)))
    assert count_faces_of_edges(faces).max() == 4
    split, joined = split_touching_sheets(vertices, faces)
    np.testing.assert_array_equal(count_faces_of_edges(joined), 2)
    np.testing.assert_array_equal(split[joined], vertices[faces])  # no face is moved
    mesh = trimesh.Trimesh(split, joined, process=False)
    assert mesh.is_watertight
    assert [part.volume for part in mesh.split()] == [1.0, 1.0]


def test_two_boxes_that_touch_in_a_corner_share_no_vertex_any_more():
    vertices, faces = merged(((0, 0, 0), (1, 1, 1)), ((1, 1, 1), (2, 2, 2)))
    assert len(vertices) == 15
    split, joined = split_touching_sheets(vertices, faces)
    assert len(split) == 16
    np.testing.assert_array_equal(split[joined], vertices[faces])


def test_a_mesh_that_is_two_manifold_is_returned_as_it_is():
    box = make_box("box", np.zeros(3), np.ones(3))
    vertices, faces = split_touching_sheets(box.vertices, box.faces)
    assert vertices is box.vertices
    assert faces is box.faces
