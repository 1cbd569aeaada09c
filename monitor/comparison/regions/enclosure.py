"""The body between two surfaces where a region changed: its volume and how sure; open, overhanging, not 2.5-D.

In: the vertices of a region on both sides, with what lies beyond the perpendicular (`beyond`) and its margin. Both
patches and a closing surface enclose what is gone, or came (divergence theorem).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import jit

from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.side import EXTRAPOLATED, Side
from monitor.comparison.distances.spreading import spread_along
from monitor.comparison.noise.correlation import kept_variance
from monitor.comparison.noise.guesses import sigma_of_guess
from monitor.comparison.noise.model import Noise
from monitor.comparison.noise.scan_errors import stated_over
from monitor.comparison.regions.beyond import Beyond
from monitor.comparison.regions.closing import Closing, border_edges, close_gap, cone_volume
from monitor.registration.motion.sampling import motion_rows
from projects.model import Bools, Floats, Ints, Registration
from projects.triangles import area_vectors, face_areas, unit_normals

ONE_SIDED = 1.0  # of half the area of both patches: a gap as large, across one direction, is a side nobody saw
BULGE = 0.25  # of a gap's width: one sigma of how far the surface that was not seen may lie off the closing one
UNSURE_CUT = 3.0**-0.5  # spacings of the vertices: where samples end is known to one, uniform on either side


@dataclass(frozen=True)
class Patch:
    """The `faces` (m, 3) of a region on one side, which vertices (n,) of the side both epochs have, or lie beside two
    that they have, `is_matched`, and which lie where the fringe of the surface was cut off, `is_cut`."""

    faces: Ints
    is_matched: Bools
    is_cut: Bools


@dataclass(frozen=True)
class Body:
    """Volume [m3] between the surfaces, positive = gained, and its sigma; NaN where they do not enclose it."""

    volume: float
    sigma: float


def spread_over_assessed(side: Side, region: Ints, widths: Floats) -> Ints:
    """Return the regions with their margin along the surface, where it is assessed; `widths` [m] by their numbers."""
    inside = np.flatnonzero(region > 0)
    if not len(inside):
        return region.copy()
    source = spread_along(side, inside, side.is_assessed | (region > 0), widths[region[inside]])
    return np.where(source >= 0, region[np.maximum(source, 0)], 0).astype(region.dtype)


def over_each_other(sides: tuple[Side, Side], margins: tuple[Ints, Ints], number: int) -> tuple[Bools, Bools]:
    """Return which vertices (n,) of both sides are of a region, given with its margin, or stand over the other side's.

    Where one side's patch ends before the other's though both have surface there, a closing film from border to border
    would pass for a body. It ends so too where the margin of another region begins: what stands over both is of both.
    """
    out = []
    for k, side in enumerate(sides):
        mask = margins[k] == number
        at = np.flatnonzero(side.is_assessed & (side.foot_vertices >= 0) & ~mask)
        mask[at] = margins[1 - k][side.foot_vertices[at]] == number
        out.append(mask)
    return out[0], out[1]


def measure_body(number: int, sides: tuple[Side, Side], margins: tuple[Ints, Ints], found: Detected,
                 registration: Registration, beyond: Beyond) -> Body | None:  # fmt: skip
    """Return the body that the patches of a region (`margins`: with their margin) enclose; None where none can be.

    A patch ends where the fringe of its surface begins, if there is anything else of it.
    """
    masks = over_each_other(sides, margins, number)
    before, after = (cut_fringe(s, m) for s, m in zip(sides, masks, strict=True))
    patches = np.vstack([before.faces[:, ::-1], after.faces + len(sides[0].areas)])
    used, patches = np.unique(patches, return_inverse=True)
    patches = patches.reshape(-1, 3)
    if len(used) < 4:
        return None
    points = _pick([s.surface.vertices for s in sides], used)
    local = points - points.mean(axis=0)
    border = border_edges(patches)
    closing = close_gap(local, border)
    if closing is None:
        return None
    is_matched = _pick([before.is_matched, after.is_matched], used)
    if is_one_sided(closing, is_matched, local[patches]):
        return Body(float("nan"), float("nan"))
    volume = cone_volume(local[patches]) + cone_volume(closing.triangles, closing.weights)
    noise = sigma_of_patches(sides, masks, found, registration)
    is_free, is_cut = _pick(beyond.is_free, used), _pick([before.is_cut, after.is_cut], used)
    ends = max(s.spacing for s in sides) * np.where(is_free, EXTRAPOLATED, np.where(is_cut, UNSURE_CUT, 0.0))
    normals = _pick([s.normals for s in sides], used)
    return Body(volume, float(np.hypot(noise, sigma_of_gap(closing, is_matched, ends, border, normals))))


def cut_fringe(side: Side, patch: Bools) -> Patch:
    """Return a patch, given by its vertices (n,), without the faces of which two corners lie in the fringe of the
    surface: half of its width, in the mean, ends on either side. All of it where it is nothing but fringe."""
    faces = side.surface.faces[_lie_within(np.asarray(side.surface.faces), patch)]
    is_matched, is_cut = side.is_assessed.copy(), np.zeros(len(patch), dtype=np.bool_)
    n_fringe = side.is_fringe[faces].sum(axis=1)
    is_kept = n_fringe < 2
    if is_kept.all() or not is_kept.any():
        return Patch(faces, is_matched, is_cut)
    is_cut[faces[~is_kept]] = True
    beside = faces[n_fringe == 1]
    is_matched[beside[side.is_assessed[beside].sum(axis=1) == 2]] = True
    return Patch(faces[is_kept], is_matched, is_cut)


def is_one_sided(closing: Closing, is_matched: Bools, patches: Floats) -> bool:
    """Return whether what closes the patches (m, 3, 3) [m] stands for a side that nobody saw, as the ground below a
    chest: one patch with a film over its mouth encloses no body.

    Areas of a closed surface as vectors add up to nothing: those of the gaps are as large as what the patches lack on
    one side. The sides of a panel, a slit, both mouths of a hole lie across all directions, and add up to little.
    """
    crosses = ~is_matched[closing.corners].all(axis=1)
    lacking = closing.weights[crosses] @ (0.5 * area_vectors(closing.triangles[crosses]))
    seen = face_areas(patches).sum()
    return bool(np.linalg.norm(lacking) > ONE_SIDED * 0.5 * seen)


@jit(nopython=True, cache=True, nogil=True)
def _lie_within(faces, mask):  # type: ignore[no-untyped-def]
    """Return which faces (m, 3) have all corners in a mask (n,) of the vertices."""
    out = np.empty(len(faces), dtype=np.bool_)
    for f in range(len(faces)):
        out[f] = mask[faces[f, 0]] and mask[faces[f, 1]] and mask[faces[f, 2]]
    return out


def _pick(both: Sequence[Any], which: Ints) -> Any:
    """Return the values of the vertices `which`, rising, numbered over both sides, of the `both` sides' arrays."""
    n_first = len(both[0])
    split = int(np.searchsorted(which, n_first))
    return np.concatenate([both[0][which[:split]], both[1][which[split:] - n_first]])


