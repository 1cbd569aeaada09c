"""One window after another over a surface: whether waves know the points there better than its fits do.

In: the middles of windows, vertices on smooth fits and points. Out: a row for each window: where they predict the
points better than the smooth surface does, waves and all that is needed to use them; and what is lost of one too short
for faces. Judged by the squares that are left, and what the freedom of either takes of the points' noise
(Mallows 1973).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import (
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    PLACE_X,
    PLACE_Y,
    PLACE_Z,
    ROOM,
    Sites,
    find_near,
    near_room,
    rows_room,
    tangent_frame,
)
from monitor.reconstruction.moments import Level
from monitor.reconstruction.periodogram import (
    N_CELLS,
    SURE_OF_PATTERN,
    alike_beside,
    pattern_in,
    sum_in_cells,
)
from monitor.reconstruction.waves import (
    CUT,
    MOST_WAVES,
    N_BENT,
    N_COEFFICIENTS,
    N_UNKNOWN,
    are_gentle,
    find_waves,
    fit_distances,
    freedom_of,
    leave_distances,
    shape_at,
    window_room,
)
from projects.model import Floats, Ints

TAKEN = 0.8  # of the radius: farther out a patch is not used
LEAST_POINTS, MOST_POINTS = 100, 4000  # of a window; of more every second, third, ... is taken
ANY_SIDE = 0.17  # least cosine between normal and window: within 80 degrees
FLAT_ENOUGH = 0.8  # length of the mean normal over a window
MOST_EDGES = 0.25  # of a window's vertices: where an edge runs through its middle
MOST_AGAINST = 0.03  # of a window's vertices, on edges that its waves contradict: they would go on over an edge
SURELY = 3.0  # sigmas, by which an edge contradicts waves
N_BESIDE = 3  # vertices whose planes say how far a point is off the smooth surface
LEAST_FREEDOM = N_BENT + 4.0  # of a patch with a wave
SPLASH = 1.5  # cells, as far as a vertex says how high the smooth surface is
LOST, N_FOUND, SIZE, VARIANCE, ALIKE, ACROSS, ASIDE, UPWARD, STRONGEST, SHORT = (
    0, 1, 2, 3, 4, slice(5, 8), slice(8, 11), slice(11, 14), slice(14, 17), slice(17, 20)
)  # fmt: skip
FREQUENCIES = slice(20, 20 + 2 * MOST_WAVES)
SHAPE = slice(FREQUENCIES.stop, FREQUENCIES.stop + N_COEFFICIENTS)
FACTOR = slice(SHAPE.stop, SHAPE.stop + N_UNKNOWN**2)
N_ROW = FACTOR.stop


class Laid(NamedTuple):
    """Where things lie in a window, in its frame and radii, and which of what is near they are; room for n."""

    u: Floats
    v: Floats
    z: Floats
    picked: Ints


class Fits(NamedTuple):
    """What is known of the smooth fits of vertices (n,): the share of its noise that a fit takes of a point next to it,
    the squared noise of a point about it, and the sigma of those that lie on an edge, 0 of others; in radii."""

    takes: Floats
    scatter2: Floats
    edges: Floats


class Heights(NamedTuple):
    """Sums (c, c) of weighted heights of the smooth surface in the cells of a window, and of the weights."""

    sums: Floats
    weights: Floats


@jit(nopython=True, cache=True)
def laid_room(n: int) -> Any:
    """Room for n places."""
    return Laid(np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int64))


@jit(nopython=True, cache=True)
def offset_of(near: Any, k: int, place: Floats) -> Any:
    """Way (m) from a place to what is near."""
    return near.values[PLACE_X, k] - place[0], near.values[PLACE_Y, k] - place[1], near.values[PLACE_Z, k] - place[2]


@jit(nopython=True, cache=True)
def slopes_of(near: Any, k: int, frame: Any) -> Any:
    """Normal of what is near, in a window's frame."""
    (tx, ty, tz), (bx, by, bz), (nx, ny, nz) = frame
    a, b, c = near.values[NORMAL_X, k], near.values[NORMAL_Y, k], near.values[NORMAL_Z, k]
    return a * tx + b * ty + c * tz, a * bx + b * by + c * bz, a * nx + b * ny + c * nz


