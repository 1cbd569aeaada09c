"""How a place was measured, in classes: by it errors differ more than what is stated of them tells.

A stratum is a roughness class (small relief is sampled differently each time), at some distance from a free edge (where
a surface ends it was seen by few scans), at some angle to the best view of the worse seen epoch (a spot that grazes a
bent surface lies beside it, on one side), with a sample so near (between samples a surface is a guess), where the
surfaces state much more than of most places or not (what they guess), in a third of the lever arm (scans placed a
little askew bend the whole, most far from its middle).
"""

from __future__ import annotations

import itertools

import numpy as np
from numba import jit

from monitor.comparison.distances.side import GAP_STEPS, STATED_STEPS, Side
from monitor.comparison.sight.views import VIEW_STEPS
from projects.model import Bools, Floats, Ints

RIM_STEPS = (2.0, 4.0, 8.0, 16.0)  # spacings from a free edge, where one class ends and the next begins
SHAPE = (len(RIM_STEPS) + 1, 3, len(VIEW_STEPS) + 1, len(GAP_STEPS) + 1, len(STATED_STEPS) + 1, 3)  # as in `KINDS`
N_STRATA = int(np.prod(SHAPE))
EVERY = np.arange(N_STRATA)
KINDS = {
    kind: [np.moveaxis(EVERY.reshape(SHAPE), axis, 0)[k].ravel() for k in range(SHAPE[axis])]
    for axis, kind in enumerate(("rim", "roughness", "view", "gap", "stated", "arm"))
}
PLACES = [EVERY.reshape(SHAPE)[i, j].ravel() for i, j in itertools.product(range(SHAPE[0]), range(SHAPE[1]))]
AGAIN = ("view", "gap", "stated")
ORDER = ("roughness", "rim", *AGAIN, None, *AGAIN, "arm", "roughness", "arm")  # None: `PLACES`
GROUPS = [EVERY, *itertools.chain.from_iterable(PLACES if kind is None else KINDS[kind] for kind in ORDER), EVERY]


def stratum_of(side: Side, spacing: float, which: Ints | slice = slice(None)) -> Ints:
    """Return the stratum (n,) uint16 of each vertex, or of those in `which`: its place in `SHAPE`."""
    rough = np.zeros(0, dtype=np.uint8) if side.surface.roughness is None else side.surface.roughness[which]
    steps, shape = np.array(RIM_STEPS), np.array(SHAPE)
    others = (side.view[which], side.gap[which], side.stated[which], side.arm[which])
    return np.asarray(_find_strata(side.to_rim[which], rough, others, spacing, steps, shape))


@jit(nopython=True, cache=True, nogil=True)
def _find_strata(to_rim, rough, others, spacing, steps, shape):  # type: ignore[no-untyped-def]
    """Return the strata; a distance that is NaN is far from all rims, without classes (none given) all is smooth."""
    out = np.empty(len(to_rim), dtype=np.uint16)
    view, gap, stated, arm = others
    for v in range(len(to_rim)):
        step = 0
        while step < len(steps) and not to_rim[v] / spacing < steps[step]:
            step += 1
        kind = min(np.int64(rough[v]), 2) if len(rough) else 0
        place = ((step * shape[1] + kind) * shape[2] + view[v]) * shape[3] + gap[v]
        out[v] = (place * shape[4] + stated[v]) * shape[5] + arm[v]
    return out


def lies_at_rim(stratum: Ints) -> Bools:
    """Return whether each stratum (n,) is one of the two steps beside a free edge."""
    return np.asarray(stratum < 2 * N_STRATA // SHAPE[0])


def mean_of_arms(values: Floats) -> Floats:
    """Return of each stratum (`N_STRATA`,) the root mean square of the values in the thirds of the lever arm."""
    return np.repeat(np.sqrt(np.mean(values.reshape(SHAPE) ** 2, axis=-1)), SHAPE[-1])