def sigma_of_gap(closing: Closing, is_matched: Bools, ends: Floats, border: Ints, normals: Floats) -> float:
    """Return one sigma [m3] of what the closing surface may miss where it crosses a gap.

    A gap may bulge by a quarter of its width: so much does a surface with a right-angled edge in it, on average; and a
    surface ends somewhere within `ends` (n,) [m], one sigma: along it, so that only what of the closing surface stands
    upright on it, by its `normals` (n, 3), sweeps a volume. Where the border (e, 2) lies in surface that both epochs
    have (`is_matched` (n,)), the closing surface is a strip within it, and misses nothing but where a surface ends.
    Gaps are taken to err together.
    """
    crosses = ~is_matched[closing.corners].all(axis=1)
    bulge = np.where(crosses, BULGE * widths_of(closing, border), 0.0)
    lying2 = np.einsum("ij,ikj->ik", unit_normals(closing.triangles), normals[closing.corners]) ** 2
    upright = np.sqrt(np.maximum(1.0 - lying2.mean(axis=1), 0.0))
    return float(_areas(closing) @ np.hypot(bulge, upright * ends[closing.corners].max(axis=1, initial=0.0)))


def widths_of(closing: Closing, border: Ints) -> Floats:
    """Return how wide [m] a gap is at each closing triangle (k,): its height over the part of the border (e, 2) in it,
    or over its shortest side where there is none."""
    length = np.linalg.norm(np.roll(closing.triangles, -1, axis=1) - closing.triangles, axis=2)
    n = max(int(closing.corners.max(initial=0)), int(border.max(initial=0))) + 1
    sides = np.sort(np.stack([closing.corners, np.roll(closing.corners, -1, axis=1)], axis=2), axis=2)
    is_border = np.isin(sides[..., 0] * n + sides[..., 1], np.sort(border, axis=1) @ np.array([n, 1]))
    base = np.where(is_border.any(axis=1), (length * is_border).sum(axis=1), length.min(axis=1))
    return np.asarray(2.0 * _areas(closing) / np.maximum(base, 1e-300))


