"""Which of the parts that are stated the errors follow: those of the surfaces, of their discord, of the scans, or none.

In: distances of calm vertices and what is stated of each. Out: a scale for each stated part, and a floor. One scale for
all is wrong: what scans disagree by may be most of what is stated, and hardly show in the difference of two epochs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import jit
from scipy.optimize import minimize

from monitor.threads import run_tasks
from projects.model import Floats

DOF = 6.0  # of Student's t: errors have tails, and what has changed a little and was not found lies there
NORMAL2 = 1.305  # with this the variance of normal errors is found: E[(nu + 1) k x^2 / (nu + k x^2)] = 1, x normal
STATED = math.log(2.0)  # one sigma of the logarithm of what is stated: it may be off by a factor of two
N_CHUNKS = 64  # whose sums are added up in their order, for threads
BOUNDS = (*((-5.0, 5.0),) * 3, (-7.0, 3.0))  # of the logarithms: of the scales, of the floor over the errors


class Parts(NamedTuple):
    """Scales of what is stated of the `surfaces`, of what their neighbouring fits contradict each other by, `discord`,
    and of the scans, `shared`, and the `floor` [m]."""

    surfaces: float
    discord: float
    shared: float
    floor: float


def fit_parts(distances: Floats, stated: tuple[Floats, Floats, Floats, Floats], n_witnesses: float) -> Parts:
    """Return the parts that make the distances (n,) [m] likeliest; `stated` (n,) [m] each are those of the surfaces, of
    their discord, of the scans and of the registration, of which the last stays as stated.

    Notes
    -----
    Greatest posterior: Student's t as wide as sqrt(a^2 surfaces^2 + c^2 discord^2 + b^2 shared^2 + motion^2 + floor^2),
    as sure as `n_witnesses` independent distances; a, b and c are held to be 1 within a factor of two, one sigma, the
    floor may be any. A part that the rest explains as well stays as stated.
    """
    size = float(np.median(np.abs(distances)))
    if not size > 0.0:
        return Parts(1.0, 1.0, 1.0, 0.0)
    figures = np.column_stack([distances, *stated]) / size
    figures *= figures
    sums = np.empty((N_CHUNKS, 5))

    def cost(p: Floats) -> tuple[float, Floats]:
        """Return the cost at the logarithms p (4,) of the scales, and its slopes (4,)."""
        run_tasks(_add_up, N_CHUNKS, figures, np.exp(2.0 * p), sums)
        value, *slopes = sums.sum(axis=0) / len(figures)
        held = np.array([*p[:3], 0.0]) / STATED**2
        gradient = n_witnesses * 2.0 * np.array(slopes) + held
        return n_witnesses * float(value) + 0.5 * float(held @ p), gradient

    found = minimize(cost, np.array([0.0, 0.0, 0.0, -1.0]), jac=True, method="L-BFGS-B", bounds=BOUNDS).x
    surfaces, discord, shared = np.exp(found[:3]).tolist()
    return Parts(surfaces, discord, shared, size * math.exp(found[3]))


@jit(nopython=True, cache=True, nogil=True)
def _add_up(begin, end, figures, scales2, sums):  # type: ignore[no-untyped-def]
    """Write for each chunk the sums of minus the logarithm of the likelihood, and of its slopes by `scales2` (4,), each
    times its scale; `figures` (n, 5) are squares of distance, surfaces, discord, scans, registration over the size."""
    for chunk in range(begin, end):
        value, slopes = 0.0, np.zeros(4)
        for i in range(len(figures) * chunk // N_CHUNKS, len(figures) * (chunk + 1) // N_CHUNKS):
            first, second, third = scales2[0] * figures[i, 1], scales2[1] * figures[i, 2], scales2[2] * figures[i, 3]
            v = first + second + third + scales2[3] + figures[i, 4] + 1e-12
            q = NORMAL2 * figures[i, 0] / (DOF * v)
            slope = (0.5 - 0.5 * (DOF + 1.0) * q / (1.0 + q)) / v
            value += 0.5 * (np.log(v) + (DOF + 1.0) * np.log1p(q))
            slopes[0] += slope * first
            slopes[1] += slope * second
            slopes[2] += slope * third
            slopes[3] += slope * scales2[3]
        sums[chunk, 0], sums[chunk, 1:] = value, slopes
