"""Points past the limb of a bent or steep surface, where part of the spot misses it (Nothegger and Dorninger, 2.1).

In: points with normals and where the scanner stood; out: a mask of those whose spot may reach over a limb onto nothing.
Only the part of the spot that is met answers, from about one range: the scan goes on past the limb, by as much as the
spot is wide, as a curtain along the beams that hangs millimetres outside of the surface.
"""

from __future__ import annotations

import math

import numpy as np

from monitor.across import frames_across
from monitor.blocks import blocks
from monitor.filtering.nearest import build_index, find_nearest_sorted
from monitor.filtering.silhouettes import (
    BLOCK,
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
N_WITHIN, FEWEST_WITHIN = 24, 12  # points within the border, rows two to five, that tell where the surface lies there
N_ALONG = 65  # border points judged as one: one in three is of a curtain or none, as its place in the grid has it
STANDS_OUT = 0.8  # standard errors of a point; without a spot the median of a border was 0.1 to 0.9, with one 0.7 to 8


def find_fringes(
    points: Floats, origin: Floats, normals: Floats, noise: Floats, known: Bools, max_incidence: float
) -> Bools:
    """Return the points (n,) at and past limbs that may hang outside of their surface.

    A curtain of one row shows in the mean alone: on a steep surface a border point goes where those around it stand
    outside of what the points within tell of the surface (`_stands_outside`). Towards its limb a surface turns away
    ever more: on the way into the scan the range falls fast at first and then less. Across a curtain it falls little at
    first and then fast: a place that shows this goes, and as long as the new border shows it, that goes too. Only
    points with neighbours of the same surface that stay are named, as for rims.

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
        ring[which[_is_curtain(field, which, gone)]] = True
        if k == 0:
            ring[which[_stands_outside(field, which)]] = True
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


def _stands_outside(field: Field, border: Ints) -> Bools:
    """Return which of the directions at the border (m,) lie where the border stands outside of its surface.

    As many border points as `N_ALONG`, those next to one another, are judged by their median. It is no test at 95 %:
    a row too many costs a row, a row too few leaves errors of three to six sigmas.
    """
    outside, at_border = np.full(len(border), np.nan), np.zeros(len(field.order), dtype=bool)
    at_border[border] = True
    first = 0
    for which, near in field.blocks(border, N_WITHIN + N_ALONG):
        outside[first : first + len(which)] = _outside(field, which, near, at_border)
        first += len(which)
    known = np.flatnonzero(np.isfinite(outside))
    shown = np.zeros(len(border), dtype=bool)
    if len(known):
        index = build_index(field.index.points[border[known]])
        for block in blocks(len(known), BLOCK):
            some = np.arange(len(known))[block]
            along = find_nearest_sorted(index, some, min(N_ALONG, len(known)))
            shown[known[block]] = np.median(outside[known][along], axis=1) > STANDS_OUT
    return shown


def _outside(field: Field, which: Ints, near: Ints, at_border: Bools) -> Floats:
    """Return how far outside of its surface each border direction (n,) stands, in standard errors; NaN of too few.

    Beside a limb the range has no second order, but the way inward as a function of the range has: it is fitted to the
    points within, and asked for at the range of the border point. What is missed there, texture too, is in the error.
    """
    offsets, rise, rank = _own_surface(field, which, near, at_border)
    weights = (rank <= N_WITHIN).astype(float)
    n = np.maximum(weights.sum(axis=1), 1.0)
    axes = frames_across(field.index.points[which].astype(float))
    u, v = (field.ranges[which][:, None] * np.einsum("nki,ni->nk", offsets, axis) for axis in axes)
    inward, aside = _turned(u, v, weights)
    mean = (weights * rise).sum(axis=1) / n
    depth = rise - mean[:, None]
    wide, deep = (np.maximum(np.sqrt((weights * x * x).sum(axis=1) / n), 1e-12) for x in (aside, depth))
    x, y = depth / deep[:, None], aside / wide[:, None]
    terms = np.stack([np.ones_like(x), x, x * x, y, y * y], axis=2)
    at = -mean / deep
    there = np.stack([np.ones_like(at), at, at * at, 0.0 * at, 0.0 * at], axis=1)
    inverse = np.linalg.pinv(np.einsum("nk,nki,nkj->nij", weights, terms, terms), hermitian=True)
    found = np.einsum("nij,nkj,nk,nk->ni", inverse, terms, weights, inward)
    missed = weights * (inward - np.einsum("nkj,nj->nk", terms, found)) ** 2
    slope = (found[:, 1] + 2.0 * found[:, 2] * at) / deep
    noise = field.noise[field.order[which]].astype(float)
    error2 = missed.sum(axis=1) / np.maximum(n - terms.shape[2], 1.0) + (noise * slope) ** 2
    error2 *= 1.0 + np.maximum(np.einsum("ni,nij,nj->n", there, inverse, there), 0.0)
    outside = (there * found).sum(axis=1) / np.sqrt(np.maximum(error2, 1e-300))
    return np.where(n >= FEWEST_WITHIN, outside, np.nan)


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
