"""Where the regions of a series lie, and which regions of its last comparison they are.

In: a series and the comparison of its reference with its last epoch. Out: words of place as the table of regions has
them, and the numbers that the maps of that comparison show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import pandas as pd

from projects.model import Comparison, Series, Surface
from projects.triangles import face_normals
from reports.facts import SeriesFacts
from reports.quantities import NBSP
from reports.whereabouts import Setting, is_all_round, locate, name_all_round, say_place, say_where, setting_of

NONE = "–"


@dataclass(frozen=True)
class Footprint:
    """Where a followed region lies, in words, and which region of the last comparison it is, 0 for none."""

    where: str
    region: int


def place_courses(told: SeriesFacts, comparison: Comparison, bearing: float | None = None) -> SeriesFacts:
    """Return the courses with their places, and with what the map of the comparison calls them."""
    placed = find_footprints(told.series, comparison, bearing)
    numbers = {k: f"no.{NBSP}{at.region}" if at.region else NONE for k, at in placed.items()}
    courses = (replace(c, where=placed[c.number].where, on_map=numbers[c.number]) for c in told.courses)
    return replace(told, courses=tuple(courses))


def find_footprints(series: Series, comparison: Comparison, bearing: float | None = None) -> dict[int, Footprint]:
    """Return where each followed region lies, by its number; `comparison` is that with the series' last epoch,
    `bearing` [rad] that of the object's front, None where nobody said.

    What is one region of the comparison lies where the comparison says; what is none, or part of one, where its own
    footprint does.
    """
    setting = setting_of(comparison.on_reference.surface, bearing)
    rows = comparison.regions.set_index("region")
    last = series.history[series.history["epoch"] == series.epoch_ids[-1]]
    of_last = {int(h["identity"]): int(h["region"]) for _, h in last.iterrows() if h["region"] in rows.index}
    shared = pd.Series(of_last, dtype=int).value_counts()
    into = {int(row["identity"]): int(row["merged_into"]) for _, row in series.regions.iterrows()}
    found = {}
    for _, row in series.regions.iterrows():
        number = of_last.get(int(row["identity"]), 0)
        if number and shared[number] == 1:
            where = locate(comparison, number, rows.loc[number, ["x", "y", "z"]].to_numpy(dtype=float), setting)
        else:
            where = _locate_footprint(series, row, comparison.on_reference.surface, setting)
        found[int(row["identity"])] = Footprint(where, of_last.get(_went_into(int(row["identity"]), into), 0))
    return found


def _went_into(identity: int, into: dict[int, int]) -> int:
    """Return the region that one has become, by which each merged `into`; itself where it did not."""
    while into.get(identity):
        identity = into[identity]
    return identity


def _locate_footprint(series: Series, row: pd.Series, surface: Surface, setting: Setting) -> str:
    """Return where what carries the number of a followed region on the reference surface lies."""
    place = row[["x", "y", "z"]].to_numpy(dtype=float)
    if len(series.identity) != len(surface.vertices):  # of a surface that was made again
        return say_place("", place, setting)
    inside = (series.identity == int(row["identity"]))[surface.faces].any(axis=1)
    patch = Surface(surface.vertices, surface.faces[inside])
    if inside.any() and is_all_round(patch):
        return say_place(name_all_round([patch], setting), place, setting)
    return say_where(face_normals(patch).sum(axis=0), place, setting)
