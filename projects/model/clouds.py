"""Points with what is known of each, and the scan of one set-up that they come from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from projects.arrays import Bools, Floats, Ints, hold_array, require_sigmas


@dataclass(frozen=True)
class PointCloud:
    """Points with what is known of each.

    Attributes
    ----------
    points : (n, 3) float64, m.
    normals : (n, 3) float64, unit vectors towards the side from which the point was seen; NaN where unknown.
    origins : (n, 3) or (3,) float64, m, position of the scanner that measured the point, in the frame of `points`.
    sigma : (n,) float64, m, one sigma of the point along its normal.
    intensity : (n,) float32, 0 to 1.
    colors : (n, 3) uint8, red, green, blue.
    scan_index : (n,) int32, which scan of the epoch the point comes from.
    n_merged : (n,) int32, how many measurements the point stands for.
    spread : (n,) float64, m, robust one-sigma spread along the normal of the measurements merged into it.
    surface_variation : (n,) float64, lambda3 / (lambda1 + lambda2 + lambda3), Pauly et al. 2002.
    roughness : (n,) uint8, `Roughness`.
    spacing : (n,) float64, m, distance to neighbouring measurements before thinning.
    """

    points: Floats
    normals: Floats | None = None
    origins: Floats | None = None
    sigma: Floats | None = None
    intensity: Floats | None = None
    colors: NDArray[np.uint8] | None = None
    scan_index: Ints | None = None
    n_merged: Ints | None = None
    spread: Floats | None = None
    surface_variation: Floats | None = None
    roughness: NDArray[np.uint8] | None = None
    spacing: Floats | None = None

    def __post_init__(self) -> None:
        hold_array(self, "points", (None, 3), np.float64)
        n = len(self.points)
        is_shared = self.origins is not None and np.ndim(self.origins) == 1
        hold_array(self, "normals", (n, 3), np.float64)
        hold_array(self, "origins", (3,) if is_shared else (n, 3), np.float64)
        hold_array(self, "colors", (n, 3), np.uint8)
        kinds = {"sigma": np.float64, "intensity": np.float32, "scan_index": np.int32, "n_merged": np.int32,
                 "spread": np.float64, "surface_variation": np.float64, "roughness": np.uint8,
                 "spacing": np.float64}  # fmt: skip
        for name, kind in kinds.items():
            hold_array(self, name, (n,), kind)
        require_sigmas(self, "sigma", "spread")

    def __len__(self) -> int:
        return len(self.points)

    def incidence_cosines(self) -> Floats:
        """Return the cosine (n,) of the angle between each point's normal and its beam; 1 where that is not known."""
        if self.origins is None or self.normals is None:
            return np.ones(len(self))
        beams = self.origins - self.points
        cosines = np.abs(np.einsum("ij,ij->i", beams, self.normals)) / np.linalg.norm(beams, axis=1)
        return np.asarray(np.where(np.isfinite(cosines), cosines, 1.0))

    def take(self, which: Bools | Ints) -> PointCloud:
        """Return the points selected by a mask or by indices, with all that is known of them."""
        picked = {}
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            shared = f.name == "origins" and value is not None and value.ndim == 1
            picked[f.name] = value if value is None or shared else value[which]
        return PointCloud(**picked)


@dataclass(frozen=True)
class Scan:
    """One instrument set-up: measured points in the scanner's own frame, and where it stood.

    `cloud.points` are in the scan's frame; `origin` is the scanner's position in that frame (0 0 0 for nearly
    every instrument); `pose` is T_project_scanner (4, 4). `rows` and `columns` are -1 or absent where the scan is
    not a grid. `dropped` counts what was not a measurement, by reason.
    """

    name: str
    cloud: PointCloud
    pose: Floats
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    rows: Ints | None = None
    columns: Ints | None = None
    scanner: str | None = None
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.cloud)
        hold_array(self, "pose", (4, 4), np.float64)
        hold_array(self, "origin", (3,), np.float64)
        hold_array(self, "rows", (n,), np.int32)
        hold_array(self, "columns", (n,), np.int32)

    def take(self, which: Bools | Ints) -> Scan:
        """Return the scan with only the points selected."""
        rows = None if self.rows is None else self.rows[which]
        columns = None if self.columns is None else self.columns[which]
        return dataclasses.replace(self, cloud=self.cloud.take(which), rows=rows, columns=columns)
