"""What teaches the noise: what lies away from all that is significant or suspect, where that is enough.

In: a side and a test of its patches. Out: masks of its vertices.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.apart import stand_apart
from monitor.comparison.detection.tested import Tested
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.noise.model import Masks
from projects.model import Bools, Ints

SUSPECT = 1e-3  # p value up to which a patch does not teach the noise, significant or not
BESIDE_WIDE = 0.25  # of what is assessed, at least: the majority less what patches at the border of the rest hold


def away_from_both(sides: tuple[Side, Side], test: Tested) -> Masks:
    """Return of both sides which vertices lie away from what is significant or suspect; see `away_from`."""
    return map_sides(lambda k: away_from(sides[k], test.units[k].number, is_hit(test, k)), larger_of(sides))


def away_from_suspect(sides: tuple[Side, Side], test: Tested, beside: Tested, alone: Masks) -> Masks:
    """Return of both sides which vertices lie away from the units of `test` that hold any of what is suspect `alone`,
    and from those that are significant or suspect `beside` it.

    The flank of a faint change beside it is not suspect by itself, and would teach the tails of the errors.
    """

    def away(k: int) -> Bools:
        number = test.units[k].number
        return away_from(sides[k], number, is_hit(beside, k) | hold_any(number, alone[k], len(beside.p_gained[k])))

    return map_sides(away, larger_of(sides))


def away_from(side: Side, number: Ints, hit: Bools) -> Bools:
    """Return which vertices (n,) lie neither in a unit that is `hit` (u,) nor in one that touches it; `number` (n,) is
    the unit of each, -1 for none."""
    return np.asarray(_lie_away(number, hit, side.neighbours))


def hold_any(number: Ints, marked: Bools, n_units: int) -> Bools:
    """Return which units (n_units,) hold any of the vertices `marked` (n,)."""
    held = number[marked]
    return np.asarray(np.bincount(held[held >= 0], minlength=n_units) > 0)


def suspect_alone(test: Tested, which: int, deep: Bools) -> Bools:
    """Return which vertices (n,) of a side lie in a unit that is suspect by itself, or are `deep` in a scrap of one."""
    number = test.units[which].number
    is_suspect = np.append(test.p_values[which][:, 0] <= SUSPECT, False)[number]
    return np.asarray(is_suspect | (deep & np.append(~test.is_whole[which], False)[number]))


def can_teach(rest: Masks, sides: tuple[Side, Side], test: Tested) -> bool:
    """Return whether what lies away from all that is significant or suspect may tell the noise: it is the majority, or,
    beside a wide change, what is significant by itself is the minority and enough lies away from all patches that are.
    """
    n_rest, n_assessed = (sum(int(m.sum()) for m in masks) for masks in (rest, [s.is_assessed for s in sides]))
    if not any(lie_apart(test, k).any() for k in range(2)):
        return n_rest > 0.5 * n_assessed
    alone = [u.areas[p[:, 0] <= max(test.limit, SUSPECT)].sum() for u, p in zip(test.units, test.p_values, strict=True)]
    return bool(sum(alone) < 0.5 * sum(u.areas.sum() for u in test.units) and n_rest > BESIDE_WIDE * n_assessed)


def is_hit(test: Tested, which: int) -> Bools:
    """Return which units (u,) of a side are significant, suspect, or part of a wide change."""
    p_values = np.minimum(test.p_gained[which], test.p_lost[which])
    return (p_values <= max(test.limit, SUSPECT)) | lie_apart(test, which)


def lie_apart(test: Tested, which: int) -> Bools:
    """Return which units (u,) belong to a wide change: few lie between those beyond 3 sigma and the rest.

    One by one they are suspect only beyond the tail that a first look allows for; they are a third of all, and as
    errors would make the level so high that none of them is ever found.
    """
    units = test.units[which]
    return stand_apart(units.means, units.areas, ~test.lies_beyond[which])


@jit(nopython=True, cache=True, nogil=True)
def _lie_away(number, hit, neighbours):  # type: ignore[no-untyped-def]
    """Return whether each vertex lies in a unit that is not hit and has no edge to one that is."""
    touched = hit.copy()
    for v in range(len(number)):
        if number[v] >= 0 and hit[number[v]]:
            for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
                if number[neighbours.vertices[k]] >= 0:
                    touched[number[neighbours.vertices[k]]] = True
    out = np.empty(len(number), dtype=np.bool_)
    for v in range(len(number)):
        out[v] = number[v] >= 0 and not touched[number[v]]
    return out
