"""What each pixel of a view sees: ray casting by Open3D (Embree), which needs no screen and gives the same everywhere.

In: a surface and a frame. Out: per sub-pixel the triangle, the nearest vertex, the smooth normal and the depth;
per pixel how much of the sky and of the key light reaches the place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from projects.model import Bools, Floats, Ints, Surface
from projects.open3d_library import load_open3d
from reports.cameras import Frame, face_normals

SUBPIXELS = 2
SKY_RAYS = 16
LIGHT_RAYS = 4
KEY_LIGHT = np.array([-0.50, 0.62, 0.60]) / np.linalg.norm([-0.50, 0.62, 0.60])  # right, up, towards the viewer


@dataclass(frozen=True)
class Scene:
    """A surface made ready for rays: Open3D's scene in coordinates about `middle`, faces, vertex normals."""

    rays: Any
    middle: Floats
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
    made = np.zeros((len(surface.vertices), 3))
    of_faces = face_normals(surface)
    for axis in range(3):
        for corner in range(3):
            made[:, axis] += np.bincount(surface.faces[:, corner], of_faces[:, axis], minlength=len(made))
    made /= np.maximum(np.linalg.norm(made, axis=1, keepdims=True), 1e-300)
    if surface.normals is None:
        return made
    return np.where(np.isfinite(surface.normals).all(axis=1, keepdims=True), surface.normals, made)


def build_scene(surface: Surface) -> Scene:
    """Return the surface ready for rays; coordinates are taken about its middle, because the rays are float32."""
    scene = load_open3d().t.geometry.RaycastingScene()
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    middle, size = (low + high) / 2, float((high - low).max())
    scene.add_triangles((surface.vertices - middle).astype(np.float32), surface.faces.astype(np.uint32))
    area = np.linalg.norm(face_normals(surface), axis=1).mean() / 2
    lift = max(0.5 * float(np.sqrt(area)), 2e-5 * size)
    normals = vertex_normals(surface).astype(np.float32)
    return Scene(scene, middle, surface.faces, normals, lift, size, surface.face_invented)


def cast_view(scene: Scene, frame: Frame) -> Pixels:
    """Return what each sub-pixel of the view sees and how it is lit."""
    rows, columns = frame.height * SUBPIXELS, frame.width * SUBPIXELS
    origins, start = _ray_origins(scene, frame, rows, columns)
    rays = np.concatenate([origins, np.broadcast_to(-frame.towards, origins.shape)], axis=-1).astype(np.float32)
    answer = scene.rays.cast_rays(rays)
    distance = answer["t_hit"].numpy()
    hit = np.isfinite(distance)
    hit[rows - frame.foot * SUBPIXELS :] = False  # kept for the scale bar
    face = np.where(hit, answer["primitive_ids"].numpy(), 0).astype(np.int64)
    u, v = np.moveaxis(answer["primitive_uvs"].numpy(), -1, 0)
    weights = np.stack([1 - u - v, u, v], axis=-1)
    corners = scene.faces[face]
    vertex = np.take_along_axis(corners, weights.argmax(axis=-1)[..., None], axis=-1)[..., 0]
    axes = np.stack([frame.right, frame.up, frame.towards]).astype(np.float32)
    inside = hit & (answer["primitive_normals"].numpy() @ axes[2] < 0)
    normal = np.einsum("rck,rckj->rcj", weights, scene.normals[corners]) @ axes.T
    normal = _turn_to_viewer(normal, inside)
    depth = np.where(hit, start - distance, np.nan).astype(np.float32)
    sky, light = _light(scene, frame, axes, (hit, normal, depth))
    invented = np.zeros_like(hit) if scene.invented is None else hit & scene.invented[face]
    return Pixels(hit, vertex, corners, weights, normal, inside, depth, sky, light, invented)


def _ray_origins(scene: Scene, frame: Frame, rows: int, columns: int) -> tuple[Floats, float]:
    """Return ray origins (rows, columns, 3) about the scene's middle, and their height above the frame's centre."""
    step = frame.metres_per_pixel / SUBPIXELS
    x = (np.arange(columns) + 0.5 - columns / 2) * step
    y = (rows / 2 - np.arange(rows) - 0.5) * step
    start = float((scene.middle - frame.centre) @ frame.towards + 2 * scene.size)
    start = min(start, frame.near)
    plane = frame.centre - scene.middle + start * frame.towards
    return plane + x[None, :, None] * frame.right + y[:, None, None] * frame.up, start


def _turn_to_viewer(normal: NDArray[np.float32], inside: Bools) -> NDArray[np.float32]:
    """Return unit normals with those of seen backs reversed, and none that looks away from the viewer."""
    normal = np.where(inside[..., None], -normal, normal)
    normal[..., 2] = np.maximum(normal[..., 2], 0.02)
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


