"""Meshes brought onto points without a fold: who is held back, how far, and who is not."""

import numpy as np

from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import face_areas_and_normals
from monitor.reconstruction.untangle import drop_intersecting, untangle


def sheet(n=12, z=0.0, up=True):
    x, y = (a.ravel().astype(float) for a in np.meshgrid(np.arange(n), np.arange(n)))
    i = np.arange(n * n).reshape(n, n)
    low, right, above, far = (a.ravel() for a in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    faces = np.r_[np.c_[low, right, far], np.c_[low, far, above]]
    return np.c_[x, y, np.full(n * n, z)], faces if up else faces[:, ::-1]


def test_mesh_without_folds_goes_all_the_way(rng):
    raw, faces = sheet()
    wanted = raw + np.c_[0.2 * rng.uniform(-1, 1, size=(len(raw), 2)), rng.normal(size=len(raw))]
    moved = untangle(raw, wanted, faces)
    assert (moved.share == 1.0).all()
    assert (moved.vertices == wanted).all()


def test_vertex_that_would_turn_faces_over_stops_on_its_way():
    raw, faces = sheet()
    wanted = raw.copy()
    wanted[5 * 12 + 5] += [2.5, 0.1, 0.0]
    moved = untangle(raw, wanted, faces)
    assert moved.share[5 * 12 + 5] == 0.25  # at 0.5 it lies 1.25 beyond its place, past the next vertex
    assert len(find_intersections(moved.vertices, faces)) == 0
    assert (face_areas_and_normals(moved.vertices, faces)[1][:, 2] > 0.0).all()
    far = np.abs(raw - raw[5 * 12 + 5]).max(axis=1) > 4.5  # no face that was cut reaches there
    assert (moved.share[far] == 1.0).all()


def test_two_sheets_that_would_pass_through_each_other_are_kept_apart():
    top, faces = sheet(z=0.5)
    bottom, below = sheet(z=-0.5, up=False)
    raw, both = np.r_[top, bottom], np.r_[faces, below + len(top)]
    bump = 0.8 * np.exp(-((top[:, :2] - 5.5) ** 2).sum(axis=1) / 8.0)
    wanted = raw.copy()
    wanted[: len(top), 2] -= bump
    wanted[len(top) :, 2] += bump
    assert len(find_intersections(wanted, both)) > 0
    moved = untangle(raw, wanted, both)
    assert len(find_intersections(moved.vertices, both)) == 0
    assert 0 < np.count_nonzero(moved.share < 1.0) < 0.5 * len(raw)


def test_faces_that_meet_in_the_raw_mesh_already_are_dropped():
    top, faces = sheet()
    across, more = sheet()
    vertices = np.r_[top, across[:, [0, 2, 1]] + [0.3, 5.3, -5.3]]
    both = np.r_[faces, more + len(top)]
    assert len(find_intersections(untangle(vertices, vertices, both).vertices, both)) > 0
    suspects = untangle(vertices, vertices, both).suspects
    assert 0 < np.count_nonzero(suspects) < 0.3 * len(both)
    kept = drop_intersecting(vertices, both, suspects)
    assert len(find_intersections(vertices, kept)) == 0
    assert len(kept) > 0.7 * len(both)
