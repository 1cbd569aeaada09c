"""How large a change must be to be told, by how wide it is: the test of patches, turned around.

In: what was detected. Out: the mean change that the patch of each unit needs, and medians over the surface for patches
of every size. A level of detection says what one vertex exceeds by chance in one case of twenty. A change is told where
a patch is significant among all patches tested, whose mean holds what no averaging takes off: what scans disagree by,
as far as patches show it (`scan_errors`), and the registration. That takes a larger one.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from monitor.comparison.detection.patches import REACHES, Patches, measure_patches
from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.noise.patch_errors import PatchErrors
from projects.model import Floats

TOLD = 0.95  # of changes so large are told
POWER = float(norm.ppf(TOLD))  # sigmas beyond what is significant


def patches_needed(sides: tuple[Side, Side], found: Detected) -> tuple[Floats, Floats]:
    """Return the mean change [m] that patches of every size around each unit (u, s) of both sides need to be told in
    `TOLD` of all cases; NaN for scraps.

    NaN where not both surfaces state their noise: the tails of patches are learned then (`patch_errors`), so far out
    from so few that what a change needs may be a third of what they say, or more, and changes teach them too.
    """
    test, layout = found.test, found.layout
    n_tested = test.n_tested // 2 if sides[0] is sides[1] else test.n_tested  # rates have one side, which counts twice
    p = test.level / max(n_tested, 1)

    def of_side(k: int) -> Floats:
        """Return those of side k."""
        patches = measure_patches(layout.outlines[k], test.units[k], layout.reaches[k], found.noise.correlation,
                                  test.scans)  # fmt: skip
        return needed(patches, test.errors, p) if sides[k].states_noise else np.full(patches.sigmas.shape, np.nan)

    return map_sides(of_side, larger_of(sides))


def needed(patches: Patches, errors: tuple[PatchErrors, ...], p: float) -> Floats:
    """Return the change [m] that each patch (u, s) needs to have a p value of at most `p` in `TOLD` of all cases."""
    columns = [e.needed(patches.kinds, patches.dofs[:, k], p, POWER) for k, e in enumerate(errors)]
    return np.where(patches.is_whole, np.column_stack(columns) * patches.sigmas, np.nan)


def by_width(needs: tuple[Floats, Floats], size: float) -> Floats:
    """Return how wide [m] a change is that holds a whole patch of each size wherever it lies, and how large [m] it must
    be to be told (s, 2), smallest first: the median over both sides. One that is wider holds smaller patches too.

    The middle of a unit lies within half a unit's diagonal of any place, and its corners as far from that again.
    """
    radii = np.array(REACHES[: needs[0].shape[1]])  # of a unit's edge, to the centres of the units within
    widths = size * 2.0 * (radii + np.sqrt(2.0))
    medians = [float(np.nanmedian(v)) if np.isfinite(v).any() else np.nan for v in np.concatenate(needs).T]
    return np.column_stack([widths, np.fmin.accumulate(medians)])
