"""Surfaces between the corners of their faces: spheres and saddles known by formula, edges, finished meshes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from monitor.comparison.distances.both_ways import make_shells, measure_sides
from monitor.comparison.distances.perpendicular import normal_distances
from monitor.reconstruction import surface_to_points
from monitor.reconstruction.bow import bow_at
from projects.model import Floats, Registration, Surface
from projects.transforms import rotation_from_vector


def sphere(turn: float = 0.0, sign: float = 1.0, subdivisions: int = 3) -> Surface:
    """Return a sphere of radius 1 m, turned, whose vertices and normals are exact; looking inwards where sign is -1."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices = mesh.vertices @ rotation_from_vector(turn * np.array([1.0, 2.0, 3.0])).T
    faces = mesh.faces if sign > 0 else mesh.faces[:, ::-1]
    return Surface(vertices, faces, normals=sign * vertices, sigma=np.full(len(vertices), 1e-5))


def patch(normals: Floats) -> Surface:
    """Return one face in the plane z = 0 with these normals at its corners."""
    vertices = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(vertices, [[0, 1, 2]], normals=normals / length, sigma=np.full(3, 1e-5))


def bow(surface: Surface, *weights: float, face: int = 0) -> float:
    """Return the bow at one place of a face."""
    return float(bow_at(surface, np.array([face]), np.array([weights]))[0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_a_sphere_the_bow_is_what_the_faces_fall_short_of_it(rng: np.random.Generator, sign: float) -> None:
    """Faces cut off up to 4.5 mm of a radius of 1 m; of that a fiftieth stays."""
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    body = sphere(sign=sign)
    points = Surface(1.02 * directions, np.array([[0, 1, 2]]), normals=sign * directions)
    feet = normal_distances(points, body, 0.5)
    flat = sign * feet.distances - 0.02
    found = sign * bow_at(body, feet.faces, feet.weights)
    assert flat.max() > 4e-3
    assert np.abs(flat - found).max() < 0.03 * flat.max()
    assert (found > -1e-12).all()


def test_on_a_saddle_it_goes_both_ways() -> None:
    """z = (x^2 - y^2) / 2 R: half-way along x the surface lies h^2 / 8 R below the edge, along y as far above."""
    h, radius = 0.01, 0.2
    vertices = np.array([[0.0, 0, 0], [h, 0, h**2 / (2 * radius)], [0, h, -(h**2) / (2 * radius)]])
    normals = np.array([[0.0, 0, 1], [-h / radius, 0, 1], [0, h / radius, 1]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    saddle = Surface(vertices, [[0, 1, 2]], normals=normals, sigma=np.full(3, 1e-5))
    sagitta = h**2 / (8 * radius)
    assert bow(saddle, 0.5, 0.5, 0.0) == pytest.approx(-sagitta, rel=2e-3)
    assert bow(saddle, 0.5, 0.0, 0.5) == pytest.approx(sagitta, rel=2e-3)
    assert bow(saddle, 1.0, 0.0, 0.0) == 0.0


def test_an_edge_is_no_bow() -> None:
    """Corners 59 degrees apart bow, 61 degrees apart they lie on two sides of an edge."""
    for degrees, bows in ((59.0, True), (61.0, False)):
        half = np.radians(degrees) / 2.0
        normals = np.array([[-np.sin(half), 0, np.cos(half)], [np.sin(half), 0, np.cos(half)], [0.0, 0, 1.0]])
        assert (bow(patch(normals), 0.4, 0.4, 0.2) > 1e-4) == bows


def test_where_nothing_is_known_the_face_is_the_surface() -> None:
    normals = np.array([[-0.2, 0, 1.0], [0.2, 0, 1.0], [0.0, 0.2, 1.0]])
    known, middle = patch(normals), (0.3, 0.3, 0.4)
    assert bow(known, *middle) > 1e-4
    assert bow(replace(known, sigma=None), *middle) == 0.0  # a finished mesh
    assert bow(replace(known, normals=None), *middle) == 0.0
    unknown = normals.copy()
    unknown[2] = np.nan
    assert bow(replace(known, normals=unknown), *middle) == 0.0
    assert bow(known, *middle, face=-1) == 0.0


def test_points_of_a_round_body_lie_on_it_and_not_outside_of_its_faces(rng: np.random.Generator) -> None:
    points = rng.normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    assert np.abs(surface_to_points(sphere(), points)).max() < 1e-4
    assert surface_to_points(replace(sphere(), sigma=None), points).mean() > 2e-3


def test_a_round_body_cut_otherwise_in_each_epoch_has_not_changed_on_either_side() -> None:
    """Measured to flat faces either side would lie 3 mm outside of the other, of a radius of 1 m."""
    still = Registration(np.eye(4), np.diag([1e-6] * 6) ** 2, np.zeros(3), True)
    reference, compared = sphere(), sphere(turn=0.4)
    for side in measure_sides(make_shells(reference, compared, (0.3, 1.0)), still):
        assert side.is_assessed.all()
        assert abs(side.distances.mean()) < 2e-5
        assert np.abs(side.distances).max() < 1e-4


def test_edges_to_a_crest_are_straight() -> None:
    """A vertex on the line where two sides meet has the mean of their normals, which neither side bends by."""
    tilted = np.array([[0.0, 0, 1], [0.0, 0, 1], [0.0, 1, 1]])
    assert abs(bow(patch(tilted), 0.5, 0.0, 0.5)) > 5e-4
    on_crest = replace(patch(tilted), is_crest=[False, False, True])
    assert bow(on_crest, 0.5, 0.0, 0.5) == 0.0
    assert abs(bow(patch(tilted), 0.0, 0.5, 0.5)) > 5e-4
    assert bow(on_crest, 0.0, 0.5, 0.5) == 0.0  # to it, as from it
    round_below = np.array([[-0.1, 0, 1], [0.1, 0, 1], [0.0, 1, 1]])
    both = replace(patch(round_below), is_crest=[False, False, True])
    assert bow(both, 0.5, 0.5, 0.0) == pytest.approx(0.125 * 0.01 * 0.2 / np.hypot(1.0, 0.1), rel=1e-9)  # along x
