"""How regions go on over more than two epochs: the words, the table and the drawing of a `Series`.

In: a series as the store keeps it. Out: `SeriesFacts` for the page, and one small chart a region as SVG.
"""

from __future__ import annotations

import datetime
import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateFormatter, AutoDateLocator, date2num

from projects.model import Floats, Series
from reports.answer import LEAST_COARSE
from reports.colours import change_ramp
from reports.drawing import INK, SOFT, drawing, plain_number, write_svg
from reports.facts import CourseFacts, SeriesFacts
from reports.motions import say_steady_motion, tell_motions
from reports.quantities import (
    MM,
    Estimate,
    Measures,
    choose_measures,
    day,
    estimate,
    in_words,
    millimetres,
    percent,
)

CHARTS = 6  # regions drawn, the largest; all are in the table
COLUMNS, ROW = 2, 1.55  # charts in a row; inches of a row
BESIDE = 0.04  # of the time drawn, left free at both ends
DATES = {365.0: "%Y", 31.0: "%b %Y", 1.0: "%d %b"}  # how ticks so many days apart are written
Z95 = 1.96
GOES_ON = ("steady", "accelerating")  # at a rate
ALL_GO_ON = {*GOES_ON, "bending", "onset", "jump and rate"}
OPEN = "the epochs do not tell which"
CHANGES = {
    "jump": "at once",
    "onset": "began later",
    "stopped": "came to rest",
    "jump and rate": "goes on beside a jump",
}
COURSES = {
    "steady": "goes on steadily",
    "none": "no trend is significant",
    "irregular": "irregular, no steady course or single jump fits",
    "single": "measured in one epoch only, which tells no course",
}


def tell_series(series: Series) -> SeriesFacts:
    """Return what a report says of a series: one row a region, largest first."""
    rows = series.regions.sort_values("area_m2", ascending=False, kind="stable")
    measures = choose_measures(rows["area_m2"])
    courses = tuple(tell_course(series, row, measures) for _, row in rows.iterrows())
    n = len(series.epoch_ids) + 1
    first, last = (day(datetime.date.fromisoformat(d)) for d in (series.reference_date, series.dates[-1]))
    lead = f"{in_words(n).capitalize()} epochs from {first} to {last}. "
    whole = say_steady_motion(series)
    if not courses:
        told = f"{lead}No region changed in any of them.{_how_small(series, 'would have been')}{whole}"
        return SeriesFacts(told, (), series, measures, tell_motions(series))
    going = sum(set(str(model).split(" or ")) <= ALL_GO_ON for model in rows["model"])
    alone = sum(_is_by_trend(row) for _, row in rows.iterrows())
    told = f"{lead}{_say_followed(len(courses), going)}{_say_by_trend(alone, len(courses))}{_how_small(series, 'is')}"
    told += whole
    return SeriesFacts(told, courses, series, measures, tell_motions(series))


def _say_followed(n: int, going: int) -> str:
    """Return how many regions are followed and how many of them go on changing, in words."""
    where = "measured over its whole footprint in every epoch that shows most of it"
    if n == 1:
        return f"One region is followed, {where}; {'it goes' if going else 'nothing says that it goes'} on changing."
    rest = f"{in_words(going)} of them {'goes' if going == 1 else 'go'}" if going else "none goes"
    return f"{in_words(n).capitalize()} regions are followed, each {where}; {rest} on changing."


def _is_by_trend(row: pd.Series) -> bool:
    """Return whether no single epoch shows a region, and its trend does; of older series that was not asked."""
    return str(row.get("found_by", "epochs")) == "trend"


def _say_by_trend(n: int, n_all: int) -> str:
    """Return how many regions are found by their trend alone, in words; empty for none."""
    if not n:
        return ""
    which = "it" if n_all == 1 else "them" if n == n_all else f"{in_words(n)} of them"
    return f" No single epoch shows {which}: all epochs together do, by {'its' if n == 1 else 'their'} trend."


def _how_small(series: Series, told: str) -> str:
    """Return from how large a rate on a steady change is `told`, or would have been, as far as it is known; and where
    only larger ones are."""
    level, least, share, most = (
        float(series.statistics.get(name, math.nan))
        for name in ("told_from_median_m_per_year", "coarse_from_m_per_year", "coarse_area_share",
                     "coarse_told_from_m_per_year")
    )  # fmt: skip
    if not math.isfinite(level):
        return ""
    words = f" A steady change {told} told from about {_per_year(level)} on (19 of 20 such, median over the surface)"
    if not share >= LEAST_COARSE:
        return f"{words}."
    return (
        f"{words}; on {percent(share)} of it only above {_per_year(least)}, on the coarsest twentieth of that above "
        f"{_per_year(most)}."
    )


def _per_year(rate: float) -> str:
    """Return a rate [m/year] in words."""
    return f"{millimetres(rate)}/year"


