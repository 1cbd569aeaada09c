"""What every chart of a report shares: ink, type, width, and SVG whose bytes are the same every time.

Lengths come in metres and are drawn in millimetres; a chart is as wide as the text on A4.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from reports.quantities import MM, NOT_KNOWN, significant

INK, SOFT, FAINT = "#26282e", "#6b7078", "#eceff3"
STYLE: dict[str, Any] = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 8.0, "svg.fonttype": "path",
    "svg.hashsalt": "heritage-monitor", "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": SOFT,
    "axes.linewidth": 0.6, "axes.labelsize": 8.0, "axes.unicode_minus": True, "xtick.color": SOFT, "ytick.color": SOFT,
    "xtick.labelcolor": INK, "ytick.labelcolor": INK, "xtick.labelsize": 7.5, "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 3.0, "ytick.major.size": 3.0,
    "hatch.linewidth": 1.1, "lines.solid_capstyle": "round",
}  # fmt: skip
WIDTH = 6.7  # inches, of every chart: the width of the text on A4


@contextmanager
def drawing(height: float, letters: float = 1.0) -> Iterator[Figure]:
    """Give an empty figure in the house's style, its letters so many times as large as in a chart as wide as the
    text."""
    larger = {name: letters * size for name, size in STYLE.items() if name.endswith(("font.size", "labelsize"))}
    with matplotlib.rc_context({**STYLE, **larger}):
        figure = Figure(figsize=(WIDTH, height))
        FigureCanvasSVG(figure)
        yield figure


def write_svg(figure: Figure) -> bytes:
    """Return the drawing as SVG without a date, so that the same input gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def say_mm(metres: float, *, sign: bool = False) -> str:
    """Return a length as millimetres with two significant digits or more: 0.0035 mm, 0.35 mm, +2.4 mm, −12 mm."""
    if not math.isfinite(metres):
        return NOT_KNOWN
    value = metres * MM
    text = f"{abs(value):.{significant(value, 2)}f} mm"
    return f"{'−' if value < 0.0 else '+' if sign and value > 0.0 else ''}{text}"


def plain_number(value: float, _: object = None) -> str:
    """Return a number of a scale with its sign, 0 without one."""
    return even_numbers([value])[0]


def even_numbers(values: Sequence[float]) -> list[str]:
    """Return the numbers of a scale with their signs and as many decimals as the one that needs most, 0 by itself."""
    largest = max((abs(v) for v in values), default=0.0)
    decimals = next((d for d in range(12) if all(abs(round(v, d) - v) <= 1e-6 * largest for v in values)), 12)
    return ["0" if abs(v) <= 1e-9 * largest else f"{v:+.{decimals}f}".replace("-", "−") for v in values]


def number_evenly(axis: Axis) -> None:
    """Write the numbers of an axis whose ends are set."""
    low, high = sorted(axis.get_view_interval())
    ends = 1e-9 * (high - low)
    at = [float(t) for t in axis.get_majorticklocs() if low - ends <= t <= high + ends]
    axis.set_ticks(at, even_numbers(at))
