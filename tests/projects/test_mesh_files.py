"""Surfaces out and in: PLY, OBJ, STL and GLB; names, types, order, precision."""

import json

import numpy as np
import pandas as pd
import pytest
import trimesh

from projects.errors import FormatError, ShapeError
from projects.formats import (
    read_counted_mesh,
    read_mesh,
    read_scans,
    surface_properties,
    write_csv,
    write_glb,
    write_obj,
    write_ply_mesh,
    write_stl,
)
from projects.model import Surface

FAR = np.array([657_123.4, 5_400_321.0, 310.0])


@pytest.fixture
def surface(rng):
    """Return a coloured sphere of radius 1 m about the origin."""
    ball = trimesh.creation.icosphere(2)
    n = len(ball.vertices)
    return Surface(
        np.array(ball.vertices), np.array(ball.faces), normals=np.array(ball.vertex_normals),
        colors=rng.integers(0, 256, (n, 3)), sigma=rng.random(n),
    )  # fmt: skip


@pytest.fixture
def far_surface(surface):
    return Surface(surface.vertices + FAR, surface.faces, normals=surface.normals, colors=surface.colors)


def test_ply_has_the_properties_asked_for_in_their_order_and_types(tmp_path, surface):
    n = len(surface.vertices)
    properties = {
        "nx": surface.normals[:, 0].astype(np.float32),
        "red": surface.colors[:, 0],
        "distance": np.full(n, np.nan, np.float32),
        "assessment": np.ones(n, np.uint8),
        "region": np.arange(n, dtype=np.int32),
    }
    write_ply_mesh(tmp_path / "a.ply", surface, properties, ["made by\na test"])
    head = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")[0].decode().splitlines()
    assert head == [
        "ply", "format binary_little_endian 1.0", "comment made by a test", f"element vertex {n}",
        "property double x", "property double y", "property double z", "property float nx", "property uchar red",
        "property float distance", "property uchar assessment", "property int region",
        f"element face {len(surface.faces)}", "property list uchar int vertex_indices",
    ]  # fmt: skip


def test_another_program_reads_the_ply(tmp_path, surface):
    region = np.arange(len(surface.vertices), dtype=np.int32)
    write_ply_mesh(tmp_path / "a.ply", surface, surface_properties(surface) | {"region": region})
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(mesh.vertices, surface.vertices)
    np.testing.assert_array_equal(mesh.faces, surface.faces)
    np.testing.assert_array_equal(mesh.visual.vertex_colors[:, :3], surface.colors)
    np.testing.assert_array_equal(mesh.metadata["_ply_raw"]["vertex"]["data"]["region"].ravel(), region)


