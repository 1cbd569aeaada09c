"""Finished meshes that show more than the object: the extent holds for them as it does for scans."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from monitor.cli import run
from monitor.mesh_extent import cut_to_extent
from projects import Project, Surface
from projects.formats import write_ply_mesh

EXTENT = {"polygon": [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]], "bottom": -0.2, "top": 0.2}


def knob(rng: np.random.Generator, shift: float = 0.0) -> Surface:
    """Return an uneven ball 0.2 m wide with 0.05 mm of noise, its middle at x = `shift` [m]."""
    ball = trimesh.creation.icosphere(5, 0.1)
    unit = np.asarray(ball.vertices) / 0.1
    height = 0.006 * np.sin(5.0 * unit[:, :1] + 2.0 * unit[:, 1:2]) * np.cos(4.0 * unit[:, 2:])
    vertices = unit * (0.1 + height + rng.normal(0.0, 5e-5, (len(unit), 1)))
    return Surface(vertices + np.array([shift, 0.0, 0.0]), np.asarray(ball.faces))


def with_neighbour(mesh: Surface) -> Surface:
    """Return a mesh with a block beside it, 0.3 m from its middle, beyond the extent."""
    block = trimesh.creation.box((0.1, 0.3, 0.3)).subdivide().subdivide().subdivide().subdivide()
    beside = np.asarray(block.vertices) + np.array([0.3, 0.0, 0.0])
    faces = np.vstack([mesh.faces, np.asarray(block.faces) + len(mesh.vertices)])
    colours = np.full((len(mesh.vertices) + len(beside), 3), 7, dtype=np.uint8)
    return Surface(np.vstack([mesh.vertices, beside]), faces, colors=colours)


def test_faces_within_the_extent_are_kept_with_what_is_known_of_them(rng: np.random.Generator) -> None:
    mesh = knob(rng)
    both = with_neighbour(mesh)
    invented = both.vertices[both.faces][..., 2].max(axis=1) < -0.08
    cut = cut_to_extent(replace(both, face_invented=invented), EXTENT)
    np.testing.assert_array_equal(cut.surface.face_invented, invented[: len(mesh.faces)])
    np.testing.assert_array_equal(cut.surface.vertices, mesh.vertices)
    np.testing.assert_array_equal(cut.surface.faces, mesh.faces)
    assert cut.surface.colors is not None
    assert cut.surface.colors.shape == mesh.vertices.shape
    ball, block = 4.0 * np.pi * 0.1**2, 4.0 * 0.1 * 0.3 + 2.0 * 0.3**2
    assert cut.share == pytest.approx(block / (ball + block), rel=0.02)  # the ball is uneven
    assert cut.n_outside == 12 * 4**4


@pytest.mark.parametrize(("extent", "shift", "share"), [(None, 0.0, 0.0), (EXTENT, 0.0, 0.0), (EXTENT, 9.0, 1.0)])
def test_nothing_is_cut_without_an_extent_within_it_and_in_a_frame_of_its_own(rng, extent, shift, share) -> None:
    mesh = knob(rng, shift)
    cut = cut_to_extent(mesh, extent)
    assert cut.surface is mesh
    assert (cut.n_outside, cut.share) == (0, share)


def test_what_stands_beside_the_object_is_not_told_as_added(tmp_path, rng, capsys) -> None:
    """It took two thirds of the area out of what is assessed, and after scans it was told as a gain of 0.04 m2."""
    project = str(tmp_path / "project")
    (tmp_path / "extent.json").write_text(json.dumps(EXTENT))
    assert run(["init", project]) == 0
    assert run(["add-object", project, "knob", "--extent", str(tmp_path / "extent.json")]) == 0
    for year, mesh in ((2021, knob(rng)), (2022, with_neighbour(knob(rng)))):
        path = tmp_path / f"e{year}.ply"
        write_ply_mesh(path, mesh)
        assert run(["add-epoch", project, "knob", f"e{year}", "--date", f"{year}-05-01", "--mesh", str(path)]) == 0
    assert run(["process", project]) == 0
    assert "mind: knob e2022: 70 % of the mesh lies outside of the object's extent" in capsys.readouterr().err
    assert run(["compare", project, "knob", "e2021", "e2022"]) == 0
    comparison = Project.open(project).get("knob", "e2022", "comparison-e2021")
    assert len(comparison.on_compared.surface.vertices) == len(knob(rng).vertices)
    assert comparison.statistics["assessed_area_share"] > 0.99
    assert len(comparison.regions) == 0