def _areas(closing: Closing) -> Floats:
    """Return the area (k,) [m2] of each closing triangle, as often as it counts."""
    return np.asarray(face_areas(closing.triangles) * closing.weights)


def sigma_of_patches(sides: tuple[Side, Side], masks: Sequence[Bools], found: Detected, registration: Registration,
                     ) -> float:  # fmt: skip
    """Return one sigma [m3] of the volume from the noise of both patches, what their scans share, and the motion.

    Where a vertex is assessed its variance is of the change, so both patches bear the same error, and half of it each
    is taken; elsewhere a patch bears its own, half of the median change's.
    """
    scale = max(e.width for e in found.test.errors)
    both, guess, alone, shared = 0.0, 0.0, 0.0, 0.0
    for side, mask in zip(sides, masks, strict=True):
        matched, own = np.flatnonzero(mask & side.is_assessed), np.flatnonzero(mask & ~side.is_assessed)
        typical = _typical_variance(side, found.noise) * scale**2 if len(own) else 0.0
        noise2, guess2 = found.noise.parts_of(side, matched)
        both += 0.5 * _sum_sigma(side.areas[matched], noise2 * scale**2, found)
        guess += 0.5 * sigma_of_guess(side.surface.vertices[matched], side.areas[matched], guess2, found.test.size)
        alone += _sum_sigma(side.areas[own], np.full(len(own), 0.5 * typical), found) ** 2
        stated = np.array(stated_over(side, np.flatnonzero(mask)))
        limb = float(side.areas[mask] @ side.limb_of(np.flatnonzero(mask)))
        shared += 0.5 * float(np.hypot(side.areas[mask].sum() * found.test.scans.sigma_of(stated), limb))
    mask, side = masks[1], sides[1]
    row = side.areas[mask] @ motion_rows(side.surface.vertices[mask], side.normals[mask], registration.centre)
    motion2 = max(float(row @ registration.covariance @ row), 0.0)
    return float(np.sqrt(both**2 + guess**2 + alone + shared**2 + motion2))


def _typical_variance(side: Side, noise: Noise) -> float:
    """Return the median variance [m2] of the assessed vertices, 0 where there are none."""
    assessed = np.flatnonzero(side.is_assessed)
    return median(np.add(*noise.parts_of(side, assessed))) if len(assessed) else 0.0


def _sum_sigma(areas: Floats, variance: Floats, found: Detected) -> float:
    """Return one sigma [m3] of the sum of area times error over some vertices of one patch."""
    if not len(areas):
        return 0.0
    total = float(areas.sum())
    scale2 = max(e.width for e in found.test.errors) ** 2
    stretch2 = found.noise.stretch.square_over(areas, variance / scale2)
    kept = kept_variance(np.array([total]), np.array([len(areas)]), found.noise.correlation, stretch2)
    return total * float(np.sqrt(np.average(variance, weights=areas) * kept[0]))
