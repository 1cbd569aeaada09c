"""What stands below the figures and tables of a report, the same words on the page and in the document.

In: the facts of a report. Out: sentences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from reports.certainty import is_closed_over, share_of_edge
from reports.document import MEANINGS
from reports.facts import CalibrationFacts, RegionFacts, ReportFacts
from reports.quantities import NBSP, NOT_KNOWN, listed, tell_bearing
from reports.smallest import dots_of_legend, is_beside_layer

COURSES = (
    f"Mean change of each followed region since the first epoch, with its 95{NBSP}% interval. Diamond: the first "
    "epoch. Filled: found as a region in that epoch; hollow: measured at the same place where none was found, as in "
    "every epoch of a region that its trend alone shows. Where the bar of a hollow one does not reach zero, this "
    "place taken by itself differs in that epoch; to be found, a region must stand out in a search of all of the "
    "surface, which asks for more. Line and band, where a trend is significant and does not slow down: the trend, "
    f"and where 95{NBSP}% of epochs will lie if it goes on."
)
COURSE_NUMBERS = (
    "Numbers are those of the series, which a region keeps through all epochs. On the map: which region it is in the "
    "pictures and the table of this comparison, which are numbered by themselves; –: none of them. Areas are of the "
    "whole footprint of a region, to two digits: no margin of them is known."
)
RECORD = (
    "Each step with its settings and the values it found for itself, as they are kept: lengths in metres, angles in "
    "radians; “auto” was found from the data."
)
LEAST_EDGE = 0.01  # of a surface lies beyond its points: pictures show it hatched, and shares do not hold it
ENDS = (".", "!", "?", "…")  # of a title that is a sentence, or was cut: no full stop follows
# What two surfaces do not tell from it, where the surface goes on: plaster that bulges, wood that shrinks.
OR_MOVED = {"lost": ", or surface that sank in (not told which)",
            "added": ", or surface that bulged out (not told which)"}  # fmt: skip


@dataclass(frozen=True)
class Captions:
    """The sentences of one report; `kinds` are names and meanings of the kinds of regions that it holds, the columns of
    regions and of courses names and units of their figures."""

    difference: str
    strips: str
    regions: str
    region_columns: tuple[tuple[str, str], ...]
    course_columns: tuple[tuple[str, str], ...]
    kinds: tuple[tuple[str, str], ...]
    courses: str
    course_numbers: str
    distribution: str
    stable: str
    record: str
    foot: str


def _name_hollows(facts: ReportFacts) -> str:
    """Return which regions are hollows too narrow for a surface, and what is told of them; "" without any."""
    known = {region.number for region in facts.regions}
    shapes = facts.comparison.statistics.get("region_shapes", [])
    hollows = [str(s["region"]) for s in shapes if s.get("is_hollow") and s["region"] in known]
    if not hollows:
        return ""
    named, one, it, its = ("No.", "is a hollow", "it", "its volume is")
    if len(hollows) > 1:
        named, one, it, its = ("Nos.", "are hollows", "they", "their volumes are")
    return (
        f"{named} {listed(hollows)} {one} too narrow to have a surface, such as a crack: told by the points measured "
        f"within, as deep as these lie; {it} may be deeper, and {its} not known. "
    )


def _name_unknown(facts: ReportFacts) -> str:
    """Return why the volume, or the margin of the extreme, of regions that are no hollows is not known; "" where all
    are."""
    hollows = {s["region"] for s in facts.comparison.statistics.get("region_shapes", []) if s.get("is_hollow")}
    others = [region for region in facts.regions if region.number not in hollows]
    no_volume = [str(r.number) for r in others if r.volume.value == NOT_KNOWN]
    no_margin = [str(r.number) for r in others if r.extreme.margin == NOT_KNOWN]
    told = ""
    if no_volume:
        told += (
            f"The volume of {_numbers(no_volume)} is not known: too little of what lies there and beside could be "
            "assessed, and the change may go on. "
        )
    if no_margin:
        told += (
            f"The margin of the extreme of {_numbers(no_margin)} is not known: at edges and rims a surface may be "
            "rounder than the object by more than it states. "
        )
    return told


def _numbers(numbers: list[str]) -> str:
    """Return the numbers of regions in words."""
    return f"no{'s' * (len(numbers) > 1)}.{NBSP}{listed(numbers)}"


def write_captions(facts: ReportFacts) -> Captions:
    """Return the sentences of a report."""
    before, after = facts.before, facts.after
    moved = f", the {after.order} moved onto the {before.order}" if facts.mode == "relative" else ""
    crs = f", {facts.crs}" if facts.crs else ""
    present = dict.fromkeys(r.kind for r in facts.regions)
    return Captions(
        difference=_name_colours(facts),
        strips=f"The same fixed views of both epochs{moved}.{_name_closed(facts)}",
        regions=_name_figures(facts),
        region_columns=(
            ("Area", facts.measures.area), ("Volume", facts.measures.volume), ("Extreme", "mm"), ("Mean", "mm"),
        ),
        course_columns=() if facts.series is None else (
            ("Area", facts.series.measures.area), ("Mean, last known", "mm"), ("Rate", "mm/year"),
            ("Volume rate", f"{facts.series.measures.volume}/year"),
        ),
        kinds=tuple((kind, f"{MEANINGS[kind]}{OR_MOVED.get(kind, '')}") for kind in present if kind in MEANINGS),
        courses=COURSES,
        course_numbers=COURSE_NUMBERS,
        distribution=(
            f"The differences of all assessed places of the {after.order} surface, with the level of detection of "
            f"single places (95{NBSP}%, median)."
        ),
        stable=_name_stable(facts),
        record=RECORD,
        foot=(
            f"{facts.title}{'' if facts.title.endswith(ENDS) else '.'} {before.epoch_id} compared with "
            f"{after.epoch_id}. Coordinates are those of the {before.order} epoch{crs}; positive differences are "
            "material gained."
        ),
    )  # fmt: skip


def _name_closed(facts: ReportFacts) -> str:
    """Return what the hatch means where either surface was closed over holes; "" where none was."""
    return " Hatched: a hole that was closed, nothing was measured there." if is_closed_over(facts.comparison) else ""


def _name_colours(facts: ReportFacts) -> str:
    """Return what the picture of the difference shows, and what its colours mean."""
    is_dotted = math.isfinite(dots_of_legend(facts.comparison))
    dotted = " Dotted: unchanged as far as can be told; only larger changes are told there." if is_dotted else ""
    uncounted = ["a hole that was closed"] * is_closed_over(facts.comparison)
    uncounted += ["the edge beyond the points"] * (share_of_edge(facts.comparison) >= LEAST_EDGE)
    also = f"; also {listed(uncounted)}, which no share counts" if uncounted else ""
    went = " Where a part moved, warm is what went in and blue what came out."
    moved = went if any(region.kind == "moved" for region in facts.regions) else ""
    numbers = " Numbers are those of the table of regions" if facts.regions else ""
    is_both = {"lost", "gained"} <= {region.side for region in facts.regions}
    numbers += ", which also says without colour what was lost and what gained." if is_both else "." * bool(numbers)
    inside = (
        "Seen from within: what looks away from the viewer is left out."
        if facts.is_room
        else "Dark grey: the inside, seen through where nothing was recorded."
    )
    return (
        f"What changed from {facts.before.date} to {facts.after.date}, drawn on the {facts.after.order} surface; all "
        "views at one scale. Warm colours: material lost, paler where it stood before what is there now. Blue: "
        f"material gained.{moved} The darkest colours: as much or more; their scale is this comparison’s own, do not "
        f"compare colours with another report’s. Light grey: assessed and unchanged.{dotted} Hatched: not "
        f"assessable{also}. {inside}{numbers}"
    )


def _name_figures(facts: ReportFacts) -> str:
    """Return what the figures in the table of regions mean."""
    beside = "Figures are beside what all of the surface lies off by. " if is_beside_layer(facts.comparison) else ""
    is_hardly_known = any(r.area.most for r in facts.regions)
    hardly = " Up to: the upper end of it, for an area that is not well known." if is_hardly_known else ""
    return (
        f"± is the half-width of the 95{NBSP}% interval.{hardly} Positive: material gained; negative: lost. "
        "Extreme: the middle of the several neighbouring places where the change is largest, so that no single one "
        "decides. Mean: free of what chance adds to it where borders are drawn. "
        f"{beside}{_name_hollows(facts)}{_name_unknown(facts)}{_name_sides(facts)}"
    )


def _name_stable(facts: ReportFacts) -> str:
    """Return what the picture of the stable areas shows."""
    looked_for = ", looked for only where you said that nothing moved" if facts.stable else ""
    not_asked = "; nearly white: outside of what you gave, not asked" if facts.stable else ""
    dark = "" if facts.is_room else " Dark grey: the inside."
    return (
        f"What held the two epochs together, on the {facts.after.order} surface. Green: held to be stable{looked_for}. "
        f"Sand: changed. Light grey: neither, left out{not_asked}.{dark}"
    )


def _name_sides(facts: ReportFacts) -> str:
    """Return whose words of place those of a report are, and how it is known which side is the front."""
    if facts.is_room:
        which = (
            "that of the first view"
            if facts.front is None
            else f"as given that which faces {tell_bearing(facts.front)}"
        )
        return f"Walls are named as by someone who stands in the room before the wall ahead, {which}."
    if facts.front is None and facts.is_flat:
        return (
            "The object lies flat, and hardly shows which side is its front: taken to be the lower edge of the view "
            "from above, which is square to its sides; “monitor set-front” gives another."
        )
    if facts.front is None:
        return (
            "Sides are those of someone who stands before the front, taken to be where most of the surface faces: the "
            "view of that name shows which side it is."
        )
    return (
        "Sides are those of someone who stands before the front, which was given with the object: it faces "
        f"{tell_bearing(facts.front)}."
    )


def caption_region(region: RegionFacts, facts: ReportFacts) -> str:
    """Return what stands below the close-up and the section of a region."""
    return (
        f"Region {region.number}: {region.area.text}, volume {region.volume.text}, extreme {region.extreme.text}. Seen "
        f"straight on, and in section from A to B: the reference is the {facts.before.order} epoch, the compared the "
        f"{facts.after.order}. The dot is the largest change on this section, a single place; the extreme is of "
        "several places, anywhere in the region."
    )


def title_region(region: RegionFacts) -> str:
    """Return the title of a region's figure."""
    return f"{region.meaning.capitalize()}, {region.where}"


def caption_calibration(calibration: CalibrationFacts) -> str:
    """Return what stands below the drawing of a range calibration."""
    return f"Ranges corrected: distances of one plane patch to its plane, before and after. {calibration.text}"
