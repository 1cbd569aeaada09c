"""Charts of a report as SVG: the colour bar, the histogram of distances, and the section through a region.

Comparisons in metres go in, drawings in millimetres come out, as bytes that are the same every time.
"""

from __future__ import annotations

import math

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator

from projects.model import Assessment, Comparison, Floats
from projects.triangles import vertex_areas
from reports.colours import DOTS, HATCH_DARK, HATCH_LIGHT, UNCHANGED, change_ramp, choose_limit
from reports.drawing import FAINT, INK, SOFT, WIDTH, drawing, number_evenly, say_mm, write_svg
from reports.quantities import MM, percent
from reports.sections import SectionLine, SectionPlane, choose_plane, cut_comparison

BEFORE, AFTER = "#8a8f98", "#15171c"
WIDE, LETTERS = 0.855, 1.2  # of a section, which stands beside a close-up, seven tenths as large: the axes, the letters
BESIDE_LEVEL = 1.6  # times the level of detection, that a histogram reaches at least
TALLEST = 3.2  # inches, of a profile


def _hex(colour: tuple[int, int, int]) -> str:
    """Return a colour as SVG names it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def draw_colour_bar(limit_m: float, lod95_m: float, told_m: float = math.nan, coarse_m: float = math.nan) -> bytes:
    """Return the legend of every difference picture: the colours in mm, and what grey, dots and hatch mean.

    Parameters
    ----------
    limit_m : m, where the colours end (`colours.choose_limit`).
    lod95_m : m, the median level of detection; smaller differences are grey. NaN where there is none.
    told_m : m, from where on changes are told on most of the surface: "unchanged" may hide smaller ones. NaN: unknown.
    coarse_m : m, the surface is dotted where only changes larger than that, or than more, are told. NaN: nowhere.
    """
    with drawing(0.78) as figure:
        axes = figure.add_axes((0.055, 0.40, 0.505, 0.26))
        limit = limit_m * MM
        level = min(lod95_m * MM, limit) if np.isfinite(lod95_m) else 0.0
        middle = (np.arange(1024) + 0.5) / 512 - 1
        ramp = change_ramp(middle * limit_m, limit_m) / 255.0
        ramp[np.abs(middle * limit) < level] = np.array(UNCHANGED) / 255.0
        axes.imshow(ramp[None], extent=(-limit, limit, 0, 1), aspect="auto", interpolation="nearest")
        _bare(axes)
        axes.set_xticks(np.linspace(-limit, limit, 5))
        number_evenly(axes.xaxis)
        axes.annotate("lost", (0, 1), (0, 4), "axes fraction", textcoords="offset points", weight="bold")
        axes.annotate("gained", (1, 1), (0, 4), "axes fraction", textcoords="offset points", ha="right", weight="bold")
        axes.annotate("change [mm], scale of this report", (0.5, 1), (0, 4), "axes fraction",
                      textcoords="offset points", ha="center")  # fmt: skip
        _add_states(figure, told_m, coarse_m)
        return write_svg(figure)


def _add_states(figure: Figure, told_m: float, coarse_m: float) -> None:
    """Add what grey, dots and hatch mean beside the colours."""
    states = [
        (UNCHANGED, HATCH_DARK, _say_unchanged(told_m), ""),
        (HATCH_LIGHT, HATCH_DARK, "not assessable", "/////"),
    ]
    if np.isfinite(coarse_m):
        states.insert(1, (UNCHANGED, DOTS, f"unchanged (up to {say_mm(coarse_m)} or more)", "..."))
    step = 0.44 if len(states) == 2 else 0.32
    for k, (colour, lines, text, hatch) in enumerate(states):
        y = 0.44 + step * (0.5 * (len(states) - 1) - k)
        box = Rectangle((0.61, y - 0.11), 0.042, 0.26, facecolor=_hex(colour), edgecolor=_hex(lines), lw=0, hatch=hatch)
        figure.add_artist(box)
        figure.text(0.665, y + 0.02, text, va="center", ha="left")


def _say_unchanged(told_m: float) -> str:
    """Return the word of the middle of the colour bar."""
    return f"unchanged (up to about {say_mm(told_m)})" if np.isfinite(told_m) else "unchanged"


def _bare(axes: Axes) -> None:
    """Take the frame and the vertical scale off."""
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def draw_histogram(comparison: Comparison) -> bytes:
    """Return how much of the assessed surface differs by how much: grey unchanged, coloured changed, in mm.

    Shares of the area of the compared surface on a logarithmic scale, so that a small change stays in sight beside
    the much larger unchanged surface; dashed at plus and minus the median level of detection.
    """
    side = comparison.on_compared
    assessed = np.isfinite(side.distances) & (side.assessment != Assessment.NOT_ASSESSABLE)
    values, areas = side.distances[assessed] * MM, vertex_areas(side.surface.vertices, side.surface.faces)[assessed]
    changed = side.assessment[assessed] == Assessment.CHANGED
    level = float(np.median(side.lod95[assessed])) * MM if len(values) else float("nan")
    reach = _histogram_reach(values, changed, comparison, level)
    edges = np.linspace(-reach, reach, 102)
    with drawing(2.3) as figure:
        axes = figure.add_axes((0.095, 0.19, 0.875, 0.70))
        share = 100.0 * areas / max(areas.sum(), 1e-300)
        whole, _ = np.histogram(values, edges, weights=share)
        parts, _ = np.histogram(values[changed], edges, weights=share[changed])
        low = _lowest_share(whole)
        _draw_bars(axes, edges, (whole, parts), choose_limit(comparison) * MM)
        _say_beyond(axes, float(share[np.abs(values) > reach].sum()))
        axes.set(
            xlim=(-reach, reach),
            yscale="log" if whole.any() else "linear",
            ylim=(low, 2.0 * max(whole.max(initial=0), 10 * low)),
        )
        _mark_level(axes, level)
        axes.set_xlabel("signed distance [mm]: lost −, gained +")
        axes.set_ylabel("assessed surface [%]")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_locator(matplotlib.ticker.NullLocator())
        axes.xaxis.set_major_locator(MaxNLocator(9, steps=[1, 2, 5, 10]))
        number_evenly(axes.xaxis)
        for edge in ("top", "right"):
            axes.spines[edge].set_visible(False)
        return write_svg(figure)


def _histogram_reach(values: Floats, changed: Floats, comparison: Comparison, level: float) -> float:
    """Return how far the histogram goes [mm]: the range of the colours, or of nearly all distances where wider, and
    well beyond the level of detection [mm], which is marked in it."""
    limit, least = choose_limit(comparison) * MM, BESIDE_LEVEL * level if np.isfinite(level) else 0.0
    nearly_all = float(np.quantile(np.abs(values), 0.999)) if len(values) else 0.0
    reach = max(limit, 1.05 * nearly_all) if changed.any() else max(1.25 * nearly_all, 0.5 * limit)
    return max(reach, least)


def _lowest_share(whole: Floats) -> float:
    """Return where the logarithmic scale starts: the power of ten at or below the smallest bar, at least 1e-3 %."""
    filled = whole[whole > 0]
    return float(max(10.0 ** np.floor(np.log10(filled.min())), 1e-3)) if len(filled) else 0.1


def _draw_bars(axes: Axes, edges: Floats, bars: tuple[Floats, Floats], limit: float) -> None:
    """Draw grey bars for all and coloured ones before them for what changed; heights in percent, edges in mm."""
    width, middle = np.diff(edges), (edges[:-1] + edges[1:]) / 2
    whole, changed = bars
    axes.bar(edges[:-1], whole, width, align="edge", color="#c3c4c6", linewidth=0)
    axes.bar(edges[:-1], changed, width, align="edge", color=change_ramp(middle, limit) / 255.0, linewidth=0)


def _say_beyond(axes: Axes, share: float) -> None:
    """Write how much [%] of the surface lies beyond the scale, where any does."""
    if share > 0.0:
        told = f"{percent(share / 100.0)} beyond the scale"
        axes.annotate(told, (1, 1), (0, -3), "axes fraction", textcoords="offset points", ha="right", va="top",
                      fontsize=7.5, color=SOFT)  # fmt: skip


def _mark_level(axes: Axes, level: float) -> None:
    """Draw dashed lines at plus and minus the level of detection [mm], with its name."""
    if not np.isfinite(level):
        return
    for side in (-1, 1):
        axes.axvline(side * level, color=INK, lw=0.7, ls=(0, (4, 3)))
    is_right = level > 0.3 * axes.get_xlim()[1]  # then its name has more room to the left
    axes.annotate(f"level of detection ±{say_mm(level / MM)}", (level, 1.0), (-5 if is_right else 5, 3),
                  textcoords="offset points", xycoords=("data", "axes fraction"), fontsize=7.5,
                  ha="right" if is_right else "left", va="bottom")  # fmt: skip


def draw_section(comparison: Comparison, region_number: int) -> bytes:
    """Return the section through a region: both epochs' profiles at equal scale, and the change along it, in mm.

    The region's extent is shaded; the largest change on the section is named. The lower scale is that of the change,
    so nothing in the profile has to be exaggerated.

    Raises
    ------
    ParameterError
        Where the comparison has no such region.
    """
    plane = choose_plane(comparison, region_number)
    lines = cut_comparison(comparison, region_number, plane)
    middle = (plane.low + plane.high) / 2
    heights = heights_shown(lines, 2.0 * plane.reach * MM)
    span = max(2.0 * plane.reach * MM, span_for(heights))
    top = profile_height(heights, span)
    with drawing(top + 1.75, LETTERS) as figure:
        inches = top + 1.75
        profile = figure.add_axes((0.97 - WIDE, 1.62 / inches, WIDE, (top - 0.12) / inches))
        change = figure.add_axes((0.97 - WIDE, 0.45 / inches, WIDE, 0.92 / inches))
        for axes in (profile, change):
            axes.axvspan(0, (plane.high - plane.low) * MM, color=FAINT, lw=0)
            axes.set_xlim((middle - plane.low) * MM - span / 2, (middle - plane.low) * MM + span / 2)
            for edge in ("top", "right"):
                axes.spines[edge].set_visible(False)
        _draw_profiles(profile, lines, plane, heights)
        _draw_change(change, lines, plane, choose_limit(comparison))
        return write_svg(figure)


def heights_shown(lines: tuple[SectionLine, SectionLine], span: float) -> Floats:
    """Return lowest and highest (2,) [mm] of what a profile shows that is `span` [mm] wide or more; nothing of none.

    All of what is cut, unless it is higher than that, as an outline that goes on: then all that is of the region, and
    as much beside it as is no higher.
    """
    every = np.concatenate([line.ends[..., 1].ravel() for line in lines]) * MM
    own = np.concatenate([line.ends[line.in_region][..., 1].ravel() for line in lines]) * MM
    if not len(every) or np.ptp(every) <= span or not len(own):
        return np.array([every.min(), every.max()]) if len(every) else every
    beside = max(0.5 * (span - np.ptp(own)), 0.0)
    return np.clip([own.min() - beside, own.max() + beside], every.min(), every.max())


def span_for(heights: Floats) -> float:
    """Return how wide [mm] a profile must be for its heights (2,) [mm] to find room at equal scale."""
    return float(np.ptp(heights)) * 1.15 * WIDE * WIDTH / (TALLEST - 0.25) if len(heights) else 0.0


def profile_height(heights: Floats, span: float) -> float:
    """Return the height [inches] of the profile's axes at equal scale: as the profile needs, 0.7 to `TALLEST`."""
    per_mm = WIDE * WIDTH / span
    return float(np.clip(np.ptp(heights) * per_mm * 1.15 + 0.25, 0.7, TALLEST)) if len(heights) else 0.7


