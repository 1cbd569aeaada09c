"""Several tests of one thing held together: how often chance makes any of them say what is not so.

In: the p values of the tests and those that chance alone makes of all of them at once. Out: adjusted p values. Tests
that agree with each other cost less than as many independent ones (Bonferroni, Holm), and the draws know how they
agree.
"""

from __future__ import annotations

import numpy as np

from projects.model import Floats


def share_as_small(values: Floats, chance: Floats) -> Floats:
    """Return how often chance makes a value as small as each of `values` (...): (1 + its count) / (1 + m).

    `chance` (m,) are the draws; one more counts, that which was seen (Davison and Hinkley 1997, Eq. 4.11).
    """
    below = np.searchsorted(np.sort(chance), values, side="right")
    return np.asarray((1.0 + below) / (1.0 + len(chance)))


def adjust_together(p_values: Floats, chance: Floats) -> Floats:
    """Return the adjusted p values (t,) of t tests of one thing: up to a level, none is wrong oftener than the level.

    Parameters
    ----------
    p_values : (t,) of the tests, each by itself.
    chance : (t, m) of the same tests on m draws in which every null hypothesis holds.

    References
    ----------
    Westfall and Young (1993), Resampling-based multiple testing, algorithm 2.8: the smallest counts against the least
    of all tests, the next one against the least of the rest.
    """
    rising = np.argsort(p_values, kind="stable")
    least = np.minimum.accumulate(chance[rising[::-1]], axis=0)[::-1]  # of a test and all after it
    alone = np.array([float(share_as_small(p_values[t], least[k])) for k, t in enumerate(rising)])
    adjusted = np.empty(len(p_values))
    adjusted[rising] = np.maximum.accumulate(alone)
    return adjusted
