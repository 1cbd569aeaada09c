"""A surface light enough for a screen: fewer faces, and a normal map that keeps the relief of all of them.

In: a surface. Out: `ScreenModel`, which `projects.formats.write_screen_glb` writes. After Nothegger (`001`,
conclusions). Faces by quadric error (Garland & Heckbert 1997, fast-simplification), texture coordinates by xatlas,
normals of the nearest place on the full surface in the tangent frame that glTF 2.0 defines.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.boxes import middle_of
from monitor.reconstruction.distances import closest_on_triangles, nearest_faces
from monitor.reconstruction.mesh import bow_ties, compact, is_degenerate, normals_by_angle
from projects.errors import ParameterError
from projects.model import Bools, Floats, Ints, Surface
from projects.triangles import share_among_vertices

TEXELS_PER_VERTEX = 3.0  # of the full surface: charts fill a good half of the map
SMALLEST, LARGEST = 256, 4096  # texels along the map's edge
GUTTER = 2  # texels around a chart, so that no neighbour bleeds into it
PIECE = 4000  # faces that are laid flat together: xatlas takes charts times faces, and noise makes thousands of charts


class ScreenModel(NamedTuple):
    """A light mesh, its vertices doubled where charts meet.

    `uv` (n, 2) from the map's upper left corner, `tangents` (n, 4): the direction along the map's rows and the side (1
    or -1) of the one up its columns. `normal_map` (rows, columns, 3) uint8: the full surface's normal in the frame of
    tangent, bitangent and normal, -1 to 1 as 0 to 255.
    """

    surface: Surface
    uv: Floats
    tangents: Floats
    normal_map: Any


def decimate_for_screen(surface: Surface, n_faces: int) -> ScreenModel:
    """Return at most `n_faces` faces of a surface with its relief as a normal map; colours of the nearest vertices.

    For the eye only: nothing may be measured on it.

    Raises
    ------
    ParameterError
        Where fewer than 4 faces are asked for, or the surface has none.
    """
    if n_faces < 4 or not len(surface.faces):
        raise ParameterError(f"{n_faces} of {len(surface.faces)} faces were asked for; give 4 or more of a mesh")
    middle = middle_of(surface.vertices)
    full = Surface(surface.vertices - middle, surface.faces, normals=full_normals(surface))
    vertices, faces = decimate(full.vertices, full.faces, n_faces)
    size = map_size(len(full.vertices))
    source, faces, uv, shape = unwrap(vertices, faces, size)
    normals = normals_by_angle(vertices, source[faces])[source]
    light = Surface(vertices[source], faces, normals=normals)
    tangents = uv_tangents(light, uv)
    normal_map = bake_normals(full, light, (uv, tangents), shape)
    colors = None if surface.colors is None else surface.colors[_nearest_vertices(full, light.vertices)]
    return ScreenModel(Surface(light.vertices + middle, faces, normals, colors=colors), uv, tangents, normal_map)


def full_normals(surface: Surface) -> Floats:
    """Return the surface's own normals, those of its faces where it has none."""
    made = normals_by_angle(surface.vertices, surface.faces)
    return made if surface.normals is None else np.where(np.isfinite(surface.normals), surface.normals, made)


def map_size(n_vertices: int) -> int:
    """Return the texels along the edge of a map that holds the relief of so many vertices, a power of two."""
    wanted = np.log2(np.sqrt(TEXELS_PER_VERTEX * max(n_vertices, 1)))
    return int(np.clip(2 ** int(np.ceil(wanted)), SMALLEST, LARGEST))


