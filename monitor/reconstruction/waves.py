"""A bent patch with waves on it, fitted to the points of one window by their distances to it.

In: points (u, v, z) of a window in its frame, in units of its radius. Out: the patch of second degree and the waves,
each found as the strongest in what is left (CLEAN: Hogbom 1974; Roberts et al. 1987), then fitted together. Noise lies
along the normals of the surface, not along those of the window: a regression of heights flattens steep waves (errors in
variables), so that the last fits are to distances from feet on the waves (Boggs, Byrd and Schnabel 1987).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.bends import leave_of_bend
from monitor.reconstruction.periodogram import (
    STEP,
    spectrum_room,
    strongest_waves,
    sum_in_cells,
)
from monitor.reconstruction.quadric import factorise, substitute
from projects.model import Floats

MOST_WAVES = 6
N_BENT = 6  # coefficients of a patch of second degree
N_COEFFICIENTS = N_BENT + 2 * MOST_WAVES
N_UNKNOWN = N_BENT + 4 * MOST_WAVES  # with both frequencies of each wave, which come last
FIRST_POWER = 17.0  # over that of noise: 1600 frequencies show as much by chance in one window of 15 000
NEXT_POWER = 11.0  # once there is one
FAINT_POWER = 34.0  # up to here a wave found may owe its height to chance
MOST_FLATTENED = 2.0  # times as high as a regression has it: beyond, any point is near to some flank of a wave
N_REFINED = 3  # steps of a frequency to its place between those of the periodogram
N_TURNED = 4  # steps of all frequencies together, each time that a wave was found
N_ROUNDS, SETTLED = 8, 0.02  # of fits to distances, at most; sigmas of a point, by which none of the coefficients moves
N_FEET = 2  # steps to the feet of points in each
FARTHEST_FOOT = 0.125  # of the radius, a step
CUT = 5.0  # sigmas, beyond which a point does not count
GENTLE = 0.3  # slope of all waves together
RIDGE = 1e-6  # of the number of points: a long wave is nearly a bend


class Window(NamedTuple):
    """Points of a window (n,), their feet, what is left of them, and what was fitted; room for all of it."""

    u: Floats
    v: Floats
    z: Floats
    foot_u: Floats
    foot_v: Floats
    left: Floats
    frequencies: Floats  # (w, 2) waves a radius along u and v
    coefficients: Floats  # (p,)
    factor: Floats  # (q, q) of the normal matrix of all unknowns, as `factorise` leaves it
    row: Floats  # (q,)
    spectrum: Any


@jit(nopython=True, cache=True)
def window_room(n: int) -> Any:
    """Room for n points."""
    return Window(
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty((MOST_WAVES, 2)),
        np.empty(N_COEFFICIENTS), np.empty((N_UNKNOWN, N_UNKNOWN)), np.empty(N_UNKNOWN), spectrum_room(),
    )  # fmt: skip


@jit(nopython=True, cache=True, error_model="numpy")
def shape_at(u: float, v: float, frequencies: Floats, n_waves: int, c: Floats, row: Floats) -> Any:
    """Height and both slopes of a patch with waves at a place; its basis there into `row`."""
    row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, u, v, u * u, u * v, v * v
    height = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v
    slope_u, slope_v = c[1] + 2.0 * c[3] * u + c[4] * v, c[2] + c[4] * u + 2.0 * c[5] * v
    for k in range(n_waves):
        f_u, f_v, p = 2.0 * np.pi * frequencies[k, 0], 2.0 * np.pi * frequencies[k, 1], N_BENT + 2 * k
        cosine, sine = np.cos(f_u * u + f_v * v), np.sin(f_u * u + f_v * v)
        row[p], row[p + 1] = cosine, sine
        height += c[p] * cosine + c[p + 1] * sine
        change = c[p + 1] * cosine - c[p] * sine
        slope_u, slope_v = slope_u + f_u * change, slope_v + f_v * change
    return height, slope_u, slope_v


@jit(nopython=True, cache=True)
def add_turns(u: float, v: float, n_waves: int, c: Floats, row: Floats) -> None:
    """Write to the end of `row`, whose waves `shape_at` wrote, how a height changes with the frequencies of each."""
    for k in range(n_waves):
        p, q = N_BENT + 2 * k, N_BENT + 2 * (n_waves + k)
        change = 2.0 * np.pi * (c[p + 1] * row[p] - c[p] * row[p + 1])
        row[q], row[q + 1] = change * u, change * v


@jit(nopython=True, cache=True)
def add_square(row: Floats, weight: float, p: int, matrix: Floats) -> None:
    """Add a row's weighted square to the lower triangle of a normal matrix."""
    for a in range(p):
        for b in range(a + 1):
            matrix[a, b] += weight * row[a] * row[b]


