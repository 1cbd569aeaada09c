"""Whether waves found in a window go on beyond it, as relief that repeats does, and chance or noise of lines does not.

In: windows with the direction and frequency of a wave in each. Out: which of these waves stand out of what else varies
along their direction, and do so again among points outside of their own window, farther along. Offsets that scan lines
have in common are white across the lines: their strongest wave stands little above the others (Fisher 1929), and is
another one in the next window. Beside a step, an edge or a single groove there is nothing to go on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit
from scipy.spatial import cKDTree

from monitor.reconstruction.bends import leave_of_bend
from monitor.reconstruction.gathering import ROOM, Sites, find_near, near_room, rows_room
from monitor.reconstruction.moments import Level
from monitor.reconstruction.periodogram import HIGHEST, LOWEST, STEP
from monitor.reconstruction.wave_windows import (
    LEAST_POINTS,
    frame_over,
    laid_room,
    lay_in_window,
    mean_upward,
    take_points,
)
from monitor.reconstruction.waves import fit_heights, window_room
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

AWAY, NEAREST, ASTRAY = 1.8, 1.2, 0.9  # radii: of the next window, at least, and off the place it should have
SURE, AGAIN = 7.0, 5.0  # times what is usual along its direction, a wave in its own window, and in the next
PLAIN = 20.0  # times, where it is enough that a window beside has a like wave that goes on
N_BESIDE = 8  # windows within a radius at most
AS_STRONG = 0.1  # of the mean square of a wave, that of the one in the next window at least
DRIFT = np.int64(2)  # steps of frequency, to which one is known, and from one window to the next
BESIDE = np.int64(3)  # steps of frequency that a wave takes to either side
KNOWN = 0.5  # waves a radius, to which a direction is known
TURN = 0.08  # rad, from one direction looked at to the next: half a wave aside at the highest frequency
FIRST, LAST = np.int64(2), np.int64(HIGHEST / STEP)  # frequencies looked at along a direction, in steps
LONG = 1.8  # waves a radius, below which a patch of fourth degree would take much of one
STANDS_OUT, STRENGTH = 0, 1


def find_going_on(sites: Sites, owners: Ints, waves: Floats, finest: Level, surface: Level, sizes: Any) -> Bools:
    """Return which waves (k,) go on beyond their windows `owners` (k,), as numbers of sites.

    Parameters
    ----------
    waves : (k, 3) direction in space times waves a radius.
    sizes : m, radius of windows and gate.
    """
    told = np.zeros((len(owners), 2))
    run_tasks(measure_waves, len(owners), sites, owners, owners, waves, finest, surface, sizes, told)
    sure = np.flatnonzero(told[:, STANDS_OUT] > SURE)
    again = np.zeros(len(owners), np.bool_)
    for way in (1.0, -1.0):
        which, others = next_windows(sites, owners[sure], way * waves[sure], sizes[0])
        which = sure[which]
        there = np.zeros((len(which), 2))
        pairs = owners[which], others, waves[which]
        run_tasks(measure_waves, len(which), sites, *pairs, finest, surface, sizes, there)
        as_strong = there[:, STRENGTH] > AS_STRONG * told[which, STRENGTH]
        again[which[as_strong & (there[:, STANDS_OUT] > AGAIN)]] = True
    plain = np.flatnonzero((told[:, STANDS_OUT] > PLAIN) & ~again)
    on = np.flatnonzero(again)
    places = sites.vertices[sites.which[owners]]
    again[plain[has_like(places[plain], waves[plain], places[on], waves[on], sizes[0])]] = True
    return again


def has_like(places: Floats, waves: Floats, others: Floats, like: Floats, radius: float) -> Bools:
    """Return which waves (k, 3) at places (k, 3) have one like them, of `like` (m, 3) at others (m, 3), in a radius."""
    if not len(others):
        return np.zeros(len(places), np.bool_)
    away, at = cKDTree(others).query(places, k=range(1, N_BESIDE + 1), distance_upper_bound=radius)
    found = np.vstack([like, np.full(3, np.inf)])[at]
    differ = np.minimum(*(np.linalg.norm(found - sign * waves[:, None], axis=2) for sign in (1.0, -1.0)))
    alike: Bools = (np.isfinite(away) & (differ < DRIFT * STEP)).any(axis=1)
    return alike


def next_windows(sites: Sites, owners: Ints, waves: Floats, radius: float) -> tuple[Ints, Ints]:
    """Return which windows (k,) have a next one along their waves (k, 3), and these."""
    places = sites.vertices[sites.which]
    along = waves / np.linalg.norm(waves, axis=1)[:, None]
    astray, others = cKDTree(places).query(places[owners] + AWAY * radius * along)
    away = np.linalg.norm(places[others] - places[owners], axis=1)
    which = np.flatnonzero((astray < ASTRAY * radius) & (away > NEAREST * radius))
    return which, others[which]


@jit(nopython=True, cache=True)
def keep_beyond(w: Any, n: int, own_u: float, own_v: float, along_u: float, along_v: float) -> int:
    """Keep those of n points of a window that lie farther along its waves than another one reaches, whose middle is
    given: how many. They are on other lines, and on no step that both windows have."""
    away = 1.0 if own_u * along_u + own_v * along_v < 0.0 else -1.0
    m = 0
    for k in range(n):
        if away * ((w.u[k] - own_u) * along_u + (w.v[k] - own_v) * along_v) > 1.0:
            w.u[m], w.v[m], w.z[m] = w.u[k], w.v[k], w.z[k]
            m += 1
    return m


@jit(nopython=True, cache=True)
def turn_into(vector: Floats, frame: Any) -> Any:
    """Components of a vector in a frame."""
    x, y, z = vector[0], vector[1], vector[2]
    (a, b, c), (d, e, f), (g, h, i) = frame
    return x * a + y * b + z * c, x * d + y * e + z * f, x * g + y * h + z * i


@jit(nopython=True, cache=True)
def write_profile(w: Any, n: int, along_u: float, along_v: float, profile: Floats) -> None:
    """Write the power at each frequency in one direction."""
    re, im = np.zeros(len(profile)), np.zeros(len(profile))
    for i in range(n):
        step = 2.0 * np.pi * STEP * (w.u[i] * along_u + w.v[i] * along_v)
        x, y, c, s = w.left[i] * np.cos(FIRST * step), w.left[i] * np.sin(FIRST * step), np.cos(step), np.sin(step)
        for j in range(len(profile)):
            re[j] += x
            im[j] += y
            x, y = x * c - y * s, x * s + y * c
    for j in range(len(profile)):
        profile[j] = re[j] * re[j] + im[j] * im[j]


@jit(nopython=True, cache=True, error_model="numpy")
def stand_out(w: Any, n: int, f_u: float, f_v: float) -> Any:
    """Highest power near a frequency, over what is usual in its direction; that power.

    A direction is known to half a wave aside. What is usual is the mean over frequencies not beside the wave, in that
    of the directions in which it is highest: lines have theirs in one, whatever the frequency.
    """
    frequency = max(np.hypot(f_u, f_v), LOWEST)
    at, n_turns = int(np.round(frequency / STEP)) - FIRST, int(np.ceil(KNOWN / (frequency * TURN)))
    profile, peak, usual = np.empty(LAST - FIRST + 1), 0.0, 0.0
    for k in range(-n_turns, n_turns + 1):
        c, s, others, n_others = np.cos(k * TURN) / frequency, np.sin(k * TURN) / frequency, 0.0, 0
        write_profile(w, n, c * f_u - s * f_v, s * f_u + c * f_v, profile)
        for j in range(len(profile)):
            if abs(j - at) <= DRIFT:
                peak = max(peak, profile[j])
            if abs(j - at) > BESIDE:
                others, n_others = others + profile[j], n_others + 1
        usual = max(usual, others / n_others)
    return peak / usual, peak


@jit(nopython=True, cache=True, nogil=True)
def measure_waves(first: int, last: int, sites: Sites, owners: Ints, windows: Ints, waves: Floats, finest: Level,
                  surface: Level, sizes: Any, out: Floats) -> None:  # fmt: skip
    """Measure the waves of `owners` in other windows, or the same, for `run_tasks`: by how much they stand out of what
    else varies along them, and their strength, of points that do not lie in the owner where it is another window."""
    radius, gate = sizes
    reach = np.hypot(radius, gate)
    rows, near, beside = rows_room(reach, radius, min(finest.bucket, surface.bucket)), near_room(ROOM), near_room(ROOM)
    w, points, upward = window_room(ROOM), laid_room(ROOM), np.empty(3)
    for task in range(first, last):
        window, middle = windows[task], sites.which[windows[task]]
        place, own = sites.vertices[middle], sites.vertices[sites.which[owners[task]]]
        m, beside = find_near(surface, sites, window, reach, rows, beside)
        if not mean_upward(beside, m, sites.normals[middle], place, radius, upward):
            continue
        n, near = find_near(finest, sites, window, reach, rows, near)
        if n > len(w.u):
            w, points = window_room(2 * n), laid_room(2 * n)
        frame = frame_over(upward)
        n = take_points(points, lay_in_window(near, n, place, frame, sizes, 1.0, points), w)
        u, v, _ = turn_into(waves[task], frame)
        frequency, flat = np.sqrt((waves[task] ** 2).sum()), np.hypot(u, v)
        if flat < 0.5 * frequency:
            continue
        if window != owners[task]:
            own_u, own_v, _ = turn_into((own - place) / radius, frame)
            n = keep_beyond(w, n, own_u, own_v, u / flat, v / flat)
        if n < LEAST_POINTS:
            continue
        variance = fit_heights(w, n, 0) if frequency < LONG else leave_of_bend(w, n)
        if not variance > 0.0:
            continue
        out[task, STANDS_OUT], peak = stand_out(w, n, u * frequency / flat, v * frequency / flat)
        out[task, STRENGTH] = peak / (n * n)