@jit(nopython=True, cache=True)
def mean_upward(near: Any, n: int, own: Floats, place: Floats, radius: float, out: Floats) -> bool:
    """Unit mean normal of what is near within the radius and looks the way of `own`; False where it bends too much."""
    x, y, z, m = 0.0, 0.0, 0.0, 0
    for k in range(n):
        dx, dy, dz = offset_of(near, k, place)
        a, b, c = near.values[NORMAL_X, k], near.values[NORMAL_Y, k], near.values[NORMAL_Z, k]
        if dx * dx + dy * dy + dz * dz < radius * radius and a * own[0] + b * own[1] + c * own[2] > 0.0:
            x, y, z, m = x + a, y + b, z + c, m + 1
    length = np.sqrt(x * x + y * y + z * z)
    if m == 0 or length < FLAT_ENOUGH * m:
        out[:] = own
        return False
    out[0], out[1], out[2] = x / length, y / length, z / length
    return True


@jit(nopython=True, cache=True)
def frame_over(upward: Floats) -> Any:
    """Unit vectors across, aside and upward of a window."""
    across, aside = tangent_frame(upward)
    return across, aside, (upward[0], upward[1], upward[2])


@jit(nopython=True, cache=True)
def lay_in_window(near: Any, n: int, place: Floats, frame: Any, sizes: Any, reach: float, laid: Any) -> int:
    """Lay what is near within `reach` radii of a window's middle, and looks its way, into its frame: how many.

    `sizes` are radius and gate (m).
    """
    (tx, ty, tz), (bx, by, bz), (nx, ny, nz) = frame
    radius, gate = sizes
    m = 0
    for k in range(n):
        dx, dy, dz = offset_of(near, k, place)
        u, v = (dx * tx + dy * ty + dz * tz) / radius, (dx * bx + dy * by + dz * bz) / radius
        z = dx * nx + dy * ny + dz * nz
        _, _, cosine = slopes_of(near, k, frame)
        if u * u + v * v <= reach * reach and abs(z) <= gate and cosine > ANY_SIDE:
            laid.u[m], laid.v[m], laid.z[m], laid.picked[m] = u, v, z / radius, k
            m += 1
    return m


@jit(nopython=True, cache=True)
def lay_vertices(sites: Any, window: int, surface: Any, sizes: Any, rows: Ints, near: Any, laid: Any) -> Any:
    """Lay the vertices that a window's patch is used for into it: how many, what is near, and where they lie.

    `near` and `laid` are room for both, which grows where it must; `sizes` are radius and gate (m).
    """
    middle, upward = sites.which[window], np.empty(3)
    place = sites.vertices[middle]
    n, near = find_near(surface, sites, window, np.hypot(sizes[0], sizes[1]), rows, near)
    mean_upward(near, n, sites.normals[middle], place, sizes[0], upward)
    laid = laid if n <= len(laid.u) else laid_room(2 * n)
    return lay_in_window(near, n, place, frame_over(upward), sizes, TAKEN, laid), near, laid


@jit(nopython=True, cache=True)
def weight_of(laid: Any, k: int) -> float:
    """Weight of a window at a vertex laid in it: less and less away from the middle."""
    away2 = laid.u[k] * laid.u[k] + laid.v[k] * laid.v[k]
    return float((1.0 - away2 / (TAKEN * TAKEN)) ** 2)