def tell_course(series: Series, row: pd.Series, measures: Measures) -> CourseFacts:
    """Return one followed region as texts."""
    history = series.history[series.history["identity"] == row["identity"]]
    last = history[np.isfinite(history["mean_m"])].tail(1)
    is_old = bool(len(last)) and str(last["epoch"].iloc[0]) != series.epoch_ids[-1]
    since = f"; last measured in epoch {last['epoch'].iloc[0]}" if is_old else ""
    mean, sigma = (float(last[name].iloc[0]) if len(last) else math.nan for name in ("mean_m", "sigma_mean_m"))
    return CourseFacts(
        number=int(row["identity"]),
        side="lost" if mean < 0 else "gained" if mean > 0 else "other",
        course=say_course(series, row) + since,
        origin=_origin(row),
        first_seen="by its trend alone" if _is_by_trend(row) else str(row["first_seen"]),
        area=estimate(float(row["area_m2"]), 0.0, measures.per_m2, measures.area),
        mean=estimate(mean, sigma, MM, "mm", signed=True),
        rate=_rate(row),
        volume_rate=_volume_rate(row, measures),
    )


def _rate(row: pd.Series) -> Estimate:
    """Return the rate of a region where one describes how it goes on."""
    if str(row["model"]) not in ("none", *GOES_ON):
        return Estimate("no one rate")
    return estimate(float(row["rate_m_per_year"]), float(row["sigma_rate_m_per_year"]), MM, "mm/year", signed=True)


def _volume_rate(row: pd.Series, measures: Measures) -> Estimate:
    """Return the rate of a region's volume where it goes on at a rate, and the series tells it."""
    if str(row["model"]) not in GOES_ON:
        return Estimate("no one rate")
    value, sigma = (float(row.get(f"{name}volume_rate_m3_per_year", math.nan)) for name in ("", "sigma_"))
    return estimate(value, sigma, measures.per_m3, f"{measures.volume}/year", signed=True)


def say_course(series: Series, row: pd.Series) -> str:
    """Return the course of a region in words: of several that the epochs do not tell apart each."""
    kinds = str(row["model"]).split(" or ")
    words = [_bends(row) if kind in ("accelerating", "bending") else CHANGES.get(kind) for kind in kinds]
    if None in words:
        return COURSES.get(kinds[0], kinds[0])
    told = " or ".join(str(w) for w in words)
    ends = [float(row[f"onset_{end}_years"]) for end in ("from", "to")]
    if kinds == ["accelerating"]:
        told = f"{told}, by {_acceleration(row)}"
    elif kinds == ["bending"]:
        told = f"{told}, by no constant acceleration"
    elif np.isfinite(ends).all():
        told = f"{told}, between {' and '.join(_when(series, end) for end in ends)}"
    return f"{told}; {OPEN}" if len(kinds) > 1 else told


def _bends(row: pd.Series) -> str:
    """Return whether what changes its rate gets faster or slower."""
    is_faster = float(row["acceleration_m_per_year2"]) * float(row["rate_m_per_year"]) > 0
    return "faster and faster" if is_faster else "slower and slower"


def _acceleration(row: pd.Series) -> str:
    """Return the size of the acceleration with its margin."""
    value, sigma = (float(row[f"{name}acceleration_m_per_year2"]) for name in ("", "sigma_"))
    return estimate(abs(value), sigma, MM, "mm/year²").text


def _when(series: Series, years: float) -> str:
    """Return the date of the epoch nearest to a time."""
    dates = (series.reference_date, *series.dates)
    nearest = int(np.argmin(np.abs(np.append(0.0, series.years) - years)))
    return day(datetime.date.fromisoformat(dates[nearest]))


def _origin(row: pd.Series) -> str:
    """Return from which regions one came, or into which it went, in words."""
    parts = []
    if int(row["parent"]):
        parts.append(f"split from {int(row['parent'])}")
    if int(row["merged_into"]):
        parts.append(f"merged into {int(row['merged_into'])}")
    return ", ".join(parts)


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
        return write_svg(figure)


def draw_dates(axes: Axes, series: Series) -> None:
    """Set the dates of a chart: the same in all of a series, whichever of its epochs a region was measured in."""
    ahead = series.forecast["years"].max() if len(series.forecast) else 0.0
    first, last = _dates(series, np.array([0.0, max(float(series.years[-1]), float(ahead))]))
    beside = BESIDE * (last - first)
    axes.set_xlim(first - beside, last + beside)
    locator = AutoDateLocator(minticks=2, maxticks=6)  # so that each length of time has one
    axes.xaxis.set_major_locator(locator)
    formatter = AutoDateFormatter(locator)
    formatter.scaled = DATES
    axes.xaxis.set_major_formatter(formatter)


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
    short = say_course(series, row).replace(";", ",").partition(",")[0]
    axes.set_title(f"region {int(row['identity'])}: {short}", loc="left", fontsize=8.0, pad=4.0)
    axes.yaxis.set_major_formatter(plain_number)
    axes.locator_params(axis="y", nbins=5)
    for edge in ("top", "right"):
        axes.spines[edge].set_visible(False)


def _dates(series: Series, years: Floats) -> Floats:
    """Return times since the first epoch as matplotlib's dates."""
    first = datetime.date.fromisoformat(series.reference_date)
    return np.asarray(date2num(first) + 365.25 * years, dtype=float)


def _colour(means: Floats) -> Any:
    """Return the colour of a loss or a gain, that of the pictures."""
    last = means[np.isfinite(means)][-1:] if np.isfinite(means).any() else np.zeros(1)
    return change_ramp(np.sign(last) * 0.8, 1.0)[0] / 255.0
