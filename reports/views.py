"""Pictures of an object: as stone before and after, its change from fixed views, and each region close up.

Surfaces and comparisons go in, `Picture`s (JPEG) come out. All pictures of a comparison are framed alike and share one
range of colours. `draw_comparison` looks at each surface once per view and is the quick way to all of them.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from projects.model import Bools, ComparedSurface, Comparison, Ints, Surface
from reports.annotations import annotate, place_labels, seen_regions
from reports.cameras import Frame, View, choose_views, face_normals, frame_view, frame_views
from reports.colours import RGB, choose_limit
from reports.raycast import SUBPIXELS, Pixels, Scene, build_scene, cast_view
from reports.sections import main_side, region_normal
from reports.shading import add_ghost, draw_change, draw_stone, map_regions, outline, paint_change

__all__ = ["Frame", "Picture", "View", "ViewPictures", "choose_views", "draw_close_up", "draw_comparison",
           "draw_difference", "draw_surface", "frame_views"]  # fmt: skip

QUALITY = 90  # of JPEG, colours at full resolution: no ringing seen about lines and hatches
FIELD = 2.4  # a close-up shows this many times the region's extent


@dataclass(frozen=True)
class Picture:
    """A finished picture.

    Attributes
    ----------
    image : the file's bytes.
    media_type : of the bytes, "image/jpeg" or "image/png".
    width, height : pixels.
    metres_per_pixel : m.
    visible_regions : regions that can be seen in it, rising.
    alt : what it shows, in words.
    """

    image: bytes
    media_type: str
    width: int
    height: int
    metres_per_pixel: float
    visible_regions: tuple[int, ...]
    alt: str


@dataclass(frozen=True)
class ViewPictures:
    """The pictures of one view: the reference as stone, the compared epoch as stone, and the change."""

    view: View
    before: Picture
    after: Picture
    difference: Picture


def draw_surface(
    surface: Surface, view: View, *, height_px: int = 900, frame: Frame | None = None, regions: Ints | None = None
) -> Picture:
    """Return a surface as stone under soft light.

    Parameters
    ----------
    surface : what is drawn.
    view : where it is looked at from.
    height_px : pixels of the picture's longest side, where no frame is given.
    frame : of `frame_views`, so that several surfaces are framed alike.
    regions : (n,) of each vertex, 0 for none: their numbers are written over the picture.
    """
    frame = frame or frame_views([view], [surface], longest_px=height_px)[0]
    pixels = cast_view(build_scene(surface), frame)
    numbers = np.zeros(pixels.hit.shape, dtype=np.int32)
    if regions is not None:
        numbers = np.where(pixels.hit & ~pixels.inside, regions[pixels.vertex], 0)
    return _finish(draw_stone(pixels), frame, _thin_out(numbers), _thin_out(pixels.hit), f"The surface, {_side(view)}")


def draw_difference(
    compared_surface: ComparedSurface,
    view: View,
    *,
    limit_m: float,
    height_px: int = 900,
    frame: Frame | None = None,
    other: ComparedSurface | None = None,
    label: bool = True,
) -> Picture:
    """Return the change of one side of a comparison as colours over its relief.

    Parameters
    ----------
    compared_surface : the side that is drawn.
    view, height_px, frame : as of `draw_surface`.
    limit_m : m, where the colours end: `colours.choose_limit` of the comparison.
    other : the other side; what it alone has beyond the outline of this one is drawn paler.
    label : whether the regions are numbered.
    """
    surfaces = [compared_surface.surface] + ([other.surface] if other else [])
    frame = frame or frame_views([view], surfaces, longest_px=height_px)[0]
    seen = cast_view(build_scene(compared_surface.surface), frame)
    ghost = (other, cast_view(build_scene(other.surface), frame)) if other else None
    return _difference((compared_surface, seen), ghost, frame, limit_m, label)


def draw_comparison(
    comparison: Comparison, views: Sequence[View] | None = None, *, limit_m: float | None = None, height_px: int = 900
) -> list[ViewPictures]:
    """Return before, after and difference from each view, all at one scale and framed alike.

    Parameters
    ----------
    comparison : both its surfaces are in the reference epoch's coordinates.
    views : where None, `choose_views` of the reference.
    limit_m : m, where the colours end; where None, `colours.choose_limit`.
    height_px : pixels of the longest side of any of the pictures.
    """
    before, after = comparison.on_reference, comparison.on_compared
    views = list(views) if views is not None else choose_views(before.surface)
    limit = limit_m if limit_m is not None else choose_limit(comparison)
    frames = frame_views(views, [before.surface, after.surface], longest_px=height_px)
    scenes = build_scene(before.surface), build_scene(after.surface)
    return [_draw_view(comparison, view, frame, scenes, limit) for view, frame in zip(views, frames, strict=True)]


def _draw_view(
    comparison: Comparison, view: View, frame: Frame, scenes: tuple[Scene, Scene], limit: float
) -> ViewPictures:
    """Return the three pictures of a view; each surface is looked at once."""
    earlier, later = (cast_view(scene, frame) for scene in scenes)
    stones = [
        _finish(draw_stone(seen), frame, _none(seen), _thin_out(seen.hit), f"The {epoch} epoch, {_side(view)}")
        for epoch, seen in (("reference", earlier), ("compared", later))
    ]
    difference = _difference(
        (comparison.on_compared, later), (comparison.on_reference, earlier), frame, limit, label=True
    )
    return ViewPictures(view, stones[0], stones[1], difference)


def _difference(
    side: tuple[ComparedSurface, Pixels],
    other: tuple[ComparedSurface, Pixels] | None,
    frame: Frame,
    limit: float,
    label: bool,
    outlined: int = 0,
) -> Picture:
    """Return the picture of change on one side, with what only the other side has as a ghost."""
    surface, seen = side
    picture = draw_change(seen, paint_change(seen, surface, limit))
    numbers, hit = map_regions(seen, surface), seen.hit
    if other is not None:
        picture = add_ghost(picture, seen, other[1], paint_change(other[1], other[0], limit))
        numbers = np.where(hit, numbers, map_regions(other[1], other[0]))
        hit = hit | other[1].hit
    if outlined:
        picture = outline(picture, numbers == outlined)
    view = View(frame.name, frame.towards, frame.up)
    shown = seen_regions(_thin_out(numbers))
    what = f"regions {', '.join(map(str, shown))} are seen" if shown else "no change region is seen"
    alt = f"Change as colours, {_side(view)}: {what}"
    return _finish(picture, frame, _thin_out(numbers), _thin_out(hit), alt, label=label)


def draw_close_up(
    comparison: Comparison, region_number: int, *, limit_m: float | None = None, height_px: int = 640
) -> Picture:
    """Return the change about one region, seen along its mean normal, the region outlined.

    Drawn on the compared epoch, or on the reference where more of the region is there to be seen (a piece that is
    gone altogether). The picture shows 2.4 times the region's extent, never finer than the surface's own detail.

    Raises
    ------
    ParameterError
        Where the comparison has no such region.
    """
    limit = limit_m if limit_m is not None else choose_limit(comparison)
    side = main_side(comparison, region_number)
    frame = frame_region(side, region_number, height_px)
    seen = cast_view(build_scene(side.surface), frame)
    return _difference((side, seen), None, frame, limit, label=False, outlined=region_number)


def frame_region(side: ComparedSurface, number: int, longest_px: int) -> Frame:
    """Return the frame of a close-up: along the region's mean normal, z up where it can be."""
    normal = region_normal(side, number)
    towards = normal / max(float(np.linalg.norm(normal)), 1e-300)
    up = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.94 else np.array([0.0, 1.0, 0.0])
    points = side.surface.vertices[side.region == number]
    tight = frame_view(View(f"region {number}", towards, up), points, 1.0)
    extent = np.ptp(points @ tight.axes.T, axis=0)
    detail = float(np.sqrt(np.linalg.norm(face_normals(side.surface), axis=1).mean()))
    field = max(FIELD * float(extent[:2].max()), 12.0 * detail)
    height = round(0.8 * longest_px)
    foot = round(0.1 * height)
    metres_per_pixel = field / (height - foot)
    centre = tight.centre - foot / 2 * metres_per_pixel * tight.up
    near = float(extent[2] / 2 + 0.5 * extent[:2].max())
    return Frame(tight.name, centre, tight.right, tight.up, tight.towards, metres_per_pixel, longest_px, height, foot,
                 near)  # fmt: skip


def _none(pixels: Pixels) -> Ints:
    return np.zeros((pixels.hit.shape[0] // SUBPIXELS, pixels.hit.shape[1] // SUBPIXELS), dtype=np.int32)


def _thin_out(fine: Any) -> Any:
    """Return one sub-pixel of each pixel of a map."""
    return fine[::SUBPIXELS, ::SUBPIXELS]


def _side(view: View) -> str:
    return f"seen from {view.name}" if view.name in ("below",) else f"{view.name} view"


def _finish(picture: RGB, frame: Frame, numbers: Ints, shown: Bools, alt: str, *, label: bool = True) -> Picture:
    """Return the picture with scale bar and labels as JPEG."""
    labels = place_labels(numbers, shown, frame) if label else []
    drawn = annotate(picture, frame, labels)
    stream = io.BytesIO()
    Image.fromarray(drawn).save(stream, "JPEG", quality=QUALITY, subsampling=0, optimize=True)
    height, width = drawn.shape[:2]
    regions = tuple(seen_regions(numbers))
    return Picture(stream.getvalue(), "image/jpeg", width, height, frame.metres_per_pixel, regions, alt)
