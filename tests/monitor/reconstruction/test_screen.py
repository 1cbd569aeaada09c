"""The light model for a screen: few faces, the relief in its normal map, a file that viewers read."""

import json
import struct

import numpy as np
import pytest
import trimesh

from monitor.reconstruction import screen
from monitor.reconstruction.screen import cut_into_pieces, decimate, decimate_for_screen, map_size, unwrap
from projects.errors import ParameterError
from projects.formats import write_screen_glb
from projects.model import Surface

RADIUS, FAR = 0.06, np.array([431_000.0, 4_512_000.0, 210.0])


def relief(way):
    """Return the height of the relief and the surface's normal in the directions `way` (n, 3)."""
    k = 2 * np.pi * RADIUS / 0.008
    height = 0.0006 * np.sin(k * way).sum(axis=1) / 3.0
    slope = 0.0002 * k * np.cos(k * way)
    slope -= (slope * way).sum(axis=1)[:, None] * way
    normals = way - slope / (RADIUS + height)[:, None]
    return height, normals / np.linalg.norm(normals, axis=1)[:, None]


def relief_sphere(subdivisions=6):
    """Return a sphere with a relief of 0.6 mm in waves of 8 mm, and its exact normals."""
    sphere = trimesh.creation.icosphere(subdivisions, radius=1.0)
    way = np.asarray(sphere.vertices)
    height, normals = relief(way)
    colors = np.where(way[:, 2:] > 0, [[200, 10, 10]], [[10, 10, 200]]).astype(np.uint8)
    return Surface((RADIUS + height)[:, None] * way + FAR, np.asarray(sphere.faces), normals=normals, colors=colors)


def normals_on_screen(model):
    """Return the normals that a viewer shows in the middle of each face, and those that it would without the map."""
    corner = model.surface.faces
    at = model.uv[corner].mean(axis=1) * model.normal_map.shape[1::-1]
    texel = model.normal_map[at[:, 1].astype(int), at[:, 0].astype(int)] / 127.5 - 1.0
    normal = model.surface.normals[corner].mean(axis=1)
    tangent = model.tangents[corner].mean(axis=1)
    frame = np.stack([tangent[:, :3], np.cross(normal, tangent[:, :3]) * tangent[:, 3:], normal], axis=1)
    shown = np.einsum("ij,ijk->ik", texel, frame)
    return shown / np.linalg.norm(shown, axis=1)[:, None], normal / np.linalg.norm(normal, axis=1)[:, None]


def test_normal_map_shows_the_relief_that_the_faces_have_lost():
    full = relief_sphere()
    model = decimate_for_screen(full, 3000)
    assert len(model.surface.faces) <= 3000
    shown, plain = normals_on_screen(model)
    middle = model.surface.vertices[model.surface.faces].mean(axis=1) - FAR
    true = relief(middle / np.linalg.norm(middle, axis=1)[:, None])[1]
    angle = [np.degrees(np.arccos(np.clip((n * true).sum(axis=1), -1, 1))) for n in (shown, plain)]
    assert np.median(angle[1]) > 5.0  # the decimated mesh alone
    assert np.median(angle[0]) < 0.4 * np.median(angle[1])  # the foot of a face lies up to a texel beside
    assert np.percentile(angle[0], 90) < 0.5 * np.percentile(angle[1], 90)


def test_a_noisy_mesh_is_laid_flat_in_pieces_without_a_loss(monkeypatch):
    """xatlas takes charts times faces of a mesh: minutes where noise makes a chart of every few faces."""
    xatlas = pytest.importorskip("xatlas")
    handed = []

    class Counted(xatlas.Atlas):
        def add_mesh(self, vertices, faces):
            handed.append(len(faces))
            super().add_mesh(vertices, faces)

    monkeypatch.setattr(xatlas, "Atlas", Counted)
    full = relief_sphere(5)
    noise = np.random.default_rng(3).normal(0.0, 0.0015, full.vertices.shape)
    vertices, faces = decimate(full.vertices - FAR + noise, full.faces, 10_000)
    source, flat, uv, shape = unwrap(vertices, faces, 512)
    assert sum(handed) == len(faces)
    assert max(handed) <= screen.PIECE < len(faces)
    assert (source[flat] == faces).all()  # each face where it was, of its own vertices
    a, b, c = np.moveaxis(uv[flat] * shape[::-1], 1, 0)
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    texel = np.full(shape, -1, np.int32)
    screen._rasterize(uv * shape[::-1], flat, texel, np.zeros((*shape, 3), np.float32))
    shown = np.bincount(texel[texel >= 0], minlength=len(flat))
    assert np.mean(shown[area > 3.0] > 0) == 1.0  # none lies below another


def test_pieces_hold_every_place_once_and_no_more_than_asked(rng):
    places = rng.uniform(size=(1001, 3)) * [4.0, 1.0, 1.0]
    pieces = cut_into_pieces(places, 300)
    assert sorted(np.concatenate(pieces).tolist()) == list(range(1001))
    assert max(len(piece) for piece in pieces) <= 300
    assert all(np.ptp(places[piece, 0]) < 1.1 for piece in pieces)  # quarters of the long side
    assert len(cut_into_pieces(places[:0], 300)) == 1


def test_model_keeps_place_colour_and_unit_frames():
    full = relief_sphere(5)
    model = decimate_for_screen(full, 1000)
    distance = np.linalg.norm(model.surface.vertices - FAR, axis=1)
    assert np.abs(distance - RADIUS).max() < 0.002
    above = model.surface.vertices[:, 2] - FAR[2] > 0.004
    assert (model.surface.colors[above] == [200, 10, 10]).all()
    assert np.allclose(np.linalg.norm(model.tangents[:, :3], axis=1), 1.0)
    assert np.abs(np.einsum("ij,ij->i", model.tangents[:, :3], model.surface.normals)).max() < 1e-9
    assert set(model.tangents[:, 3].tolist()) <= {1.0, -1.0}
    assert (model.uv >= 0.0).all()
    assert (model.uv <= 1.0).all()


def test_file_is_gltf_with_a_normal_texture_and_opens_in_its_place(tmp_path):
    model = decimate_for_screen(relief_sphere(4), 500)
    path = tmp_path / "model.glb"
    write_screen_glb(path, model.surface, model.uv, model.tangents, model.normal_map)
    raw = path.read_bytes()
    magic, version, length, n_json, kind = struct.unpack("<4sIII4s", raw[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(raw), b"JSON")
    content = json.loads(raw[20 : 20 + n_json])
    assert content["materials"][0]["normalTexture"] == {"index": 0}
    assert {"POSITION", "NORMAL", "TANGENT", "TEXCOORD_0", "COLOR_0"} == set(
        content["meshes"][0]["primitives"][0]["attributes"]
    )
    mesh = trimesh.load(path, process=False).to_mesh()
    x, y, z = model.surface.vertices.T
    assert np.abs(np.asarray(mesh.vertices) - np.column_stack([x, z, -y])).max() < 1e-6  # y is up in glTF
    assert (np.asarray(mesh.faces) == model.surface.faces).all()
    image = np.asarray(trimesh.load(path, process=False).geometry.popitem()[1].visual.material.normalTexture)
    assert (image == model.normal_map).all()


def test_map_grows_with_the_mesh_up_to_what_viewers_take():
    assert [map_size(n) for n in (1, 100_000, 10_000_000)] == [256, 1024, 4096]


def test_too_few_faces_are_refused():
    with pytest.raises(ParameterError, match="4 or more"):
        decimate_for_screen(relief_sphere(3), 3)
