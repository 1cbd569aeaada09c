"""Nouns go to trimesh, pyvista, pandas and Open3D and come back the same, in order, and as copies."""

import dataclasses

import numpy as np
import pytest
import trimesh

from projects import convert
from projects.errors import ParameterError, ShapeError
from projects.model import ComparedSurface, PointCloud, Surface

FAR = np.array([6e5, 5e6, 100.0])


@pytest.fixture
def cloud(rng):
    n = 50
    normals = rng.normal(size=(n, 3))
    return PointCloud(
        points=rng.normal(size=(n, 3)) + FAR,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        origins=np.array([6e5, 5e6, 110.0]),
        sigma=np.where(np.arange(n) % 5 == 0, np.nan, 1e-4),
        intensity=rng.random(n),
        colors=rng.integers(0, 256, (n, 3)),
        n_merged=rng.integers(1, 9, n),
    )


@pytest.fixture
def surface():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) + FAR
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    normals = np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(vertices, faces, normals, sigma=np.array([1, 2, np.nan, 4.0]), colors=np.arange(12).reshape(4, 3))


def assert_same(got, expected):
    for field in dataclasses.fields(expected):
        ours, theirs = getattr(expected, field.name), getattr(got, field.name)
        assert (ours is None) == (theirs is None), field.name
        if ours is not None:
            np.testing.assert_allclose(theirs, np.broadcast_to(ours, np.shape(theirs)), rtol=1e-12, err_msg=field.name)


def test_cloud_survives_pandas(cloud):
    table = convert.cloud_to_pandas(cloud)
    assert list(table.columns[:6]) == ["x", "y", "z", "nx", "ny", "nz"]
    assert table["red"].tolist() == cloud.colors[:, 0].tolist()
    assert_same(convert.cloud_from_pandas(table), cloud)


def test_table_without_coordinates_is_refused(cloud):
    with pytest.raises(ShapeError, match="lacks the columns y"):
        convert.cloud_from_pandas(convert.cloud_to_pandas(cloud).drop(columns="y"))


def test_cloud_survives_pyvista_in_double_precision(cloud):
    mesh = convert.cloud_to_pyvista(cloud)
    assert mesh.points.dtype == np.float64
    assert_same(convert.cloud_from_pyvista(mesh), cloud)


def test_surface_survives_trimesh_with_vertices_in_order(surface):
    assert_same(convert.surface_from_trimesh(convert.surface_to_trimesh(surface)), surface)


def test_surface_survives_pyvista(surface):
    assert_same(convert.surface_from_pyvista(convert.surface_to_pyvista(surface)), surface)


def test_which_faces_are_invented_goes_along(surface):
    closed = dataclasses.replace(surface, face_invented=np.array([False, True, False, False]))
    for back in (convert.surface_from_trimesh(convert.surface_to_trimesh(closed)),
                 convert.surface_from_pyvista(convert.surface_to_pyvista(closed))):  # fmt: skip
        assert back.face_invented is not None
        assert back.face_invented.tolist() == [False, True, False, False]
    assert convert.surface_from_pyvista(convert.surface_to_pyvista(surface)).face_invented is None


def test_changing_the_converted_mesh_does_not_change_the_surface(surface):
    before = surface.vertices.copy()
    convert.surface_to_trimesh(surface).vertices += 1.0
    mesh = convert.surface_to_pyvista(surface)
    mesh.points += 1.0
    mesh.point_data["sigma"] += 1.0
    np.testing.assert_array_equal(surface.vertices, before)
    assert surface.sigma[0] == 1.0


def test_polygons_of_pyvista_become_triangles():
    import pyvista

    surface = convert.surface_from_pyvista(pyvista.Plane(i_resolution=2, j_resolution=1))
    assert surface.faces.shape == (4, 3)


