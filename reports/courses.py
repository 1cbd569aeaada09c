"""How regions go on over more than two epochs: the words and the table of a `Series`.

In: a series as the store keeps it. Out: `SeriesFacts` for the page.
"""

from __future__ import annotations

import datetime
import math

import numpy as np
import pandas as pd

from projects.model import Series
from reports.facts import CourseFacts, SeriesFacts
from reports.motions import say_steady_motion, tell_motions
from reports.quantities import (
    FINEST,
    MM,
    NOT_KNOWN,
    WORDS,
    Estimate,
    Measures,
    choose_measures,
    count,
    day,
    estimate,
    in_words,
    leading,
    millimetres,
    percent,
    print_number,
)
from reports.smallest import LEAST_COARSE

GOES_ON = ("steady", "accelerating")  # at a rate
ALL_GO_ON = {*GOES_ON, "bending", "onset", "jump and rate"}
OPEN = "the epochs do not tell which"
NEXT_TELLS = "the next epoch will tell whether it goes on"  # of what only the last one shows
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
    whole = say_steady_motion(series) + say_doubts(series)
    if not courses:
        told = f"{lead}No region changed in any of them.{_how_small(series, 'would have been')}{whole}"
        return SeriesFacts(told, (), series, measures, tell_motions(series))
    going = sum(set(str(model).split(" or ")) <= ALL_GO_ON for model in rows["model"])
    alone = sum(_is_by_trend(row) for _, row in rows.iterrows())
    told = f"{lead}{_say_followed(len(courses), going)}{_say_by_trend(alone, len(courses))}{_how_small(series, 'is')}"
    told += whole
    return SeriesFacts(told, courses, series, measures, tell_motions(series))


def say_doubts(series: Series) -> str:
    """Return which epochs may lie otherwise than they were taken to, and why; empty where none is doubted."""
    what = {"pose": "epoch {} lies on epoch {}", "scans": "the scans of epoch {} lie on each other"}
    return "".join(
        f" In doubt is how {what[d['of']].format(d['epoch'], series.reference_id)}: {d['doubt']}."
        for d in series.statistics.get("doubts", ())
    )


def _say_followed(n: int, going: int) -> str:
    """Return how many regions are followed and how many of them go on changing, in words."""
    where = "measured over its whole footprint in every epoch that shows most of it"
    if n == 1:
        return f"One region is followed, {where}; {'it goes' if going else 'nothing says that it goes'} on changing."
    say = in_words if n < len(WORDS) else count  # one style in a sentence
    which = "all" if going == n else say(going)
    rest = f"{which} of them {'goes' if going == 1 else 'go'}" if going else "of none it is told that it goes"
    return f"{say(n).capitalize()} regions are followed, each {where}; {rest} on changing."


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
        origin=_origin(row, series.regions),
        first_seen="by its trend alone" if _is_by_trend(row) else str(row["first_seen"]),
        area=_area(row, measures),
        mean=estimate(mean, sigma, MM, "mm", signed=True),
        rate=_rate(row),
        volume_rate=_volume_rate(row, measures),
    )


def _area(row: pd.Series, measures: Measures) -> Estimate:
    """Return the area of a region's footprint with two digits: the series has no margin of it, and it is not exact."""
    value = float(row["area_m2"]) * measures.per_m2
    if not (math.isfinite(value) and value > 0.0):
        return Estimate(NOT_KNOWN)
    return Estimate(print_number(value, min(leading(value) + 1, FINEST)), "", measures.area)


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
    elif kinds == ["jump"] and ends[1] == float(series.years[-1]):
        told = f"new between {' and '.join(_when(series, end) for end in ends)}; {NEXT_TELLS}"
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


def _origin(row: pd.Series, regions: pd.DataFrame) -> str:
    """Return from which of the `regions` one came, into which it went, or which went into it, in words."""
    parts = []
    if int(row["parent"]):
        parts.append(f"split from {int(row['parent'])}")
    if int(row["merged_into"]):
        parts.append(f"merged into {int(row['merged_into'])}, which tells of it since")
    merged = regions.loc[regions["merged_into"] == row["identity"], "identity"]
    if len(merged):
        parts.append(f"in all epochs with what was {' and '.join(str(int(i)) for i in merged)}")
    return ", ".join(parts)
