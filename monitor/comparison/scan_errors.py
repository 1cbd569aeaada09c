"""How much of what scans are stated to disagree by is error of a change, as the means of unchanged patches show it.

In: patches of every size of both sides. Out: `ScanErrors`, a scale of what is stated, by how much that is, and how many
witnesses it rests on. Both epochs were seen alike, by the same scanner and from the same places, so that much of what
their scans disagree by is the same in both and falls out of the change; or it does not, where scans were placed anew.
Single vertices hardly know which: their own noise hides it. In patches that averages out, and what scans disagree by is
left. It agrees far along a surface, so that few places bear witness of it; where much is stated, fewer still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtr, stdtrit

from monitor.comparison.noise import STATED_WITNESSES, believe
from monitor.comparison.patch_errors import HARDLY_T, INNER, NORMAL, quantile_of
from projects.model import Floats, Ints

ALIKE = 0.05  # of the surface's area, over which what scans disagree by is taken to agree: as wide as any patch tested
STATED_BEYOND = (0.0, 0.5, 0.8, 0.95)  # shares of the patches, beyond which more is stated: each has its own scale
FEWEST_PATCHES = 20  # of a size, that show a scale
FAR = 1e-6  # p value of a patch that is significant among all of a surface
LEAST_SCALE = 0.25  # what is stated may be off by a factor of two, one sigma; of one place by four


@dataclass(frozen=True)
class ScanErrors:
    """What is stated of the scans times `scales` (c,), of which each holds from `steps` (c,) [m] stated on, the first
    from 0; as sure as `n_witnesses` (c,) independent places are."""

    steps: Floats
    scales: Floats
    n_witnesses: Floats

    def _class_of(self, stated: Floats) -> Ints:
        """Return which of the scales holds for what is `stated` [m]."""
        return np.asarray(np.searchsorted(self.steps, stated, side="right") - 1)

    def sigma_of(self, stated: Floats) -> Floats:
        """Return one sigma [m] of the mean over a place, of what is `stated` [m] of it in the mean; of any shape."""
        return np.asarray(self.scales[self._class_of(stated)] * stated)

    def dof_of(self, sigma2: Floats, stated: Floats) -> Floats:
        """Return the degrees of freedom of a mean with the variance `sigma2` [m2], the scans' part of it included, of
        which alone the size is estimated (Satterthwaite 1946); at most `NORMAL`."""
        share = np.divide(self.sigma_of(stated) ** 2, sigma2, out=np.zeros(np.shape(stated)), where=sigma2 > 0.0)
        return np.asarray(np.minimum(self.n_witnesses[self._class_of(stated)] / np.maximum(share**2, 1e-200), NORMAL))

    def as_normal(self, z: float, sigma: float, stated: float) -> float:
        """Return how many sigmas off zero a normal distribution has the p value of a mean that lies `z` of its `sigma`
        [m] off, of which so much [m] is `stated` of the scans."""
        dof = float(self.dof_of(np.array(sigma**2), np.array(stated)))
        return z if dof >= HARDLY_T else float(-np.sign(z) * ndtri(stdtr(dof, -abs(z))))


AS_STATED = ScanErrors(np.zeros(1), np.ones(1), np.full(1, NORMAL))


def learn_scans(means: Floats, own2: Floats, stated: Floats, calm_share: float) -> ScanErrors:
    """Return what calm patches show of the errors of scans.

    A scale is what nine tenths of the means of a size, their other errors taken off, lie within (`INNER`), of the size
    that shows most; where more is stated it may be larger, never smaller. What is stated counts for `STATED_WITNESSES`,
    since it may be off by a factor of two; no single place is believed to err by less than a quarter of it.

    Parameters
    ----------
    means, own2, stated : (p, s), m, m2, m, of each size of patch; the variance of all but the scans, and what is stated
        of these. NaN means of patches that are not calm.
    calm_share : of all patches, that are.
    """
    is_known = np.isfinite(means)
    of_units = stated[is_known[:, 0], 0]
    if len(of_units) < FEWEST_PATCHES or not of_units.max() > 0.0:
        return AS_STATED
    asked = scales_asked(means, own2, stated)
    steps = np.quantile(of_units, STATED_BEYOND)
    steps[0] = 0.0
    scales = np.ones(len(steps))
    for k, step in enumerate(steps):
        before, least = (scales[k - 1],) * 2 if k else (1.0, LEAST_SCALE)
        shown = max(_inner(asked[is_known[:, size] & (stated[:, size] >= step), size])
                    for size in range(means.shape[1]))  # fmt: skip
        n_witnesses = calm_share * (1.0 - STATED_BEYOND[k]) / ALIKE
        scales[k] = before * believe(max(shown, least) / before, n_witnesses, STATED_WITNESSES)
    return ScanErrors(steps, *believe_stated(scales, calm_share / ALIKE))


def believe_stated(scales: Floats, n_witnesses: float) -> tuple[Floats, Floats]:
    """Return the scales (c,), which `n_witnesses` show, and how many each rests on: where so few tell less, far out
    (`FAR`), than if all were as stated and known, that is believed, or what is more than stated."""
    known = np.maximum(scales, 1.0)
    is_vague = scales * -stdtrit(max(n_witnesses, 1.0), 0.5 * FAR) > known * -ndtri(0.5 * FAR)
    return np.where(is_vague, known, scales), np.where(is_vague, NORMAL, n_witnesses)


def scales_asked(means: Floats, own2: Floats, stated: Floats) -> Floats:
    """Return the scale (p, s) of what is stated from which on each patch lies within its sigma as `INNER` of all do."""
    rest2 = np.maximum((means / quantile_of(NORMAL, INNER)) ** 2 - own2, 0.0)
    return np.asarray(np.sqrt(rest2) / np.maximum(stated, 1e-300))


def _inner(asked: Floats) -> float:
    """Return the scale that `INNER` of the patches ask for at most; 0 of few."""
    return float(np.quantile(asked, INNER)) if len(asked) >= FEWEST_PATCHES else 0.0
