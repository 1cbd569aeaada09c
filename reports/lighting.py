"""How much light reaches each place of a view: of a soft sky (ambient occlusion) and of one broad key light.

What the primary rays have seen goes in; per sub-pixel shares in 0 to 1 come out. Rays are cast once a pixel, each
pixel of a 4 x 4 block in other directions, and averaged over the block, so few rays do the work of many.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from projects.model import Bools, Floats, Ints
from reports.cameras import Frame

SUBPIXELS = 2  # per pixel and side
SKY_RAYS = 16
KEY_RAYS = 4
BLOCK = 4
KEY_LIGHT = np.array([-0.50, 0.62, 0.60]) / np.linalg.norm([-0.50, 0.62, 0.60])  # right, up, towards the viewer
KEY_WIDTH = 0.14  # rad, radius of the key light: how soft its shadows are
REACH = 0.25  # of the picture's longest side: how far the sky's rays look for what stands in their way

Float32 = NDArray[np.float32]


class Occluder(Protocol):
    """What rays can meet: Open3D's scene, coordinates about `middle`, and how far rays start off the surface [m]."""

    @property
    def rays(self) -> Any: ...

    @property
    def middle(self) -> Floats: ...

    @property
    def lift(self) -> float: ...


def cast_light(scene: Occluder, frame: Frame, hit: Bools, normal: Float32, depth: Float32) -> tuple[Float32, Float32]:
    """Return the shares of the sky and of the key light (rows, columns) at each sub-pixel.

    Parameters
    ----------
    hit, normal, depth : (rows, columns, ...) of each sub-pixel; normals in the frame's axes, depth [m] towards the
        viewer from the frame's centre.
    """
    every = (slice(SUBPIXELS // 2, None, SUBPIXELS),) * 2
    seen, deep = hit[every], np.where(hit, depth, 0)[every]
    rows, columns = np.nonzero(seen)
    normals = normal[every][seen]
    start = _places(scene, frame, rows, columns, deep[seen])
    start += scene.lift * ((2.0 * normals + [0, 0, 1]) @ frame.axes)
    block = (rows % BLOCK) * BLOCK + columns % BLOCK
    reach = REACH * frame.metres_per_pixel * max(frame.width, frame.height)
    shares = _open_sky(scene, frame, start, normals, block, reach), _open_key(scene, frame, start, block)
    sky, key = (_spread(share, seen, deep, reach / 25) for share in shares)
    return sky, key


def _places(scene: Occluder, frame: Frame, rows: Ints, columns: Ints, height: Float32) -> Floats:
    """Return the places (n, 3) that the cast sub-pixels see, about the scene's middle."""
    off = 0.5 / SUBPIXELS
    x = (columns + 0.5 + off - frame.width / 2) * frame.metres_per_pixel
    y = (frame.height / 2 - rows - 0.5 - off) * frame.metres_per_pixel
    return frame.centre - scene.middle + np.stack([x, y, height], axis=-1) @ frame.axes


def _spiral(n: int) -> tuple[Floats, Floats]:
    """Return radius (n,) and angle (BLOCK squared, n) of points spread evenly over a disk, turned for each pixel."""
    k = np.arange(n)
    turn = np.arange(BLOCK * BLOCK) * (2 * np.pi / 16 * 5)
    return np.sqrt((k + 0.5) / n), k * np.pi * (3 - np.sqrt(5)) + turn[:, None]


def _open_sky(scene: Occluder, frame: Frame, start: Floats, normal: Float32, block: Ints, reach: float) -> Float32:
    """Return the share (n,) of cosine-distributed rays about the normals that meet nothing within their reach.

    Many rays look near and few far, so that hollows darken gently.
    """
    radius, angle = _spiral(SKY_RAYS)
    side = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    basis = [(part @ frame.axes).astype(np.float32) for part in (side, np.cross(normal, side), normal)]
    order = (np.arange(SKY_RAYS) * 7) % SKY_RAYS  # lengths spread over the directions, which run outwards in order
    lengths = reach * (0.03 + 0.97 * ((order + 0.5) / SKY_RAYS) ** 2)
    rays = np.empty((len(start), 6), dtype=np.float32)
    rays[:, :3] = start
    open_share = np.zeros(len(start), dtype=np.float32)
    for k in range(SKY_RAYS):
        across = (radius[k] * np.cos(angle[:, k])).astype(np.float32)[block, None]
        along = (radius[k] * np.sin(angle[:, k])).astype(np.float32)[block, None]
        rays[:, 3:] = across * basis[0] + along * basis[1] + np.float32(np.sqrt(1 - radius[k] ** 2)) * basis[2]
        open_share += ~scene.rays.test_occlusions(rays, 0.0, float(lengths[k])).numpy()
    return open_share / np.float32(SKY_RAYS)


def _open_key(scene: Occluder, frame: Frame, start: Floats, block: Ints) -> Float32:
    """Return the share (n,) of the key light, a disk, that is in sight."""
    radius, angle = _spiral(KEY_RAYS)
    side = np.cross(KEY_LIGHT, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    rays = np.empty((len(start), 6), dtype=np.float32)
    rays[:, :3] = start
    open_share = np.zeros(len(start), dtype=np.float32)
    for k in range(KEY_RAYS):
        off = np.cos(angle[:, k, None]) * side + np.sin(angle[:, k, None]) * np.cross(KEY_LIGHT, side)
        rays[:, 3:] = ((KEY_LIGHT + KEY_WIDTH * radius[k] * off) @ frame.axes).astype(np.float32)[block]
        open_share += ~scene.rays.test_occlusions(rays).numpy()
    return open_share / np.float32(KEY_RAYS)


def _spread(share: Float32, seen: Bools, depth: Float32, tolerance: float) -> Float32:
    """Return the share averaged over blocks of pixels of like depth (this removes the pattern), at sub-pixel size."""
    image = np.zeros(seen.shape, dtype=np.float32)
    image[seen] = share
    total, weight = np.zeros_like(image), np.zeros_like(image)
    padded = [np.pad(a, BLOCK // 2, mode="edge") for a in (image, seen.astype(np.float32), depth)]
    rows, columns = seen.shape[0], seen.shape[1]
    for dy in range(BLOCK):
        for dx in range(BLOCK):
            value, there, far = (a[dy : dy + rows, dx : dx + columns] for a in padded)
            like = there * (np.abs(far - depth) < tolerance)
            total += like * value
            weight += like
    smooth = np.where(weight > 0, total / np.maximum(weight, 1), 0).astype(np.float32)
    if seen.any() and not seen.all():
        nearest: Any = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
        smooth = smooth[tuple(nearest)]
    return np.repeat(np.repeat(smooth, SUBPIXELS, axis=0), SUBPIXELS, axis=1)
