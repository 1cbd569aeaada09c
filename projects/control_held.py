"""Whether control holds an epoch as a whole, as its network step recorded it.

In: the figures of a network step. Out: how many control points hold targets, and whether they leave no motion free.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def control_holds_whole(figures: Mapping[str, Any]) -> bool:
    """Return whether control holds every motion of the epoch: not with none of its points found, nor with so few, or so
    near to one line, that how sure the whole is has no figure. Where nobody recorded how many were found (the
    adjustment was switched off), the scans are taken to stand as their control says."""
    n_held, sigma = figures.get("n_control"), figures.get("sigma_position_m")
    if n_held is None:
        return True
    return n_held > 0 and sigma is not None and math.isfinite(sigma)
