"""Points past the limb of a bent or steep surface, where part of the spot misses it (Nothegger and Dorninger, 2.1).

In: points with normals and where the scanner stood; out: a mask of those whose spot may reach over a limb onto nothing.
Only the part of the spot that is met answers, from about one range: the scan goes on past the limb, by as much as the
spot is wide, as a curtain along the beams that hangs millimetres outside of the surface. The step is off by default:
what is left of curtains here and there passes for change where all else became surer (BENCHMARKS.md).
"""

from __future__ import annotations

import math

import numpy as np

from monitor.across import frames_across
from monitor.filtering.silhouettes import (
    JUMP_SIGMAS,
    N_ASIDE,
    Field,
    has_inner,
    look_out,
    widest_gap,
)
from projects.model import Bools, Floats, Ints

STEEP = math.cos(math.radians(45.0))  # flatter, what hangs over a rim lies in the plane of its surface
STEEP_GAP = math.radians(145.0)  # in the surroundings of a border point; at the corners of a grid's it is no wider
WINDOWS = (12, 24, 48)  # neighbours: two, three and five rows of a scan within its border
# Standard errors by which the range must bend, of the noise across the surface: at 75 degrees four are one of a range.
# With that of a range, and 2 to 4 of it, a steep plate keeps its border without a spot, but of dense balls with one
# too much stays outside: 1.7 to 2.1 sigmas where 1.5 are left (phase-2020, R 0.1 m, 1.5 mm).
SURE = 4.0
N_ROUNDS = 12  # rows at most, those of a spot of ten spacings


def find_fringes(
    points: Floats, origin: Floats, normals: Floats, noise: Floats, known: Bools, max_incidence: float
) -> Bools:
    """Return the points (n,) at and past limbs that may hang outside of their surface.

    On a steep surface all points of the border go, for a curtain of one row cannot be told from the surface: asked by
    what the rows within say of it, too much stayed, and passed for change. Towards its limb a surface turns away ever
    more: on the way into the scan the range falls fast at first and then less. Across a curtain it falls little at
    first and then fast: as long as the new border shows that, it goes too. Only points with neighbours of the same
    surface that stay are named, as for rims.

    Parameters
    ----------
    points, origin, normals : (n, 3) and (3,) m and (n, 3), of the scan and its scanner.
    noise : (n,) m, one sigma across the surface.
    known : (n,) points of surfaces; the others are passed over.
    max_incidence : rad, of the steepest surface along which ranges do not jump.
    """
    field = look_out(points, origin, noise, known, math.tan(max_incidence))
    beams = points[field.order] - origin
    is_steep = np.abs((beams * normals[field.order]).sum(axis=1)) < STEEP * np.linalg.norm(beams, axis=1)
    gone, asked = np.zeros(len(field.order), dtype=bool), np.flatnonzero(is_steep)
    for k in range(N_ROUNDS):
        ring, (which, beside) = gone.copy(), _border(field, asked, gone)
        ring[which if k == 0 else which[_is_curtain(field, which, gone)]] = True
        fresh = has_inner(field, ring) & ~gone
        if not fresh.any():
            break
        gone |= fresh
        around = np.unique(beside[fresh[which]])
        asked = around[is_steep[around] & ~gone[around]]
    named = np.zeros(len(points), dtype=bool)
    named[field.order[gone]] = True
    return named


def _border(field: Field, asked: Ints, gone: Bools) -> tuple[Ints, Ints]:
    """Return those of the directions `asked` at the border (m,) of what is not gone, and what lies beside (m, k)."""
    found, beside = [np.zeros(0, dtype=np.int64)], [np.zeros((0, min(2 * N_ASIDE + 1, len(gone))), dtype=np.int64)]
    for which, near in field.blocks(asked, 2 * N_ASIDE + 1):
        offsets, _, rank = _own_surface(field, which, near, gone)
        own = np.where((rank <= N_ASIDE + 1)[:, :, None], offsets, 0.0)
        out = (widest_gap(field.index.points[which], own) > STEEP_GAP) & ((rank <= N_ASIDE).sum(axis=1) == N_ASIDE)
        found.append(which[out])
        beside.append(near[out])
    return np.concatenate(found), np.concatenate(beside)


def _is_curtain(field: Field, asked: Ints, gone: Bools) -> Bools:
    """Return which of some border directions show a curtain."""
    shown = [np.zeros(0, dtype=bool)]
    for which, near in field.blocks(asked, 2 * WINDOWS[-1] + 1):
        offsets, rise, rank = _own_surface(field, which, near, gone)
        noise = field.noise[field.order[which]].astype(float)
        bent = [_bends_back(field.index.points[which], offsets, rise, rank <= n + 1, noise) for n in WINDOWS]
        shown.append(np.any(bent, axis=0))
    return np.concatenate(shown)


def _turned(u: Floats, v: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return places (n, k) by how far they lie inward, towards the mean of those that count, and aside of that way."""
    along, across = (weights * u).sum(axis=1)[:, None], (weights * v).sum(axis=1)[:, None]
    length = np.maximum(np.hypot(along, across), 1e-300)
    return (along * u + across * v) / length, (along * v - across * u) / length


def _own_surface(field: Field, which: Ints, near: Ints, gone: Bools) -> tuple[Floats, Floats, Ints]:
    """Return of what lies near some directions (n, k) the offset (n, k, 3), the rise of range [m], and its rank among
    what is of the same surface and not gone; the largest there is where it is not."""
    offsets = field.index.points[near].astype(float) - field.index.points[which][:, None]
    rise = field.ranges[near].astype(float) - field.ranges[which][:, None]
    least = np.minimum(field.ranges[near], field.ranges[which][:, None])
    limit = least * np.linalg.norm(offsets, axis=2) * field.slope
    own = (np.abs(rise) <= limit + JUMP_SIGMAS * field.noise[field.order[which]][:, None]) & ~gone[near]
    return offsets, rise, np.where(own, np.cumsum(own, axis=1), np.iinfo(np.int64).max)


def _bends_back(directions: Floats, offsets: Floats, rise: Floats, chosen: Bools, noise: Floats) -> Bools:
    """Return where the range of the chosen neighbours (n, k), on the way inward, falls ever faster (n,).

    It is of second order along that way and across; its bend along it is asked.
    """
    weights = chosen.astype(float)
    u, v = (np.einsum("nki,ni->nk", offsets, axis) for axis in frames_across(directions.astype(float)))
    x, y = _turned(u, v, weights)
    size = np.sqrt((weights * (x * x + y * y)).sum(axis=1) / np.maximum(weights.sum(axis=1), 1.0))[:, None]
    size = np.maximum(size, 1e-12)  # all in one direction
    x, y = x / size, y / size
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y], axis=2)
    inverse = np.linalg.pinv(np.einsum("nk,nki,nkj->nij", weights, terms, terms), hermitian=True)
    bend = np.einsum("nj,nkj,nk,nk->n", inverse[:, 3], terms, weights, rise)
    return np.asarray(bend < -SURE * noise * np.sqrt(np.maximum(inverse[:, 3, 3], 0.0)))