def _light(scene: Scene, frame: Frame, axes: Floats, seen: tuple[Bools, Floats, Floats]) -> tuple[Floats, Floats]:
    """Return the share of the sky and of the key light at each sub-pixel, cast once a pixel and smoothed."""
    every = (slice(SUBPIXELS // 2, None, SUBPIXELS),) * 2
    hit, normal, depth = seen[0][every], seen[1][every], seen[2][every]
    rows, columns = np.nonzero(hit)
    n, height = normal[hit], depth[hit]
    x = (columns + 0.5 + 0.5 / SUBPIXELS - frame.width / 2) * frame.metres_per_pixel
    y = (frame.height / 2 - rows - 0.5 - 0.5 / SUBPIXELS) * frame.metres_per_pixel
    place = frame.centre - scene.middle + np.stack([x, y, height], axis=-1) @ axes
    start = place + scene.lift * (2.0 * n + [0, 0, 1]) @ axes
    pattern = (rows % 4) * 4 + columns % 4
    reach = 0.25 * frame.metres_per_pixel * max(frame.width, frame.height)
    fields = []
    for aim, lengths in ((_sky_rays(n, pattern), reach * _reaches(SKY_RAYS)), (_key_rays(pattern), None)):
        open_share = np.zeros(len(start), dtype=np.float32)
        for k in range(aim.shape[1]):
            rays = np.concatenate([start, aim[:, k] @ axes], axis=1).astype(np.float32)
            far = float("inf") if lengths is None else float(lengths[k])
            open_share += ~scene.rays.test_occlusions(rays, 0.0, far).numpy()
        image = np.zeros(hit.shape, dtype=np.float32)
        image[hit] = open_share / aim.shape[1]
        fields.append(_spread(image, hit, np.where(hit, depth, 0), reach / 25))
    return fields[0], fields[1]


def _reaches(n: int) -> Floats:
    """Return how far each sky ray looks for obstacles, as fractions: many near, few far, so hollows darken gently."""
    order = (np.arange(n) * 7) % n  # spread over the directions, which run through the hemisphere in order
    return 0.03 + 0.97 * ((order + 0.5) / n) ** 2


def _sky_rays(normal: Floats, pattern: Ints) -> NDArray[np.float32]:
    """Return cosine-distributed directions (n, SKY_RAYS, 3) about each normal, turned by the pixel's place in 4 x 4."""
    k = np.arange(SKY_RAYS)
    radius = np.sqrt((k + 0.5) / SKY_RAYS)
    angle = k * np.pi * (3 - np.sqrt(5)) + pattern[:, None] * (2 * np.pi / 16 * 5)
    side = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(normal, side)
    ahead = np.sqrt(1 - radius**2)
    return ((radius * np.cos(angle))[..., None] * side[:, None] + (radius * np.sin(angle))[..., None] * other[:, None]
            + ahead[:, None] * normal[:, None]).astype(np.float32)  # fmt: skip


def _key_rays(pattern: Ints) -> NDArray[np.float32]:
    """Return directions (n, LIGHT_RAYS, 3) to a key light about 15 degrees wide, so that shadows have soft edges."""
    k = np.arange(LIGHT_RAYS)
    radius = 0.14 * np.sqrt((k + 0.5) / LIGHT_RAYS)
    angle = k * np.pi * (3 - np.sqrt(5)) + pattern[:, None] * (2 * np.pi / 16 * 5)
    side = np.cross(KEY_LIGHT, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    spread = np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * np.cross(KEY_LIGHT, side)
    return (KEY_LIGHT + radius[None, :, None] * spread).astype(np.float32)


def _spread(image: Floats, hit: Bools, depth: Floats, tolerance: float) -> NDArray[np.float32]:
    """Return the field averaged over 4 x 4 pixels of like depth (this removes the pattern), at sub-pixel size."""
    total, weight = np.zeros_like(image), np.zeros_like(image)
    padded = [np.pad(a, 2, mode="edge") for a in (image, hit.astype(np.float32), depth)]
    rows, columns = image.shape
    for dy in range(4):
        for dx in range(4):
            value, there, far = (a[dy : dy + rows, dx : dx + columns] for a in padded)
            like = there * (np.abs(far - depth) < tolerance)
            total += like * value
            weight += like
    smooth = np.where(weight > 0, total / np.maximum(weight, 1), 0).astype(np.float32)
    index = ndimage.distance_transform_edt(~hit, return_distances=False, return_indices=True) if not hit.all() else None
    filled = smooth if index is None else smooth[tuple(index)]
    return np.repeat(np.repeat(filled, SUBPIXELS, axis=0), SUBPIXELS, axis=1)
