"""A side of a comparison of which only what is stated matters."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from projects.model import Roughness


def side_of(sigmas: list[float], own: list[Roughness] | None, other: list[Roughness] | None = None) -> SimpleNamespace:
    """Return a side of which only what is stated of its vertices [m] and the roughness there in both epochs matter."""
    n, best = len(sigmas), np.zeros(len(sigmas), dtype=np.uint8)
    surfaces = [SimpleNamespace(roughness=None if c is None else np.array(c, dtype=np.uint8), sample_distance=None)
                for c in (own, other)]  # fmt: skip
    return SimpleNamespace(sigma_surfaces=np.array(sigmas), surface=surfaces[0], other=surfaces[1],
                           foot_vertices=np.arange(n), is_assessed=np.ones(n, dtype=bool), sigma_discord=np.zeros(n),
                           sigma_shared=np.zeros(n), limb=None, limb_of=lambda which: np.zeros(n)[which],
                           sigma_motion=np.zeros(n), distances=np.zeros(n),
                           to_rim=np.full(n, np.nan), view=best, gap=best, stated=best, arm=best)  # fmt: skip
