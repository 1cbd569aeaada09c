"""Neighbourhood size and noise, told at points sampled over a cloud (Nothegger and Dorninger, section 2.3).

In: the index of a cloud; out: a `NeighbourhoodModel`. Growing neighbourhoods are fitted at each sampled point. Where
noise is as thick as the largest of them is wide, they are taken from every second, fourth, ... point instead: as many
points of a surface seen from farther off.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from monitor.declare import check_settings, setting
from monitor.filtering.facing import same_facing
from monitor.filtering.nearest import PointIndex, build_index, find_nearest_sorted
from monitor.filtering.neighbourhoods import NeighbourhoodModel, find_sizes, model_noise
from monitor.filtering.tangents import COLUMNS, fit_tangents
from projects.errors import ParameterError
from projects.model import Bools, Floats, Ints

N_SIZES = 14
LEAST_SIZE = 10
WIDER = 3  # times as many are looked at in a sample where those that look away are left out
BAND = 3.0  # sigmas of the noise that a neighbourhood's radius must exceed for its normal to mean something
THIN = 5.5  # sigmas of the noise in the radius of the largest; a narrower one cuts off so much that noise seems less
MOST_STRIDE = 256  # noise of 16 spacings
LEAST_SHARE = 4  # times as many points as the largest neighbourhood has that a stride must leave
RADIUS, LAMBDA3 = COLUMNS.index("radius"), COLUMNS.index("lambda3")


@dataclass(frozen=True, kw_only=True)
class NormalSettings:
    """Robust normals: neighbourhood size and the minimum covariance determinant."""

    n_neighbours: int | None = setting(
        None,
        unit="points",
        meaning="neighbours of a tangent plane; auto: those whose normals have the least error",
        low=8,
        high=400,
    )
    min_neighbours: int = setting(
        16,
        unit="points",
        meaning="least automatic size: more than 5 times the 3 dimensions (Rousseeuw & van Driessen)",
        low=8,
        high=400,
    )
    max_neighbours: int = setting(100, unit="points", meaning="largest automatic size", low=8, high=400)
    n_samples: int = setting(600, unit="points", meaning="points at which the size is estimated", low=20, high=100_000)
    h_share: float = setting(
        0.55,
        unit="",
        meaning="share of neighbours that must agree; 1 - h_share of outliers is survived",
        low=0.5,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.min_neighbours > self.max_neighbours:
            raise ParameterError(
                f"NormalSettings.min_neighbours = {self.min_neighbours} exceeds max_neighbours = "
                f"{self.max_neighbours}; set a smaller one, or the other larger"
            )


@dataclass(frozen=True)
class _Sampled:
    """The planes of growing neighbourhoods about sampled points: neighbours (s, k), `tangents.COLUMNS` (s, j, 14)."""

    near: Ints
    rows: Floats
    model: NeighbourhoodModel

    @property
    def is_thin(self) -> Bools:
        """(s,) where the largest neighbourhood is much wider than the noise is thick."""
        return np.asarray(self.rows[:, -1, RADIUS] >= THIN * self.model.noise)

    def replaced(self, where: Bools, by: _Sampled) -> _Sampled:
        """Return these with what another has `where` (s,) holds."""
        model = dataclasses.replace(
            self.model,
            sizes=np.where(where, by.model.sizes, self.model.sizes),
            noise=np.where(where, by.model.noise, self.model.noise),
            strides=np.where(where, by.model.strides, self.model.strides),
        )
        near = np.where(where[:, None], by.near, self.near)
        return _Sampled(near, np.where(where[:, None, None], by.rows, self.rows), model)


def clean_limits(n_max: int) -> Floats:
    """Return, for each n up to `n_max`, lambda3 over the noise variance that noise alone exceeds once in a hundred."""
    degrees = np.maximum(np.arange(n_max + 1) - 3.0, 1.0)
    return chi2.ppf(0.99, degrees) / degrees


def fit_rows(index: PointIndex, which: Ints, near: Ints, n: Ints, noise: Floats, settings: NormalSettings) -> Floats:
    """Return the rows of `tangents.COLUMNS` for the points `which`."""
    limits = clean_limits(near.shape[1])
    return fit_tangents(index.points, which, np.ascontiguousarray(near), n, noise, limits, settings.h_share)


def sample_neighbourhoods(
    index: PointIndex, settings: NormalSettings, facing: Floats | None = None
) -> NeighbourhoodModel:
    """Estimate neighbourhood size and noise at points sampled evenly along the space-filling curve.

    Where normals `facing` (n, 3) are given, of neighbours that look the same way.
    """
    n_points = len(index.points)
    largest = min(max(settings.max_neighbours, settings.n_neighbours or 0), n_points)
    sizes = np.unique(np.rint(np.geomspace(min(LEAST_SIZE, largest), largest, N_SIZES)).astype(np.int64))
    which = np.unique(np.linspace(0, n_points - 1, min(settings.n_samples, n_points)).astype(np.int64))
    sampled = _look_around(index, which, sizes, 1, settings, facing)
    if settings.n_neighbours is not None:
        return dataclasses.replace(
            sampled.model, sizes=np.full(len(which), float(min(settings.n_neighbours, n_points)))
        )
    sampled = _beyond_noise(index, which, sizes, sampled, settings, facing)
    model, near = sampled.model, sampled.near
    noise = model.at(model.points)[1]
    normals = _fit_sizes(index, which, near, sizes, noise, settings)[:, :, :3]  # once more as they will be estimated
    with np.errstate(divide="ignore"):  # points that coincide never reach beyond the noise
        least = largest * (BAND * noise / sampled.rows[:, -1, RADIUS]) ** 2
    best = find_sizes(model.points, sizes, normals, least)
    return dataclasses.replace(model, sizes=np.clip(best, min(settings.min_neighbours, largest), largest))


def _beyond_noise(
    index: PointIndex, which: Ints, sizes: Ints, sampled: _Sampled, settings: NormalSettings, facing: Floats | None
) -> _Sampled:
    """Return what was sampled, of wider neighbourhoods where the noise is as thick as they are wide.

    Each is as wide as the noise asks and no wider. What is a heap at every width stays as it is; so does what is one up
    to a width that finds a thinner surface elsewhere, since too narrow a neighbourhood tells too little noise.
    """
    is_thick, stride = ~sampled.is_thin, 2
    while is_thick.any() and stride <= MOST_STRIDE and len(index.points) >= LEAST_SHARE * stride * sizes[-1]:
        wider = _look_around(index, which, sizes, stride, settings, facing)
        found = is_thick & wider.is_thin & (wider.model.noise >= sampled.model.noise)
        sampled, is_thick, stride = sampled.replaced(found, wider), is_thick & ~found, 2 * stride
    return sampled


def _look_around(
    index: PointIndex, which: Ints, sizes: Ints, stride: int, settings: NormalSettings, facing: Floats | None
) -> _Sampled:
    """Return growing neighbourhoods about the points `which`, of every `stride`-th point, and the noise they tell."""
    near = _nearest_of_sample(index, which, int(sizes[-1]), stride, facing)
    rows = _fit_sizes(index, which, near, sizes, np.zeros(len(which)), settings)
    model = model_noise(index.points[which], sizes, rows[:, :, LAMBDA3], rows[:, -1, RADIUS], int(sizes[-1]))
    return _Sampled(near, rows, dataclasses.replace(model, strides=np.full(len(which), stride)))


def _fit_sizes(
    index: PointIndex, which: Ints, near: Ints, sizes: Ints, noise: Floats, settings: NormalSettings
) -> Floats:
    """Return (s, j, 14) `tangents.COLUMNS` of each of the points `which` and each size, where the noise is known."""
    fitted = [fit_rows(index, which, near[:, :n], np.full(len(which), n), noise, settings) for n in sizes]
    return np.stack(fitted, axis=1)


def _nearest_of_sample(index: PointIndex, which: Ints, k: int, stride: int, facing: Floats | None) -> Ints:
    """Return the k nearest (m, k) of the points `which`, where there are as many of those that look the same way."""
    some = index if stride == 1 else build_index(index.points[::stride])
    if facing is None:
        return find_nearest_sorted(index, which, k, stride, some)
    near = find_nearest_sorted(index, which, min(WIDER * k, len(some.points)), stride, some)
    same, n_same = same_facing(which, near, np.full(len(which), near.shape[1]), facing)
    return np.where((n_same >= k)[:, None], same[:, :k], near[:, :k])
