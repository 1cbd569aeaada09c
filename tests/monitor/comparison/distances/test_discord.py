"""What the fits of neighbouring vertices contradict each other by, on shapes where it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from monitor.comparison import compare
from monitor.comparison.distances.discord import SHARE, sigma_of_discord
from monitor.comparison.distances.stars import gather_neighbours, make_mesh
from projects.model import Floats, Registration, Surface

N = 41  # vertices along an edge of a plate


def plate(heights: Floats, normals: Floats | None = None) -> Surface:
    """Return a plate of `N` x `N` vertices 1 mm apart, at 1e6 m from the origin, with these heights (N * N,) [m]."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(N), np.arange(N)))
    points = np.column_stack([1e-3 * x, 1e-3 * y, heights]) + np.array([1e6, 2e6, 3.0])
    k = np.flatnonzero((x < N - 1) & (y < N - 1))
    faces = np.concatenate([np.column_stack([k, k + 1, k + N + 1]), np.column_stack([k, k + N + 1, k + N])])
    up = np.tile([0.0, 0.0, 1.0], (N * N, 1)) if normals is None else normals
    return Surface(points, faces, normals=up, sigma=np.full(N * N, 2e-5))


def discord_of(surface: Surface) -> Floats:
    return sigma_of_discord(surface, gather_neighbours(make_mesh(surface.vertices, surface.faces)))


def test_on_a_sphere_the_fits_of_neighbours_agree() -> None:
    """The chord is perpendicular to the sum of both normals; held against one normal it would be 0.25 mm off."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    normals = ball.vertices / 0.05
    surface = Surface(ball.vertices, ball.faces, normals=normals, sigma=np.full(len(normals), 1e-4))
    assert discord_of(surface).max() < 1e-9


def test_independent_heights_contradict_each_other_by_the_root_of_two(rng: np.random.Generator) -> None:
    found = discord_of(plate(1e-4 * rng.normal(size=N * N)))
    assert np.sqrt(np.mean(found**2)) == pytest.approx(SHARE * np.sqrt(2.0) * 1e-4, rel=0.05)
    assert np.quantile(found, [0.05, 0.95]) == pytest.approx([0.5e-4, 1.0e-4], abs=0.1e-4)  # one vertex: 0.35 to 1.2


def test_a_vertex_that_is_off_is_told_with_those_around_it_and_no_others() -> None:
    heights, middle = np.zeros(N * N), N * N // 2
    heights[middle] = 1e-3
    found = discord_of(plate(heights))
    # six edges at the vertex, 1 mm each; of each neighbour's six one: (1 + 6 / 6) / 7 of the square
    assert found[middle] == pytest.approx(SHARE * np.sqrt(2.0 / 7.0) * 1e-3, rel=1e-6)
    beyond = np.abs(plate(heights).vertices - plate(heights).vertices[middle])[:, :2].max(axis=1) > 2.5e-3
    assert (found[beyond] == 0.0).all()


def test_a_slope_that_heights_do_not_have_is_told() -> None:
    """All normals lean by 0.1 along x, and the plate lies flat: an edge of 1 mm along x is off by 0.1 mm."""
    leaning = np.tile([np.sin(0.1), 0.0, np.cos(0.1)], (N * N, 1))
    found = discord_of(plate(np.zeros(N * N), leaning))
    # of six edges two along x and two diagonal ones have it
    assert found[N * N // 2] == pytest.approx(SHARE * np.sqrt(4.0 / 6.0) * 1e-3 * np.sin(0.1), rel=1e-3)


def test_nothing_is_said_of_crests_of_unknown_normals_and_of_finished_meshes() -> None:
    heights, middle = np.zeros(N * N), N * N // 2
    heights[middle] = 1e-3
    surface = plate(heights)
    is_crest = np.arange(N * N) == middle
    assert (discord_of(replace(surface, is_crest=is_crest)) == 0.0).all()
    unknown = np.array(surface.normals)
    unknown[middle] = np.nan
    assert (discord_of(replace(surface, normals=unknown)) == 0.0).all()
    assert (discord_of(replace(surface, sigma=None)) == 0.0).all()


def test_where_fits_contradict_each_other_the_level_is_larger(rng: np.random.Generator) -> None:
    """Half of a plate errs by five times what is stated, on both surfaces; its level follows, the other stays."""
    is_bad = np.arange(N * N) % N > N // 2
    sigma = np.where(is_bad, 1e-4, 2e-5)
    plates = [plate(sigma * rng.normal(size=N * N)) for _ in range(2)]
    fixed = Registration(np.eye(4), np.diag([1e-9] * 3 + [1e-9] * 3) ** 2, plates[0].vertices[0], True)
    side = compare(plates[0], plates[1], fixed).on_compared
    known = np.isfinite(side.lod95)
    levels = [np.median(side.lod95[known & half]) for half in (~is_bad, is_bad)]
    assert levels[0] == pytest.approx(1.96 * np.sqrt(2.0) * 2e-5, rel=0.25)
    assert levels[1] == pytest.approx(1.96 * np.sqrt(2.0) * 1e-4, rel=0.25)  # as stated: a fifth
