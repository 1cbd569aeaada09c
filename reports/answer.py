"""The answer before all else: what changed, where, how much, how sure, in sentences for a conservator.

In: a comparison and its regions as texts. Out: a headline, a few sentences, the figures to remember.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from projects.model import Z95, Assessment, ComparedSurface, Comparison, NotAssessed
from reports.facts import Answer, EpochFacts, KeyFigure, RegionFacts, Told
from reports.quantities import (
    MM,
    NAN,
    NBSP,
    NOT_KNOWN,
    WORDS,
    about_square,
    count,
    estimate,
    in_words,
    listed,
    millimetres,
    percent,
    square,
)
from reports.smallest import (
    is_beside_layer,
    say_beyond_tolerance,
    say_coarse,
    say_coarse_beside,
    say_how_small,
    say_level,
    told_by_width,
)
from reports.whereabouts import Setting, locate_most
from reports.wholemotion import PartMotion, describe_motion, describe_parts, knows_motion

LISTED = 6  # of one kind: beyond it their numbers are not listed
MOSTLY = 0.5  # of the surface not assessable: the headline says so
LEAST_SIGMA_SCALE = 1e-6 / Z95  # no scale is told closer: the doubt about the motion says the same number
NAMED = 3  # so many regions are told in the answer, the others stand in the table
NONE_ASSESSED = "Nothing could be assessed."
NOT_ASSESSABLE = "not assessable"
AGREEMENT_UNKNOWN = "how well the coordinates of both epochs agree is not known"
HAPPENED = {
    "lost": "lost material",
    "added": "gained material",
    "moved": "moved as a part",
    "cleaned": "lost a thin, even layer (cleaning, weathering) or, if flat, moved inwards as a whole",
    "coated": "gained a thin, even layer (a coating, dirt) or, if flat, moved outwards as a whole",
    "unclear": "changed in a way that is neither clearly loss nor gain",
}
LAYER_OR_PIECE = (
    "Where a region is flat, an even layer and a piece of its size that moved as a whole look alike: the surfaces do "
    "not tell which it was."
)
MOVED_OR_WHOLE = "moved, as a part or with the whole"  # where the motion of the whole is in the differences
NONE_FOUND = "on all of the surface that could be assessed"
WHY_NOT = {
    NotAssessed.NO_FACE: "the other epoch has no surface there that faces the same way",
    NotAssessed.FREE_EDGE: "it lies beyond the edge of what the other epoch recorded",
    NotAssessed.SHEET_BETWEEN: "another part of the object lies in between",
    NotAssessed.TOO_UNCERTAIN: "the measurement is too uncertain there",
    NotAssessed.NOT_SEEN: "no scan of one epoch saw whether anything is there",
    NotAssessed.BEYOND_SEARCH: "the other epoch has no surface near by",
    NotAssessed.LOOKED_THROUGH: "the other epoch’s scanner looked through it, over less than a region’s area",
    NotAssessed.NO_ONE_SURFACE: "most of what was measured there lies off any one surface (plants, spray, joints)",
    NotAssessed.MET_NOTHING: "the other epoch’s scans hold nothing in that direction (gone, too dark, or cut out)",
    NotAssessed.UNEXPLAINED: (
        "what was measured there differs by more than errors do, but too little, or in too small spots, to be told as "
        "a region, or beside a steep change"
    ),
}


def state_answer(
    comparison: Comparison, regions: tuple[RegionFacts, ...], before: EpochFacts, after: EpochFacts, setting: Setting,
) -> Answer:  # fmt: skip
    """Return the answer of a comparison; `setting`: what words of place go by."""
    largest, tables = _largest(comparison, regions)
    return Answer(
        headline=_doubted(_headline(comparison, regions, (before, after)), comparison),
        changed=_what_changed(comparison, regions, before, after, tables),
        largest=largest,
        figures=_figures(comparison, regions, before, after),
        sure=_how_sure(comparison, bool(regions), (before, after), setting),
    )


def _how_sure(
    comparison: Comparison, changed: bool, epochs: tuple[EpochFacts, EpochFacts], setting: Setting
) -> tuple[Told, ...]:
    """Return how far what is told can be relied upon, by what it is about."""
    told = {
        "The rest": _lies_off(comparison),
        "How small": (say_how_small(comparison, changed), *say_coarse(comparison)),
        "Tolerance": say_beyond_tolerance(comparison),
        "The whole": (_whole(comparison),),
        "Not assessed": (_not_assessed(comparison, epochs), *_met_nothing(comparison, epochs, setting)),
    }
    return tuple(Told(subject, " ".join(texts)) for subject, texts in told.items() if texts)


def _doubted(headline: str, comparison: Comparison) -> str:
    """Return a headline with the word that it is in doubt, where something speaks against how the epochs lie on each
    other: the remarks say what. That nothing could be assessed is in no doubt."""
    if not comparison.registration.doubt or headline == NONE_ASSESSED:
        return headline
    return f"In doubt: {headline[0].lower()}{headline[1:]}"


def _headline(comparison: Comparison, regions: tuple[RegionFacts, ...], epochs: tuple[EpochFacts, EpochFacts]) -> str:
    """Return the first sentence of the report: what changed, or that nothing did."""
    n, unknown = len(regions), max(shares_not_assessed(comparison))
    if n == 0 and _is_all_unknown(comparison):
        return NONE_ASSESSED
    where = f" on the {percent(1.0 - unknown)} of the surface that could be assessed" if unknown > MOSTLY else ""
    if n == 0 and differs_as_a_whole(comparison):
        return f"No part changed against the rest{where}, but {_as_a_whole(comparison, epochs)}."
    if n == 0 and comparison.statistics.get("motion_is_significant"):
        return f"No part changed against the rest{where}, but the object as a whole {_moved_by(comparison)}."
    if n == 0:
        return f"No change was found{where}."
    told = _told_first(describe_parts(comparison), n)
    if comparison.mode == "absolute" and comparison.statistics.get("motion_is_significant"):
        return f"The object as a whole {_moved_by(comparison)}; {told[0].lower()}{told[1:]}, with it or apart from it."
    is_off = is_beside_layer(comparison) and _exceeds_its_margin(comparison)
    return f"{told} against the rest, which lies {_off(comparison)}." if is_off else f"{told}."


def _moved_by(comparison: Comparison) -> str:
    """Return by how much the object as a whole, which surely moved, did: its shift where that exceeds its margin, else
    its turn."""
    motion = describe_motion(comparison.registration)
    return f"moved by {motion.displacement.text}" if motion.is_shifted else f"turned by {motion.angle.text}"


def _exceeds_its_margin(comparison: Comparison) -> bool:
    """Return whether what is not called changed lies off by more than its margin."""
    offset, sigma = (comparison.statistics.get(name, NAN) for name in ("offset_m", "sigma_offset_m"))
    return bool(abs(offset) > Z95 * sigma)


def _told_first(parts: list[PartMotion], n: int) -> str:
    """Return how many parts moved, and how many of `n` regions are no part's motion, as the beginning of a sentence."""
    rest = n - len({r for part in parts for r in part.regions})
    moved = f"{in_words(len(parts))} part{'s' * (len(parts) > 1)} moved"
    others = f"{in_words(rest)}{' other' * (rest < n)} region{'s' * (rest != 1)} changed"
    told = others if not parts else f"{moved}, and {others}" if rest else moved
    return told[0].upper() + told[1:]