@jit(nopython=True, cache=True)
def fit_heights(w: Any, n: int, n_waves: int) -> float:
    """Fit heights by least squares, what is left into `left`; its mean square for each that is free, NaN for none."""
    p, matrix, rhs = N_BENT + 2 * n_waves, w.factor, np.zeros(N_UNKNOWN)
    matrix[:p, :p] = 0.0
    w.coefficients[:] = 0.0
    for i in range(n):
        shape_at(w.u[i], w.v[i], w.frequencies, n_waves, w.coefficients, w.row)
        add_square(w.row, 1.0, p, matrix)
        for a in range(p):
            rhs[a] += w.row[a] * w.z[i]
    for a in range(p):
        matrix[a, a] += RIDGE * n
    if n <= 2 * p or not factorise(matrix, p):
        return np.nan
    substitute(matrix, rhs, p)
    w.coefficients[:p] = rhs[:p]
    total = 0.0
    for i in range(n):
        height, _, _ = shape_at(w.u[i], w.v[i], w.frequencies, n_waves, w.coefficients, w.row)
        w.left[i] = w.z[i] - height
        total += w.left[i] ** 2
    return float(total / (n - p))


@jit(nopython=True, cache=True)
def refine(w: Any, n: int, f_u: float, f_v: float) -> Any:
    """Frequencies of a wave at which most of what is left follows it, from those of the periodogram (Gauss-Newton)."""
    for _ in range(N_REFINED):
        a, b = amplitudes(w, n, f_u, f_v)
        matrix, rhs, row = np.zeros((4, 4)), np.zeros(4), np.empty(4)
        for i in range(n):
            turn = 2.0 * np.pi * (f_u * w.u[i] + f_v * w.v[i])
            row[0], row[1] = np.cos(turn), np.sin(turn)
            change = 2.0 * np.pi * (b * row[0] - a * row[1])
            row[2], row[3] = change * w.u[i], change * w.v[i]
            add_square(row, 1.0, 4, matrix)
            for k in range(4):
                rhs[k] += row[k] * w.left[i]
        for k in range(4):
            matrix[k, k] *= 1.0 + RIDGE
        if not factorise(matrix, 4):
            break
        substitute(matrix, rhs, 4)
        f_u += min(max(rhs[2], -0.5 * STEP), 0.5 * STEP)
        f_v += min(max(rhs[3], -0.5 * STEP), 0.5 * STEP)
    return f_u, f_v


@jit(nopython=True, cache=True)
def amplitudes(w: Any, n: int, f_u: float, f_v: float) -> Any:
    """Cosine's and sine's part of what is left at one frequency, by least squares."""
    cc, cs, ss, c, s = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        turn = 2.0 * np.pi * (f_u * w.u[i] + f_v * w.v[i])
        cosine, sine = np.cos(turn), np.sin(turn)
        cc, cs, ss = cc + cosine * cosine, cs + cosine * sine, ss + sine * sine
        c, s = c + cosine * w.left[i], s + sine * w.left[i]
    determinant = max(cc * ss - cs * cs, 1e-12 * cc * ss)
    return (c * ss - s * cs) / determinant, (s * cc - c * cs) / determinant


@jit(nopython=True, cache=True, error_model="numpy")
def turn_heights(w: Any, n: int, n_waves: int) -> float:
    """`fit_heights` with the frequencies of all waves free (Gauss-Newton): a patch takes of a long wave what bends, so
    that what it leaves seems shorter."""
    q, rhs, best = N_BENT + 4 * n_waves, np.empty(N_UNKNOWN), fit_heights(w, n, n_waves)
    for _ in range(N_TURNED):
        if not best > 0.0:
            break
        before = w.frequencies.copy()
        w.factor[:q, :q], rhs[:] = 0.0, 0.0
        for i in range(n):
            shape_at(w.u[i], w.v[i], w.frequencies, n_waves, w.coefficients, w.row)
            add_turns(w.u[i], w.v[i], n_waves, w.coefficients, w.row)
            add_square(w.row, 1.0, q, w.factor)
            for a in range(q):
                rhs[a] += w.row[a] * w.left[i]
        for a in range(q):
            w.factor[a, a] += RIDGE * n
        if n <= 2 * q or not factorise(w.factor, q):
            return fit_heights(w, n, n_waves)
        substitute(w.factor, rhs, q)
        _move_by(w, n_waves, rhs)
        less = fit_heights(w, n, n_waves)
        if not 0.0 < less < best:
            w.frequencies[:] = before
            return fit_heights(w, n, n_waves)
        if less > (1.0 - SETTLED) * best:
            return less
        best = less
    return best


