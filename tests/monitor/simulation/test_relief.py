"""The terracotta relief: closed, of the stated sizes, and known where its brows and steep edges are."""

import numpy as np
import pytest
import trimesh
from brows_of_relief import brow_profiles

from monitor.simulation.changes import erode, hollow_out
from monitor.simulation.relief import BROW_HEIGHT, HEIGHT, relief_height, relief_scene
from monitor.simulation.true_change import change_at


@pytest.fixture(scope="module")
def relief():
    return relief_scene(cell=0.001)


def test_the_relief_is_closed_and_as_large_as_the_papers(relief):
    body = relief.bodies[0]
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0.2 * 0.2 * 0.02  # positive: the faces look outwards
    np.testing.assert_allclose(np.ptp(body.vertices, axis=0)[[0, 2]], 0.2)
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 801), np.linspace(-0.1, 0.1, 801))
    assert relief_height(u, v).max() == pytest.approx(HEIGHT, abs=5e-4)
    assert relief_height(u, v).min() == pytest.approx(0.0, abs=1e-9)


def test_brows_stand_out_by_their_height_and_are_three_to_five_millimetres_wide():
    u, v = np.moveaxis(brow_profiles(), -1, 0)
    h = relief_height(u, v)
    stands_out = h[:, 1] - 0.5 * (h[:, 0] + h[:, 2])
    # The forehead's own bend over 3 to 5 mm adds 0.1 mm at most.
    np.testing.assert_allclose(stands_out[3:-3], BROW_HEIGHT, atol=1.2e-4)
    width = np.hypot(*(np.moveaxis(brow_profiles(), -1, 0)[:, :, 0] - np.moveaxis(brow_profiles(), -1, 0)[:, :, 2]))
    assert 0.003 <= width.min() < 0.0034
    assert 0.0046 < width.max() <= 0.005


def test_regions_hold_brows_steep_edges_and_flat_parts(relief):
    u, v = brow_profiles()[:, 1].T
    crest = np.column_stack([u, -relief_height(u, v), v])
    assert relief.regions["brows"](crest).all()
    assert not relief.regions["flat"](crest).any()
    outline = np.array([[0.030, 0.0, -0.0597]])  # the chin's edge
    assert relief.regions["steep"](outline)
    assert not relief.regions["steep"](crest).any()
    assert relief.regions["flat"](np.array([[0.078, 0.0, 0.0]]))


def test_truth_is_the_mesh_and_its_curvature_the_heights(relief, rng):
    u, v = rng.uniform(-0.03, 0.03, (2, 400))
    v = 0.047 + 0.2 * v  # the forehead, smooth
    n = relief.truth.normal(np.column_stack([u, -relief_height(u, v), v]))
    on = relief.truth.closest_point(np.column_stack([u, -relief_height(u, v), v]))
    for height in (0.0008, -0.0008):
        np.testing.assert_allclose(relief.truth.signed_distance(on + height * n), height, atol=2e-5)
    assert np.all(n[:, 1] < -0.5)
    # A dome of half axes 56 and 76 mm and 16.5 mm high bends as an ellipsoid at its middle, 16.5 mm / a^2.
    bend = relief.truth.curvature(np.array([[0.0, -0.03, 0.050], [0.001, -0.03, 0.055]]))
    assert np.all((bend > 0.0165 / 0.076**2) & (bend < 0.04 / 0.056**2))


def test_a_change_moves_the_reliefs_nodes_and_leaves_the_others(relief):
    at = np.array([0.0, -float(relief_height(0.0, 0.050)), 0.050])  # the forehead
    worn = relief_scene(cell=0.001, changes=[erode("worn forehead", at, radius=0.01, depth=0.0006)])
    lost = relief_scene(cell=0.001, changes=[hollow_out("hole", at, np.array([0.008, 0.006, 0.008]))])
    before = relief.bodies[0].vertices
    for after, deepest in ((worn, 0.0006), (lost, 0.006)):
        change = change_at(before, after.truth)
        far = np.linalg.norm(before - at, axis=1) > 0.013
        np.testing.assert_array_equal(before[far], after.bodies[0].vertices[far])
        assert change.min() == pytest.approx(-deepest, rel=0.25)
        assert trimesh.Trimesh(after.bodies[0].vertices, after.bodies[0].faces, process=False).is_watertight