def differs_as_a_whole(comparison: Comparison) -> bool:
    """Return whether the compared epoch is of another scale, or all of its surface lies off: without regions, too, that
    is not the same as no change."""
    is_other_scale = math.isfinite(comparison.registration.scale)
    return is_other_scale or bool(comparison.statistics.get("offset_is_told"))


def _as_a_whole(comparison: Comparison, epochs: tuple[EpochFacts, EpochFacts]) -> str:
    """Return in words by what the compared epoch differs as a whole from the reference; `epochs`: these, in order."""
    scale, sigma = comparison.registration.scale, comparison.registration.sigma_scale
    if math.isfinite(scale):
        times = estimate(scale, max(sigma, LEAST_SIGMA_SCALE), 1.0, "").text
        return f"the {epochs[1].order} epoch is {times} times as large as the {epochs[0].order} one"
    return f"the surface as a whole lies {_off(comparison)}"


def _is_all_unknown(comparison: Comparison) -> bool:
    """Return whether nothing of the compared surface could be assessed."""
    return not comparison.on_compared.assessment.any()


def _what_changed(
    comparison: Comparison, regions: tuple[RegionFacts, ...], before: EpochFacts, after: EpochFacts, tables: list[str]
) -> tuple[str, ...]:
    """Return what changed between which dates; `tables`: where what does not follow one by one is to be found."""
    between = f"Between {before.date} and {after.date}"
    if not regions and _is_all_unknown(comparison):
        return (f"Whether anything changed between {before.date} and {after.date} is not known.",)
    if not regions:
        what = "changed"
        if differs_as_a_whole(comparison):
            what = "stands out of the rest"
        return (f"{between} no part of the surface that could be assessed {what} by more than errors can make.",)
    parts: list[str] = []
    kinds = Counter(r.kind for r in regions)
    say = in_words if all(n < len(WORDS) for n in kinds.values()) else count  # one style in a sentence
    for kind, n in kinds.items():
        numbers = listed([str(r.number) for r in regions if r.kind == kind])
        which = f" ({'no.' if n == 1 else 'nos.'}{NBSP}{numbers})" if n <= LISTED else ""
        things = "" if parts else " region" if n == 1 else " regions"
        happened = MOVED_OR_WHOLE if kind == "moved" and holds_whole(comparison) else HAPPENED.get(kind, kind)
        parts.append(f"{say(n)}{things} {happened}{which}")
    # Their margins are added up as if all erred alike: the sum has no more digits than that leaves.
    whole = about_square(*(float(comparison.regions[name].sum()) for name in ("area_m2", "sigma_area_m2")))
    size = f"; together they cover {whole}" if len(regions) > 1 else ""
    rest = (f"The largest of them follow; all stand in {listed(tables)}.",) if tables else ()
    doubt = (LAYER_OR_PIECE,) if any(r.kind in ("cleaned", "coated") for r in regions) else ()
    return (f"{between} {listed(parts)}{size}.", *doubt, *rest)