@jit(nopython=True, cache=True, error_model="numpy")
def find_waves(w: Any, n: int, highest: float, cosines: Floats, sines: Floats) -> Any:
    """Fit the window's n points by a patch with waves, as many as stand out of noise, if any does where a patch of
    fourth degree is taken off: how many, and the mean square of what is left (in squared radii).

    No wave has a higher frequency than `highest` (waves a radius). Of the strongest that is left above, the mean square
    comes fourth, 0 where none stands out of noise, and its frequencies third, 0 where that was not the strongest of
    all: a step has waves of every length.
    """
    n_waves, variance = 0, leave_of_bend(w, n)
    power, _, _, power_above, above = look_for_waves(w, n, variance, highest, cosines, sines)
    is_short = power_above > power
    if power >= FIRST_POWER:  # anew, on a patch that takes less of a long wave
        n_waves, variance, power_above, above = add_waves(w, n, highest, cosines, sines)
    if not variance > 0.0 or power_above < FIRST_POWER:
        return n_waves, variance, (0.0, 0.0), 0.0
    return n_waves, variance, above if is_short else (0.0, 0.0), 2.0 * power_above * variance / n


@jit(nopython=True, cache=True)
def look_for_waves(w: Any, n: int, variance: float, highest: float, cosines: Floats, sines: Floats) -> Any:
    """`strongest_waves` of what is left of the window's n points; none where the variance is not known."""
    if not variance > 0.0:
        return 0.0, 0.0, 0.0, 0.0, (0.0, 0.0)
    sum_in_cells(w.u, w.v, w.left, n, w.spectrum)
    return strongest_waves(w.spectrum, n, variance, highest, cosines, sines)


@jit(nopython=True, cache=True, error_model="numpy")
def add_waves(w: Any, n: int, highest: float, cosines: Floats, sines: Floats) -> Any:
    """Fit a patch of second degree, and add the strongest wave of what is left as long as it stands out of noise: how
    many, the mean square of what is left, and power and frequencies of the strongest above `highest`."""
    n_waves, variance = 0, fit_heights(w, n, 0)
    power, f_u, f_v, power_above, above = look_for_waves(w, n, variance, highest, cosines, sines)
    while n_waves < MOST_WAVES and power >= (NEXT_POWER if n_waves else FIRST_POWER):
        before = w.frequencies.copy()
        w.frequencies[n_waves, 0], w.frequencies[n_waves, 1] = refine(w, n, f_u, f_v)
        less = turn_heights(w, n, n_waves + 1)
        if not 0.0 < less < variance:
            w.frequencies[:] = before
            variance = fit_heights(w, n, n_waves)
            break
        variance, n_waves = less, n_waves + 1
        power, f_u, f_v, power_above, above = look_for_waves(w, n, variance, highest, cosines, sines)
    return n_waves, variance, power_above, above


@jit(nopython=True, cache=True)
def freedom_of(w: Any, n: int, n_waves: int, variance: float) -> float:
    """How many coefficients a patch with waves is worth: of each wave amplitude, phase and both frequencies, and as
    many again for a faint one, which is the best of hundreds."""
    free = float(N_BENT)
    for k in range(n_waves):
        p = N_BENT + 2 * k
        power = n * (w.coefficients[p] ** 2 + w.coefficients[p + 1] ** 2) / (4.0 * variance)
        free += 4.0 + 4.0 * FAINT_POWER / max(power, FAINT_POWER)
    return free


@jit(nopython=True, cache=True)
def are_gentle(w: Any, n_waves: int) -> bool:
    """Whether the waves found are nowhere so steep that a fit of heights flattens them by more than some hundredths."""
    steepest = 0.0
    for k in range(n_waves):
        amplitude = np.hypot(w.coefficients[N_BENT + 2 * k], w.coefficients[N_BENT + 2 * k + 1])
        steepest += 2.0 * np.pi * amplitude * np.hypot(w.frequencies[k, 0], w.frequencies[k, 1])
    return bool(steepest < GENTLE)


@jit(nopython=True, cache=True)
def distance_from(w: Any, i: int, n_waves: int) -> Any:
    """Distance of a point from the plane that touches the waves at its foot, their slopes and the cosine there."""
    u, v = w.foot_u[i], w.foot_v[i]
    height, slope_u, slope_v = shape_at(u, v, w.frequencies, n_waves, w.coefficients, w.row)
    cosine = 1.0 / np.sqrt(1.0 + slope_u * slope_u + slope_v * slope_v)
    return (w.z[i] - height - (w.u[i] - u) * slope_u - (w.v[i] - v) * slope_v) * cosine, slope_u, slope_v, cosine


@jit(nopython=True, cache=True)
def leave_distances(w: Any, n: int, n_waves: int) -> float:
    """Write how far the points are off waves fitted to their heights into `left`; the variance of a point."""
    w.foot_u[:n], w.foot_v[:n], total = w.u[:n], w.v[:n], 0.0
    for i in range(n):
        w.left[i] = distance_from(w, i, n_waves)[0]
        total += w.left[i] ** 2
    return float(total / (n - N_BENT - 2 * n_waves))


