"""Meshes whose faces have corners of their own that rounding parted: they are joined again, and nothing else is."""

import numpy as np
import pytest
import trimesh

from projects.formats import read_mesh, write_ply_mesh
from projects.model import Surface


def soup(mesh: trimesh.Trimesh, parted: float, rng: np.random.Generator) -> Surface:
    """Return the faces of a mesh, each with corners of its own that lie off by some `parted` [m]."""
    corners = np.array(mesh.vertices)[mesh.faces].reshape(-1, 3)
    return Surface(corners + rng.normal(0.0, parted, corners.shape), np.arange(len(corners)).reshape(-1, 3))


@pytest.mark.parametrize("parted", [0.0, 2e-7])
def test_corners_that_rounding_parted_are_one_vertex(tmp_path, rng, parted):
    ball = trimesh.creation.icosphere(3, 0.5)
    write_ply_mesh(tmp_path / "soup.ply", soup(ball, parted, rng))
    read = read_mesh(tmp_path / "soup.ply")
    assert len(read.vertices) == len(ball.vertices)
    assert len(read.faces) == len(ball.faces)
    assert trimesh.Trimesh(read.vertices, read.faces, process=False).is_watertight


def test_faces_a_tenth_of_an_edge_apart_stay_apart(tmp_path, rng):
    """Pieces that lie as far from each other as a gap of a survey are no one surface."""
    ball = trimesh.creation.icosphere(2, 0.5)
    apart = 0.1 * float(np.median(ball.edges_unique_length))
    write_ply_mesh(tmp_path / "soup.ply", soup(ball, apart, rng))
    assert len(read_mesh(tmp_path / "soup.ply").vertices) == 3 * len(ball.faces)


def test_inner_vertices_that_all_but_touch_are_two(tmp_path):
    """Two balls that touch at a point of each share no edge there, and stay two bodies."""
    balls = [trimesh.creation.icosphere(2, 0.5), trimesh.creation.icosphere(2, 0.5)]
    balls[1].apply_translation([2.0 * balls[0].vertices[:, 0].max() + 1e-7, 0.0, 0.0])
    both = trimesh.util.concatenate(balls)
    write_ply_mesh(tmp_path / "balls.ply", Surface(np.array(both.vertices), np.array(both.faces)))
    assert len(read_mesh(tmp_path / "balls.ply").vertices) == len(both.vertices)