@jit(nopython=True, cache=True)
def take_points(laid: Any, n: int, w: Any) -> int:
    """Copy the points of a window, of more than `MOST_POINTS` every second, third, ...: how many."""
    step = max((n + MOST_POINTS - 1) // MOST_POINTS, 1)
    for k in range(n // step):
        w.u[k], w.v[k], w.z[k] = laid.u[k * step], laid.v[k * step], laid.z[k * step]
    return n // step


@jit(nopython=True, cache=True)
def cells_around(at: float) -> tuple[int, int]:
    """First cell within `SPLASH` of a place along one axis, and the first behind the last."""
    first, last = max(int(np.ceil(at - SPLASH)), 0), min(int(np.floor(at + SPLASH)) + 1, int(N_CELLS))
    return first, last


@jit(nopython=True, cache=True, error_model="numpy")
def raise_heights(beside: Any, vertices: Any, m: int, frame: Any, heights: Any) -> None:
    """Write how high the planes of the m vertices of a window lie in the cells around each of them."""
    heights.sums[:], heights.weights[:] = 0.0, 0.0
    size = 2.0 / N_CELLS
    for k in range(m):
        a, b, c = slopes_of(beside, vertices.picked[k], frame)
        at_u, at_v = (vertices.u[k] + 1.0) / size - 0.5, (vertices.v[k] + 1.0) / size - 0.5
        first_i, last_i = cells_around(at_u)
        first_j, last_j = cells_around(at_v)
        for i in range(first_i, last_i):
            for j in range(first_j, last_j):
                du, dv = i - at_u, j - at_v
                weight = max(1.0 - (du * du + dv * dv) / (SPLASH * SPLASH), 0.0) ** 2
                heights.sums[i, j] += weight * (vertices.z[k] - size * (du * a + dv * b) / c)
                heights.weights[i, j] += weight


@jit(nopython=True, cache=True, error_model="numpy")
def leave_of_smooth(w: Any, n: int, heights: Any) -> float:
    """Write what the smooth surface leaves of the points of a window, NaN where it has no height; their mean square."""
    total, n_known = 0.0, 0
    for i in range(n):
        x, y = 0.5 * (w.u[i] + 1.0) * N_CELLS - 0.5, 0.5 * (w.v[i] + 1.0) * N_CELLS - 0.5
        a, b = max(min(int(np.floor(x)), int(N_CELLS) - 2), 0), max(min(int(np.floor(y)), int(N_CELLS) - 2), 0)
        height, weights = 0.0, 0.0
        for p in range(2):
            for q in range(2):
                share = max(1.0 - abs(x - a - p), 0.0) * max(1.0 - abs(y - b - q), 0.0)
                if heights.weights[a + p, b + q] > 0.0:
                    height += share * heights.sums[a + p, b + q] / heights.weights[a + p, b + q]
                    weights += share
        w.left[i] = np.nan
        if weights > 0.5:
            w.left[i] = w.z[i] - height / weights
            total, n_known = total + w.left[i] ** 2, n_known + 1
    return total / max(n_known, 1)


@jit(nopython=True, cache=True)
def mean_over(beside: Any, vertices: Any, m: int, values: Floats) -> float:
    """Mean over the m vertices of a window of what is known of all."""
    total = 0.0
    for k in range(m):
        total += values[beside.groups[vertices.picked[k]]]
    return total / max(m, 1)


@jit(nopython=True, cache=True)
def off_smooth(u: float, v: float, z: float, beside: Any, vertices: Any, m: int, frame: Any) -> Any:
    """Distance (in radii) of a point from the planes of the vertices next to it, and the number of the nearest one."""
    least, rows = np.full(N_BESIDE, np.inf), np.zeros(N_BESIDE, np.int64)
    for k in range(m):
        away = (vertices.u[k] - u) ** 2 + (vertices.v[k] - v) ** 2 + (vertices.z[k] - z) ** 2
        if away < least[N_BESIDE - 1]:
            at = N_BESIDE - 1
            while at > 0 and least[at - 1] > away:
                least[at], rows[at] = least[at - 1], rows[at - 1]
                at -= 1
            least[at], rows[at] = away, k
    total, off = 0.0, 0.0
    for q in range(min(N_BESIDE, m)):
        k = rows[q]
        a, b, c = slopes_of(beside, vertices.picked[k], frame)
        weight = 1.0 / max(least[q], 1e-12)
        off += weight * ((u - vertices.u[k]) * a + (v - vertices.v[k]) * b + (z - vertices.z[k]) * c)
        total += weight
    return off / total, vertices.picked[rows[0]]


@jit(nopython=True, cache=True)
def is_better(w: Any, n: int, n_waves: int, variance: float, judged: Any) -> bool:
    """Whether the waves of a window predict its inner points better than the smooth surface there does.

    `judged` are what is near, the m vertices laid in the window, their number, the frame, what fits take of all, and
    the squared noise of a point about them.
    """
    beside, vertices, m, frame, takes, scatter2 = judged
    noise2 = min(variance, scatter2)  # waves leave relief too where they are not all of it
    gain, n_inner, most = 0.0, 0, CUT * CUT * variance
    for i in range(n):
        if w.u[i] ** 2 + w.v[i] ** 2 < TAKEN * TAKEN:
            off, near = off_smooth(w.u[i], w.v[i], w.z[i], beside, vertices, m, frame)
            gain += min(off * off, most) - min(w.left[i] ** 2, most)
            gain += 2.0 * noise2 * takes[beside.groups[near]]
            n_inner += 1
    return bool(gain > 2.0 * noise2 * freedom_of(w, n, n_waves, variance) * n_inner / n)


@jit(nopython=True, cache=True)
def share_against(
    w: Any, n: int, n_waves: int, variance: float, beside: Any, vertices: Any, m: int, edges: Floats
) -> float:
    """Share of the m vertices of a window that lie on edges, by `edges` with their own sigma, and surely off its waves.

    What bends much passes for an edge here and there, and waves go along with it.
    """
    n_against, own2 = 0, variance * (N_BENT + 4 * n_waves) / n
    for k in range(m):
        sigma = edges[beside.groups[vertices.picked[k]]]
        if sigma > 0.0:
            height, slope_u, slope_v = shape_at(
                vertices.u[k], vertices.v[k], w.frequencies, n_waves, w.coefficients, w.row
            )
            off2 = (vertices.z[k] - height) ** 2 / (1.0 + slope_u**2 + slope_v**2)
            n_against += 1 if off2 > SURELY * SURELY * (sigma * sigma + own2) else 0
    return n_against / m


@jit(nopython=True, cache=True)
def share_on(beside: Any, vertices: Any, m: int, edges: Floats) -> float:
    """Share of the m vertices of a window that lie on edges."""
    n_on = 0
    for k in range(m):
        n_on += 1 if edges[beside.groups[vertices.picked[k]]] > 0.0 else 0
    return n_on / max(m, 1)


@jit(nopython=True, cache=True)
def write_window(w: Any, n: int, n_waves: int, variance: float, missed2: float, frame: Any, row: Floats) -> None:
    """Write what is needed to use a window's waves; what varies over several cells and they leave among it.

    `missed2` is the mean square of what else they may be off by.
    """
    sum_in_cells(w.u, w.v, w.left, n, w.spectrum)
    row[N_FOUND], row[SIZE], row[VARIANCE] = n_waves, n, variance
    row[ALIKE] = max(alike_beside(w.spectrum), missed2)
    for a in range(3):
        row[ACROSS.start + a], row[ASIDE.start + a], row[UPWARD.start + a] = frame[0][a], frame[1][a], frame[2][a]
    strongest, most = 0, 0.0
    for k in range(n_waves):
        for a in range(2):
            row[FREQUENCIES.start + 2 * k + a] = w.frequencies[k, a]
        height = np.hypot(w.coefficients[N_BENT + 2 * k], w.coefficients[N_BENT + 2 * k + 1])
        if height > most:
            strongest, most = k, height
    write_direction(w.frequencies[strongest, 0], w.frequencies[strongest, 1], frame, row[STRONGEST])
    row[SHAPE], row[FACTOR] = w.coefficients, w.factor.ravel()


@jit(nopython=True, cache=True)
def write_direction(f_u: float, f_v: float, frame: Any, out: Floats) -> None:
    """Write frequencies across and aside of a window as a vector in space."""
    for a in range(3):
        out[a] = f_u * frame[0][a] + f_v * frame[1][a]


@jit(nopython=True, cache=True, nogil=True)
def fit_windows(first: int, last: int, sites: Sites, finest: Level, surface: Level, fits: Fits,
                sizes: Any, cosines: Floats, sines: Floats, out: Floats) -> None:  # fmt: skip
    """Fit the windows `first` to `last`, for `run_tasks`; `sizes` are radius and gate (m), lengths told in radii.

    The third of `sizes` is the highest frequency that faces can show, in waves a radius; of a stronger wave that they
    cannot, its direction and strength are told. The rows of `fits` are those of `surface`.
    """
    takes, scatter2, edges = fits
    radius, gate, highest = sizes
    reach = np.hypot(radius, gate)
    rows, near, beside = rows_room(reach, radius, min(finest.bucket, surface.bucket)), near_room(ROOM), near_room(ROOM)
    w, points, vertices, upward = window_room(ROOM), laid_room(ROOM), laid_room(ROOM), np.empty(3)
    heights = Heights(np.empty((N_CELLS, N_CELLS)), np.empty((N_CELLS, N_CELLS)))
    for window in range(first, last):
        middle = sites.which[window]
        place = sites.vertices[middle]
        m, beside = find_near(surface, sites, window, reach, rows, beside)
        if not mean_upward(beside, m, sites.normals[middle], place, radius, upward):
            continue
        n, near = find_near(finest, sites, window, reach, rows, near)
        if max(n, m) > len(w.u):
            w, points, vertices = window_room(2 * max(n, m)), laid_room(2 * max(n, m)), laid_room(2 * max(n, m))
        frame = frame_over(upward)
        m = lay_in_window(beside, m, place, frame, (radius, gate), 1.0, vertices)
        n = take_points(points, lay_in_window(near, n, place, frame, (radius, gate), 1.0, points), w)
        if n < LEAST_POINTS or m == 0 or share_on(beside, vertices, m, edges) > MOST_EDGES:
            continue
        raise_heights(beside, vertices, m, frame, heights)
        variance = leave_of_smooth(w, n, heights)
        if not variance > 0.0:
            continue
        sum_in_cells(w.u, w.v, w.left, n, w.spectrum)
        sure = pattern_in(w.spectrum, variance)
        if sure < SURE_OF_PATTERN and mean_over(beside, vertices, m, takes) * n < LEAST_FREEDOM:
            continue
        n_waves, variance, (short_u, short_v), missed2 = find_waves(w, n, highest, cosines, sines)
        write_direction(short_u, short_v, frame, out[window, SHORT])
        out[window, LOST] = missed2
        if n_waves == 0:
            continue
        judged = beside, vertices, m, frame, takes, mean_over(beside, vertices, m, scatter2)
        if are_gentle(w, n_waves) and not is_better(w, n, n_waves, leave_distances(w, n, n_waves), judged):
            continue
        variance, unsure2 = fit_distances(w, n, n_waves, variance)
        missed2 = max(missed2, unsure2)
        if not (variance > 0.0 and is_better(w, n, n_waves, variance, judged)):
            continue
        if share_against(w, n, n_waves, variance, beside, vertices, m, edges) < MOST_AGAINST:
            write_window(w, n, n_waves, variance, missed2, frame, out[window])
