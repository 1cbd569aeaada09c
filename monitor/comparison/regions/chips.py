"""Small and deep: changes smaller than the area over which errors agree, and far beyond what errors explain.

In: both sides, what was found on them, and the parts that are to be regions. Out: which parts are so deep that one
witness is enough, and the sides without what is far off zero and in no region. Averages over patches say nothing of a
chip as small as one of them; its depth does, where both surfaces show it and not one of them alone, as at an edge that
one epoch rounds: there the vertices of the other have their feet where it stands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from monitor.comparison.detection.marking import grow
from monitor.comparison.detection.tested import Detected, Detection
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.side import Side
from projects.model import Bools, Floats, Ints, NotAssessed

HANDFUL = 7.0  # squares of the spacing: the area of a vertex and those around it
FEW = 3.0  # squares of the spacing of the vertices: one of them may be a bad fit, and the points decide in the end
STATED = 3.0  # sigmas as stated, whatever the stable areas make of these
STREWN = 1.0 / 3.0  # of what was measured around a vertex; along sharp edges the shares of two epochs differ by less
SHARP = np.cos(np.radians(30.0))  # from a vertex to the next: the cells of the surface do not follow such a shape


def stand_alone(sides: Sequence[Side], found: Detected, parts: tuple[Ints, Ints], n_parts: int) -> Bools:
    """Return which parts (n_parts,) are as deep as no error is, taken for one witness each.

    Both sides must show it: on their mean a few vertices, on the one that shows less of it half as many, are farther
    off zero than the farthest of all vertices is by chance, and than what is stated of them explains: a level is of all
    places of a class, by how much most of these err, and a single place may well err by as much as it says. One epoch's
    surface turns a broken edge by more vertices than the other; beside free edges errors have tails that no level
    describes, but on one side alone.
    """
    areas, counts = np.zeros((2, n_parts)), np.zeros((2, n_parts))
    for k, (side, part) in enumerate(zip(sides, parts, strict=True)):
        is_deep = (levels_off(side, found.sides[k]) > found.test.far) & (stated_off(side) > STATED)
        at = np.flatnonzero((part >= 0) & is_deep)
        areas[k] = np.bincount(part[at], side.areas[at], minlength=n_parts)
        counts[k] = np.bincount(part[at], minlength=n_parts)
    least = FEW * max(float(np.median(side.areas)) for side in sides)
    is_on_both = (areas.min(axis=0) >= 0.5 * least) & (counts.min(axis=0) >= 2.0)  # one vertex may be a bad fit
    return np.asarray(is_on_both & (areas.mean(axis=0) >= least))


def turn_sharply(sides: Sequence[Side], regions: tuple[Ints, Ints], n_regions: int) -> Bools:
    """Return which regions 1 to n (n,) hold neighbouring vertices whose normals differ by more than `SHARP`.

    The surface of an edge, or of a pit few cells wide, is rounder and shallower than what was measured, by more than
    its vertices know: how deep a chip is there has no margin.
    """
    least = np.ones(n_regions + 1)
    for side, region in zip(sides, regions, strict=True):
        own = np.repeat(np.arange(len(region)), np.diff(side.neighbours.starts))
        other = side.neighbours.vertices
        inside = (region[own] > 0) & (region[own] == region[other])
        own, other = own[inside], other[inside]
        np.minimum.at(least, region[own], np.einsum("ij,ij->i", side.normals[own], side.normals[other]))
    return least[1:] < SHARP


def levels_off(side: Side, found: Detection) -> Floats:
    """Return how many levels of detection each vertex (n,) lies off zero; 0 where it is not assessed."""
    return np.asarray(np.where(side.is_assessed, np.abs(np.nan_to_num(side.distances)) / found.lod95, 0.0))


def stated_off(side: Side) -> Floats:
    """Return how many sigmas, as both surfaces and their scans state them, each vertex (n,) lies off zero; 0 where it
    is not assessed, infinity where nothing is stated."""
    stated = np.hypot(side.sigma_surfaces, side.sigma_scans)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(side.is_assessed, np.abs(np.nan_to_num(side.distances)) / stated, 0.0)


def drop_unexplained(sides: tuple[Side, Side], found: Detected, regions: tuple[Ints, Ints],
                     smallest: tuple[Floats, Floats]) -> tuple[Side, Side]:  # fmt: skip
    """Return the sides without the vertices in none of the `regions` of which nobody knows what they show, and where
    "unchanged" would be wrong.

    That is what is farther off zero than any error (a chip as small as the spacing, an edge that fits round, a stray
    sheet); what differs, with its neighbours, by more than is told there (`smallest` (n,) [m]: a crack that was filled,
    narrower than any patch); and where the points of one epoch lie off its surface and those of the other do not (a pit
    that the surface passes over). What was cut off a region as the skirt of a step is explained by it, but where it
    differs by more than is told there, nobody knows whether it is one, or the flank of what fades out.
    """
    first, second = (
        s.without(s.is_assessed & (r == 0) & is_open(s, f, hang_on(s, f, r), found.test.far, told),
                  NotAssessed.UNEXPLAINED)
        for s, f, r, told in zip(sides, found.sides, regions, smallest, strict=True)
    )  # fmt: skip
    return first, second


def is_open(side: Side, found: Detection, hangs_on: Bools, far: float, told: Floats) -> Bools:
    """Return of which vertices (n,) outside of regions nobody knows what they show; `hangs_on` are those that were cut
    off a region."""
    alone = is_unlike(side, found, far, told) | is_strewn_once(side)
    return np.asarray(np.where(hangs_on, exceeds_told(side, found, told) & (levels_off(side, found) > 1.0), alone))


def is_unlike(side: Side, found: Detection, far: float, told: Floats) -> Bools:
    """Return which vertices (n,) differ by more than `far` levels of detection, or, a handful that hang together, by
    more than is `told` (n,) [m] where they are; that may not be known (NaN)."""
    differs = exceeds_told(side, found, told)
    part = connect_like(np.where(differs, (found.smooth > 0.0).astype(np.int64), -1), [side.neighbours])
    areas = np.bincount(part[differs], side.areas[differs], minlength=1)
    is_handful = differs & (areas[np.maximum(part, 0)] >= HANDFUL * float(np.median(side.areas)))
    return np.asarray((levels_off(side, found) > far) | is_handful)


def exceeds_told(side: Side, found: Detection, told: Floats) -> Bools:
    """Return which vertices (n,) differ, with their neighbours and by themselves, by more than is `told` there."""
    off = np.abs(np.nan_to_num(side.distances))
    return np.asarray(side.is_assessed & (np.abs(found.smooth) > told) & (off > told))


def hang_on(side: Side, found: Detection, region: Ints) -> Bools:
    """Return which vertices (n,) are in a region, or were cut off one as the skirt of a step (`skirts`)."""
    sign = np.sign(np.where(side.is_assessed, found.smooth, 0.0)).astype(np.int8)
    return np.asarray((region > 0) | grow(region > 0, found.is_changed, sign, side.neighbours))


def is_strewn_once(side: Side) -> Bools:
    """Return where (n,) more of what was measured around lies off the surface in one epoch than in the other, by
    `STREWN` of it; nowhere where an epoch does not know."""
    own, other = side.surface.stray_share, side.other.stray_share
    if own is None or other is None:
        return np.zeros(len(side.areas), dtype=np.bool_)
    return np.asarray((side.foot_vertices >= 0) & (np.abs(own - other[side.foot_vertices]) > STREWN))
