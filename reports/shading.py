"""From what the pixels see to pictures: stone under soft light, and change painted over the relief.

Light is computed in linear light; pictures are sRGB uint8 on white paper.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from projects.model import Assessment, Bools, ComparedSurface, Floats, Ints
from reports.colours import (
    DOTS,
    HATCH_DARK,
    HATCH_LIGHT,
    INSIDE,
    RGB,
    STONE,
    UNCHANGED,
    change_ramp,
)
from reports.lighting import KEY_LIGHT, SUBPIXELS
from reports.raycast import Pixels

FILL_LIGHT = np.array([0.72, -0.05, 0.69])
HATCH_PERIOD = 9.0  # pixels of the picture
DOT_PERIOD, DOT_RADIUS = 6.0, 1.3  # pixels of the picture
OUTLINE = (30, 30, 36)
GHOST, BEFORE = 0.45, 0.75  # how strongly a place is drawn that only the earlier surface has: on paper, before a later


def to_linear(colour: Floats) -> Floats:
    """Return linear light (0 to 1) of sRGB values (0 to 255)."""
    c = np.asarray(colour, dtype=np.float32) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_srgb(light: Floats) -> Floats:
    """Return sRGB values (0 to 255, float) of linear light, clipped to 0 to 1."""
    c = np.clip(light, 0.0, 1.0)
    return (255.0 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)).astype(np.float32)


def shade(pixels: Pixels) -> Floats:
    """Return the light (rows, columns) that white stone sends back: key light, fill, sky, and a hint of curvature."""
    n = pixels.normal
    key = np.maximum(n @ KEY_LIGHT.astype(np.float32), 0.0) * (0.15 + 0.85 * pixels.light)
    fill = np.maximum(n @ (FILL_LIGHT / np.linalg.norm(FILL_LIGHT)).astype(np.float32), 0.0)
    sky = pixels.sky * (0.75 + 0.25 * n[..., 1])
    light = 0.62 * key + 0.16 * fill * (0.4 + 0.6 * pixels.sky) + 0.46 * sky
    return light * (1.0 + 0.16 * np.tanh(2.2 * _curvature(pixels)))


def _curvature(pixels: Pixels) -> Floats:
    """Return how fast the normals turn apart: positive on ridges, negative in grooves, per pixel of the picture."""
    nx, ny = (ndimage.gaussian_filter(pixels.normal[..., k], 1.2) for k in (0, 1))
    turning = np.gradient(nx, axis=1) - np.gradient(ny, axis=0)
    whole = ndimage.binary_erosion(pixels.hit, iterations=3)
    depth = np.where(pixels.hit, pixels.depth, 0)
    jump = ndimage.maximum_filter(depth, 5) - ndimage.minimum_filter(depth, 5)
    smooth = whole & (jump < 20 * np.median(jump[whole])) if whole.any() else whole
    return np.where(smooth, turning * SUBPIXELS * 2, 0.0)


def hatch(rows: int, columns: int) -> Floats:
    """Return the diagonal hatch (rows, columns) of sub-pixels: 1 on a line, 0 between."""
    y, x = np.mgrid[:rows, :columns] / SUBPIXELS
    along = np.mod(x + y, HATCH_PERIOD)
    return (along < 0.34 * HATCH_PERIOD).astype(np.float32)


def dots(rows: int, columns: int) -> Floats:
    """Return dots in staggered rows (rows, columns) of sub-pixels: 1 in a dot, 0 between."""
    y, x = np.mgrid[:rows, :columns] / SUBPIXELS
    row = np.floor(y / DOT_PERIOD)
    dx = np.mod(x + 0.5 * DOT_PERIOD * np.mod(row, 2.0), DOT_PERIOD) - 0.5 * DOT_PERIOD
    dy = np.mod(y, DOT_PERIOD) - 0.5 * DOT_PERIOD
    return (dx**2 + dy**2 < DOT_RADIUS**2).astype(np.float32)


def paint_stone(pixels: Pixels) -> Floats:
    """Return the material's linear colour (rows, columns, 3): stone, hatched where a hole was closed and nothing
    measured, and a cool grey on the inside of the surface."""
    colour = np.empty((*pixels.hit.shape, 3), dtype=np.float32)
    colour[:] = to_linear(np.array(STONE))
    colour[pixels.invented] = paint_hatch(pixels.invented)
    colour[pixels.inside] = to_linear(np.array(INSIDE)) * 0.8
    return colour


def paint_hatch(where: Bools) -> Floats:
    """Return the linear colours (n, 3) of the hatch at the n places of a mask (rows, columns)."""
    lines = hatch(*where.shape)[where][:, None]
    return np.asarray(lines * to_linear(np.array(HATCH_DARK)) + (1 - lines) * to_linear(np.array(HATCH_LIGHT)))


def paint_change(pixels: Pixels, side: ComparedSurface, limit_m: float) -> Floats:
    """Return the linear colour (rows, columns, 3) of change: by distance, grey where unchanged, with dots where only
    large changes would be told, hatched where unknown.

    A state holds where the corners that have it make up half of the place; the distance is interpolated over the
    changed corners of the triangle.
    """
    unknown = (share_of(pixels, side.assessment == Assessment.NOT_ASSESSABLE) >= 0.5) | pixels.invented
    changed = (share_of(pixels, side.assessment == Assessment.CHANGED) >= 0.5) & ~unknown
    colour = np.empty((*pixels.hit.shape, 3), dtype=np.float32)
    colour[:] = to_linear(np.array(UNCHANGED))
    coarse = (share_of(pixels, side.is_coarse) >= 0.5) & ~unknown
    colour[coarse & (dots(*coarse.shape) > 0.0)] = to_linear(np.array(DOTS))
    colour[changed] = to_linear(change_ramp(_interpolate(pixels, side, changed), limit_m))
    colour[unknown] = paint_hatch(unknown)
    colour[pixels.inside] = to_linear(np.array(INSIDE))
    return colour


def share_of(pixels: Pixels, of_vertex: Bools) -> Floats:
    """Return what share (rows, columns) of each place belongs to the vertices of a mask (barycentric)."""
    return (of_vertex[pixels.corners] * pixels.weights).sum(axis=-1) * pixels.hit


def map_regions(pixels: Pixels, side: ComparedSurface) -> Ints:
    """Return the region (rows, columns) that each sub-pixel shows, 0 for none."""
    number = side.changed_region
    seen = np.where(pixels.hit & ~pixels.inside, number[pixels.vertex], 0)
    return np.where(share_of(pixels, number > 0) >= 0.5, seen, 0)


def _interpolate(pixels: Pixels, side: ComparedSurface, where: Bools) -> Floats:
    """Return distances [m] at the sub-pixels, from those corners of the triangle that are changed themselves."""
    corners, weights = pixels.corners[where], pixels.weights[where]
    counts = weights * (side.assessment[corners] == Assessment.CHANGED)
    values = np.where(counts > 0, side.distances[corners], 0.0)
    return (counts * values).sum(axis=1) / counts.sum(axis=1)


def draw_stone(pixels: Pixels) -> RGB:
    """Return the picture (height, width, 3) of the bare surface."""
    light = shade(pixels)[..., None] * paint_stone(pixels) * 1.06
    return compose(light, pixels.hit)


def draw_change(pixels: Pixels, colour: Floats) -> RGB:
    """Return the picture of change: the colours of the legend over the relief, whose light is held back for them."""
    return compose(light_of_change(pixels, colour), pixels.hit)


def light_of_change(pixels: Pixels, colour: Floats) -> Floats:
    """Return the linear light (rows, columns, 3) of change painted in `colour` over the relief."""
    return colour * np.clip(0.30 + 0.80 * shade(pixels)[..., None], 0.25, 1.08)


def draw_with_ghost(pixels: Pixels, colour: Floats, earlier: Pixels, colour_earlier: Floats, only: Bools) -> RGB:
    """Return the picture of change with what the mask says that only the earlier surface has, drawn paler over it.

    What stood before something that is seen now is outlined.
    """
    light = np.where(pixels.hit[..., None], light_of_change(pixels, colour), 1.0)
    share = np.where(pixels.hit, BEFORE, GHOST)[..., None].astype(np.float32)
    pale = share * light_of_change(earlier, colour_earlier) + (1 - share) * light
    drawn = compose(np.where(only[..., None], pale, light), pixels.hit | only)
    return outline(drawn, only & pixels.hit)


def coverage(hit: Bools) -> Floats:
    """Return the share (height, width) of each pixel that is hit."""
    rows, columns = hit.shape
    return hit.reshape(rows // SUBPIXELS, SUBPIXELS, columns // SUBPIXELS, SUBPIXELS).mean(axis=(1, 3))


def compose(light: Floats, hit: Bools) -> RGB:
    """Return the sRGB picture (height, width, 3) uint8: sub-pixels averaged over white paper."""
    whole = np.where(hit[..., None], to_srgb(light), 255.0)
    rows, columns = hit.shape
    blocks = whole.reshape(rows // SUBPIXELS, SUBPIXELS, columns // SUBPIXELS, SUBPIXELS, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def outline(picture: RGB, inside: Bools) -> RGB:
    """Return the picture with a thin dark line around the sub-pixels of a mask."""
    ring = ndimage.binary_dilation(inside, iterations=SUBPIXELS + 1) & ~ndimage.binary_dilation(inside)
    share = coverage(ring)[..., None]
    return np.rint(picture * (1.0 - 0.85 * share) + 0.85 * share * np.array(OUTLINE)).astype(np.uint8)