def _points(line: SectionLine, plane: SectionPlane) -> Floats:
    """Return the ends of the segments in mm, counted along from the region's beginning."""
    return (line.ends - [plane.low, 0.0]) * MM


def _draw_profiles(axes: Axes, lines: tuple[SectionLine, SectionLine], plane: SectionPlane, heights: Floats) -> None:
    """Draw both epochs at equal scale."""
    for line, colour, width, name in ((lines[0], BEFORE, 1.7, "reference"), (lines[1], AFTER, 0.9, "compared")):
        axes.add_collection(LineCollection(list(_points(line, plane)), colors=colour, linewidths=width))
        axes.plot([], [], color=colour, lw=width, label=name)
    if len(heights):
        box = axes.get_window_extent()
        tall = (axes.get_xlim()[1] - axes.get_xlim()[0]) * box.height / box.width
        centre = (heights.min() + heights.max()) / 2
        axes.set_ylim(centre - tall / 2, centre + tall / 2)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    axes.tick_params(labelbottom=False)
    axes.set_ylabel("height [mm]")
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(0.985, 1.0),
        ncols=2,
        frameon=False,
        fontsize=7.5 * LETTERS,
        borderpad=0.1,
        borderaxespad=0.35,
    )
    axes.annotate("both epochs, heights and lengths at one scale", (0, 1), (14, 4), "axes fraction",
                  textcoords="offset points", fontsize=7.5 * LETTERS)  # fmt: skip
    for name, end in (("A", 0), ("B", 1)):
        axes.annotate(name, (end, 1), (0, 4), "axes fraction", textcoords="offset points", weight="bold", ha="center")


