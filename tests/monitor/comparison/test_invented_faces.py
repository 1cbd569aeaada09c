"""Surfaces closed by invented faces are compared as those that are open: these faces are no part of what was measured.

Unchanged bodies, measured down to different heights; the underside of neither was seen.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from monitor.comparison import compare
from monitor.comparison.series.rate_side import lay_bare
from monitor.reconstruction.holes import close_holes, free_loops
from monitor.reconstruction.mesh import normals_by_angle
from monitor.second_opinion import ask_m3c2
from projects.model import Assessment, Comparison, PointCloud, Registration, Surface

NOISE = 1e-4  # m
STILL = Registration(np.eye(4), np.eye(6) * 1e-12, np.zeros(3), True)


def open_body(rng: np.random.Generator, lowest: float) -> Surface:
    """Return a ball of 0.5 m, measured above a height [m]."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    ball.update_faces(ball.triangles_center[:, 2] > lowest)
    ball.remove_unreferenced_vertices()
    vertices = np.array(ball.vertices)
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    sigma = np.full(len(vertices), NOISE)
    places = vertices + rng.normal(0.0, NOISE, (len(vertices), 1)) * normals
    return Surface(places, np.array(ball.faces), normals=normals, sigma=sigma)


def closed(surface: Surface) -> Surface:
    """Return the surface with its underside closed, new vertices behind the old."""
    mesh = close_holes(surface.vertices, surface.faces, np.inf, 0.05)
    assert (mesh.n_closed, mesh.n_left_open) == (1, 0)
    sigma = np.full(len(mesh.vertices), np.nan)
    sigma[: len(surface.vertices)] = surface.sigma
    invented = np.arange(len(mesh.faces)) >= mesh.n_measured
    normals = np.vstack([surface.normals, normals_by_angle(mesh.vertices, mesh.faces)[len(surface.vertices) :]])
    return Surface(mesh.vertices, mesh.faces, normals=normals, sigma=sigma, face_invented=invented)


@pytest.fixture(scope="module")
def pairs() -> tuple[Comparison, Comparison]:
    rng = np.random.default_rng(5)
    before, after = open_body(rng, -0.1), open_body(rng, -0.3)
    return compare(before, after, STILL), compare(closed(before), closed(after), STILL)


def test_where_a_surface_ends_nothing_is_assessed_though_invented_faces_go_on(pairs) -> None:
    """The whole rim was assessed, and what lies beside the other surface's; of bodies of points by up to 2.2 mm."""
    for side in ("on_compared", "on_reference"):
        open_, shut = (getattr(pair, side) for pair in pairs)
        n = len(open_.assessment)
        rim = np.concatenate(free_loops(open_.surface.faces))
        assert (shut.assessment[rim] == Assessment.NOT_ASSESSABLE).all()
        assert (shut.assessment[n:] == Assessment.NOT_ASSESSABLE).all()
        assert np.array_equal(shut.assessment[:n], open_.assessment)


def test_share_of_the_area_assessed_is_of_what_was_measured(pairs) -> None:
    """Invented faces counted as area that could not be assessed: 0.63 and 0.73 for 0.68 and 0.91."""
    open_, shut = (pair.statistics for pair in pairs)
    for share in ("assessed_area_share", "assessed_area_share_reference"):
        assert shut[share] == pytest.approx(open_[share], rel=1e-9)


def test_cylinders_of_m3c2_are_as_wide_as_the_points_of_what_was_measured_ask_for(pairs) -> None:
    """They are to hold 30 points, and held 36: by the area of invented faces, where there are none."""
    cloud = PointCloud(pairs[0].on_compared.surface.vertices)
    open_, shut = (ask_m3c2(pair, cloud, cloud)["cylinder_radius_m"] for pair in pairs)
    assert shut == pytest.approx(open_, rel=1e-9)


def test_area_of_a_followed_surface_is_what_was_measured(rng) -> None:
    """2.65 m2 for 1.89."""
    surface = open_body(rng, -0.1)
    bare = [lay_bare(s, STILL) for s in (surface, closed(surface))]
    rim = np.concatenate(free_loops(surface.faces))
    assert np.array_equal(bare[1].to_rim[rim] < 1e-9, bare[0].to_rim[rim] < 1e-9)
    assert bare[1].spacing == bare[0].spacing  # invented vertices lie as densely as their span has them
    areas = [float(side.measured_areas.sum()) for side in bare]
    assert areas[1] == pytest.approx(areas[0], rel=1e-9)


def test_a_surface_that_no_face_is_invented_of_is_as_it_was(rng) -> None:
    surface = open_body(rng, -0.1)
    marked = replace(surface, face_invented=np.zeros(len(surface.faces), dtype=bool))
    first, second = (compare(s, open_body(np.random.default_rng(2), -0.3), STILL) for s in (surface, marked))
    assert np.array_equal(first.on_reference.distances, second.on_reference.distances, equal_nan=True)
