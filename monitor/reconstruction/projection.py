"""Vertices brought onto a robust local fit of the raw points, each with its own standard error.

In: vertices and normals of a raw surface, the cloud's points and normals, and how far each fit may reach. Out:
`Projection`: moved vertices, fitted normals, sigma, support. A Poisson surface smooths and is biased where it smooths
(Nothegger, `001`, table 1); the fit is neither, and what remains uncertain is stated per vertex.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import (
    OVER_THE_RIM,
    ROOM,
    Sites,
    block_edge,
    block_sites,
    edge_of_groups,
    find_near,
    gate_height,
    gather_patch,
    keep_own_side,
    mean_normal,
    near_room,
    patch_room,
    rows_room,
    tilt,
)
from monitor.reconstruction.moments import Level, build_levels
from monitor.reconstruction.quadric import (
    COUNT,
    CURVED,
    EFFECTIVE,
    HEIGHT,
    PLANE,
    SIGMA,
    SLOPE_U,
    SLOPE_V,
    UNIT_ERROR,
    fit_patch,
    slope_chi2,
)
from monitor.reconstruction.remainder import off_middle, second_moment, third_moment
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

LADDER_RATIO = 1.4  # of one radius to the next
BIAS_POWER = 4  # of the radius, with which the bias of a curved patch grows
MOST_EXTRAPOLATED = 4.0  # standard error against that of a mean; a curved patch at the rim of its points exceeds it
UNFIT = 1.5  # times the noise: points that scatter more about a fit are not of one smooth patch
N_WIDENED = 3  # radii of the ladder for a plane: its own and the next wider, where too few points lie within it
MOST_TURNS, UPRIGHT = 2, 0.1  # a frame is turned once to the fitted slope, unless that is within 6 degrees,
SURE_SLOPE = 12.0  # or within what noise makes: chi2 of two
STEEPEST2 = 3.0  # squared slope of 60 degrees against the mean normal, beyond which a fit is not of its points' sheet
PRIOR = 8.0  # points, for which the noise around counts in the scatter of one fit
OFF_MIDDLE = 0.2  # of the radius: points whose middle lies farther off are of one side
PLACE, NORMAL, OUT_UNIT, OUT_SCATTER, OUT_SUPPORT, OUT_DEGREE, OUT_THIRD, OUT_SECOND, OUT_FREE, N_OUT = (
    slice(0, 3), slice(3, 6), *range(6, 14)
)  # fmt: skip


class Reach(NamedTuple):
    """How the points around each vertex are fitted, one value a vertex.

    `curved` and `flat` are the rungs of the ladder for a curved patch and for a plane, `is_flat` says which to take
    where the points allow both, `is_fourth` where a curved patch errs by its fourth order and is to be rid of it (see
    `fit_fourth`), `misfit` (m) is what the surface was seen to depart from such a fit at its middle, and `noise` (m)
    one sigma of a point there. `whole` (m) is the misfit of a curved patch with its fourth order left on; `second`
    (1/m) and `third` (1/m2) are what the derivatives of the surface there come to, root sum of squares.
    """

    curved: Ints
    flat: Ints
    is_flat: Bools
    is_fourth: Bools
    misfit: Floats
    noise: Floats
    whole: Floats
    second: Floats
    third: Floats
    furrows: Furrows | None = None

    def take(self, which: Ints) -> Reach:
        """Return what holds at the vertices selected, by discs alone."""
        return Reach(
            self.curved[which], self.flat[which], self.is_flat[which], self.is_fourth[which], self.misfit[which],
            self.noise[which], self.whole[which], self.second[which], self.third[which],
        )  # fmt: skip


class Furrows(NamedTuple):
    """Vertices whose fits are stretched: along what is alike along and narrow across, as furrows, edges and folds are.

    Of each of the vertices `which` (k,): `rung` of the ladder across, less than none for radii below its first;
    `stretch`, how many times as long the window is; `misfit` (m); and the direction `alongs` (n, 3) of all vertices.
    """

    which: Ints
    rung: Ints
    stretch: Floats
    misfit: Floats
    alongs: Floats


class Projection(NamedTuple):
    """Vertices on the local fit; where no fit was possible the vertex stays and its sigma is NaN."""

    vertices: Floats  # (n, 3)
    normals: Floats  # (n, 3)
    sigma: Floats  # (n,)
    scatter: Floats  # (n,) one-sigma of the points about the patch
    n_support: Ints  # (n,)
    is_fitted: Bools  # (n,)
    unit: Floats  # (n,) standard error that the noise of the points makes, in sigmas of one

    def take(self, which: Ints) -> Projection:
        """Return the vertices selected."""
        return Projection(*(getattr(self, name).take(which, axis=0) for name in self._fields))


class Samples(NamedTuple):
    """The cloud as fits take it: a `Level` for each radius (m, ascending), and the noise of its points (m)."""

    levels: list[Level]
    radii: Floats
    noise: float


def sum_up_samples(finest: Level, radii: Floats, noise: float) -> Samples:
    """Return points, given as the finest level, summed up in cells for fits within each of `radii`."""
    return Samples(build_levels(finest, radii, noise), radii, float(noise))


def project_vertices(
    vertices: Floats, normals: Floats, samples: Samples, reach: Reach, max_shift: float, cuts: Floats | None = None
) -> Projection:
    """Move each vertex along its normal onto the patch fitted to the points of its sheet around it.

    Points that look another way, or lie farther along the normal than noise and curvature explain, belong to another
    sheet. Where a curved patch would extrapolate a plane is taken. A move beyond `max_shift` (m) means that the fit
    is not about this vertex: it is refused. Where `cuts` (n, 2, 10) are given points beyond them are left out, though
    not of fits along furrows.
    """
    out, misfit = np.zeros((len(vertices), N_OUT)), reach.misfit
    if reach.furrows is not None:
        _project_along(vertices, normals, samples, reach.furrows, max_shift, out)
        misfit = misfit.copy()
        misfit[reach.furrows.which] = reach.furrows.misfit
        misfit = np.where(out[:, OUT_SUPPORT] > 0.0, misfit, reach.misfit)
    around, which = Around(vertices, normals, samples, max_shift, cuts), np.flatnonzero(out[:, OUT_SUPPORT] == 0.0)
    _project_as_reached(around, reach, which, out)
    _narrow(around, reach, out)
    keeps_fourth = reach.is_fourth & (out[:, OUT_DEGREE] == CURVED)
    misfit = np.hypot(np.where(keeps_fourth, reach.whole, misfit), left_at_rims(reach, out))
    scatter = steadied(np.fmin(reach.noise, samples.noise), out)
    is_fitted = out[:, OUT_SUPPORT] > 0.0
    return Projection(
        vertices=np.where(is_fitted[:, None], out[:, PLACE], vertices),
        normals=np.where(is_fitted[:, None], out[:, NORMAL], normals),
        sigma=np.where(is_fitted, np.hypot(scatter * out[:, OUT_UNIT], misfit), np.nan),
        scatter=np.where(is_fitted, scatter, np.nan),
        n_support=np.abs(out[:, OUT_SUPPORT]).astype(np.int32),
        is_fitted=is_fitted,
        unit=np.where(is_fitted, out[:, OUT_UNIT], np.nan),
    )


def steadied(noise: Floats, out: Floats) -> Floats:
    """Return the scatter (n,) [m] about each fit, few points of which tell little: the noise (n,) [m] around, where it
    is larger and known, counts for `PRIOR` points. A smaller one says nothing against what is seen here."""
    seen2, free = out[:, OUT_SCATTER] ** 2, out[:, OUT_FREE]
    return np.sqrt((free * seen2 + PRIOR * np.fmax(seen2, noise**2)) / (free + PRIOR))


def left_at_rims(reach: Reach, out: Floats) -> Floats:
    """Return by how much (n,) [m] the surface may depart from fits that their points hold from one side.

    From a curved patch by its third derivatives, from a plane that stands for a curved patch by its second; a plane
    that was chosen has its own misfit.
    """
    is_chosen = reach.is_flat & (out[:, OUT_DEGREE] == PLANE)
    left = np.hypot(out[:, OUT_THIRD] * reach.third, out[:, OUT_SECOND] * reach.second)
    return np.where(is_chosen, 0.0, left)


class Around(NamedTuple):
    """Raw vertices (n, 3), their normals, the points around them, how far (m) they may go, and where windows end."""

    vertices: Floats
    normals: Floats
    samples: Samples
    max_shift: float
    cuts: Floats | None


def _project_as_reached(around: Around, reach: Reach, which: Ints, out: Floats) -> None:
    """Project the vertices `which` onto curved patches, where there is none onto planes."""
    last = len(around.samples.radii) - 1
    fourth = which[(reach.is_fourth & ~reach.is_flat & (reach.curved < last))[which]]
    _project_all(around, 4, np.minimum(reach.curved + 1, last), fourth, out)
    curved = which[(out[which, OUT_SUPPORT] == 0.0) & ~reach.is_flat[which]]
    _project_all(around, 2, reach.curved, curved, out)
    for wider in range(N_WIDENED):
        which = which[out[which, OUT_SUPPORT] == 0.0]
        _project_all(around, 1, np.minimum(reach.flat + wider, last), which, out)


def _narrow(around: Around, reach: Reach, out: Floats) -> None:
    """Project vertices again, within less and less, whose points scatter about the fit by more than their noise.

    How far fits may reach is decided at probes. A vertex on an edge may be nearest to one on a flat side, whose plane
    would take in both sides here, and lie millimetres inside of them.
    """
    reach = reach._replace(**{name: getattr(reach, name).copy() for name in ("curved", "flat", "is_flat", "is_fourth")})
    which = _unfit(np.arange(len(around.vertices)), reach, out)
    while len(which):
        reach.curved[which], reach.flat[which] = (np.maximum(r[which] - 1, 0) for r in (reach.curved, reach.flat))
        reach.is_flat[which] &= reach.flat[which] > 0
        reach.is_fourth[which] = False
        out[which] = 0.0
        _project_as_reached(around, reach, which, out)
        which = _unfit(which, reach, out)


def _unfit(which: Ints, reach: Reach, out: Floats) -> Ints:
    """Return which of the vertices `which` (k,) have fits that leave more than noise, and could have narrower ones."""
    rung = np.where(reach.is_flat[which], reach.flat[which], reach.curved[which])
    is_unfit = (out[which, OUT_SUPPORT] > 0.0) & (out[which, OUT_SCATTER] > UNFIT * reach.noise[which])
    return which[(rung > 0) & is_unfit]


def _project_all(around: Around, degree: int, rungs: Ints, which: Ints, out: Floats) -> None:
    """Project the vertices `which`, each at its rung."""
    vertices, normals, samples, max_shift, cuts = around
    for rung, radius in enumerate(samples.radii):
        at_rung = which[rungs[which] == rung]
        if len(at_rung):
            sites = block_sites(vertices, normals, at_rung, radius, cuts=cuts)
            sizes = (radius, 1.0, gate_height(radius, samples.noise), max_shift, samples.noise)
            run_tasks(_project, len(sites.starts) - 1, sites, samples.levels[rung], sizes, degree, out)


def _project_along(
    vertices: Floats, normals: Floats, samples: Samples, furrows: Furrows, max_shift: float, out: Floats
) -> None:
    """Project the vertices of furrows, those of one size together."""
    for rung, stretch in np.unique(np.column_stack([furrows.rung, furrows.stretch]), axis=0):
        here = furrows.which[(furrows.rung == rung) & (furrows.stretch == stretch)]
        radius = float(samples.radii[0] * LADDER_RATIO**rung)
        sites = block_sites(vertices, normals, here, radius, furrows.alongs)
        sizes = (radius, float(stretch), gate_height(radius, samples.noise), max_shift, samples.noise)
        run_tasks(_project, len(sites.starts) - 1, sites, samples.levels[max(int(rung), 0)], sizes, 2, out)


@jit(nopython=True, cache=True)
def project_one(
    level: Any, near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, sizes: Any, degree: int,
    room: Any, row: Floats,
) -> None:  # fmt: skip
    """Project one vertex: frame from the mean normal of its points, then once more from slope and place fitted.

    The second frame stands on the first patch: about the raw vertex, which may lie cells off at a step or a wall, it
    would take the points of another part of the sheet, or of another sheet. It is turned only to a slope that noise
    does not make: noise across a turned frame has a part along it, which adds to the slope that it made (errors in
    variables), most where points lie on one side.
    """
    fit, place = room.fit, room.place
    radius, stretch, gate, max_shift, noise = sizes
    own = row[NORMAL]
    if not mean_normal(near, n_near, vertex, normal, along, radius, stretch, gate, own):
        return
    place[:] = vertex
    slope2, n_points, n = 0.0, 0.0, 0
    for _ in range(MOST_TURNS):
        n, n_points = gather_patch(
            level, near, n_near, place, own, along, radius, stretch, gate, room.patch, room.picked
        )
        if degree == 4:
            if not fit_fourth(room, n, radius):
                return
        elif not fit_patch(room.patch, n, radius, 1.0, stretch, degree, room.work, fit, room.influence):
            return
        if degree > 1 and not fit[UNIT_ERROR] * np.sqrt(fit[EFFECTIVE]) <= MOST_EXTRAPOLATED:
            return
        slope2 = fit[SLOPE_U] ** 2 + fit[SLOPE_V] ** 2
        if slope2 > STEEPEST2:
            break
        place += fit[HEIGHT] * own
        tilt(own, along, fit[SLOPE_U], fit[SLOPE_V])
        if slope2 < UPRIGHT**2 or is_by_noise(room, n, degree, radius, stretch, noise):
            break
    row[OUT_SUPPORT] = -n_points
    dx, dy, dz = place[0] - vertex[0], place[1] - vertex[1], place[2] - vertex[2]
    if slope2 <= 1.0 and dx * dx + dy * dy + dz * dz <= max_shift * max_shift:
        row[PLACE] = place
        row[OUT_UNIT], row[OUT_SCATTER] = fit[UNIT_ERROR] / np.sqrt(1.0 + slope2), fit[SIGMA]
        row[OUT_SUPPORT] = n_points
        write_limits(room, n, degree, radius, stretch, row)


@jit(nopython=True, cache=True)
def is_by_noise(room: Any, n: int, degree: int, radius: float, stretch: float, noise: float) -> bool:
    """Whether noise of the points may have made the slope of the fit made last.

    What they scatter by beyond it, at steps and edges, is no noise.
    """
    beyond = room.fit[SIGMA] / max(min(room.fit[SIGMA], noise), 1e-300)
    span = 1.0 / LADDER_RATIO if degree == 4 else 1.0
    chi2 = slope_chi2(room.patch, n, radius, span, stretch, min(degree, 2), room.work, room.fit)
    by_noise: bool = chi2 * beyond * beyond < SURE_SLOPE
    return by_noise


@jit(nopython=True, cache=True)
def write_limits(room: Any, n: int, degree: int, radius: float, stretch: float, row: Floats) -> None:
    """Write how many points the scatter of the fit made last rests on, and how far it follows the surface."""
    row[OUT_FREE] = max(room.fit[EFFECTIVE] - (3.0 if degree == 1 else 6.0), 1.0)
    row[OUT_DEGREE], row[OUT_THIRD], row[OUT_SECOND] = degree, 0.0, 0.0
    if degree == 1:
        row[OUT_SECOND] = second_moment(room.patch, n, room.influence) * radius**2
    elif stretch == 1.0:
        row[OUT_THIRD] = third_moment(room.patch, n, room.influence) * radius**3


@jit(nopython=True, cache=True)
def fit_fourth(room: Any, n: int, radius: float) -> bool:
    """Fit curved patches within `radius` and within one step of the ladder less; carry their heights on to none.

    The bias of a curved patch's height grows with the fourth power of its radius: what the wider differs from the
    narrower tells that of the latter, which is taken off, at 1.14 times the standard error (generalized jackknife:
    Schucany & Sommers 1977). All else is the narrower patch's. False where one of them cannot be, and where points lie
    on one side: there the bias grows with the third power.
    """
    fit, influence = room.fit, room.influence
    if not fit_patch(room.patch, n, radius, 1.0, 1.0, CURVED, room.work, fit, room.wider):
        return False
    wider = fit[HEIGHT]
    if not fit_patch(room.patch, n, radius, 1.0 / LADDER_RATIO, 1.0, CURVED, room.work, fit, influence):
        return False
    if off_middle(room.patch, n, 1.0 / LADDER_RATIO) > OFF_MIDDLE:
        return False
    carry = 1.0 / (LADDER_RATIO**BIAS_POWER - 1.0)
    fit[HEIGHT] += carry * (fit[HEIGHT] - wider)
    across_groups, variance = 0.0, 0.0
    for i in range(n):
        across_groups += room.patch[COUNT, i] * influence[i] * influence[i]
        influence[i] += carry * (influence[i] - room.wider[i])
        variance += room.patch[COUNT, i] * influence[i] * influence[i]
    within_groups = max(fit[UNIT_ERROR] ** 2 - across_groups, 0.0)
    fit[UNIT_ERROR] = np.sqrt(variance + (1.0 + carry) ** 2 * within_groups)
    return True


@jit(nopython=True, cache=True, nogil=True)
def _project(first: int, last: int, sites: Sites, level: Level, sizes: Any, degree: int, out: Floats) -> None:
    """Project the vertices of the blocks `first` to `last`, for `run_tasks`; sizes are radius, stretch, gate, limit,
    noise."""
    radius, stretch, gate, _, _ = sizes
    reach = np.hypot(OVER_THE_RIM * stretch * radius, gate)
    rows, near, room = rows_room(reach, block_edge(radius), level.bucket), near_room(ROOM), patch_room(ROOM)
    mixed, own = edge_of_groups(level, radius), near_room(ROOM)
    for block in range(first, last):
        n_near, near = find_near(level, sites, block, reach, rows, near)
        if n_near > len(room.picked):
            room = patch_room(2 * n_near)
        if len(near.groups) > len(own.groups):
            own = near_room(len(near.groups))
        for k in range(sites.starts[block], sites.starts[block + 1]):
            i = sites.which[k]
            vertex, normal, along = sites.vertices[i], sites.normals[i], sites.alongs[k]
            if len(sites.cuts) == 0:
                project_one(level, near, n_near, vertex, normal, along, sizes, degree, room, out[i])
            else:
                n_own = keep_own_side(near, n_near, sites.cuts[k], mixed, own)
                project_one(level, own, n_own, vertex, normal, along, sizes, degree, room, out[i])
