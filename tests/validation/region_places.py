"""On which of the places that changed each region of a comparison lies, and what is said of them against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from rows import Row

from monitor.simulation.changes import Edit
from monitor.simulation.true_change import TrueChange
from projects.model import Assessment, Comparison, Floats


@dataclass(frozen=True)
class PlacedEdit:
    """What truly changed, named in the table as its edit, and where its middle is."""

    edit: Edit
    place: Floats


class Unit(NamedTuple):
    """A unit of volume as a table has it: its name, how many of it are a cubic metre, how many digits it shows."""

    name: str
    per_m3: float
    digits: int


MM3, CM3 = Unit("mm3", 1e9, 0), Unit("cm3", 1e6, 1)


def places_of_regions(comparison: Comparison, places: Sequence[Floats], near: float) -> list[int]:
    """Return the place (3,) [m] that the centre of each region is nearest to, -1 where none is within `near` [m]."""
    out = []
    for centre in comparison.regions[["x", "y", "z"]].to_numpy(dtype=float):
        away = np.linalg.norm(np.array(places) - centre, axis=1)
        out.append(int(away.argmin()) if away.min() < near else -1)
    return out


def look_at(comparison: Comparison, place: Floats) -> tuple[bool, float]:
    """Return whether the vertex of the earlier surface next to a place (3,) [m] is called unchanged, and from how large
    a change [m] on it tells one."""
    side = comparison.on_reference
    nearest = int(np.linalg.norm(side.surface.vertices - place, axis=1).argmin())
    told_from = float("nan") if side.told_from is None else float(side.told_from[nearest])
    return bool(side.assessment[nearest] == Assessment.UNCHANGED), told_from


def row_of_place(
    changed: PlacedEdit, truth: TrueChange, told: Sequence[pd.Series], found: Sequence[Comparison], unit: Unit = MM3
) -> Row:
    """Return how often what changed was `told` in the comparisons `found`, by the regions that lie on it, and their
    figures."""
    others = {"deepest, mm": f"{1e3 * truth.extreme:+.1f}", "told": "",
              f"volume, {unit.name}": f"{unit.per_m3 * truth.volume:+.{unit.digits}f}", f"told, {unit.name}": "",
              "within 1.96 sigma: deepest, area, volume": ""}  # fmt: skip
    if told:
        deepest, volume = (mean_known([t[figure] for t in told]) for figure in ("extreme_m", "volume_m3"))
        in_unit = f"{unit.per_m3 * volume:+.{unit.digits}f}" if np.isfinite(volume) else "not known"
        others |= {"told": f"{1e3 * deepest:+.1f}", f"told, {unit.name}": in_unit}
        pairs = (("extreme_m", truth.extreme), ("area_m2", truth.area), ("volume_m3", truth.volume))
        others["within 1.96 sigma: deepest, area, volume"] = ", ".join(within(told, *pair) for pair in pairs)
    seen = [look_at(c, changed.place) for c in found]
    others["its middle called unchanged"] = f"{sum(is_unchanged for is_unchanged, _ in seen)} of {len(found)}"
    least = [told_from for _, told_from in seen if np.isfinite(told_from)]
    others["it tells from, mm"] = f"{1e3 * np.median(least):.1f}" if least else ""
    return Row(f"{changed.edit.name}: told", f"{len(told)} of {len(found)}", others=others, value=float(len(told)))


def mean_known(figures: Sequence[float]) -> float:
    """Return the mean of the figures that are known, NaN where none is."""
    known = [f for f in figures if np.isfinite(f)]
    return float(np.mean(known)) if known else float("nan")


def within(told: Sequence[pd.Series], name: str, true: float) -> str:
    """Return how many of the regions that know a figure and its margin hold its truth within 1.96 sigma."""
    known = [t for t in told if np.isfinite(t[name]) and np.isfinite(t[f"sigma_{name}"])]
    return f"{sum(abs(t[name] - true) < 1.96 * t[f'sigma_{name}'] for t in known)} of {len(known)}"
