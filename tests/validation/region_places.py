"""On which of the places that changed each region of a comparison lies, and what is said of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from projects.model import Assessment, Comparison, Floats


def places_of_regions(comparison: Comparison, places: Sequence[Floats], near: float) -> list[int]:
    """Return the place (3,) [m] that the centre of each region is nearest to, -1 where none is within `near` [m]."""
    out = []
    for centre in comparison.regions[["x", "y", "z"]].to_numpy(dtype=float):
        away = np.linalg.norm(np.array(places) - centre, axis=1)
        out.append(int(away.argmin()) if away.min() < near else -1)
    return out


def is_called_unchanged(comparison: Comparison, place: Floats) -> bool:
    """Return whether the vertex of the earlier surface next to a place (3,) [m] is called unchanged."""
    side = comparison.on_reference
    nearest = int(np.linalg.norm(side.surface.vertices - place, axis=1).argmin())
    return bool(side.assessment[nearest] == Assessment.UNCHANGED)