def _largest(comparison: Comparison, regions: tuple[RegionFacts, ...]) -> tuple[tuple[Told, ...], list[str]]:
    """Return the first parts that moved and the first regions beside them, and the tables that hold more of either."""
    moved = describe_parts(comparison)
    of_parts = {number for part in moved for number in part.regions}
    others = [r for r in regions if r.number not in of_parts]
    told = (*(_tell_part(k, part) for k, part in enumerate(moved[:NAMED], start=1)), *map(_tell, others[:NAMED]))
    return told, [f"the table of {what}" for what, left in (("parts", moved), ("regions", others)) if len(left) > NAMED]


def _tell_part(number: int, part: PartMotion) -> Told:
    """Return how far a part moved."""
    n = len(part.regions)
    which = f"(region{'s' * (n > 1)} {listed([str(r) for r in part.regions])}) " if 0 < n <= LISTED else ""
    shift, turn = part.shift.text, part.turn.text
    if part.is_shifted:
        turned = f" and turned by {turn}" if part.is_turned else ""
        told = f"moved as a whole against the rest, by {shift}{turned}."
    elif part.is_turned:
        told = f"turned as a whole against the rest, by {turn}; its middle did not measurably move ({shift})."
    else:
        how = f"how much of it is a shift ({shift}) and how much a turn ({turn}) cannot be told apart"
        told = f"moved as a whole against the rest; {how}."
    return Told(f"Part {number}", f"{which}{told}")


def holds_whole(comparison: Comparison) -> bool:
    """Return whether the differences hold, or may hold, a motion of the whole, which looks like one of parts."""
    return comparison.mode == "absolute" and comparison.statistics.get("motion_is_significant") is not False


def _tell(region: RegionFacts) -> Told:
    """Return where a region lies, how large it is and by how much it changed."""
    peak = {"lost": "at its deepest", "gained": "at its highest"}.get(region.side, "at most")
    size = f"{region.area.text}, {peak} {region.extreme.text}, volume{NBSP}{region.volume.text}"
    return Told(f"Region {region.number}", f"({region.where}): {size}.")


