"""How well each pair of scans tells their motion: the variance of its witnesses, beside targets of stated covariance.

In: the matches of all pairs at the present motions. Out: a factor of the common variance for each pair. Two scans that
share only steep, bent or far places err there by several times what others do; under one variance for all pairs they
would turn whole blocks of scans against their targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.registration.network import Pairs, Scales
from monitor.registration.sampling import cell_numbers
from monitor.registration.weights import robust_scale
from projects.model import Floats
from projects.transforms import apply

CLIP = 3.0  # sigmas, beyond which a residual counts no more in the mean of its patch
BELIEVED = 4.0  # patches that what all pairs together show counts as, in each


@dataclass(frozen=True)
class _Witnesses:
    """Patches of a pair of scans: their mean residuals (p,) [m], and how many points they have (p,)."""

    means: Floats
    counts: Floats

    def factor(self, sigma: float) -> float:
        """Return the variance of a patch about zero over sigma^2, no less than independent noise leaves."""
        return max(robust_scale(self.means) ** 2 / sigma**2, 1.0 / float(np.mean(self.counts)))


def pair_factors(matches: Pairs, motions: Sequence[Floats], scales: Scales) -> dict[tuple[int, int], float]:
    """Return for each pair of scans the variance of its witnesses over `scales.sigma`^2, both ways of a pair alike.

    A pair's own patches are believed as far as there are many: what all pairs together show counts as four of them.
    """
    pairs = sorted({(min(key), max(key)) for key in matches})
    of_pair = {
        pair: _join([_witnesses(matches, key, motions, scales) for key in (pair, pair[::-1]) if key in matches])
        for pair in pairs
    }  # fmt: skip
    common = _join(list(of_pair.values())).factor(scales.sigma)
    factors = {}
    for pair, seen in of_pair.items():
        n = len(seen.means)
        factor = (n * seen.factor(scales.sigma) + BELIEVED * common) / (n + BELIEVED)
        factors[pair] = factors[pair[::-1]] = factor
    return factors


def _witnesses(matches: Pairs, key: tuple[int, int], motions: Sequence[Floats], scales: Scales) -> _Witnesses:
    """Return the patches of the matches of one scan with another."""
    pair = matches[key]
    numbers = np.unique(cell_numbers(apply(motions[key[1]], pair.points), scales.patch), return_inverse=True)[1]
    counts = np.bincount(numbers).astype(float)
    held = np.clip(pair.residuals, -CLIP * scales.sigma, CLIP * scales.sigma)
    return _Witnesses(np.bincount(numbers, held) / counts, counts)


def _join(parts: Sequence[_Witnesses]) -> _Witnesses:
    """Return the patches of several together."""
    return _Witnesses(np.concatenate([p.means for p in parts]), np.concatenate([p.counts for p in parts]))
