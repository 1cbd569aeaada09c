"""Pictures of an object: as stone before and after, its change from fixed views, and each region close up.

Surfaces and comparisons go in, `Picture`s (JPEG) come out. All pictures of a comparison are framed alike and share one
range of colours. `draw_comparison` looks at each surface once per view and is the quick way to all of them.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from PIL import Image

from projects.model import Bools, ComparedSurface, Comparison, Floats, Ints, Surface
from projects.triangles import face_normals
from reports.annotations import annotate, place_labels, seen_regions
from reports.cameras import Frame, View, choose_views, frame_view, frame_views, project_points, title_of
from reports.colours import RGB, choose_limit
from reports.lighting import SUBPIXELS
from reports.raycast import Pixels, Scene, build_scene, cast_view
from reports.sections import SectionPlane, choose_plane, main_side, region_areas, region_normal
from reports.shading import draw_change, draw_stone, draw_with_ghost, map_regions, outline, paint_change

__all__ = ["Frame", "Picture", "View", "ViewPictures", "choose_views", "draw_close_up", "draw_comparison",
           "draw_difference", "draw_surface", "frame_views"]  # fmt: skip

QUALITY = 90  # of JPEG, colours at full resolution: no ringing seen about lines and hatches
LEAST_SHARE = 0.1  # of a region's area, that a picture must show to be said to show the region
NEARER = 2.0  # pixels, by which what is gone stood nearer to the viewer than what is seen now
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
    of_vertex = np.zeros(len(surface.vertices), dtype=np.int32) if regions is None else regions
    numbers = _thin_out(np.where(pixels.hit & ~pixels.inside, of_vertex[pixels.vertex], 0))
    labels = place_labels(numbers, _thin_out(pixels.hit), frame)
    return finish_picture(annotate(draw_stone(pixels), frame, labels), frame, numbers, f"The surface, {title_of(view)}")


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
    other : the other side; what it alone has, beyond the outline of this one or before it, is drawn paler.
    label : whether the regions are numbered.
    """
    surfaces = [compared_surface.surface] + ([other.surface] if other else [])
    frame = frame or frame_views([view], surfaces, longest_px=height_px)[0]
    seen = cast_view(build_scene(compared_surface.surface), frame)
    ghost = (other, cast_view(build_scene(other.surface), frame)) if other else None
    return _difference((compared_surface, seen), ghost, frame, limit_m, label)


def draw_comparison(
    comparison: Comparison, views: Sequence[View] | None = None, *, limit_m: float | None = None, height_px: int = 900,
    letters_px: float = 0.0,
) -> list[ViewPictures]:  # fmt: skip
    """Return before, after and difference from each view, all at one scale and framed alike.

    Parameters
    ----------
    comparison : both its surfaces are in the reference epoch's coordinates.
    views : where None, `choose_views` of the reference.
    limit_m : m, where the colours end; where None, `colours.choose_limit`.
    height_px : pixels of the longest side of any of the pictures.
    letters_px : pixels, the height of letters and numbers; 0: as the size of the pictures suggests.
    """
    before, after = comparison.on_reference, comparison.on_compared
    views = list(views) if views is not None else choose_views(before.surface)
    limit = limit_m if limit_m is not None else choose_limit(comparison)
    frames = frame_views(views, [before.surface, after.surface], longest_px=height_px, letters_px=letters_px)
    scenes = build_scene(before.surface), build_scene(after.surface)
    with ThreadPoolExecutor(max_workers=2) as pool:  # the views do not depend on each other
        return list(
            pool.map(lambda at: _draw_view(comparison, at[0], at[1], scenes, limit), zip(views, frames, strict=True))
        )


