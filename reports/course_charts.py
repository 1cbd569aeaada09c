"""One small chart a region: how it goes on over more than two epochs.

In: a series as the store keeps it. Out: SVG.
"""

from __future__ import annotations

import datetime
import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import AutoDateFormatter, AutoDateLocator, DateFormatter, DayLocator, date2num
from matplotlib.figure import Figure

from projects.model import Z95, Floats, Series
from reports.colours import change_ramp
from reports.courses import say_course
from reports.drawing import INK, SOFT, drawing, number_evenly, write_svg
from reports.quantities import MM

CHARTS = 6  # regions drawn, the largest; all are in the table
COLUMNS, ROW = 2, 1.55  # charts in a row; inches of a row
ROOM = 0.006  # of the figure's width, left free beside titles
SHORT = 5.0  # days, of a series whose every day has room for its date
BESIDE = 0.04  # of the time drawn, left free at both ends
DATES = {365.0: "%Y", 31.0: "%b %Y", 1.0: "%d %b\n%Y"}  # how ticks so many days apart are written


def draw_courses(series: Series) -> bytes:
    """Return a chart for each of the largest regions: mean change with its 95 % interval, and its trend, in mm."""
    rows = series.regions.sort_values("area_m2", ascending=False, kind="stable").head(CHARTS)
    n_columns = min(COLUMNS, len(rows))
    n_rows, width = math.ceil(len(rows) / n_columns), 1.0 / n_columns
    height = n_rows * ROW + 0.3
    with drawing(height) as figure:
        for k, (_, row) in enumerate(rows.iterrows()):
            left, top = k % n_columns * width, k // n_columns
            box = (left + 0.095, (height - (top + 1) * ROW + 0.12) / height, width - 0.12, (ROW - 0.5) / height)
            axes = figure.add_axes(box)
            draw_course(axes, series, row)
            axes.set_ylabel("mean change [mm]" if left == 0 else "")
            draw_dates(axes, series)
        make_room(figure, width)
        return write_svg(figure)


def make_room(figure: Figure, width: float) -> None:
    """Move all charts to the right where the numbers of one, or its title, begin left of its place, one of so many of
    the figure's `width`."""
    renderer, across = FigureCanvasAgg(figure).get_renderer(), figure.get_figwidth() * figure.dpi
    begins = [(axes.yaxis.get_tightbbox(renderer), axes.get_position().x0 // width * width) for axes in figure.axes]
    short = max(left + ROOM - box.x0 / across for box, left in begins if box is not None)
    for axes in figure.axes if short > 0.0 else []:
        box = axes.get_position()
        axes.set_position((box.x0 + short, box.y0, box.width - short, box.height))


def draw_dates(axes: Axes, series: Series) -> None:
    """Set the dates of a chart: the same in all of a series, whichever of its epochs a region was measured in."""
    ahead = series.forecast["years"].max() if len(series.forecast) else 0.0
    first, last = _dates(series, np.array([0.0, max(float(series.years[-1]), float(ahead))]))
    beside = BESIDE * (last - first)
    axes.set_xlim(first - beside, last + beside)
    is_short = last - first < SHORT  # else ticks would be hours apart, and dates stand twice
    locator = DayLocator() if is_short else AutoDateLocator(minticks=2, maxticks=6)  # each length of time has one
    axes.xaxis.set_major_locator(locator)
    formatter = AutoDateFormatter(locator)
    formatter.scaled = DATES
    axes.xaxis.set_major_formatter(DateFormatter(DATES[1.0]) if is_short else formatter)


def draw_course(axes: Axes, series: Series, row: pd.Series) -> None:
    """Draw one region: points with 95 % bars, the forecast's line and band where there is one."""
    history = series.history[series.history["identity"] == row["identity"]]
    dates, means = _dates(series, history["years"].to_numpy(float)), history["mean_m"].to_numpy(float) * MM
    bars = Z95 * history["sigma_mean_m"].to_numpy(float) * MM
    found = history["region"].to_numpy(int) > 0
    forecast: Any = series.forecast[series.forecast["identity"] == row["identity"]]
    axes.axhline(0.0, color=SOFT, lw=0.5)
    colour = _colour(means)
    if len(forecast):
        at, mid = _dates(series, forecast["years"].to_numpy(float)), forecast["mean_m"].to_numpy(float) * MM
        band = Z95 * forecast["sigma_m"].to_numpy(float) * MM
        axes.fill_between(at, mid - band, mid + band, color=colour, alpha=0.16, lw=0)
        axes.plot(at, mid, color=colour, lw=0.9)
    axes.errorbar(dates, means, bars, fmt="none", ecolor=INK, elinewidth=0.8, capsize=2.0, capthick=0.8)
    axes.plot(dates[found], means[found], "o", color=colour, mec=INK, mew=0.6, ms=4.5)
    axes.plot(dates[~found], means[~found], "o", color="white", mec=INK, mew=0.6, ms=4.5)
    axes.plot(_dates(series, np.zeros(1)), [0.0], "D", color=INK, ms=3.2)
    axes.set_title(f"region {int(row['identity'])}: {_in_short(series, row)}", loc="left", fontsize=8.0, pad=4.0)
    axes.locator_params(axis="y", nbins=5)
    number_evenly(axes.yaxis)
    for edge in ("top", "right"):
        axes.spines[edge].set_visible(False)


def _in_short(series: Series, row: Any) -> str:
    """Return the course of a region in the words that a chart has room for: the table has all of them."""
    if " or " in str(row["model"]):
        return "the epochs do not tell its course"
    return say_course(series, row).replace(";", ",").partition(",")[0]


def _dates(series: Series, years: Floats) -> Floats:
    """Return times since the first epoch as matplotlib's dates."""
    first = datetime.date.fromisoformat(series.reference_date)
    return np.asarray(date2num(first) + 365.25 * years, dtype=float)


def _colour(means: Floats) -> Any:
    """Return the colour of a loss or a gain, that of the pictures."""
    last = means[np.isfinite(means)][-1:] if np.isfinite(means).any() else np.zeros(1)
    return change_ramp(np.sign(last) * 0.8, 1.0)[0] / 255.0