def _draw_change(axes: Axes, lines: tuple[SectionLine, SectionLine], plane: SectionPlane, limit: float) -> None:
    """Draw the change along the section, coloured as in the pictures, with the level of detection as a band."""
    line = max(reversed(lines), key=lambda one: int(one.in_region.sum()))
    along, change = _points(line, plane)[..., 0], line.distances * MM
    known = np.isfinite(change).all(axis=1)
    _mark_unknown(axes, along[~known])
    along, change, inside = along[known], change[known], line.in_region[known]
    level = float(np.nanmedian(line.lod95[known])) * MM if known.any() else 0.0
    axes.axhspan(-level, level, color="#d6d5d2", lw=0, alpha=0.75)
    base = np.stack([along, np.zeros_like(along)], axis=-1)
    curve = np.stack([along, change], axis=-1)
    areas = np.concatenate([base, curve[:, ::-1]], axis=1)
    colours = change_ramp(change[inside].mean(axis=1) / MM, limit) / 255.0
    axes.add_collection(PolyCollection(list(areas[inside]), facecolors=colours, edgecolors=colours, linewidths=0.2))
    axes.add_collection(LineCollection(list(curve), colors=INK, linewidths=0.8))
    axes.axhline(0, color=SOFT, lw=0.6)
    _scale_change(axes, change, level)
    if inside.any():
        _name_largest(axes, along[inside], change[inside])
    axes.set_xlabel("along the section [mm], shaded where it lies in the region")
    axes.set_ylabel("change [mm]")
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    number_evenly(axes.yaxis)


