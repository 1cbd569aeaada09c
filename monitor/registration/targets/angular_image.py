"""A scan as an image: one pixel for each direction of its grid, with the point and the intensity measured there.

In: `Scan`, whose rows and columns are used where it has them; otherwise the directions of its points are put on a grid
of their own. Out: `AngularImage` and its coarser versions, in which targets near the scanner are as small as far ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from projects.model import Bools, Floats, Ints, Scan

N_FOR_STEP = 2_000  # points that tell the angular steps
N_BESIDE = 8  # of each, the nearest
ROOM = 1.2  # of a step is a pixel, so that none stays empty
MOST_PIXELS_PER_POINT = 50.0  # a grid emptier than this is no scan from one station
SEAM = 0.15  # rad, of the first columns are repeated after a full turn, so that no target is cut in two


@dataclass(frozen=True)
class AngularImage:
    """Points (h, w, 3) [m] from the scanner, NaN where nothing was measured, and their intensity (h, w).

    `step_rows` and `step_columns` [rad] lie between neighbouring pixels; a column's step shrinks with the cosine of
    the elevation. `factor` pixels of the finest image make one of this along each side.
    """

    points: Floats
    intensity: Floats
    step_rows: float
    step_columns: float
    factor: int = 1

    @property
    def ranges(self) -> Floats:
        """Distance (h, w) [m] from the scanner."""
        return np.asarray(np.linalg.norm(self.points, axis=2))

    def density(self, direction: Floats) -> float:
        """Return pixels per steradian about a direction (3,)."""
        cosine = float(np.hypot(direction[0], direction[1]) / np.linalg.norm(direction))
        return 1.0 / (self.step_rows * self.step_columns * max(cosine, 0.01))

    def coarser(self) -> AngularImage:
        """Return the image with two by two pixels averaged; a pixel is empty where half of its four are."""
        h, w = (n - n % 2 for n in self.intensity.shape)
        blocks = np.stack([self.points[i:h:2, j:w:2] for i in (0, 1) for j in (0, 1)])
        values = np.stack([self.intensity[i:h:2, j:w:2] for i in (0, 1) for j in (0, 1)])
        measured = np.isfinite(blocks[..., 0])
        n = measured.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            points = np.where(measured[..., None], blocks, 0.0).sum(axis=0) / n[..., None]
            intensity = np.where(measured, values, 0.0).sum(axis=0) / n
        points[n < 3], intensity[n < 3] = np.nan, np.nan
        return AngularImage(points, intensity, 2 * self.step_rows, 2 * self.step_columns, 2 * self.factor)


def make_image(scan: Scan) -> AngularImage | None:
    """Return the scan as an image, or None where its points do not look like those of one station."""
    points = scan.cloud.points - scan.origin
    usable = np.isfinite(points).all(axis=1) & (np.einsum("ni,ni->n", points, points) > 0)
    if usable.sum() < 100:
        return None
    intensity = np.full(len(points), np.nan) if scan.cloud.intensity is None else scan.cloud.intensity.astype(float)
    rows, columns = _grid(scan, points, usable)
    rows, columns = rows - rows[usable].min(), columns - columns[usable].min()
    h, w = int(rows[usable].max()) + 1, int(columns[usable].max()) + 1
    if h * w > MOST_PIXELS_PER_POINT * usable.sum():
        return None
    image, values = np.full((h, w, 3), np.nan), np.full((h, w), np.nan)
    image[rows[usable], columns[usable]] = points[usable]
    values[rows[usable], columns[usable]] = intensity[usable]
    steps = _steps(image)
    if not np.isfinite(steps).all():
        return None
    return _close_turn(AngularImage(image, values, *steps))


def _grid(scan: Scan, points: Floats, usable: Bools) -> tuple[Ints, Ints]:
    """Return the row and column (n,) of each point: its own, or where its direction falls."""
    if scan.rows is not None and scan.columns is not None and min(scan.rows.min(), scan.columns.min()) >= 0:
        return scan.rows.astype(np.int64), scan.columns.astype(np.int64)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    step_rows, step_columns = _direction_steps(elevation[usable], azimuth[usable])
    with np.errstate(invalid="ignore"):
        rows, columns = np.floor(elevation / step_rows), np.floor(azimuth / step_columns)
    rows[~usable], columns[~usable] = 0, 0
    return rows.astype(np.int64), columns.astype(np.int64)


def _direction_steps(elevation: Floats, azimuth: Floats) -> tuple[float, float]:
    """Return the usual step [rad] of the elevations (n,), and that of the azimuths (n,), of neighbouring directions.

    Where a scanner's rows are as far apart as its columns are at the horizon, directions above and below lie nearer to
    each other: the angle between them is no step of either. Neighbours above and beside each other tell each its own.
    """
    directions = np.stack([elevation, azimuth], axis=1)
    some = directions[:: max(len(directions) // N_FOR_STEP, 1)]
    _, near = cKDTree(directions).query(some, k=min(N_BESIDE + 1, len(directions)))
    apart = np.abs(directions[near[:, 1:]] - some[:, None])
    steps = []
    for axis in (0, 1):
        along = np.where(apart[..., axis] > apart[..., 1 - axis], apart[..., axis], np.inf).min(axis=1)
        steps.append(float(np.median(along[np.isfinite(along)])) if np.isfinite(along).any() else np.inf)
    either = min(steps)
    return tuple(max(ROOM * (s if np.isfinite(s) else either), 1e-6) for s in steps)  # type: ignore[return-value]


def _steps(image: Floats) -> tuple[float, float]:
    """Return the angles [rad] between neighbouring rows, and between columns at the horizon."""
    elevation = np.arctan2(image[..., 2], np.hypot(image[..., 0], image[..., 1]))
    azimuth = np.arctan2(image[..., 1], image[..., 0])
    down = np.abs(np.diff(elevation, axis=0))
    across = np.abs((np.diff(azimuth, axis=1) + np.pi) % (2.0 * np.pi) - np.pi)
    if not (np.isfinite(down).any() and np.isfinite(across).any()):
        return float("nan"), float("nan")
    return float(np.nanmedian(down)), float(np.nanmedian(across))


def _close_turn(image: AngularImage) -> AngularImage:
    """Return the image with its first columns repeated at the end where it goes all the way round."""
    w = image.intensity.shape[1]
    if w * image.step_columns < 2.0 * np.pi - 2.0 * image.step_columns:
        return image
    n = int(SEAM / image.step_columns)
    return AngularImage(
        np.concatenate([image.points, image.points[:, :n]], axis=1),
        np.concatenate([image.intensity, image.intensity[:, :n]], axis=1),
        image.step_rows, image.step_columns,
    )  # fmt: skip