def test_comparison_keeps_unknown_distances_unknown(surface):
    n = len(surface.vertices)
    distances = np.array([0.001, np.nan, -0.002, 0.0])
    side = ComparedSurface(
        surface, distances, abs(distances), np.array([2, 0, 2, 1], np.uint8), np.arange(n), np.zeros(n, np.uint8)
    )
    table = convert.compared_to_pandas(side)
    np.testing.assert_array_equal(table["distances"], distances)
    assert table["assessment"].tolist() == [2, 0, 2, 1]
    assert "told_from" not in table
    known = convert.compared_to_pandas(dataclasses.replace(side, told_from=2.0 * abs(distances)))
    np.testing.assert_array_equal(known["told_from"], 2.0 * abs(distances))
    mesh = convert.compared_to_pyvista(side)
    np.testing.assert_array_equal(mesh.point_data["distances"], distances)
    assert mesh.n_cells == len(surface.faces)
    back = convert.compared_from_pyvista(mesh)
    assert_same(back.surface, surface)
    for name in ("distances", "lod95", "assessment", "region", "reasons"):
        np.testing.assert_array_equal(getattr(back, name), getattr(side, name))
    assert back.told_from is None
    assert np.isnan(back.coarse_from)
    coarse = dataclasses.replace(side, told_from=np.array([1.0, np.nan, 1.0, 3.0]), coarse_from=2.0)
    again = convert.compared_from_pyvista(convert.compared_to_pyvista(coarse))
    assert again.coarse_from == 2.0
    assert again.is_coarse.tolist() == coarse.is_coarse.tolist()
    with pytest.raises(ShapeError, match="lacks the point data distances, lod95"):
        convert.compared_from_pyvista(convert.surface_to_pyvista(surface))


def test_points_and_colours_of_a_cloud_survive_trimesh(cloud):
    back = convert.cloud_from_trimesh(convert.cloud_to_trimesh(cloud))
    np.testing.assert_array_equal(back.points, cloud.points)
    np.testing.assert_array_equal(back.colors, cloud.colors)
    bare = convert.cloud_from_trimesh(convert.cloud_to_trimesh(PointCloud(cloud.points)))
    assert bare.colors is None


def test_cloud_survives_open3d(cloud):
    back = convert.cloud_from_open3d(convert.cloud_to_open3d(cloud))
    np.testing.assert_allclose(back.points, cloud.points)
    np.testing.assert_allclose(back.normals, cloud.normals)
    np.testing.assert_array_equal(back.colors, cloud.colors)


def test_normals_among_the_attributes_of_a_trimesh_are_taken(surface):
    mesh = convert.surface_to_trimesh(dataclasses.replace(surface, normals=None))
    mesh.vertex_attributes["normals"] = surface.normals
    assert_same(convert.surface_from_trimesh(mesh), surface)


def test_a_trimesh_without_normals_becomes_a_surface_without():
    """Trimesh makes them of the faces when asked, and zero ones where a vertex has no face."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.2], [1, 1, 0], [5, 5, 5.0]]) + FAR
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]], process=False)
    for asked in (False, True):  # what was looked at before makes no difference
        assert not asked or not mesh.vertex_normals[4].any()
        back = convert.surface_from_trimesh(mesh)
        assert back.normals is None
        np.testing.assert_array_equal(back.vertices, corners)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.3, [1, 2, 3], FAR))
    assert convert.surface_from_trimesh(mesh).normals is None


def test_normals_and_colours_go_along_as_pyvista_reads_them_from_a_file(surface, tmp_path):
    import pyvista

    from projects.formats import write_ply_mesh

    channels = {name: surface.colors[:, k].astype(np.uint8) for k, name in enumerate(("red", "green", "blue"))}
    normals = {f"n{axis}": surface.normals[:, k] for k, axis in enumerate("xyz")}
    write_ply_mesh(tmp_path / "a.ply", surface, {**normals, **channels})
    read = pyvista.read(tmp_path / "a.ply")
    read.point_data["Normals"] = surface.normals  # its reader leaves them out, its filters call them so
    back = convert.surface_from_pyvista(read)
    np.testing.assert_array_equal(back.colors, surface.colors)
    np.testing.assert_allclose(back.normals, surface.normals, atol=1e-7)
    read.point_data["RGBA"] = np.c_[read.point_data["RGB"], np.full(4, 255, np.uint8)]
    del read.point_data["RGB"]
    np.testing.assert_array_equal(convert.surface_from_pyvista(read).colors, surface.colors)
    assert convert.cloud_from_pyvista(read).normals.shape == (4, 3)


def test_what_is_no_mesh_of_trimesh_is_refused_with_what_it_is():
    ball = trimesh.creation.icosphere(subdivisions=1)
    with pytest.raises(ParameterError, match=r"is a Scene; .*a scene\.to_mesh\(\) is one"):
        convert.surface_from_trimesh(trimesh.Scene(ball))
    with pytest.raises(ParameterError, match=r"is a PointCloud; a trimesh\.Trimesh is needed$"):
        convert.surface_from_trimesh(trimesh.PointCloud(ball.vertices))
    with pytest.raises(ParameterError, match=r"is a Trimesh; a trimesh\.PointCloud is needed"):
        convert.cloud_from_trimesh(ball)
    assert len(convert.surface_from_trimesh(trimesh.Scene(ball).to_mesh()).faces) == len(ball.faces)
