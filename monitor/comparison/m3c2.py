"""M3C2: the change between two clouds along a normal, as most programs compute it; here the second opinion.

In: two clouds, core points and cylinders along their normals. Out: mean to mean distances with Lague's linear level of
detection. Every radius is a radius; other programs' "scales" are diameters. Lague, Brodu and Leroux (2013), Accurate 3D
comparison of complex topography with terrestrial laser scanner, ISPRS J. Photogramm. 82.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.noise.level_of_detection import lague_lod95
from projects.errors import ParameterError, ShapeError
from projects.model import Bools, Floats, Ints

CHUNK = 4096  # core points looked at together: bounds the memory
FEWEST_POINTS = 4  # of each cloud in a cylinder, for a spread (Lague et al. 2013, section 3.3.1)
FEWEST_FOR_NORMAL = 3
UNIT = 1e-4  # how far a unit vector's length may be off, as rounded by files of few digits


@dataclass(frozen=True)
class M3C2Result:
    """What M3C2 says at core points; arrays (n,) but `normals` (n, 3).

    `distances` [m] are positive where the compared cloud lies on the side that the normal points to; `lod95` [m] is
    Lague's; `n_reference`, `n_compared` are the points in each cylinder and `spread_reference`, `spread_compared` [m]
    their standard deviations along the normal (divided by n, as in CloudCompare and PDAL). NaN where a cloud has too
    few points there.
    """

    distances: Floats
    lod95: Floats
    n_reference: Ints
    n_compared: Ints
    spread_reference: Floats
    spread_compared: Floats
    normals: Floats

    @property
    def is_significant(self) -> Bools:
        """Where the distance exceeds its level of detection; False where nothing is known."""
        return np.abs(self.distances) > self.lod95


def m3c2(reference_points: Floats, compared_points: Floats, core_points: Floats, *, cylinder_radius: float,
         max_depth: float, normals: Floats | None = None, normal_radius: float | None = None,
         orientation: Floats | None = None, registration_error: float = 0.0) -> M3C2Result:  # fmt: skip
    """Measure the change between two clouds along a normal at each core point, with Lague's level of detection.

    Parameters
    ----------
    reference_points, compared_points, core_points : (n, 3) m, in one frame.
    cylinder_radius : m, of the cylinder about each normal whose points are averaged.
    max_depth : m, the cylinder reaches so far to both sides of the core point.
    normals : (n, 3) unit vectors, NaN where unknown; otherwise of the plane through the reference points within
        `normal_radius` [m] of the core point, on the side of `orientation` (3,) (upwards where left out).
    registration_error : m, added linearly to the level of detection; zero calls much unchanged surface significant.

    Returns
    -------
    M3C2Result
        Distances positive along the normal, from reference to compared.

    Raises
    ------
    ShapeError, ParameterError
        For clouds that are not (n, 3) or not finite, lengths that are not positive, and normals of another length.

    Notes
    -----
    distance = mean_compared - mean_reference; lod95 = 1.96 (sqrt(s1^2 / n1 + s2^2 / n2) + registration_error).
    """
    clouds = [_require_points(p, name) for p, name in ((reference_points, "reference_points"),
              (compared_points, "compared_points"), (core_points, "core_points"))]  # fmt: skip
    reference, compared, cores = clouds
    _require_positive(cylinder_radius=cylinder_radius, max_depth=max_depth)
    if not _is_number(registration_error) or not registration_error >= 0.0:
        raise ParameterError(f"registration_error = {registration_error!r} m: must be 0 or larger")
    if normals is None:
        if normal_radius is None:
            raise ParameterError("neither normals nor normal_radius were given; give one of them")
        _require_positive(normal_radius=normal_radius)
        normals = plane_normals(reference, cores, normal_radius, _require_direction(orientation))
    else:
        normals = _require_unit(normals, cores)
    size = (cylinder_radius, max_depth)
    n1, mean1, spread1 = average_in_cylinders(reference, cores, normals, size)
    n2, mean2, spread2 = average_in_cylinders(compared, cores, normals, size)
    known = (n1 >= FEWEST_POINTS) & (n2 >= FEWEST_POINTS)
    with np.errstate(divide="ignore", invalid="ignore"):
        lod95 = lague_lod95(spread1, n1, spread2, n2, registration_error)
    return M3C2Result(np.where(known, mean2 - mean1, np.nan), np.where(known, lod95, np.nan), n1, n2, spread1, spread2,
                      np.asarray(normals, dtype=np.float64))  # fmt: skip


def plane_normals(points: Floats, cores: Floats, radius: float, orientation: Floats | None = None) -> Floats:
    """Return the unit normal (n, 3) of the plane through the points within `radius` [m]; NaN with fewer than three."""
    upwards = np.array([0.0, 0.0, 1.0]) if orientation is None else np.asarray(orientation, dtype=np.float64)
    tree = cKDTree(points)
    out = np.full((len(cores), 3), np.nan)
    for start in range(0, len(cores), CHUNK):
        here = cores[start : start + CHUNK]
        owner, which = _within(tree, here, radius)
        n = np.bincount(owner, minlength=len(here))
        offset = points[which] - here[owner]  # small numbers, wherever the clouds lie
        mean = _sums(owner, offset, len(here)) / np.maximum(n, 1)[:, None]
        offset -= mean[owner]
        products = (offset[:, :, None] * offset[:, None, :]).reshape(-1, 9)
        _, vectors = np.linalg.eigh(_sums(owner, products, len(here)).reshape(-1, 3, 3))
        normal = vectors[:, :, 0]
        normal *= np.where(normal @ upwards < 0.0, -1.0, 1.0)[:, None]
        out[start : start + CHUNK] = np.where((n >= FEWEST_FOR_NORMAL)[:, None], normal, np.nan)
    return out


def average_in_cylinders(points: Floats, cores: Floats, normals: Floats, size: tuple[float, float],
                         ) -> tuple[Ints, Floats, Floats]:  # fmt: skip
    """Return number, mean and standard deviation (n,) [m] along the normal of the points in each core's cylinder.

    `size` is the radius and the depth to both sides [m]. Long cylinders are looked up ball by ball along their axis.
    """
    radius, depth = size
    n_balls = max(int(np.ceil(depth / radius)), 1)
    half = depth / n_balls  # of the slab of the cylinder that a ball stands for
    centres = half * (2.0 * np.arange(n_balls) + 1.0) - depth
    tree = cKDTree(points)
    n, mean, spread = np.zeros(len(cores), dtype=np.int64), np.full(len(cores), np.nan), np.full(len(cores), np.nan)
    usable = np.flatnonzero(np.isfinite(normals).all(axis=1))
    for start in range(0, len(usable), CHUNK):
        rows = usable[start : start + CHUNK]
        owner, height = _gather(tree, points, cores[rows], normals[rows], (radius, half, centres))
        n[rows] = np.bincount(owner, minlength=len(rows))
        with np.errstate(divide="ignore", invalid="ignore"):
            mean[rows] = np.bincount(owner, height, minlength=len(rows)) / n[rows]
            squares = np.bincount(owner, (height - mean[rows][owner]) ** 2, minlength=len(rows))
            spread[rows] = np.sqrt(squares / n[rows])
    return n, mean, spread


def _gather(tree: cKDTree, points: Floats, cores: Floats, normals: Floats, slabs: tuple[float, float, Floats],
            ) -> tuple[Ints, Floats]:  # fmt: skip
    """Return (core, height along its normal [m]) of all points in the cylinders; each point once for each core."""
    radius, half, centres = slabs
    owners, heights = [], []
    last = len(centres) - 1
    for k, centre in enumerate(centres):
        owner, which = _within(tree, cores + centre * normals, np.hypot(radius, half) * (1.0 + 1e-12))
        offset = points[which] - cores[owner]
        height = np.einsum("ij,ij->i", offset, normals[owner])
        aside2 = np.einsum("ij,ij->i", offset, offset) - height**2
        above, below = height >= centre - half, (height < centre + half) | ((k == last) & (height <= centre + half))
        inside = (aside2 <= radius**2) & above & below
        owners.append(owner[inside])
        heights.append(height[inside])
    return np.concatenate(owners), np.concatenate(heights)


def _within(tree: cKDTree, centres: Floats, radius: float) -> tuple[Ints, Ints]:
    """Return all pairs (centre, point) no farther apart than `radius` [m]."""
    found = tree.query_ball_point(centres, radius, workers=-1, return_sorted=True)
    owner = np.repeat(np.arange(len(centres)), [len(f) for f in found])
    return owner, np.concatenate([np.asarray(f, dtype=np.int64) for f in found]) if len(owner) else owner


def _sums(owner: Ints, values: Floats, n: int) -> Floats:
    """Return the sum (n, k) of the rows of `values` for each owner."""
    return np.column_stack([np.bincount(owner, column, minlength=n) for column in values.T])


def _require_points(points: Floats, name: str) -> Floats:
    """Return the points as float64 (n, 3), all finite, or raise `ShapeError`."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ShapeError(f"{name} have shape {array.shape}; (n, 3) is needed")
    n_bad = int((~np.isfinite(array)).any(axis=1).sum())
    if n_bad:
        raise ShapeError(f"{name}: {n_bad} of {len(array)} are not finite; leave them out")
    return array


