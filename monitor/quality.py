"""Figures that say how well a surface fits its scans (design step 10).

In come signed distances, out come statistics.
"""

from __future__ import annotations

import numpy as np

from projects.model import Floats


def describe_distances(distances: Floats) -> dict[str, float]:
    """Return the figures of signed distances (n,) [m], NaN where unknown.

    Returns
    -------
    dict
        `bias_m` (mean), `nmad_m` (1.4826 MAD), `rmse_m`, `p95_m` (95 % quantile of the absolute values), all in
        metres and NaN where no distance is known; `unknown_share` of the points.
    """
    known = distances[np.isfinite(distances)]
    share = 1.0 - len(known) / max(1, len(distances))
    if len(known) == 0:
        return {"bias_m": np.nan, "nmad_m": np.nan, "rmse_m": np.nan, "p95_m": np.nan, "unknown_share": share}
    return {
        "bias_m": float(known.mean()),
        "nmad_m": float(1.4826 * np.median(np.abs(known - np.median(known)))),
        "rmse_m": float(np.sqrt(np.mean(known**2))),
        "p95_m": float(np.quantile(np.abs(known), 0.95)),
        "unknown_share": float(share),
    }