def decimate(vertices: Floats, faces: Ints, n_faces: int) -> tuple[Floats, Ints]:
    """Return a two-manifold of at most about `n_faces` faces; vertices (m, 3) in metres near the origin."""
    if len(faces) > n_faces:
        import fast_simplification

        vertices, faces = fast_simplification.simplify(
            vertices.astype(np.float32), faces.astype(np.int32), target_count=n_faces
        )
    vertices, faces = np.asarray(vertices, float), np.asarray(faces, np.int64)
    drop: Bools = is_degenerate(vertices, faces, 0.0)
    while drop.any():
        faces = faces[~drop]
        drop = bow_ties(faces)
    used, faces = compact(len(vertices), faces)
    return vertices[used], faces


def unwrap(vertices: Floats, faces: Ints, size: int) -> tuple[Ints, Ints, Floats, tuple[int, int]]:
    """Lay the faces flat in charts that do not overlap: the vertex of each new one, faces, uv, rows and columns.

    Piece by piece, packed together: charts end where pieces do, which adds a few per cent of vertices.
    """
    import xatlas

    atlas = xatlas.Atlas()
    used, order = [], cut_into_pieces(vertices[faces].mean(axis=1), PIECE)
    for piece in order:
        own, corners = np.unique(faces[piece], return_inverse=True)
        used.append(own)
        atlas.add_mesh(vertices[own].astype(np.float32), corners.reshape(-1, 3).astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution, options.padding = size, 2 * GUTTER
    atlas.generate(pack_options=options)
    charted = [atlas[k] for k in range(len(used))]
    first = np.cumsum([0, *(len(source) for source, _, _ in charted)])
    source = np.concatenate([own[part[0]] for own, part in zip(used, charted, strict=True)])
    flat = np.empty(faces.shape, np.int64)
    for piece, start, part in zip(order, first[:-1], charted, strict=True):
        flat[piece] = part[1] + start
    uv = np.concatenate([part[2] for part in charted]).astype(float)
    return source.astype(np.int64), flat, uv, (atlas.height, atlas.width)


def cut_into_pieces(places: Floats, most: int) -> list[Ints]:
    """Return which places (n, 3) are in each piece of at most `most`: halves, each of the longest side's two ends."""
    pieces: list[Ints] = []
    left: list[Ints] = [np.arange(len(places))]
    while left:
        piece = left.pop()
        if len(piece) <= most:
            pieces.append(piece)
            continue
        along = places[piece, np.ptp(places[piece], axis=0).argmax()]
        half = len(piece) // 2
        rank = np.argsort(along, kind="stable")
        left += [np.sort(piece[rank[half:]]), np.sort(piece[rank[:half]])]
    return pieces


def uv_tangents(surface: Surface, uv: Floats) -> Floats:
    """Return the direction of growing u at each vertex across its normal, and the side of falling v (n, 4)."""
    assert surface.normals is not None
    corner, at = surface.vertices[surface.faces], uv[surface.faces]
    e, f = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    (eu, ev), (fu, fv) = (at[:, 1] - at[:, 0]).T, (at[:, 2] - at[:, 0]).T
    area = (eu * fv - fu * ev)[:, None]
    sign = np.sign(area)
    along, down = sign * (fv[:, None] * e - ev[:, None] * f), sign * (eu[:, None] * f - fu[:, None] * e)
    sums = [np.column_stack([share_among_vertices(way[:, axis], surface.faces, len(uv)) for axis in range(3)])
            for way in (along, down)]  # fmt: skip
    tangent = sums[0] - np.einsum("ij,ij->i", sums[0], surface.normals)[:, None] * surface.normals
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    any_other = np.cross(surface.normals, np.where(np.abs(surface.normals[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    tangent = np.where(length > 0.0, tangent, any_other)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    up = np.einsum("ij,ij->i", np.cross(surface.normals, tangent), -sums[1])
    return np.c_[tangent, np.where(up < 0.0, -1.0, 1.0)]


def bake_normals(full: Surface, light: Surface, frame: tuple[Floats, Floats], shape: tuple[int, int]) -> Any:
    """Return the map (rows, columns, 3) uint8 of the full surface's normals in the light one's frames.

    A texel whose nearest place on the full surface looks away (the other side of a thin part) keeps the light normal.
    """
    assert full.normals is not None
    assert light.normals is not None
    uv, tangents = frame
    face = np.full(shape, -1, np.int32)
    weights = np.zeros((*shape, 3), np.float32)
    _rasterize(uv * [shape[1], shape[0]], light.faces, face, weights)
    rows, columns = np.nonzero(face >= 0)
    corners, share = light.faces[face[rows, columns]], weights[rows, columns].astype(float)
    places = np.einsum("ij,ijk->ik", share, light.vertices[corners])
    nearest = nearest_faces(full, places)
    _, inside = closest_on_triangles(places, full.vertices[full.faces[nearest]])
    true = np.einsum("ij,ijk->ik", inside, full.normals[full.faces[nearest]])
    normal = np.einsum("ij,ijk->ik", share, light.normals[corners])
    tangent = np.einsum("ij,ijk->ik", share, tangents[corners][:, :, :3])
    bitangent = np.cross(normal, tangent) * tangents[corners[:, 0], 3:]
    local = np.column_stack([np.einsum("ij,ij->i", true, axis) for axis in (tangent, bitangent, normal)])
    local = np.where(local[:, 2:] > 0.0, local, [[0.0, 0.0, 1.0]])
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    out = np.tile(np.array([128, 128, 255], np.uint8), (*shape, 1))
    out[rows, columns] = np.round(127.5 * (local + 1.0)).astype(np.uint8)
    return out


def _nearest_vertices(full: Surface, places: Floats) -> Ints:
    """Return the full surface's vertex next to each place (n, 3)."""
    face = nearest_faces(full, places)
    _, weights = closest_on_triangles(places, full.vertices[full.faces[face]])
    return full.faces[face, np.argmax(weights, axis=1)]


@jit(nopython=True, cache=True)
def _rasterize(uv: Floats, faces: Ints, face: Any, weights: Any) -> None:
    """Write the face at each texel's middle and its weights; a gutter around gets those of the nearest place inside."""
    rows, columns = face.shape
    for gutter in (0.0, 1.0 * GUTTER):
        for f in range(len(faces)):
            ax, ay = uv[faces[f, 0], 0], uv[faces[f, 0], 1]
            bx, by = uv[faces[f, 1], 0], uv[faces[f, 1], 1]
            cx, cy = uv[faces[f, 2], 0], uv[faces[f, 2], 1]
            area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
            if area == 0.0:
                continue
            first_x, last_x = int(np.floor(min(ax, bx, cx) - gutter)), int(np.ceil(max(ax, bx, cx) + gutter))
            first_y, last_y = int(np.floor(min(ay, by, cy) - gutter)), int(np.ceil(max(ay, by, cy) + gutter))
            for y in range(max(first_y, 0), min(last_y + 1, rows)):
                for x in range(max(first_x, 0), min(last_x + 1, columns)):
                    if face[y, x] >= 0:
                        continue
                    px, py = x + 0.5, y + 0.5
                    wb = ((px - ax) * (cy - ay) - (cx - ax) * (py - ay)) / area
                    wc = ((bx - ax) * (py - ay) - (px - ax) * (by - ay)) / area
                    wa = 1.0 - wb - wc
                    if min(wa, wb, wc) < 0.0:
                        if gutter == 0.0:
                            continue
                        wa, wb, wc = max(wa, 0.0), max(wb, 0.0), max(wc, 0.0)
                        total = wa + wb + wc
                        wa, wb, wc = wa / total, wb / total, wc / total
                        dx, dy = wa * ax + wb * bx + wc * cx - px, wa * ay + wb * by + wc * cy - py
                        if dx * dx + dy * dy > 2.0 * gutter * gutter:
                            continue
                    face[y, x] = f
                    weights[y, x, 0], weights[y, x, 1], weights[y, x, 2] = wa, wb, wc