def _off(comparison: Comparison) -> str:
    """Return how far in or out the unchanged surface lies on average."""
    mean = float(comparison.statistics.get("offset_m", NAN))
    told = estimate(abs(mean), float(comparison.statistics.get("sigma_offset_m", NAN)), MM, "mm").text
    return f"{told} further {'out' if mean > 0.0 else 'in'}"


def _lies_off(comparison: Comparison) -> tuple[str, ...]:
    """Return what to think of an unchanged surface that lies off to one side, where it does."""
    beside = is_beside_layer(comparison) and len(comparison.regions) > 0
    if not comparison.statistics.get("offset_is_told") and not beside:
        return ()
    lost = float(comparison.statistics["offset_m"]) < 0.0
    layer = "taken off (cleaning, weathering)" if lost else "laid on (a coating, dirt)"
    stands_out = "" if beside else ": no part stands out"
    is_left = comparison.mode == "absolute"
    included = ", a motion of the whole included" if is_left else ""
    like = f"A layer {layer} nearly everywhere{', such a motion' if is_left else ''} and scanners whose ranges differ"
    return (
        f"What is not called changed lies {_off(comparison)} on average{included}. {like} look alike{stands_out}. "
        "Say where nothing changed (a stable area) to tell them apart.",
        *(("Regions and their figures are beside that: how far they stand out of the rest.",) if beside else ()),
    )


def _whole(comparison: Comparison) -> str:
    """Return whether the object moved as a whole, as far as that is known, and what was done about it."""
    motion = describe_motion(comparison.registration)
    shift, turn = motion.displacement.text, motion.angle.text
    where = "taken out of" if comparison.mode == "relative" else "contained in"
    if not knows_motion(comparison):
        return (
            f"Whether the object as a whole moved is {NOT_ASSESSABLE}: its coordinates differ by {shift}, turned by "
            f"{turn}, which is {where} the differences, but {AGREEMENT_UNKNOWN} without control points that hold both."
        )
    if not comparison.statistics.get("motion_is_significant"):
        return f"The object as a whole did not measurably move ({shift}, turned by {turn})."
    return (
        f"The object as a whole stands {shift} from where it stood, turned by {turn}; this is {where} the differences."
    )


def shares_not_assessed(comparison: Comparison) -> tuple[float, float]:
    """Return the shares of the reference and of the compared surface that could not be assessed: of their areas, else
    of their vertices."""

    def share(name: str, side: ComparedSurface) -> float:
        """Return the share of the area of one side, by vertices where the record holds no areas."""
        assessed = comparison.statistics.get(name, NAN)
        if np.isfinite(assessed):
            return float(1.0 - assessed)
        return float(np.mean(side.assessment == Assessment.NOT_ASSESSABLE)) if len(side.assessment) else NAN

    return (
        share("assessed_area_share_reference", comparison.on_reference),
        share("assessed_area_share", comparison.on_compared),
    )


def shares_by_assessment(comparison: Comparison, k: int) -> dict[str, float]:
    """Return which share of the reference (`k` = 0) or the compared surface (1) is "unchanged", "changed", or could not
    be assessed for each reason, by its name: of its area without the edge beyond its points, else of its vertices."""
    areas = comparison.statistics.get("areas_by_assessment_m2")
    if areas is not None:
        whole = max(sum(areas[k].values()), 1e-300)
        return {name: area / whole for name, area in areas[k].items()}
    side = (comparison.on_reference, comparison.on_compared)[k]
    unknown = side.assessment == Assessment.NOT_ASSESSABLE
    masks = {"unchanged": side.assessment == Assessment.UNCHANGED, "changed": side.assessment == Assessment.CHANGED}
    masks |= {reason.name.lower(): unknown & (side.reasons == reason) for reason in WHY_NOT}
    return {name: float(mask.sum()) / max(len(mask), 1) for name, mask in masks.items()}


def less_assessed(comparison: Comparison) -> int:
    """Return the side of which more could not be assessed: 0 the reference, 1 the compared surface."""
    reference, compared = shares_not_assessed(comparison)
    return 0 if reference > compared else 1


