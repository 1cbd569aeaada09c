"""The Rocaille stove: closed pieces of the size that the paper tells, glazed, each of which can be shifted singly."""

import dataclasses

import numpy as np
import pytest
import trimesh

from monitor.simulation import build_scene, erode, measure_changes, move_part, rebuild_stove, stove_model
from monitor.simulation.stove import COURSES, HEIGHT, front_relief
from projects.transforms import apply

CELL = 0.010


@pytest.fixture(scope="module")
def corner():
    """Return three neighbouring pieces of the lower storey's front as a model of their own."""
    model = stove_model(cell=CELL)
    return dataclasses.replace(model, parts=tuple(model.part(f"piece 3.{k}") for k in (3, 4, 5)))


def test_the_stove_is_three_metres_of_pieces_no_larger_than_the_paper_says():
    model = stove_model(cell=CELL)
    pieces = [part for part in model.parts if part.name.startswith("piece")]
    assert len(pieces) == 12 * (len(COURSES) - 1)
    assert model.bounds()[1, 2] == pytest.approx(HEIGHT, abs=0.03)
    assert max(np.diff(COURSES)) < 0.30
    gloss = {part.name: part.gloss for part in pieces}
    assert 0 < sum(g > 0 for g in gloss.values()) < len(pieces)  # glazed tiles between matt mouldings


def test_the_pieces_are_closed_and_stand_side_by_side(corner):
    scene = build_scene(corner)
    for body in scene.bodies[:3]:
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_watertight  # each edge in two faces, one each way
        assert np.linalg.norm(np.sort(np.ptp(body.vertices, axis=0))[1:]) < 0.45  # 30 by 30 cm and the relief
    fields = [part.field_in_model() for part in corner.parts]
    for k, body in enumerate(scene.bodies[:3]):
        for j in range(3):
            if j != k:
                assert (fields[j](body.vertices.T) > -1e-4).all()  # no piece reaches into another


def test_the_relief_lies_on_the_front_and_is_mirrored_but_for_its_flame():
    z = np.linspace(0.45, 1.2, 400)
    x, z = np.meshgrid(np.linspace(0.2, 0.55, 200), z)
    right, left = front_relief()(x, z), front_relief()(-x, z)
    np.testing.assert_allclose(right, left, atol=0.004, rtol=0.1)
    assert 0.02 < right.max() < 0.06
    middle = front_relief()(np.array([0.05]), np.array([0.85])) - front_relief()(np.array([-0.05]), np.array([0.85]))
    assert abs(middle[0]) > 0.002


def test_one_piece_is_shifted_and_its_neighbours_stay(corner):
    T = np.eye(4)
    T[:3, 3] = [0.0, -0.035, 0.0]
    edit = move_part("piece set 35 mm forward", "piece 3.4", T)
    before, after = build_scene(corner), build_scene(corner, [edit])
    np.testing.assert_allclose(after.bodies[1].vertices, apply(T, before.bodies[1].vertices), atol=1e-12)
    for k in (0, 2):
        np.testing.assert_array_equal(after.bodies[k].vertices, before.bodies[k].vertices)
    (change,) = measure_changes(corner, [edit])
    assert change.kind == "moved"
    assert 0.015 < abs(change.extreme) <= 0.035 + 1e-6


def test_a_stove_set_up_again_has_every_piece_off_and_one_by_35_mm():
    model = stove_model(cell=CELL)
    edits = rebuild_stove(model, seed=1)
    assert len(edits) == 120
    shift = [apply(e.T_after_before, model.part(e.part).bounds().mean(axis=0)[None])[0] for e in edits]
    length = np.linalg.norm(shift - np.stack([model.part(e.part).bounds().mean(axis=0) for e in edits]), axis=1)
    assert length.max() == pytest.approx(0.035, abs=1e-12)
    assert np.median(length) == pytest.approx(0.006, rel=0.2)  # median of 120 of a Rayleigh distribution
    assert (length > 0.0).all()


@pytest.mark.slow
def test_wear_of_a_moulding_has_the_volume_between_its_meshes():
    model = stove_model(cell=CELL)
    base = dataclasses.replace(model, parts=(dataclasses.replace(model.part("piece 1.4"), cell=0.004),))
    at = base.parts[0].body().vertices
    centre = at[at[:, 1].argmin()]  # on the torus, in front
    edit = erode("worn torus", centre, radius=0.05, depth=0.003)
    (change,) = measure_changes(base, [edit])
    volumes = []
    for changes in ((), (edit,)):
        body = build_scene(base, changes).bodies[0]
        volumes.append(trimesh.Trimesh(body.vertices, body.faces, process=False).volume)
    assert change.kind == "lost"
    assert -0.003 * np.sqrt(2.0) < change.extreme < -0.0029  # on the arris by a joint both faces are worn
    assert change.volume == pytest.approx(volumes[1] - volumes[0], rel=0.04)  # triangles of 4 mm on a torus of 32 mm
