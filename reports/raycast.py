"""What each pixel of a view sees: ray casting by Open3D (Embree), which needs no screen and gives the same everywhere.

In: a surface and a frame. Out: per sub-pixel the triangle, the nearest vertex, the smooth normal and the depth;
per pixel how much of the sky and of the key light reaches the place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from projects.model import Bools, Floats, Ints, Surface
from projects.triangles import area_vectors, face_areas
from projects.triangles import vertex_normals as normals_by_area
from reports.cameras import Frame, look_to, make_scene
from reports.lighting import SUBPIXELS, cast_light


@dataclass(frozen=True)
class Scene:
    """A surface made ready for rays: Open3D's scene in coordinates about `middle`, vertices in them, faces, normals."""

    rays: Any
    middle: Floats
    vertices: NDArray[np.float32]
    faces: Ints
    normals: NDArray[np.float32]
    lift: float  # [m] how far secondary rays start off the surface
    size: float  # [m] longest extent
    invented: Bools | None


@dataclass(frozen=True)
class Pixels:
    """What the sub-pixels of a view see, all (height * SUBPIXELS, width * SUBPIXELS, ...).

    `hit`: something is there. `vertex`: the surface's vertex nearest to the place, 0 where nothing is hit.
    `weights`, `corners`: barycentric coordinates and vertices of the triangle. `normal`: in frame axes (right,
    up, towards), turned to the viewer. `inside`: the back of a face is seen. `depth`: towards the viewer [m].
    `sky`, `light`: share of the sky and of the key light that reaches the place. `invented`: closes a hole.
    """

    hit: Bools
    vertex: Ints
    corners: Ints
    weights: NDArray[np.float32]
    normal: NDArray[np.float32]
    inside: Bools
    depth: NDArray[np.float32]
    sky: NDArray[np.float32]
    light: NDArray[np.float32]
    invented: Bools


def vertex_normals(surface: Surface) -> Floats:
    """Return the surface's unit normals (n, 3), made from its faces (weighted by area) where absent or NaN."""
    made = np.nan_to_num(normals_by_area(surface.vertices, surface.faces))
    if surface.normals is None:
        return made
    return np.where(np.isfinite(surface.normals).all(axis=1, keepdims=True), surface.normals, made)


def build_scene(surface: Surface) -> Scene:
    """Return the surface ready for rays; coordinates are taken about its middle, because the rays are float32."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    middle, size = (low + high) / 2, float((high - low).max())
    vertices = (surface.vertices - middle).astype(np.float32)
    area = face_areas(surface.vertices[surface.faces]).mean()
    lift = float(np.clip(0.5 * np.sqrt(area), 2e-5 * size, 2e-3 * size))
    normals = vertex_normals(surface).astype(np.float32)
    rays = make_scene(vertices, surface.faces)
    return Scene(rays, middle, vertices, surface.faces, normals, lift, size, surface.face_invented)


def keep_facing(scene: Scene, towards: Floats) -> Scene:
    """Return the scene with only those faces that look to a viewer who is far away `towards` (3,)."""
    facing = look_to(area_vectors(scene.vertices[scene.faces]), towards.astype(np.float32))
    faces, invented = scene.faces[facing], None if scene.invented is None else scene.invented[facing]
    return replace(scene, rays=make_scene(scene.vertices, faces), faces=faces, invented=invented)


def cast_view(scene: Scene, frame: Frame) -> Pixels:
    """Return what each sub-pixel of the view sees and how it is lit."""
    if frame.cut_away:
        scene = keep_facing(scene, frame.towards)
    rays, start = _primary_rays(scene, frame)
    answer = scene.rays.cast_rays(rays)
    distance = answer["t_hit"].numpy()
    hit = np.isfinite(distance)
    hit[len(hit) - frame.foot * SUBPIXELS :] = False  # kept for the scale bar
    face = np.where(hit, answer["primitive_ids"].numpy(), 0).astype(np.int32)
    u, v = np.moveaxis(answer["primitive_uvs"].numpy(), -1, 0)
    weights = np.stack([1 - u - v, u, v], axis=-1)
    corners = scene.faces[face]
    vertex = np.take_along_axis(corners, weights.argmax(axis=-1)[..., None], axis=-1)[..., 0]
    axes = frame.axes.astype(np.float32)
    inside = hit & (answer["primitive_normals"].numpy() @ axes[2] < 0)
    normal = np.einsum("rck,rckj->rcj", weights, scene.normals[corners]) @ axes.T
    normal = _turn_to_viewer(normal, inside)
    depth = np.where(hit, start - distance, np.nan).astype(np.float32)
    sky, light = cast_light(scene, frame, hit, normal, depth)
    invented = np.zeros_like(hit) if scene.invented is None else hit & scene.invented[face]
    return Pixels(hit, vertex, corners, weights, normal, inside, depth, sky, light, invented)


def _primary_rays(scene: Scene, frame: Frame) -> tuple[NDArray[np.float32], float]:
    """Return rays (rows, columns, 6) about the scene's middle, and their start's height above the frame's centre."""
    rows, columns = frame.height * SUBPIXELS, frame.width * SUBPIXELS
    step = frame.metres_per_pixel / SUBPIXELS
    x = (np.arange(columns) + 0.5 - columns / 2) * step
    y = (rows / 2 - np.arange(rows) - 0.5) * step
    start = float((scene.middle - frame.centre) @ frame.towards + 2 * scene.size)
    start = min(start, frame.near)
    plane = frame.centre - scene.middle + start * frame.towards
    rays = np.empty((rows, columns, 6), dtype=np.float32)
    rays[..., :3] = (plane + x[:, None] * frame.right)[None] + (y[:, None] * frame.up)[:, None]
    rays[..., 3:] = -frame.towards
    return rays, start


def _turn_to_viewer(normal: NDArray[np.float32], inside: Bools) -> NDArray[np.float32]:
    """Return unit normals with those of seen backs reversed, and none that looks away from the viewer."""
    normal = np.where(inside[..., None], -normal, normal)
    normal[..., 2] = np.maximum(normal[..., 2], 0.02)
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