def test_property_that_ply_cannot_hold_is_refused(tmp_path, surface):
    n = len(surface.vertices)
    for properties in ({"id": np.zeros(n, np.int64)}, {"a b": np.zeros(n)}, {"short": np.zeros(n - 1)}):
        with pytest.raises(ShapeError, match="PLY property"):
            write_ply_mesh(tmp_path / "a.ply", surface, properties)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("suffix", "write", "tolerance"),
    [(".ply", write_ply_mesh, 0.0), (".obj", write_obj, 0.51e-6), (".glb", write_glb, 6e-8)],
)
def test_surface_far_from_the_origin_comes_back(tmp_path, far_surface, suffix, write, tolerance):
    write(tmp_path / f"a{suffix}", far_surface)
    got = read_mesh(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(got.vertices, far_surface.vertices, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(got.faces, far_surface.faces)
    np.testing.assert_array_equal(got.colors, far_surface.colors)
    (stream,) = read_scans(tmp_path / f"a{suffix}")
    (chunk,) = stream.chunks()
    np.testing.assert_array_equal(chunk.cloud.points, got.vertices)


def test_glb_stands_upright_where_y_is_up_and_its_colours_are_amounts_of_light(tmp_path, surface):
    """glTF 2.0, sections 3.4 and 3.7.2.1; half of the light of white is shown as 188 (sRGB)."""
    colors = np.tile(np.array([[188, 0, 255]], np.uint8), (len(surface.vertices), 1))
    write_glb(tmp_path / "a.glb", surface, colors)
    raw = (tmp_path / "a.glb").read_bytes()
    n_json = int.from_bytes(raw[12:16], "little")
    content = json.loads(raw[20 : 20 + n_json])
    seen = trimesh.load(tmp_path / "a.glb", process=False).to_mesh()
    x, y, z = surface.vertices.T
    np.testing.assert_allclose(seen.vertices, np.column_stack([x, z, -y]), atol=1e-6)
    accessor = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = content["bufferViews"][accessor["bufferView"]]
    light = np.frombuffer(raw, "<f4", 3, 28 + n_json + view["byteOffset"])
    np.testing.assert_allclose(light, [0.503, 0.0, 1.0], atol=1e-3)


def test_stl_comes_back_with_each_vertex_once(tmp_path, surface):
    write_stl(tmp_path / "a.stl", surface)
    got = read_mesh(tmp_path / "a.stl")
    assert len(got.vertices) == len(surface.vertices)
    np.testing.assert_allclose(got.vertices[got.faces], surface.vertices[surface.faces], atol=6e-8)
    normals = trimesh.load(tmp_path / "a.stl", process=False).face_normals
    assert (np.einsum("ij,ij->i", normals, surface.vertices[surface.faces].mean(axis=1)) > 0.9).all()


def test_stl_refuses_coordinates_that_it_would_move(tmp_path, far_surface):
    with pytest.raises(FormatError, match=r"would move these coordinates by up to \d+ mm"):
        write_stl(tmp_path / "a.stl", far_surface)


def test_text_stl_is_read_and_a_cut_one_refused(tmp_path):
    text = "solid a\n" + 2 * (
        "facet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  vertex 1 0 0\n  vertex 0 1.5 0\n endloop\nendfacet\n"
    )
    (tmp_path / "a.stl").write_text(text + "endsolid a\n")
    got = read_mesh(tmp_path / "a.stl")
    assert (len(got.vertices), len(got.faces)) == (3, 2)
    (tmp_path / "b.stl").write_text(text)
    with pytest.raises(FormatError, match="endsolid"):
        read_mesh(tmp_path / "b.stl")


def test_binary_stl_that_is_cut_off_is_refused(tmp_path, surface):
    write_stl(tmp_path / "a.stl", surface)
    (tmp_path / "b.stl").write_bytes((tmp_path / "a.stl").read_bytes()[:-1])
    with pytest.raises(FormatError, match=r"b\.stl: "):
        read_mesh(tmp_path / "b.stl")


def test_obj_polygons_and_corners_counted_from_the_end_are_understood(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\nv 0 0 1\nf -1 -2//1 -3\n"
    (tmp_path / "a.obj").write_text(text)
    got = read_mesh(tmp_path / "a.obj", unit=0.001)
    assert sorted(map(tuple, got.faces)) == [(0, 1, 2), (0, 2, 3), (4, 3, 2)]
    assert got.vertices.max() == 0.001


def test_vertices_of_no_face_are_no_part_of_the_mesh(tmp_path):
    text = "v 9 9 9 1 0 0\nv 1 0 0 0 255 0\nv nan nan nan 0 0 0\nv 1 1 0 0 0 255\nv 0 1 0 1 1 1\nf 2 4 5\n"
    (tmp_path / "a.obj").write_text(text)
    got = read_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(got.vertices, [[1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(got.faces, [[0, 1, 2]])
    np.testing.assert_array_equal(got.colors, [[0, 255, 0], [0, 0, 255], [1, 1, 1]])


def test_what_is_left_out_of_a_mesh_is_counted(tmp_path):
    text = "v 9 9 9\nv 1 0 0\nv 8 8 8\nv 1 1 0\nv 0 1 0\nv 1 0 0\nv 7 7 7\nf 2 4 5\nf 2 4 4\nf 7 7 7\nf 2 6 5\n"
    (tmp_path / "a.obj").write_text(text)
    got = read_counted_mesh(tmp_path / "a.obj")
    assert len(got.surface.faces) == 1
    assert got.dropped == {"vertices_of_no_triangle": 3, "triangles_without_three_corners": 3}
    (tmp_path / "b.obj").write_text("v 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\n")
    assert read_counted_mesh(tmp_path / "b.obj").dropped == {}


def test_a_byte_order_mark_costs_no_vertex(tmp_path):
    (tmp_path / "a.obj").write_bytes(b"\xef\xbb\xbfv 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    assert len(read_mesh(tmp_path / "a.obj").vertices) == 3


def test_line_of_a_broken_text_stl_is_named_as_the_file_counts_it(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 {y} 0\nendloop\nendfacet\n"
    (tmp_path / "a.stl").write_text("solid a\n" + facet.format(y="1") + facet.format(y="1x") + "endsolid a\n")
    with pytest.raises(FormatError, match="line 13 has '1x', which is no number"):
        read_mesh(tmp_path / "a.stl")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 4\n", "name vertices 0 to 3; it has 0 to 2"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 0 1 2\n", "vertex 0; OBJ counts from 1"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf a b c\n", "names no vertex"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 2\n", "no faces with three different corners"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\n", "holds no faces"),
        ("v 0 0 0\nv nan 0 0\nv 1 1 0\nf 1 2 3\n", "not finite"),
        ("# a\nv 0 0 0\nvt 0 0\nv 1 0\nv 1 1 0\nf 1 2 3\n", "line 4 has 2 values"),
        ("v 0 0 0\n\nv\nf 1 2 3\n", "line 3 has a vertex without numbers"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nf 3 2", "line 5 has a face of 2 corners"),
    ],
)
def test_mesh_that_is_none_is_refused(tmp_path, text, message):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_mesh(tmp_path / "a.obj")


def test_points_are_no_mesh(tmp_path):
    (tmp_path / "a.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(FormatError, match="XYZ holds no mesh"):
        read_mesh(tmp_path / "a.xyz")


def test_file_that_names_another_opens_nothing(tmp_path):
    secret = tmp_path / "secret.bin"
    secret.write_bytes(np.zeros(9, "<f4").tobytes())
    gltf = (
        b'{"asset":{"version":"2.0"},"buffers":[{"uri":"secret.bin","byteLength":36}],"bufferViews":[{"buffer":0,'
        b'"byteLength":36}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],"meshes":'
        b'[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],"scenes":[{"nodes":[0]}],"scene":0}'
    )
    gltf += b" " * (-len(gltf) % 4)
    head = np.array([2, 20 + len(gltf), len(gltf)], "<u4").tobytes()
    (tmp_path / "a.glb").write_bytes(b"glTF" + head + b"JSON" + gltf)
    with pytest.raises(FormatError, match=r"a\.glb: "):
        read_mesh(tmp_path / "a.glb")


def test_table_keeps_digits_and_unknown_values(tmp_path):
    table = pd.DataFrame({"kind": ["lost", "Größe"], "area_m2": [0.1 + 0.2, np.nan]})
    write_csv(tmp_path / "a.csv", table)
    assert (tmp_path / "a.csv").read_text("utf-8") == "kind,area_m2\nlost,0.30000000000000004\nGröße,nan\n"


def test_existing_file_stays_whole_when_writing_fails(tmp_path, surface):
    write_ply_mesh(tmp_path / "a.ply", surface)
    before = (tmp_path / "a.ply").read_bytes()
    with pytest.raises(ShapeError):
        write_ply_mesh(tmp_path / "a.ply", surface, {"bad": np.zeros(1)})
    assert (tmp_path / "a.ply").read_bytes() == before
    with pytest.raises(FormatError, match="does not exist"):
        write_ply_mesh(tmp_path / "none" / "a.ply", surface)


def test_corners_parted_along_seams_are_one_vertex_again(tmp_path, surface):
    """As files with textures have them, and those that part all faces: each seam would be a free edge."""
    corners = surface.faces.ravel()
    soup = Surface(
        surface.vertices[corners], np.arange(len(corners)).reshape(-1, 3), normals=surface.normals[corners],
        colors=surface.colors[corners],
    )  # fmt: skip
    write_ply_mesh(tmp_path / "soup.ply", soup, surface_properties(soup))
    found = read_mesh(tmp_path / "soup.ply")
    assert len(found.vertices) == len(surface.vertices)
    assert len(found.faces) == len(surface.faces)
    np.testing.assert_array_equal(found.vertices[found.faces], surface.vertices[surface.faces])
    np.testing.assert_allclose(found.normals[found.faces], surface.normals[surface.faces], atol=1e-6)
    np.testing.assert_array_equal(found.colors[found.faces], surface.colors[surface.faces])


def test_what_is_one_place_in_space_has_the_mean_normal_of_its_sides(tmp_path):
    points = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 0]])
    normals = np.repeat([[0.0, 0, 1], [1, 0, 0]], 3, axis=0)
    folded = Surface(points, np.array([[0, 2, 1], [3, 5, 4]]), normals=normals)
    write_ply_mesh(tmp_path / "fold.ply", folded, surface_properties(folded))
    found = read_mesh(tmp_path / "fold.ply")
    np.testing.assert_array_equal(found.vertices, points[[0, 1, 2, 4]])  # as they come first in the file
    assert found.faces.tolist() == [[0, 2, 1], [0, 1, 3]]
    half = np.sqrt(0.5)
    np.testing.assert_allclose(found.normals, [[half, 0, half], [half, 0, half], [0, 0, 1], [1, 0, 0]], atol=1e-6)


@pytest.mark.parametrize("program", ["ours", "binary that adds a quality", "text"])
def test_which_faces_are_invented_comes_back(tmp_path, program):
    """They came back as measured, and an underside that nobody saw was compared."""
    path, box = tmp_path / "closed.ply", trimesh.creation.box()
    invented = np.asarray(box.triangles_center)[:, 2] < -0.4
    write_ply_mesh(path, Surface(np.array(box.vertices), np.array(box.faces), face_invented=invented))
    if program != "ours":
        is_text = program == "text"
        kinds = "property list uchar int vertex_indices\nproperty float quality\nproperty uchar invented\n"
        header = f"ply\nformat {'ascii' if is_text else 'binary_little_endian'} 1.0\nelement vertex 8\n"
        header += "".join(f"property double {axis}\n" for axis in "xyz") + f"element face 13\n{kinds}end_header\n"
        faces = np.zeros(13, [("n", "u1"), ("corners", "<i4", 3), ("quality", "<f4"), ("invented", "u1")])
        faces["n"], faces["quality"] = 3, 0.5
        faces["corners"][1:], faces["invented"][1:] = box.faces, invented  # the first has no area
        lines = [" ".join(map(str, row)) for row in box.vertices.tolist()]
        lines += [f"3 {' '.join(map(str, f['corners']))} {f['quality']} {f['invented']}" for f in faces]
        body = ("\n".join(lines) + "\n").encode() if is_text else np.array(box.vertices).tobytes() + faces.tobytes()
        path.write_bytes(header.encode() + body)
    read = read_mesh(path)
    assert np.array_equal(read.faces, box.faces)
    assert read.face_invented is not None
    assert np.array_equal(read.face_invented, invented)