def _draw_view(
    comparison: Comparison, view: View, frame: Frame, scenes: tuple[Scene, Scene], limit: float
) -> ViewPictures:
    """Return the three pictures of a view; each surface is looked at once."""
    earlier, later = (cast_view(scene, frame) for scene in scenes)
    none = np.zeros((1, 1), dtype=np.int32)
    stones = [
        finish_picture(annotate(draw_stone(seen), frame, []), frame, none, f"The {epoch} epoch, {title_of(view)}")
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
) -> Picture:
    """Return the picture of change on one side, with what only the other side has as a ghost."""
    surface, seen = side
    colour = paint_change(seen, surface, limit)
    numbers, hit = map_regions(seen, surface), seen.hit
    if other is None:
        picture = draw_change(seen, colour)
    else:
        earlier, gone = other[1], map_regions(other[1], other[0])
        only = earlier.hit & (~hit | stood_before(seen, numbers, earlier, gone, frame.metres_per_pixel))
        picture = draw_with_ghost(seen, colour, earlier, paint_change(earlier, other[0], limit), only)
        numbers, hit = np.where(only, gone, numbers), hit | only
    every = _thin_out(numbers)
    numbers = _drop_slivers(every, side[0], other[0] if other else None, frame)
    labels = place_labels(numbers, _thin_out(hit), frame) if label else []
    return finish_picture(annotate(picture, frame, labels), frame, numbers, _say_change(frame, numbers, every))


def stood_before(later: Pixels, numbers: Ints, earlier: Pixels, gone: Ints, metres_per_pixel: float) -> Bools:
    """Return where a region of the earlier surface stood before what is seen now, and is not seen now as that region.

    `numbers` and `gone` are the regions of the later and the earlier surface at the sub-pixels.
    """
    with np.errstate(invalid="ignore"):
        before = earlier.depth - later.depth > NEARER * metres_per_pixel
    return (gone > 0) & (gone != numbers) & before


def _drop_slivers(numbers: Ints, side: ComparedSurface, other: ComparedSurface | None, frame: Frame) -> Ints:
    """Return the region of each pixel without the regions of which less than a tenth of the area can be seen."""
    areas = region_areas(side)
    if other is not None:
        own = region_areas(other)
        areas = np.maximum(np.resize(areas, n := max(len(areas), len(own))) * (np.arange(n) < len(areas)),
                           np.resize(own, n) * (np.arange(n) < len(own)))  # fmt: skip
    seen = np.bincount(numbers.ravel(), minlength=len(areas)) * frame.metres_per_pixel**2
    return np.where(seen[numbers] >= LEAST_SHARE * areas[numbers], numbers, 0)


def _say_change(frame: Frame, numbers: Ints, every: Ints) -> str:
    """Return in words what a difference picture shows: the regions of which enough is seen to be numbered; where there
    are none, those of `every` pixel."""
    shown, slight = seen_regions(numbers), seen_regions(every)
    what = f"regions seen: {', '.join(map(str, shown))}" if shown else "no change region is seen"
    if slight and not shown:
        what = f"only small parts of regions are seen: {', '.join(map(str, slight))}"
    return f"Change as colours, {title_of(frame)}; {what}"


def draw_close_up(
    comparison: Comparison, region_number: int, *, limit_m: float | None = None, height_px: int = 640,
    letters_px: float = 0.0,
) -> Picture:  # fmt: skip
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
    frame = replace(frame_region(side, region_number, height_px), letters=letters_px)
    seen = cast_view(build_scene(side.surface), frame)
    numbers = map_regions(seen, side)
    picture = outline(draw_change(seen, paint_change(seen, side, limit)), numbers == region_number)
    marks = section_marks(choose_plane(comparison, region_number), frame)
    drawn = annotate(picture, frame, [], marks)
    return finish_picture(drawn, frame, _thin_out(numbers), f"Change as colours, close up on region {region_number}")


def section_marks(plane: SectionPlane, frame: Frame) -> Floats:
    """Return where the section enters and leaves a close-up: lines from outside in (2, 2, 2), pixels x and y."""
    middle = (plane.low + plane.high) / 2
    ends = np.array([[middle - plane.reach, plane.low], [middle + plane.reach, plane.high]])
    return project_points(frame, plane.origin + ends[..., None] * plane.along)[..., :2]


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


def _thin_out(fine: Any) -> Any:
    """Return one sub-pixel of each pixel of a map."""
    return fine[::SUBPIXELS, ::SUBPIXELS]


def finish_picture(drawn: RGB, frame: Frame, numbers: Ints, alt: str) -> Picture:
    """Return the drawn picture as JPEG."""
    stream = io.BytesIO()
    Image.fromarray(drawn).save(stream, "JPEG", quality=QUALITY, subsampling=0, optimize=True)
    height, width = drawn.shape[:2]
    regions = tuple(seen_regions(numbers))
    return Picture(stream.getvalue(), "image/jpeg", width, height, frame.metres_per_pixel, regions, alt)
