"""Do values that lie off stand apart from the rest, as what changed does, or are they the tail of its errors?

Errors thin out the farther off they are. What changed all over a part of an object lies about a middle of its own, with
few values between that and the rest; a scale that grows until it holds both takes change for error.
"""

from __future__ import annotations

import numpy as np

from projects.model import Bools, Floats

LEAST_SHARE = 0.1  # of all, on one side: a smaller group moves no scale by much
VALLEY = 0.5  # of what lies in as wide a window at either middle: between them there is no more
COMPACT = 0.4  # of a group, at least, lies in that window: pieces that moved each by itself are no group


def stand_apart(values: Floats, weights: Floats, is_near: Bools) -> Bools:
    """Return which values (n,) that are not near lie in a group of its own, above or below those near, which lie about
    zero; `weights` (n,) are how much each counts."""
    out = np.zeros(len(values), dtype=bool)
    for sign in (-1.0, 1.0):
        away = sign * values
        group = ~is_near & (away > 0.0)
        own = float(weights[group].sum())
        if own > 0.0 and own >= LEAST_SHARE * weights.sum() and _is_parted(away, weights, group):
            out |= group
    return out


def _is_parted(away: Floats, weights: Floats, group: Bools) -> bool:
    """Return whether few values lie halfway between zero and the middle of a group."""
    rising = np.argsort(away[group])
    total = np.cumsum(weights[group][rising])
    middle = float(away[group][rising][np.searchsorted(total, 0.5 * total[-1])])
    near, between, far = (float(weights[np.abs(away - part * middle) < middle / 6.0].sum()) for part in (0.0, 0.5, 1.0))
    return between <= VALLEY * min(near, far) and far >= COMPACT * total[-1]
