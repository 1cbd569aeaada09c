"""What the header of an E57 scan states of all its points, gathered block by block: limits, bounds, field of view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from projects.model import Floats

N_SECTORS = 1 << 16  # of azimuth, in which the field of view is looked for


@dataclass
class Extremes:
    """The least and the greatest of each field of a scan, of ranges and elevations, and the azimuths in sectors."""

    low: dict[str, float] = field(default_factory=dict)
    high: dict[str, float] = field(default_factory=dict)
    sectors: Floats = field(default_factory=lambda: np.tile([[np.inf], [-np.inf]], N_SECTORS))

    def add(self, fields: Mapping[str, Any]) -> None:
        """Take a block in."""
        x, y, z = (fields[f"cartesian{axis}"] for axis in "XYZ")
        angles = {"range": np.sqrt(x * x + y * y + z * z), "elevation": np.arctan2(z, np.hypot(x, y))}
        for name, values in (*fields.items(), *angles.items()):
            self.low[name] = min(self.low.get(name, values.min()), values.min())
            self.high[name] = max(self.high.get(name, values.max()), values.max())
        azimuth = np.arctan2(y, x)
        sector = ((azimuth + np.pi) / (2.0 * np.pi) * N_SECTORS).astype(np.int64).clip(0, N_SECTORS - 1)
        np.minimum.at(self.sectors[0], sector, azimuth)
        np.maximum.at(self.sectors[1], sector, azimuth)

    def field_of_view(self) -> tuple[float, float]:
        """Return where the azimuths [rad] start and, up from there, end: outside lies the widest empty sector."""
        first, last = self.sectors[:, np.isfinite(self.sectors[0])]
        gaps = np.append(first[1:], first[0] + 2.0 * np.pi) - last
        widest = int(gaps.argmax())
        start, end = float(first[(widest + 1) % len(first)]), float(last[widest])
        return start, end + (2.0 * np.pi if end < start else 0.0)


def header_bounds(extremes: Extremes) -> dict[str, dict[str, Any]]:
    """Return the header's bounds and limits: of coordinates, indices, intensity and colour."""
    low, high = extremes.low, extremes.high
    box: dict[str, Any] = {}
    for axis in "xyz":
        name = f"cartesian{axis.upper()}"
        box |= {f"{axis}Minimum": float(low[name]), f"{axis}Maximum": float(high[name])}
    bounds = {"cartesianBounds": box, "sphericalBounds": _spherical_bounds(extremes)}
    if "rowIndex" in low:
        index: dict[str, Any] = {}
        for name in ("row", "column"):
            index |= {f"{name}Minimum": int(low[f"{name}Index"]), f"{name}Maximum": int(high[f"{name}Index"])}
        bounds["indexBounds"] = {**index, "returnMinimum": 0, "returnMaximum": 0}
    if "intensity" in low:
        bounds["intensityLimits"] = {"intensityMinimum": 0.0, "intensityMaximum": 1.0}
    if "colorRed" in low:
        limits = {"Minimum": 0, "Maximum": 255}
        bounds["colorLimits"] = {f"color{c}{k}": v for c in ("Red", "Green", "Blue") for k, v in limits.items()}
    return bounds


def _spherical_bounds(extremes: Extremes) -> dict[str, Any]:
    """Return ranges [m], elevations and azimuths [rad]; azimuths run from start up to end, which may lie beyond pi."""
    bounds: dict[str, Any] = {}
    for name in ("range", "elevation"):
        bounds |= {f"{name}Minimum": float(extremes.low[name]), f"{name}Maximum": float(extremes.high[name])}
    start, end = extremes.field_of_view()
    return bounds | {"azimuthStart": start, "azimuthEnd": end}