def _require_unit(normals: Floats, cores: Floats) -> Floats:
    """Return the normals (n, 3) of the core points, NaN where unknown; raise where one has another length than 1."""
    if np.shape(normals) != cores.shape:
        raise ShapeError(f"normals have shape {np.shape(normals)}; {cores.shape} is needed")
    array = np.asarray(normals, dtype=np.float64)
    lengths = np.linalg.norm(array, axis=1)
    off = np.abs(lengths - 1.0) > UNIT  # NaN is not
    if off.any():
        raise ParameterError(
            f"normals: {int(off.sum())} of {len(array)} are no unit vectors, the first is {lengths[off][0]:.6g} long; "
            "divide each by its length"
        )
    return array


def _require_direction(orientation: Floats | None) -> Floats | None:
    """Return the direction (3,) that normals look to, None where none is given; raise `ShapeError` for another."""
    if orientation is None:
        return None
    if np.shape(orientation) != (3,) or not np.isfinite(np.asarray(orientation, dtype=np.float64)).all():
        raise ShapeError(f"orientation {orientation!r}: a direction (3,) of finite numbers is needed")
    return np.asarray(orientation, dtype=np.float64)


def _is_number(value: object) -> bool:
    """Return whether a value is one real number."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _require_positive(**lengths: float) -> None:
    """Raise `ParameterError` for a length that is not positive."""
    for name, value in lengths.items():
        if not _is_number(value) or not 0.0 < value < np.inf:
            raise ParameterError(f"{name} = {value!r} m: must be larger than 0, and finite")
