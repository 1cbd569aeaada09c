"""How much of what scans are stated to disagree by is error of a change, as the means of unchanged patches show it.

In: patches of every size of both sides. Out: `ScanErrors`, a scale of what is stated, by how much that is, and how many
witnesses it rests on. Where both epochs were seen alike, by the same scanner and from the same places, much of what
their scans disagree by is the same in both and falls out of the change; where scans were placed anew, it may not.
Single vertices hardly know which: their own noise hides it. In patches that averages out, and what scans disagree by is
left. It agrees far along a surface, so that few places bear witness of it; where much is stated, fewer still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtr, stdtrit

from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.asked_scale import believe
from monitor.comparison.noise.model import STATED_WITNESSES
from monitor.comparison.noise.patch_errors import HARDLY_T, INNER, NORMAL, quantile_of
from projects.model import Floats, Ints

ALIKE = 0.05  # of the surface's area, over which what scans disagree by is taken to agree: as wide as any patch tested
STEPS = (0.0, 1.5)  # times what is stated of most patches: where more is, it has a scale of its own
LEAST_USUAL = 1.0 / 16.0  # of the most that is stated: where hardly anything is of most patches, the rest is apart
FEWEST_PATCHES = 40  # of a size, of both sides, that show a scale
WAYS = 6  # in which one scan can lie off another
PER_WITNESS = 4.0  # patches of both sides, which bear the same witness, at least
FAR = 1e-6  # p value of a patch that is significant among all of a surface
LEAST_SCALE = 0.25  # what is stated may be off by a factor of two, one sigma; of one place by four
MOST_SIGMAS = 37.0  # of a normal distribution that a p value can tell


@dataclass(frozen=True)
class ScanErrors:
    """What is stated of the scans, cut at `steps` (c,) [m] in squares, the first 0: up to the next step it counts
    `scales` (c,) times, as sure as `n_witnesses` (c,) independent places are.

    What falls out of the change up to a step, since both epochs' scans err alike there, does so where more is stated
    too. Beyond it what is stated counts in full, and all together, from there on, the scale of the step times.
    """

    steps: Floats
    scales: Floats
    n_witnesses: Floats

    def _variances(self, stated: Floats) -> list[Floats]:
        """Return the variance [m2] of what lies between each two steps, of what is `stated` [m]; of any shape."""
        out: list[Floats] = []
        upper = np.append(self.steps[1:], np.inf)
        for scale, low, high in zip(self.scales, self.steps, upper, strict=True):
            between2 = np.maximum(np.minimum(stated, high) ** 2 - low**2, 0.0)
            out = [np.where(stated >= low, scale**2, 1.0) * below2 for below2 in out] + [scale**2 * between2]
        return out

    def sigma_of(self, stated: Floats) -> Floats:
        """Return one sigma [m] of the mean over a place, of what is `stated` [m] of it in the mean; of any shape."""
        return np.asarray(np.sqrt(sum(self._variances(stated))))

    def dof_of(self, sigma2: Floats, stated: Floats) -> Floats:
        """Return the degrees of freedom of a mean with the variance `sigma2` [m2], the scans' part of it included, of
        which alone the size is estimated, between each two steps by itself (Satterthwaite 1946); at most `NORMAL`."""
        unsure = np.zeros(np.shape(stated))
        for variance, n_witnesses in zip(self._variances(stated), self.n_witnesses, strict=True):
            share = np.divide(variance, sigma2, out=np.zeros(np.shape(stated)), where=sigma2 > 0.0)
            unsure += share**2 / n_witnesses
        return np.asarray(np.minimum(1.0 / np.maximum(unsure, 1e-200), NORMAL))

    def as_normal(self, z: float, sigma: float, stated: float) -> float:
        """Return how many sigmas off zero a normal distribution has the p value of a mean that lies `z` of its `sigma`
        [m] off, of which so much [m] is `stated` of the scans; at most `MOST_SIGMAS`."""
        dof = float(self.dof_of(np.array(sigma**2), np.array(stated)))
        away = z if dof >= HARDLY_T else -np.sign(z) * ndtri(stdtr(dof, -abs(z)))
        return float(np.clip(away, -MOST_SIGMAS, MOST_SIGMAS))


AS_STATED = ScanErrors(np.zeros(1), np.ones(1), np.full(1, NORMAL))


def stated_over(side: Side, vertices: Ints) -> float:
    """Return the mean by area [m] of what scans are stated to disagree by at some vertices; 0 of none."""
    return float(np.average(side.sigma_shared[vertices], weights=side.areas[vertices])) if len(vertices) else 0.0


def learn_scans(means: Floats, own2: Floats, stated: Floats, still_share: float, n_scans: int = 0) -> ScanErrors:
    """Return what patches that hold still show of the errors of scans.

    A scale is what nine tenths of the means of a size, their other errors taken off, lie within (`INNER`), of the size
    that shows most. What is stated counts for `STATED_WITNESSES`, since it may be off by a factor of two; no single
    place is believed to err by less than a quarter of it. Where more is stated than of most, what goes beyond that
    counts in full, or more: fewer places show what of it is error, and each by itself.

    Parameters
    ----------
    means, own2, stated : (p, s), m, m2, m, of each size of patch, smallest first; the variance of all but the scans,
        and what is stated of these. NaN means of patches that do not hold still.
    still_share : of the area, that does.
    n_scans : of the epoch that has fewer, 0 where it is not known. Scans are rigid: k of them disagree in 6 (k - 1)
        ways, and no more places bear witness of it.
    """
    is_known = np.isfinite(means)
    of_units = stated[is_known[:, 0], 0]
    if len(of_units) < FEWEST_PATCHES or not of_units.max() > 0.0:
        return AS_STATED
    steps = np.array(STEPS) * max(median(of_units), LEAST_USUAL * float(of_units.max()))
    most = min(still_share / ALIKE, len(of_units) / PER_WITNESS, WAYS * (n_scans - 1) if n_scans else np.inf)
    scales, witnesses = np.ones(len(steps)), np.full(len(steps), NORMAL)
    for k, step in enumerate(steps):
        least = 1.0 if k else LEAST_SCALE
        known = ScanErrors(steps[: k + 1], scales[: k + 1], witnesses[: k + 1]).sigma_of(stated)
        asked = scales_asked(means, own2, known)
        shown = max(_inner(asked[is_known[:, size] & (stated[:, size] >= step), size])
                    for size in range(means.shape[1]))  # fmt: skip
        n_witnesses = most * float(np.mean(of_units >= step))
        scale = believe(max(shown, least), n_witnesses, STATED_WITNESSES)
        scales[k], witnesses[k] = believe_stated(scale, n_witnesses)
    return ScanErrors(steps, scales, witnesses)


def believe_stated(scale: float, n_witnesses: float) -> tuple[float, float]:
    """Return a scale that so many witnesses show, and how many it rests on: where so few tell less, far out (`FAR`),
    than what is stated does, that is believed as if known; so is what is more than stated, as it was shown."""
    known = max(scale, 1.0)
    if n_witnesses < 1.0 or scale * -stdtrit(n_witnesses, 0.5 * FAR) > known * -ndtri(0.5 * FAR):
        return known, NORMAL
    return scale, n_witnesses


def scales_asked(means: Floats, own2: Floats, stated: Floats) -> Floats:
    """Return the scale (p, s) of what is stated from which on each patch lies within its sigma as `INNER` of all do.

    Where other errors are larger than what is stated of the scans, what they are stated too small by would be a scale
    of any size: it is the scans' up to what is stated.
    """
    rest2 = np.maximum((means / quantile_of(NORMAL, INNER)) ** 2 - own2, 0.0)
    asked = np.sqrt(rest2) / np.maximum(stated, 1e-12)
    return np.where(stated**2 >= own2, asked, np.minimum(asked, 1.0))


def _inner(asked: Floats) -> float:
    """Return the scale that `INNER` of the patches ask for at most; 0 of few."""
    return float(np.quantile(asked, INNER)) if len(asked) >= FEWEST_PATCHES else 0.0
