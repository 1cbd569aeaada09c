"""Weights of the pairs of many scans by what makes them uncertain: sigma of points, relief, angles.

In: the matches of all pairs at the present motions. Out: for each pair of scans the spread of its residuals and how far
the means of its patches are to be believed, both in proportion. What causes of uncertainty do is told by the residuals
of all pairs together, by the same function as for two epochs (`residual_sigma`). Errors that whole patches share stay
with the patches: points twice as rough do not make a patch as a whole twice as bad, so patches tell that by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.registration.network import CLIP, Pairs, Scales
from monitor.registration.sampling import cell_numbers
from monitor.registration.weights import residual_sigma
from projects.model import Floats
from projects.transforms import apply

MOST_TRUST = 4.0  # times the mean: few quiet patches must not hold a scan alone


def weigh_unevenly(matches: Pairs, motions: Sequence[Floats], scales: Scales) -> Scales:
    """Return the scales with the spreads of residuals and the trusts in patches of each pair of scans."""
    keys = list(matches)
    residuals = np.concatenate([matches[key].residuals for key in keys])
    causes = [np.concatenate(c) for c in zip(*(matches[key].causes for key in keys), strict=True)]
    spread = residual_sigma(residuals, causes, np.ones(len(residuals), dtype=bool))
    member = _patches(matches, motions, scales.patch)
    count = np.bincount(member)
    means = np.bincount(member, np.clip(residuals, -CLIP * spread, CLIP * spread)) / count
    stated = np.sqrt(np.bincount(member, spread**2)) / count
    trust = (1.0 / residual_sigma(means, (stated,), count > 1) ** 2)[member]
    trust = np.minimum(trust / trust.mean(), MOST_TRUST)
    ends = np.cumsum([len(matches[key]) for key in keys])[:-1]
    spreads, trusts = np.split(spread / scales.sigma, ends), np.split(trust / trust.mean(), ends)
    return replace(
        scales, spreads=dict(zip(keys, spreads, strict=True)), trusts=dict(zip(keys, trusts, strict=True))
    )  # fmt: skip


def _patches(matches: Pairs, motions: Sequence[Floats], patch: float) -> np.ndarray:
    """Return the number of the patch, a cube of edge `patch` [m], of each residual; every pair of scans has its own."""
    numbers, first = [], 0
    for (_, j), pair in matches.items():
        numbers.append(first + np.unique(cell_numbers(apply(motions[j], pair.points), patch), return_inverse=True)[1])
        first = int(numbers[-1].max()) + 1
    return np.concatenate(numbers)
