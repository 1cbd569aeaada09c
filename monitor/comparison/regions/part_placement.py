"""What the scans' own placement adds to the uncertainty of a part's motion.

In: a comparison and the places of a part on both of its surfaces. Out: a covariance (6, 6) to be added to that of the
motion. A scan that stands a little off takes all that it saw of a part with it: the fit of the part, by which its
motion was measured, is as good as ever, and no residual tells of it.
"""

from __future__ import annotations

import numpy as np

from monitor.comparison.noise.patch_errors import NORMAL
from monitor.comparison.noise.scan_errors import AS_STATED, ScanErrors
from projects.model import Bools, ComparedSurface, Comparison, Floats, NotAssessed


def placement_of(comparison: Comparison, on_compared: Bools, on_reference: Bools, centre: Floats) -> Floats:
    """Return the covariance (6, 6) of (w, t) [rad, m] about `centre` (3,), by which scans may put a part elsewhere.

    `on_compared` (n,) and `on_reference` (m,) are the vertices of the part. The scans of both epochs are off by what
    they are stated to disagree by there, as the comparison's unchanged patches bear it out, in any direction, and are
    turned by as much over the object, whose width is the root mean square distance from the centre.
    """
    stated = np.hypot(_stated_over(comparison.on_compared, on_compared),
                      _stated_over(comparison.on_reference, on_reference))  # fmt: skip
    variance = float(_scan_errors(comparison).sigma_of(np.asarray(stated))) ** 2
    side = comparison.on_compared
    away = side.surface.vertices[side.reasons == NotAssessed.ASSESSED] - centre
    width2 = float(np.mean(np.einsum("ij,ij->i", away, away)))
    return np.diag([variance / width2] * 3 + [variance] * 3)


def _stated_over(side: ComparedSurface, which: Bools) -> float:
    """Return the mean [m] of what scans are stated to disagree by, over those of some vertices where it is stated; 0
    where it is at none, as for a finished mesh."""
    shared = side.surface.sigma_shared
    stated = np.zeros(0) if shared is None else shared[which]
    stated = stated[np.isfinite(stated)]
    return float(stated.mean()) if len(stated) else 0.0


def _scan_errors(comparison: Comparison) -> ScanErrors:
    """Return how much of what is stated of the scans is error, as the comparison says."""
    scales, steps = (comparison.statistics.get(f"error_{name}") for name in ("scales_scans", "steps_scans_m"))
    if not scales:
        return AS_STATED
    return ScanErrors(np.asarray(steps), np.asarray(scales), np.full(len(scales), NORMAL))
