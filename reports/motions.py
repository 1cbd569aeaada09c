"""How the object as a whole moved over more than two epochs: the words and the tables of a `Series`.

A steady motion of the whole is no change of any region: where the shape is compared with itself it falls out. Whether
it is one is known only where control points say how well the coordinates of the epochs agree.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from projects.model import Series
from reports.answer import AGREEMENT_UNKNOWN, NOT_ASSESSABLE
from reports.facts import Table
from reports.quantities import DEGREES, MM, Estimate, estimate
from reports.wholemotion import sigma_along

SIGNIFICANT = 0.05
MISFIT = 0.01  # epochs that chance leaves less often off a steady motion are off it
UPRIGHT = 0.8  # of a shift: from so much on it is called one up or down


def tell_motions(series: Series) -> Table | None:
    """Return how the object stood as a whole in each epoch against the first, and what that is a year; None without a
    network."""
    if not len(series.motions):
        return None
    rows: list[tuple[str, ...]] = []
    for _, m in series.motions.iterrows():
        shift = estimate(float(m["shift_m"]), float(m["sigma_shift_m"]), MM, "mm")
        turn = estimate(float(m["turn_rad"]), float(m["sigma_turn_rad"]), DEGREES, "°")
        rows.append((str(m["epoch"]), shift.text, turn.text, _moved(float(m["probability_unmoved"]))))
    steady = series.statistics.get("steady_motion")
    if steady is not None:
        rows.append(("a year", *(rate.text for rate in _rates(steady)), _course(steady)))
    note = f"All registrations adjusted together, against epoch {series.reference_id}. {_say_closure(series)}"
    unknown = series.motions["probability_unmoved"].isna()
    if unknown.any():
        note += f" Of motions that are {NOT_ASSESSABLE}, {AGREEMENT_UNKNOWN}: control points that hold both would tell."
    differ = "coordinates differ by" if unknown.all() else "displaced by"
    return Table("The object as a whole", ("epoch", differ, "turned by", "motion"), tuple(rows), note)


def _say_closure(series: Series) -> str:
    """Return how well the registrations fit each other: as many as there are later epochs close no loop, and whatever
    they say they fit; those that frames alone hold tell nothing."""
    telling = series.closures.dropna(subset=["misfit_sigma"])
    if len(telling) <= len(series.motions):
        return "No registration between two later epochs checks them."
    worst = telling.sort_values("misfit_sigma").iloc[-1]
    return (f"The one that fits the others least, {worst['reference']} to {worst['compared']}, is off by "
            f"{float(worst['misfit_sigma']):.1f} sigma.")  # fmt: skip


def say_steady_motion(series: Series) -> str:
    """Return whether the object goes on moving as a whole, and at which rate, in words; empty where it is not known."""
    steady = series.statistics.get("steady_motion")
    if steady is None:
        return ""
    shift, turn = _rates(steady)
    course = _course(steady)
    if course == "not significant":
        return f" No steady motion of the whole is told: {shift.text} and {turn.text} a year."
    if course == "at no one rate":
        return " As a whole it moved, but at no one rate."
    is_shifted, is_turned = (steady[name] < SIGNIFICANT for name in ("p_shift", "p_turn"))
    told = [f"is displaced by {shift.text}{_way(steady)}"] if is_shifted or not is_turned else []
    told += [f"turns by {turn.text}"] if is_turned or not is_shifted else []
    return f" As a whole it moves on steadily: it {' and '.join(told)} a year."


def steady_motion_table(series: Series) -> pd.DataFrame | None:
    """Return the steady motion of the whole as one row: the place that it is about [m], rates and their sigmas, how
    often chance makes as much; None where it is not known."""
    steady = series.statistics.get("steady_motion")
    if steady is None:
        return None
    sigma = np.sqrt(np.diag(np.asarray(steady["covariance"])))
    turns, shifts = [f"turn_{a}_rad_per_year" for a in "xyz"], [f"{a}_m_per_year" for a in "xyz"]
    row = {
        "epochs": steady["epochs"],
        **dict(zip("xyz", steady["centre"], strict=True)),
        **dict(zip([*turns, *shifts], steady["rate"], strict=True)),
        **dict(zip([f"sigma_{name}" for name in (*turns, *shifts)], sigma, strict=True)),
        **{name: steady[name] for name in ("p_rate", "p_turn", "p_shift", "p_fit")},
    }
    return pd.DataFrame([row])


def _moved(probability_unmoved: float) -> str:
    """Return whether the object moved, as far as that is known."""
    if math.isnan(probability_unmoved):
        return NOT_ASSESSABLE
    return "significant" if probability_unmoved < SIGNIFICANT else "not significant"


def _rates(steady: dict[str, Any]) -> tuple[Estimate, Estimate]:
    """Return the shift and the turn of a year, with their margins."""
    rate, covariance = np.asarray(steady["rate"]), np.asarray(steady["covariance"])
    shift, turn = (
        estimate(float(np.linalg.norm(rate[part])), sigma_along(rate[part], covariance[part, part]), scale, unit)
        for part, scale, unit in ((slice(3, 6), MM, "mm"), (slice(0, 3), DEGREES, "°"))
    )
    return shift, turn


def _course(steady: dict[str, Any]) -> str:
    """Return how the object moves, as far as its epochs bear it out."""
    if steady["p_fit"] < MISFIT:
        return "at no one rate"
    return "steady" if steady["p_rate"] < SIGNIFICANT else "not significant"


def _way(steady: dict[str, Any]) -> str:
    """Return whether a shift goes up or down, in words; empty where it does neither."""
    shift = np.asarray(steady["rate"])[3:]
    if abs(shift[2]) < UPRIGHT * np.linalg.norm(shift):
        return ""
    return " upwards" if shift[2] > 0.0 else " downwards"
