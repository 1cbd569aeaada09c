"""Finished meshes whose faces look the wrong way: turned where that can be told, said where it cannot."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from monitor.cli import run
from monitor.winding import wind_outward
from projects import Project
from projects.formats import write_ply_mesh
from projects.model import Surface

MIDDLE = np.array([5.0, -3.0, 2.0])  # m


def ball(radius: float = 0.3) -> Surface:
    """Return a sphere [m], off the origin, that looks outward."""
    mesh = trimesh.creation.icosphere(3, radius)
    mesh.apply_translation(MIDDLE)
    return Surface(np.array(mesh.vertices), np.array(mesh.faces), normals=mesh.vertex_normals)


def outward(surface: Surface) -> np.ndarray:
    """Return which faces (m,) of a ball look away from its middle."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    return (np.cross(b - a, c - a) * (a - MIDDLE)).sum(axis=1) > 0.0


def turned(surface: Surface, which) -> Surface:
    """Return the surface with some of its faces turned."""
    faces = surface.faces.copy()
    faces[which] = faces[which][:, ::-1]
    return Surface(surface.vertices, faces, normals=surface.normals)


def without_base(surface: Surface) -> Surface:
    """Return the ball without what lies lowest: a fifth of its height."""
    return Surface(surface.vertices, surface.faces[surface.vertices[surface.faces, 2].mean(axis=1) > 2.0 - 0.6 * 0.3])


def test_a_sound_mesh_stays_as_it_is():
    found = wind_outward(ball())
    assert (found.n_turned, found.looks_inward) == (0, False)
    assert found.surface.normals is not None


@pytest.mark.parametrize("make", [ball, lambda: without_base(ball())])
def test_a_body_inside_out_is_turned_round_closed_or_open_below(make):
    found = wind_outward(turned(make(), slice(None)))
    assert found.n_turned == len(found.surface.faces)
    assert outward(found.surface).all()
    assert found.surface.normals is None  # they looked inward too


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_faces_that_look_against_those_around_them_are_turned(rng, share):
    which = rng.random(len(ball().faces)) < share
    found = wind_outward(turned(ball(), which))
    assert found.n_turned == which.sum()
    assert outward(found.surface).all()


def test_what_looks_inward_and_is_as_wide_as_a_room_stays_and_is_said():
    found = wind_outward(turned(ball(radius=1.0), slice(None)))
    assert (found.n_turned, found.looks_inward) == (0, True)


def test_a_sheet_keeps_its_side():
    """A relief encloses nothing: which side was seen only the file can tell."""
    axis = np.linspace(-0.2, 0.2, 21)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    index = np.arange(21 * 21).reshape(21, 21)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    sheet = Surface(np.c_[x, y, 0.02 * np.sin(20.0 * x)], np.r_[np.c_[a, b, c], np.c_[a, c, d]])
    for given in (sheet, turned(sheet, slice(None))):
        found = wind_outward(given)
        assert (found.n_turned, found.looks_inward) == (0, False)


def test_a_band_with_a_twist_stays_as_it_is():
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    rim = [np.c_[np.cos(turn), np.sin(turn), 0.0 * turn] * (0.3 + w * np.cos(turn / 2))[:, None]
           + np.c_[0.0 * turn, 0.0 * turn, w * np.sin(turn / 2)] for w in (-0.05, 0.05)]  # fmt: skip
    k = np.arange(40)
    after, crossed = (k + 1) % 40, k == 39  # where the band closes, its edges change places
    low, high = np.where(crossed, after + 40, after), np.where(crossed, after, after + 40)
    band = Surface(np.concatenate(rim), np.r_[np.c_[k, low, high], np.c_[k, high, k + 40]])
    assert wind_outward(band).n_turned == 0


def write_dented(path: Path, depth: float, seed: int) -> Path:
    """Write an uneven ball of 0.3 m, inside out, with a dent [m] at one side and 0.05 mm of noise."""
    rng = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(5, 1.0)
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    ways = np.array(mesh.vertices)
    radius = 0.15 + 0.01 * np.sin(7.0 * ways[:, 0]) * np.cos(6.0 * ways[:, 1]) + rng.normal(0.0, 5e-5, len(ways))
    radius -= depth * np.clip(10.0 * ways[:, 2] - 8.5, 0.0, 1.0)
    write_ply_mesh(path, Surface(ways * radius[:, None], np.array(mesh.faces)[:, ::-1]))
    return path


def test_what_meshes_lost_that_are_inside_out_is_told_as_lost(tmp_path, capsys):
    """Both were compared as they came, and a dent of 3 mm was told as added."""
    project = str(tmp_path / "project")
    assert run(["init", project]) == run(["add-object", project, "ball"]) == 0
    for name, year, depth in (("e1", 2025, 0.0), ("e2", 2026, 0.003)):
        file = str(write_dented(tmp_path / f"{name}.ply", depth, year))
        assert run(["add-epoch", project, "ball", name, "--date", f"{year}-05-01", "--mesh", file]) == 0
    assert run(["process", project]) == 0
    assert capsys.readouterr().err.count("the mesh was inside out; its faces were turned outward") == 2
    assert run(["compare", project, "ball", "e1", "e2"]) == 0
    regions = Project.open(project).get("ball", "e2", "comparison-e1").regions
    assert list(regions["kind"]) == ["lost"]
    assert regions["extreme_m"].iloc[0] == pytest.approx(-0.003, abs=3e-4)  # six sigmas of noise
