"""Lengths as messages and records tell them, on an ivory as on a facade: in millimetres, with two digits at least.

In: a length in metres. Out: its words. The report words its own numbers by their margins (`reports.quantities`).
"""

from __future__ import annotations

import math


def in_millimetres(metres: float) -> str:
    """Return a length [m] in millimetres with two digits or more and no exponent: 0.035 mm, 2.4 mm, 240 mm."""
    value = 1e3 * metres
    decimals = max(1 - math.floor(math.log10(abs(value))), 0) if math.isfinite(value) and value != 0.0 else 0
    return f"{value:.{decimals}f} mm"
