"""What changed plainly, before any noise is known: far beyond what is stated, on both surfaces and in their points.

In: both sides, and the points of both epochs. Out: which vertices do not teach the noise. How large errors are is
learned from what did not change, of each class of place by itself. Where most of a class has changed, as all edges of
an object do whose one boss was moved, it would teach the change as its error, and nothing would ever be told there.
Fits to edges differ by many times what they state where nothing changed, too; the points that they were made of do not.
What scans err by is in these as well: it is held to be twice what is stated, and where most of an object errs by more
than is stated, the rest must stand out of that; what stands out all over is no plain change. One wide piece that does,
as where a crust was taken off, teaches; what is small beside it is judged without it.
"""

from __future__ import annotations

import numpy as np

from monitor.blocks import blocks
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.side import N_DRAWN, Side, larger_of, map_sides
from monitor.comparison.regions.borne_out import Points, are_borne_out
from monitor.comparison.regions.chips import HANDFUL
from monitor.comparison.regions.parts import foot_links
from projects.model import Bools, Floats, Ints, NotAssessed

SIGMAS, AROUND = 3.0, 1.5  # as stated, or as most places err: plain is what lies so far off zero, with what around it
MOST_PLAIN = 0.1  # of the assessed area: what stands out of the rest on more of it may be what scans err by there
SCANS = 2.0  # times what scans are stated to disagree by: it may be off by a factor of two, and no point tells
CORE = 0.6745  # sigmas within which half of normal errors lie


def changed_plainly(sides: tuple[Side, Side], points: Points, limits: tuple[float, float]) -> tuple[Bools, Bools]:
    """Return which vertices (n,) of both sides changed plainly: parts that both surfaces show, `SIGMAS` off zero, and
    that the points of both epochs bear out; and what hangs together with them, off by `AROUND`.

    Sigmas are as stated, of the scans `SCANS` times that, or larger by as much as the middle of all distances is; a
    motion of the whole that stays in the distances is taken off. Nothing is plain where an epoch has no points or does
    not state its noise; no piece that alone is more than `MOST_PLAIN` of what is assessed; and nothing where all other
    pieces together are.

    Parameters
    ----------
    points : returns those (m, 3) m of both epochs, in the reference's coordinates.
    limits : m and rad, the search limit and the largest angle between normals.
    """
    nothing = np.zeros(len(sides[0].areas), dtype=np.bool_), np.zeros(len(sides[1].areas), dtype=np.bool_)
    if not sides[0].states_noise:
        return nothing
    left = (sides[0].expected, sides[1].expected) if any(side.expected.any() for side in sides) else None
    told = sides if left is None else (sides[0].without_motion(), sides[1].without_motion())
    n_vertices = larger_of(told)
    off = map_sides(lambda k: sigmas_off(told[k]), n_vertices)
    usual = max(usual_sigmas(told, off), 1.0)
    parts, n_parts = number_parts(told, off, SIGMAS * usual)
    both = points() if n_parts else (None, None)
    if both[0] is None or both[1] is None:
        return nothing
    is_plain = np.append(False, are_borne_out(told, parts, n_parts, both, limits, left, each_must=True))
    pieces, n_pieces = number_parts(told, off, AROUND * usual)
    shares = share_of(told, pieces, n_pieces)
    holds = np.zeros(n_pieces + 1, dtype=np.bool_)
    for piece, part in zip(pieces, parts, strict=True):
        holds[piece[is_plain[part]]] = True
    holds &= np.append(False, shares <= MOST_PLAIN)
    return (holds[pieces[0]], holds[pieces[1]]) if float(shares[holds[1:]].sum()) <= MOST_PLAIN else nothing


def sigmas_off(side: Side) -> Floats:
    """Return how many sigmas, of the scans `SCANS` times as stated, each vertex (n,) float32 lies off zero, signed; 0
    where it is not assessed."""
    out = np.zeros(len(side.distances), dtype=np.float32)
    for block in blocks(len(out)):
        surfaces2 = side.sigma_surfaces[block] ** 2 + side.sigma_discord[block] ** 2
        common2 = SCANS**2 * (side.sigma_shared[block] ** 2 + side.limb_of(block) ** 2) + side.sigma_motion[block] ** 2
        off = side.distances[block] / np.sqrt(np.maximum(surfaces2 + common2, 1e-300))
        out[block] = np.where(side.reasons[block] == NotAssessed.ASSESSED, off, 0.0)
    return out


def usual_sigmas(sides: tuple[Side, Side], off: tuple[Floats, Floats]) -> float:
    """Return how many times larger than stated the errors of most assessed places are, by the middle of them."""
    drawn = []
    for side, own in zip(sides, off, strict=True):
        step = max(len(own) // N_DRAWN, 1)
        drawn.append(np.abs(own[::step][side.reasons[::step] == NotAssessed.ASSESSED]))
    every = np.concatenate(drawn).astype(np.float64)
    return float(median(every)) / CORE if len(every) else 1.0


def number_parts(sides: tuple[Side, Side], off: tuple[Floats, Floats], least: float) -> tuple[tuple[Ints, Ints], int]:
    """Return the part (n,) of each vertex of both sides, from 1 on, 0 for none, and how many parts there are: what is
    `off` (n,) by more than so many sigmas, of one sign, hangs together over both, and is a handful on each."""
    n_first = len(off[0])
    kinds = np.concatenate([np.where(np.abs(o) > least, np.sign(o).astype(np.int8) + np.int8(1), np.int8(-1))
                            for o in off])  # fmt: skip
    links = [foot_links(sides[0], kinds[:n_first] >= 0) + np.array([0, n_first]),
             foot_links(sides[1], kinds[n_first:] >= 0) + np.array([n_first, 0])]  # fmt: skip
    part = connect_like(kinds, [s.neighbours for s in sides], links)
    both, n_parts = (part[:n_first], part[n_first:]), int(part.max(initial=-1)) + 1
    areas = [np.bincount(p[p >= 0], s.areas[p >= 0], minlength=n_parts) for s, p in zip(sides, both, strict=True)]
    kept = np.flatnonzero(np.minimum(*areas) >= HANDFUL * max(float(median(s.areas)) for s in sides))
    number = np.zeros(n_parts + 1, dtype=np.int32)
    number[kept] = np.arange(1, len(kept) + 1)
    return (number[both[0]], number[both[1]]), len(kept)  # part -1 is the last entry: 0


def share_of(sides: tuple[Side, Side], pieces: tuple[Ints, Ints], n_pieces: int) -> Floats:
    """Return the share (n_pieces,) of what is assessed of a side that each piece, from 1 on, covers; the larger one."""
    shares = []
    for side, own in zip(sides, pieces, strict=True):
        assessed = max(float(side.areas[side.is_assessed].sum()), 1e-300)
        shares.append(np.bincount(own, side.areas, minlength=n_pieces + 1)[1:] / assessed)
    return np.maximum(*shares)
