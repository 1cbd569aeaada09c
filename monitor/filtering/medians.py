"""Medians of what is known. In: values, NaN where one is not; out: medians along an axis, NaN where none is known."""

from __future__ import annotations

import numpy as np

from projects.model import Floats


def median_known(values: Floats, axis: int = -1) -> Floats:
    """Return the median of the known values along an axis; numpy's own takes one row after the other."""
    ordered = np.sort(values, axis=axis)  # NaN last
    n = np.isfinite(ordered).sum(axis=axis, keepdims=True)
    last = ordered.shape[axis] - 1
    lower, upper = np.maximum(n - 1, 0) // 2, np.minimum(n // 2, last)
    middle = 0.5 * (np.take_along_axis(ordered, lower, axis) + np.take_along_axis(ordered, upper, axis))
    return np.asarray(np.squeeze(middle, axis=axis))