def _not_assessed(comparison: Comparison, epochs: tuple[EpochFacts, EpochFacts]) -> str:
    """Return the shares that could not be assessed, of both surfaces, and the main reason on the one with more."""
    shares = [percent(s) for s in shares_not_assessed(comparison)]
    k = less_assessed(comparison)
    here, there = epochs[k], epochs[1 - k]
    shares_here = shares_by_assessment(comparison, k)
    most = max(WHY_NOT, key=lambda reason: shares_here.get(reason.name.lower(), 0.0))
    said = f"{shares[k]} of the {here.order} epoch’s surface could not be assessed"
    if shares_here.get(most.name.lower(), 0.0) > 0.0:
        said += f", mostly because {WHY_NOT[most]}"
    return f"{said}; of the {there.order} epoch’s it is {shares[1 - k]}."


def _met_nothing(comparison: Comparison, epochs: tuple[EpochFacts, EpochFacts], setting: Setting) -> tuple[str, ...]:
    """Return how much of each surface lies where the other epoch's scans hold nothing in its direction, and where."""
    areas = comparison.statistics.get("met_nothing_area_m2", (NAN, NAN))
    told = []
    for k, word in enumerate(("gone", "new")):
        side, here, there = (comparison.on_reference, comparison.on_compared)[k], epochs[k], epochs[1 - k]
        if areas[k] > 0.0:
            where = locate_most(side, side.reasons == NotAssessed.MET_NOTHING, setting)
            what = f"{square(areas[k])} of the {here.order} epoch’s surface{f' ({where})' if where else ''}"
            told.append(
                f"In the direction of {what} the {there.order} epoch’s scans hold nothing: it is {word}, or it or "
                "something before it was too dark for them, or it was cut out of the files."
            )
    return tuple(told)


def _figures(
    comparison: Comparison, regions: tuple[RegionFacts, ...], before: EpochFacts, after: EpochFacts
) -> tuple[KeyFigure, ...]:
    """Return the four figures to remember."""
    unknown = [percent(s) for s in shares_not_assessed(comparison)]
    k = less_assessed(comparison)
    here = (before, after)[k]
    return (
        _how_many(comparison, regions),
        _smallest(comparison),
        _moved(comparison),
        KeyFigure(
            "Not assessable", unknown[k], f"of the {here.order} epoch’s surface; {unknown[1 - k]} of the other’s"
        ),
    )


def _moved(comparison: Comparison) -> KeyFigure:
    """Return how far the object as a whole moved and how sure that is, or by how much its coordinates differ."""
    motion, statistics = describe_motion(comparison.registration), comparison.statistics
    if not knows_motion(comparison):
        differ = f"coordinates differ by {motion.displacement.text}, turned by {motion.angle.text}"
        return KeyFigure("Motion of the whole", NOT_ASSESSABLE, differ)
    moved = "significant" if statistics.get("motion_is_significant") else "not significant"
    told = f"{moved} (confidence {print_significance(statistics['motion_significance'])})"
    return KeyFigure("Object as a whole", motion.displacement.text, f"turned by {motion.angle.text}; {told}")


def _smallest(comparison: Comparison) -> KeyFigure:
    """Return the smallest change that is told, and how wide it must be."""
    rows, coarse = told_by_width(comparison), say_coarse_beside(comparison)
    against = "; against the rest" if is_beside_layer(comparison) else ""
    if not rows:
        return KeyFigure("Level of detection", say_level(comparison), f"95\u00a0%, median, single places{coarse}")
    width, depth = (millimetres(v) for v in rows[0])
    return KeyFigure("Smallest change told", depth, f"{width} wide or wider, 19 of 20 such{against}{coarse}")


def _how_many(comparison: Comparison, regions: tuple[RegionFacts, ...]) -> KeyFigure:
    """Return the number of regions by kind; that none was found where nothing could be assessed is no number."""
    if not regions and _is_all_unknown(comparison):
        return KeyFigure("Regions of change", NOT_KNOWN, "nothing could be assessed")
    kinds = ", ".join(f"{n}\u00a0{kind}" for kind, n in Counter(r.kind for r in regions).items())
    none = "beside what all of the surface differs by" if differs_as_a_whole(comparison) else NONE_FOUND
    return KeyFigure("Regions of change", str(len(regions)), kinds or none)


def print_significance(significance: float) -> str:
    """Return the confidence 1 - p that the object did move, in per cent."""
    if not np.isfinite(significance):
        return NOT_KNOWN
    return "above 99.9\u00a0%" if significance > 0.999 else percent(significance)
