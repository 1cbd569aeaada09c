"""Roughness classes: relief beyond noise alone (Nothegger and Dorninger, section 2.2; Pauly et al. 2002)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from monitor.filtering.nearest import BLOCK
from projects.model import Floats, Ints, Roughness

ROUGH_TIMES_NOISE = 3.0  # shape that outweighs the noise three times over is rough


def classify_roughness(relief2: Floats, noise: Floats, n_neighbours: Ints) -> NDArray[np.uint8]:
    """Classify points by the relief around them against what noise alone gives at that neighbourhood size.

    Parameters
    ----------
    relief2 : (n,) m2, mean square height of the neighbours over the robust plane, free of the bias of small n: lambda3
        with the neighbours that the robust plane leaves out (the flank of a groove, the far side of an edge).
    noise : (n,) m, noise alone.
    n_neighbours : (n,) neighbourhood size.

    Returns
    -------
    (n,) uint8 `Roughness`. SMOOTH: noise alone exceeds this relief in one case of a hundred; MEDIUM: more than
    that; ROUGH: three times the noise or more. Surface variation is this over the sum of the eigenvalues, which is
    that of the neighbourhood whatever the noise: comparing one compares the other.
    """
    relief2, noise, n_neighbours = np.asarray(relief2), np.asarray(noise), np.asarray(n_neighbours)
    sizes = np.arange(int(n_neighbours.max(initial=0)) + 1)
    degrees = np.maximum(sizes - 3.0, 1.0)
    limits = chi2.ppf(0.99, degrees) / degrees
    classes = np.full(len(relief2), Roughness.SMOOTH, dtype=np.uint8)
    for first in range(0, len(classes), BLOCK):  # so that nothing but the classes is as long as the points
        block = slice(first, first + BLOCK)
        ratio = relief2[block] / np.maximum(noise[block] ** 2, 1e-30)
        classes[block][ratio > limits[n_neighbours[block]]] = Roughness.MEDIUM
        classes[block][ratio > ROUGH_TIMES_NOISE**2] = Roughness.ROUGH
    return classes
