"""What held two epochs together: the compared surface with its stable areas, what changed, and what took no part.

A comparison goes in, small pictures come out; calm colours, since they say nothing about change.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from projects.extent import Extent, inside
from projects.model import Assessment, Comparison, Floats, Ints
from reports.annotations import annotate
from reports.cameras import View, choose_views, frame_views, title_of
from reports.colours import INSIDE, LEFT_OUT, OUTSIDE, SET_ASIDE, STABLE
from reports.raycast import Pixels, build_scene, cast_view
from reports.shading import draw_change, share_of, to_linear
from reports.views import Picture, finish_picture

MOST_VIEWS = 4  # enough to see that the areas lie all around
LONGEST = 420  # pixels
LETTERS = 0.055  # of the widest picture: 6 points where that is a quarter as wide as the text on A4
HELD, CHANGED, OTHER, OUT_OF_BOUNDS = range(4)
COLOURS = (STABLE, SET_ASIDE, LEFT_OUT, OUTSIDE)


def draw_stable(
    comparison: Comparison, given: Extent | None = None, bearing: float | None = None
) -> list[tuple[View, Picture]]:
    """Return the stable areas from up to four views; none where the registration does not say which they are.

    Parameters
    ----------
    comparison : its compared surface is drawn.
    given : where the user says that nothing moved, in the reference's coordinates: outside of it nothing was asked.
    bearing : rad, of the front, as of `cameras.front_of`.
    """
    side, is_stable = comparison.on_compared, comparison.registration.is_stable
    if is_stable is None or len(is_stable) != len(side.surface.vertices) or not is_stable.any():
        return []
    views = choose_views(comparison.on_reference.surface, bearing)[:MOST_VIEWS]
    frames = frame_views(views, [side.surface], longest_px=LONGEST)
    frames = [replace(frame, letters=LETTERS * max(f.width for f in frames)) for frame in frames]
    scene = build_scene(side.surface)
    asked = np.ones(len(is_stable), dtype=bool) if given is None else inside(given, side.surface.vertices)
    held = is_stable & (comparison.mode == "absolute")  # changed with the whole alone, by the motion that is left in
    classes = np.select(
        [~asked, (side.assessment == Assessment.CHANGED) & ~held, is_stable], [OUT_OF_BOUNDS, CHANGED, HELD], OTHER
    )
    pictures = []
    for view, frame in zip(views, frames, strict=True):
        seen = cast_view(scene, frame)
        drawn = annotate(draw_change(seen, paint_classes(seen, classes)), frame, [])
        none = np.zeros((1, 1), dtype=np.int32)
        pictures.append((view, finish_picture(drawn, frame, none, f"Stable areas, {title_of(view)}")))
    return pictures


def paint_classes(pixels: Pixels, classes: Ints) -> Floats:
    """Return the linear colour (rows, columns, 3) of the class of each place, by most of its corners."""
    shares = np.stack([share_of(pixels, classes == k) for k in range(len(COLOURS))])
    colour = to_linear(np.array(COLOURS))[shares.argmax(axis=0)]
    colour[pixels.invented] = to_linear(np.array(LEFT_OUT))
    colour[pixels.inside] = to_linear(np.array(INSIDE))
    return colour