@jit(nopython=True, cache=True)
def fit_distances(w: Any, n: int, n_waves: int, variance: float) -> Any:
    """Fit the waves found to distances from them; the variance of a point (in squared radii), NaN where it fails.

    Points farther off than `CUT` sigmas do not count. The distances are left in `left`. The fit of heights stays where
    waves grow without end. Noise has flattened it by some (2 pi f sigma)^2, at most to a half; the mean square of that
    comes second, else 0.
    """
    heights, frequencies, unsure2 = w.coefficients.copy(), w.frequencies.copy(), 0.0
    found = _fit_distances(w, n, n_waves, variance)
    for p in range(N_BENT, N_BENT + 2 * n_waves, 2):
        low, high = np.hypot(heights[p], heights[p + 1]), np.hypot(w.coefficients[p], w.coefficients[p + 1])
        if not high < MOST_FLATTENED * low:
            found = np.nan
        k = (p - N_BENT) // 2
        turns2 = (2.0 * np.pi) ** 2 * (frequencies[k, 0] ** 2 + frequencies[k, 1] ** 2)
        unsure2 += 0.5 * (low * min(turns2 * variance, 1.0)) ** 2
    if found > 0.0:
        return found, 0.0
    w.frequencies[:] = frequencies
    fit_heights(w, n, n_waves)
    for a in range(N_BENT + 2 * n_waves, N_BENT + 4 * n_waves):  # without freedom of the frequencies
        w.factor[a, : a + 1] = 0.0
    return leave_distances(w, n, n_waves), unsure2


@jit(nopython=True, cache=True)
def _fit_distances(w: Any, n: int, n_waves: int, variance: float) -> float:
    """Fit distances in rounds, from the fit of heights on; the variance of a point, NaN where there is no end."""
    q, rhs = N_BENT + 4 * n_waves, np.empty(N_UNKNOWN)
    w.foot_u[:n], w.foot_v[:n] = w.u[:n], w.v[:n]
    for _ in range(N_ROUNDS):
        w.factor[:q, :q], rhs[:] = 0.0, 0.0
        total, n_in, cut2 = 0.0, 0.0, CUT * CUT * variance
        for i in range(n):
            off, cosine = _stand_on_foot(w, i, n_waves)
            w.left[i] = off
            if off * off < cut2:
                add_turns(w.foot_u[i], w.foot_v[i], n_waves, w.coefficients, w.row)
                add_square(w.row, cosine * cosine, q, w.factor)
                for a in range(q):
                    rhs[a] += cosine * off * w.row[a]
                total, n_in = total + off * off, n_in + 1.0
        for a in range(q):
            w.factor[a, a] += RIDGE * n
        if n_in <= 2 * q or not factorise(w.factor, q):
            return np.nan
        substitute(w.factor, rhs, q)
        variance = total / (n_in - q)
        if _move_by(w, n_waves, rhs) ** 2 < SETTLED * SETTLED * variance:
            break
    return float(variance)


@jit(nopython=True, cache=True)
def _stand_on_foot(w: Any, i: int, n_waves: int) -> Any:
    """Move a point's foot to where it stands over the waves; its distance from them and the cosine of their slope."""
    for _ in range(N_FEET):
        off, slope_u, slope_v, cosine = distance_from(w, i, n_waves)
        step_u, step_v = off * slope_u * cosine, off * slope_v * cosine
        w.foot_u[i] = w.u[i] + min(max(step_u, -FARTHEST_FOOT), FARTHEST_FOOT)
        w.foot_v[i] = w.v[i] + min(max(step_v, -FARTHEST_FOOT), FARTHEST_FOOT)
    off, _, _, cosine = distance_from(w, i, n_waves)
    return off, cosine


@jit(nopython=True, cache=True)
def _move_by(w: Any, n_waves: int, step: Floats) -> float:
    """Change coefficients and frequencies by a step; by how much the coefficients change at most."""
    p, most = N_BENT + 2 * n_waves, 0.0
    for a in range(p):
        w.coefficients[a] += step[a]
        most = max(most, abs(step[a]))
    for k in range(n_waves):
        for a in range(2):
            w.frequencies[k, a] += min(max(step[p + 2 * k + a], -0.5 * STEP), 0.5 * STEP)
    return most


@jit(nopython=True, cache=True)
def error2_at(w: Any, n_waves: int, variance: float) -> float:
    """Squared standard error of the height whose basis is in `row`, which is used up."""
    total = 0.0
    for a in range(N_BENT + 4 * n_waves):
        x = w.row[a]
        for b in range(a):
            x -= w.factor[a, b] * w.row[b]
        w.row[a] = x * w.factor[a, a]
        total += w.row[a] ** 2
    return variance * total
