"""What changed and hangs together over both sides: the parts that regions are made of.

In: both sides, what changed on them, and what of it is told apart. Out: the part of each vertex, numbers common to
both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from monitor.comparison.detection.tested import Detection
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.side import Side
from monitor.comparison.regions.beyond import SIGNS, Beyond
from projects.model import Bools, Floats, Ints

N_SIGNS = 3  # of a change: loss, none, gain


def connect_sides(sides: tuple[Side, Side], found: tuple[Detection, Detection], beyond: Beyond,
                  apart: tuple[Bools, Bools] | None = None) -> tuple[Ints, Ints]:  # fmt: skip
    """Return the connected part of each vertex of both sides, -1 where not changed; numbers are common to both.

    Changed is also what was looked through: lost on the reference, gained on the compared surface. What is set `apart`
    hangs together with nothing else.
    """
    n_first = len(sides[0].areas)
    changed = np.concatenate([f.is_changed | t for f, t in zip(found, beyond.is_through, strict=True)])
    sign = np.concatenate([np.where(t, s, np.sign(np.nan_to_num(f.smooth))).astype(np.int8)
                           for f, t, s in zip(found, beyond.is_through, SIGNS, strict=True)])  # fmt: skip
    links = [foot_links(sides[0], changed[:n_first]) + np.array([0, n_first]),
             foot_links(sides[1], changed[n_first:]) + np.array([n_first, 0])]  # fmt: skip
    for k, (own, other) in enumerate(((0, n_first), (n_first, 0))):
        at = np.flatnonzero(beyond.is_through[k] & (beyond.nearest[k] >= 0))
        links.append(np.column_stack([at + own, beyond.nearest[k][at] + other]))
    kinds = np.where(changed, sign + np.int8(1), np.int8(-1))
    if apart is not None:
        kinds[changed & np.concatenate(apart)] += N_SIGNS
    part = connect_like(kinds, [s.neighbours for s in sides], links)
    return part[:n_first], part[n_first:]


def connect_apart(sides: tuple[Side, Side], whole: tuple[Ints, Ints], pieces: tuple[Ints, Ints],
                  apart: tuple[Bools, Bools], least: float) -> tuple[Ints, Ints]:  # fmt: skip
    """Return the parts of both sides (n,), where pieces of less than the `least` area [m2] are given back.

    `whole` (n,) are the parts that hang together, `pieces` (n,) what is left of them where some is `apart`, -1 where
    nothing changed. Of a part, small pieces that are apart go with the largest that is not, small ones that are not
    with the largest that is: they hung together through it.
    """
    area, of_whole = area_of_parts(sides, pieces), np.zeros(max(int(p.max(initial=-1)) for p in pieces) + 1, dtype=int)
    for part, piece in zip(whole, pieces, strict=True):
        of_whole[piece[piece >= 0]] = part[piece >= 0]
    is_set_apart, number = are_set_apart(pieces, apart, len(area)), np.append(np.arange(len(area)), -1)
    for part in np.unique(of_whole[is_set_apart]):
        own = np.flatnonzero(of_whole == part)
        largest = [max(own[is_set_apart[own] == which], key=lambda k: area[k], default=-1) for which in (False, True)]
        for piece in own[area[own] < least]:
            other = largest[0] if is_set_apart[piece] or largest[1] < 0 or area[largest[1]] < least else largest[1]
            number[piece] = other if other >= 0 else piece
    return number[pieces[0]].astype(np.int32), number[pieces[1]].astype(np.int32)


def area_of_parts(sides: Sequence[Side], parts: Sequence[Ints]) -> Floats:
    """Return the area [m2] of each part on the side that has more of it; -1 in `parts` is none."""
    area = np.zeros(max(int(p.max(initial=-1)) for p in parts) + 1)
    for side, part in zip(sides, parts, strict=True):
        area = np.maximum(area, np.bincount(part[part >= 0], side.areas[part >= 0], minlength=len(area)))
    return area


def are_set_apart(parts: tuple[Ints, Ints], apart: tuple[Bools, Bools] | None, n_parts: int) -> Bools:
    """Return which parts (n_parts,) of both sides are mostly set `apart`."""
    of_parts = np.zeros((2, n_parts))
    for part, which in zip(parts, apart or (), strict=False):
        for k, own in enumerate((part[~which & (part >= 0)], part[which & (part >= 0)])):
            of_parts[k] += np.bincount(own, minlength=n_parts)
    return np.asarray(of_parts[1] > of_parts[0])


def foot_links(side: Side, changed: Bools) -> Ints:
    """Return (vertex, nearest vertex of its foot's face on the other surface) for each assessed vertex in `changed`."""
    at = np.flatnonzero(side.is_assessed & changed)
    return np.column_stack([at, side.foot_vertices[at]]).astype(np.int64)
