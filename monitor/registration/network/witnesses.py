"""What patches of the overlaps say: how far scans really lie off each other, and how well each pair tells it.

In: the matches of all pairs at the present motions. Out: the misfit of patches, from which the noise of single points
is gone; and, beside targets of stated covariance, a factor of the common variance for each pair. Two scans that share
only steep, bent or far places err there by several times what others do; under one variance for all pairs they would
turn whole blocks of scans against their targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.registration.motion.sampling import cell_numbers
from monitor.registration.network.equations import Pairs, Scales
from monitor.robust import robust_scale
from projects.model import Floats
from projects.transforms import apply

CLIP = 3.0  # sigmas, beyond which a residual counts no more in the mean of its patch
EXPLAINED = 1.0 / 3.0  # of the variance of patches as given: what poses must explain to be better than those given
BELIEVED = 4.0  # patches that what all pairs together show counts as, in each


@dataclass(frozen=True)
class Witnesses:
    """Patches of overlaps: their mean residuals (p,) [m], and how many points they have (p,)."""

    means: Floats
    counts: Floats

    @property
    def misfit(self) -> float:
        """Robust sigma [m] of the patches about zero."""
        return robust_scale(self.means)

    def factor(self, sigma: float) -> float:
        """Return the variance of a patch about zero over sigma^2, no less than independent noise leaves."""
        return max(self.misfit**2 / sigma**2, 1.0 / float(np.mean(self.counts)))


def gather_witnesses(matches: Pairs, motions: Sequence[Floats], patch: float) -> Witnesses:
    """Return the patches, cubes of edge `patch` [m], of all pairs of scans at these motions."""
    return _join([_witnesses(matches, key, motions, patch, np.inf) for key in matches])


def explains_misfit(before: Witnesses, after: Witnesses, n_parameters: int) -> bool:
    """Return whether motions of so many parameters explain a third of the variance of patches, beyond chance.

    Single points would not tell: noise of half a millimetre hides that scans lie a third of a millimetre off.
    """
    n = len(after.means)
    if n <= n_parameters:
        return False
    return after.misfit**2 * n / (n - n_parameters) < (1.0 - EXPLAINED) * before.misfit**2


def pair_factors(matches: Pairs, motions: Sequence[Floats], scales: Scales) -> dict[tuple[int, int], float]:
    """Return for each pair of scans the variance of its witnesses over `scales.sigma`^2, both ways of a pair alike.

    A pair's own patches are believed as far as there are many: what all pairs together show counts as four of them.
    """
    pairs = sorted({(min(key), max(key)) for key in matches})
    of_pair = {
        pair: _join([
            _witnesses(matches, key, motions, scales.patch, CLIP * scales.sigma)
            for key in (pair, pair[::-1]) if key in matches
        ])
        for pair in pairs
    }  # fmt: skip
    common = _join(list(of_pair.values())).factor(scales.sigma)
    factors = {}
    for pair, seen in of_pair.items():
        n = len(seen.means)
        factor = (n * seen.factor(scales.sigma) + BELIEVED * common) / (n + BELIEVED)
        factors[pair] = factors[pair[::-1]] = factor
    return factors


def count_sharers(matches: Pairs, motions: Sequence[Floats], patch: float) -> dict[tuple[int, int], float]:
    """Return for each pair of scans how many scans share a patch of theirs (harmonic mean over its patches)."""
    places = [apply(motions[j], pair.points) for (_, j), pair in matches.items()]
    cells = np.split(cell_numbers(np.concatenate(places), patch), np.cumsum([len(p) for p in places])[:-1])
    cells = [np.unique(c) for c in cells]
    n = len(motions)
    seen = np.unique(np.concatenate([c * n + k for c, key in zip(cells, matches, strict=True) for k in key]))
    patches, n_scans = np.unique(seen // n, return_counts=True)
    return {
        key: 1.0 / float(np.mean(1.0 / n_scans[np.searchsorted(patches, c)]))
        for c, key in zip(cells, matches, strict=True)
    }


def _witnesses(
    matches: Pairs, key: tuple[int, int], motions: Sequence[Floats], patch: float, limit: float
) -> Witnesses:
    """Return the patches of the matches of one scan with another, residuals held within the limit [m]."""
    pair = matches[key]
    numbers = np.unique(cell_numbers(apply(motions[key[1]], pair.points), patch), return_inverse=True)[1]
    counts = np.bincount(numbers).astype(float)
    held = np.clip(pair.residuals, -limit, limit)
    return Witnesses(np.bincount(numbers, held) / counts, counts)


def _join(parts: Sequence[Witnesses]) -> Witnesses:
    """Return the patches of several together."""
    means, counts = [p.means for p in parts], [p.counts for p in parts]
    return Witnesses(np.concatenate([*means, np.empty(0)]), np.concatenate([*counts, np.empty(0)]))