def _mark_unknown(axes: Axes, along: Floats) -> None:
    """Hatch where the change is not assessable: segments (n, 2) [mm] along the section, of which some is not known."""
    if not len(along):
        return
    for first, last in join_spans(np.sort(along, axis=1)):
        axes.axvspan(first, last, facecolor=_hex(HATCH_LIGHT), edgecolor=_hex(HATCH_DARK), lw=0, hatch="/////")
    axes.annotate("hatched: not assessable", (1, 1), (0, 3), "axes fraction", textcoords="offset points", ha="right",
                  fontsize=7.5 * LETTERS)  # fmt: skip


def join_spans(spans: Floats) -> list[tuple[float, float]]:
    """Return spans (n, 2), each with its lower end first, rising and joined where they touch or lie over each other."""
    joined: list[tuple[float, float]] = []
    for first, last in spans[spans[:, 0].argsort()]:
        if joined and first <= joined[-1][1] + 1e-6:
            joined[-1] = (joined[-1][0], max(joined[-1][1], float(last)))
        else:
            joined.append((float(first), float(last)))
    return joined


def _scale_change(axes: Axes, change: Floats, level: float) -> None:
    """Set the vertical limits to what there is, with room for a word at the far end."""
    low, high = min(change.min(initial=0), -level), max(change.max(initial=0), level)
    tall = high - low if high > low else 1.0  # where nothing of it is known, an empty chart
    falls = -change.min(initial=0) > change.max(initial=0)
    axes.set_ylim(low - (0.32 if falls else 0.1) * tall, high + (0.1 if falls else 0.32) * tall)


def _name_largest(axes: Axes, along: Floats, change: Floats) -> None:
    """Write the largest change beside its place, on white: it may stand over hatching."""
    where = np.unravel_index(np.abs(change).argmax(), change.shape)
    x, y = along[where], change[where]
    axes.plot([x], [y], "o", ms=3, color=INK)
    axes.annotate(say_mm(y / MM, sign=True), (x, y), (0, 5 if y > 0 else -5), textcoords="offset points", ha="center",
                  va="bottom" if y > 0 else "top", weight="bold",
                  bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0.0, "pad": 0.6})  # fmt: skip


__all__ = ["draw_colour_bar", "draw_histogram", "draw_section", "say_mm"]
