"""What changed plainly, before any noise is known: far beyond what is stated, on both surfaces and in their points.

In: both sides, and the points of both epochs. Out: which vertices do not teach the noise. How large errors are is
learned from what did not change, of each class of place by itself. Where most of a class has changed, as all edges of
an object do whose one boss was moved, it would teach the change as its error, and nothing would ever be told there.
Surfaces alone differ by many times what they state along edges where nothing changed, too; their points do not.
"""

from __future__ import annotations

import numpy as np

from monitor.comparison.blocks import blocks
from monitor.comparison.borne_out import SURE, Points, are_borne_out
from monitor.comparison.chips import FEW
from monitor.comparison.connected import connect_like
from monitor.comparison.marking import HALF, grow
from monitor.comparison.side import Side, larger_of, map_sides
from projects.model import Bools, Ints

BESIDE, PLAIN = 1, 2  # how far off zero: half of `SURE` sigmas as stated, all of it


def changed_plainly(sides: tuple[Side, Side], points: Points, limits: tuple[float, float]) -> tuple[Bools, Bools]:
    """Return which vertices (n,) of both sides changed plainly: parts that both surfaces show, `SURE` sigmas as stated
    off zero, and that the points of both epochs bear out; and what hangs together with them, off by half of that. A
    motion of the whole that stays in the distances is taken off.

    Parameters
    ----------
    points : returns those (m, 3) m of both epochs, in the reference's coordinates; nothing is plain without.
    limits : m and rad, the search limit and the largest angle between normals.
    """
    n_vertices, left = larger_of(sides), (sides[0].expected, sides[1].expected)
    sides = sides[0].without_motion(), sides[1].without_motion()
    steps = map_sides(lambda k: steps_off(sides[k]), n_vertices)
    parts, n_parts = number_parts(sides, steps)
    is_plain = np.zeros(n_parts + 1, dtype=np.bool_)  # the first: no part
    if n_parts:
        both = points()
        if both[0] is not None and both[1] is not None:
            is_plain[1:] = are_borne_out(sides, parts, n_parts, both, limits, left)
    return map_sides(lambda k: grow(is_plain[parts[k]], np.abs(steps[k]) >= BESIDE, np.sign(steps[k]),
                                    sides[k].neighbours), n_vertices)  # fmt: skip


def steps_off(side: Side) -> Ints:
    """Return of each vertex (n,) int8 how far its change is beyond what is stated, `BESIDE` or `PLAIN`, with its sign;
    0 where it is not, or not assessed."""
    out = np.zeros(len(side.distances), dtype=np.int8)
    for block in blocks(len(out)):
        stated2 = side.sigma_surfaces[block] ** 2 + side.sigma_discord[block] ** 2 + side.sigma_common[block] ** 2
        change = np.where(side.is_assessed[block], side.distances[block], 0.0)
        off = np.abs(change) / np.sqrt(np.maximum(stated2, 1e-300))
        out[block] = np.sign(change) * np.where(off > SURE, PLAIN, off > HALF * SURE)
    return out


def number_parts(sides: tuple[Side, Side], steps: tuple[Ints, Ints]) -> tuple[tuple[Ints, Ints], int]:
    """Return the part (n,) of each vertex of both sides, from 1 on, 0 for none, and how many parts there are: what is
    plain by its `steps` (n,), of one sign, hangs together over both, and is more than few vertices on each."""
    n_first, links = len(steps[0]), []
    kinds = np.concatenate([np.where(np.abs(s) == PLAIN, np.sign(s) + np.int8(1), np.int8(-1)) for s in steps])
    for side, step, own, other in ((sides[0], steps[0], 0, n_first), (sides[1], steps[1], n_first, 0)):
        at = np.flatnonzero((np.abs(step) == PLAIN) & (side.foot_vertices >= 0))
        links.append(np.column_stack([at + own, side.foot_vertices[at] + other]).astype(np.int64))
    part = connect_like(kinds, [s.neighbours for s in sides], links)
    both, n_parts = (part[:n_first], part[n_first:]), int(part.max(initial=-1)) + 1
    areas = [np.bincount(p[p >= 0], s.areas[p >= 0], minlength=n_parts) for s, p in zip(sides, both, strict=True)]
    least = FEW * max(float(np.median(side.areas)) for side in sides)
    kept = np.flatnonzero(np.minimum(*areas) >= least)
    number = np.zeros(n_parts + 1, dtype=np.int32)
    number[kept] = np.arange(1, len(kept) + 1)
    return (number[both[0]], number[both[1]]), len(kept)  # part -1 is the last entry: 0
