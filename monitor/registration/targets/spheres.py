"""Sphere targets in a scan: where normals meet in one point at the radius of a usual target, and the fit to its points.

In: the scan as an image, and the radii that spheres may have. Out: `SurveyTarget`s, each tested for its size, for how
much of it was seen, for residuals no larger than the noise, and for standing free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import label

from monitor.registration.targets.angular_image import AngularImage
from monitor.robust import robust_scale, tukey_weights
from projects.model import Bools, Floats, Ints, SurveyTarget

PIXELS_ACROSS = 8.0, 18.0  # of a sphere in the image that it is looked for in
MEET = 0.25  # of the radius: how near the ends of neighbouring normals must come
FEWEST_SHARE = 0.1  # of the pixels of a sphere whose normals must meet
STEEPEST = np.sin(np.radians(60.0))  # beyond this incidence the footprint is no longer on the sphere alone
FREE_RING = 1.2, 1.5  # of the radius, where the background must not be the sphere's own neighbourhood
SURE = 4.0  # sigmas of a free radius, within which it may be
N_STEPS = 12
_Candidate = tuple[Floats, tuple[int, int]]
N_BLOCKS_ACROSS = 7  # blocks whose residuals are summed: noise that neighbours share counts


@dataclass(frozen=True)
class SphereRules:
    """What a sphere must be: one of the `radii` [m], and the limits of TargetSettings."""

    radii: tuple[float, ...]
    completeness: float
    roughness: float
    size: float


@dataclass(frozen=True)
class _Sphere:
    """A sphere, its pixels, and the other radii (k,) [m] that its points would bear as well."""

    target: SurveyTarget
    cut: _Cut
    others: tuple[float, ...]


def find_spheres(finest: AngularImage, rules: SphereRules) -> list[SurveyTarget]:
    """Return the sphere targets of a scan, with centres in its frame about the scanner.

    Where the points of one do not tell which of two usual radii it has, it has that of the spheres beside it which do:
    a survey's are of one kind. A wrong radius puts the centre off by the difference, along the line of sight; where no
    other sphere tells, the covariance says so.
    """
    found = _search(finest, rules)
    told = tuple(sorted({s.target.radius for s in found if not s.others}))
    return _without_doubles([_settle_radius(s, told, rules) if s.others else s.target for s in found])


def _settle_radius(sphere: _Sphere, told: tuple[float, ...], rules: SphereRules) -> SurveyTarget:
    """Return a sphere that may have several radii: with one that others have (`told`), else as unsure as that is."""
    target, points = sphere.target, sphere.cut.points[sphere.cut.measured]
    if target.radius in told:
        return target
    for radius in sorted(set(told) & set(sphere.others), key=lambda r: abs(r - target.radius)):
        again = _test_sphere(sphere.cut, target.centre, radius, replace(rules, radii=(radius,)))
        if again is not None:
            return again.target
    farthest = max(abs(r - target.radius) for r in sphere.others)
    is_on = np.abs(np.linalg.norm(points - target.centre, axis=1) - target.radius) < farthest
    return replace(target, covariance=target.covariance + _of_radius(points[is_on], target.centre, farthest**2))


def _search(finest: AngularImage, rules: SphereRules) -> list[_Sphere]:
    """Return the spheres of a scan, some of them twice, each with the radius that is nearest to what its points say."""
    found: list[_Sphere] = []
    image = finest
    while min(image.intensity.shape) >= PIXELS_ACROSS[0]:
        normals, step = _normals(image.points), image.step_rows
        across = 2.0 / (image.ranges * step)  # pixels for a radius of one metre
        for radius in rules.radii:
            at_range = (across >= PIXELS_ACROSS[0] / radius) & (across <= PIXELS_ACROSS[1] / radius)
            for centre, pixel in _candidates(image, normals, at_range, radius):
                if not any(np.linalg.norm(s.target.centre - centre) < 0.5 * s.target.radius for s in found):
                    cut = _cut_out(finest, pixel, centre, FREE_RING[1] * radius)
                    sphere = _test_sphere(cut, centre, radius, rules)
                    found += [] if sphere is None else [sphere]
        image = image.coarser()
    return found


def _without_doubles(found: list[SurveyTarget]) -> list[SurveyTarget]:
    """Return each sphere once, as the one that fits best of those that lie in each other."""
    kept: list[SurveyTarget] = []
    for target in sorted(found, key=lambda t: -t.n_points):
        if all(np.linalg.norm(t.centre - target.centre) > t.radius for t in kept):
            kept.append(target)
    return kept


def _candidates(image: AngularImage, normals: Floats, at_range: Bools, radius: float) -> list[_Candidate]:
    """Return where the normals of enough neighbouring pixels meet at the depth of the radius, and the finest pixel.

    Of the pixels `at_range` those meet whose neighbours' normals end near each other, along rows and along columns.
    """
    i, j = np.nonzero(at_range[2:-2, 2:-2])
    i, j = i + 2, j + 2

    def apart(di: int, dj: int) -> Floats:
        a, b = (i + di, j + dj), (i - di, j - dj)
        return np.asarray(
            np.linalg.norm(image.points[a] - image.points[b] - radius * (normals[a] - normals[b]), axis=1)
        )

    near = apart(0, 1) < MEET * radius
    i, j = i[near], j[near]
    near = apart(1, 0) < MEET * radius
    i, j = i[near], j[near]
    meets = np.zeros(at_range.shape, dtype=bool)
    meets[i, j] = True
    numbers, n = label(meets, structure=np.ones((3, 3)))
    member = numbers[i, j]
    ends = image.points[i, j] - radius * normals[i, j]
    count = np.bincount(member, minlength=n + 1)
    centres = []
    for k in np.flatnonzero(count >= 4):
        centre = np.median(ends[member == k], axis=0)
        seen = np.pi * (radius / np.linalg.norm(centre)) ** 2 * image.density(centre)
        if count[k] >= FEWEST_SHARE * seen:
            pixel = int(np.median(i[member == k])), int(np.median(j[member == k]))
            centres.append((centre, ((2 * pixel[0] + 1) * image.factor // 2, (2 * pixel[1] + 1) * image.factor // 2)))
    return centres


def _normals(points: Floats) -> Floats:
    """Return unit normals (h, w, 3) towards the scanner from the two pixels on each side; NaN at gaps and borders."""
    across, down = np.full(points.shape, np.nan), np.full(points.shape, np.nan)
    across[:, 1:-1] = points[:, 2:] - points[:, :-2]
    down[1:-1] = points[2:] - points[:-2]
    normals = np.cross(across, down)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    away = np.einsum("hwi,hwi->hw", normals, points) > 0
    normals[away] *= -1.0
    return normals


@dataclass(frozen=True)
class _Cut:
    """The pixels of the finest image about a candidate: points (h, w, 3) and where they are measured."""

    points: Floats
    measured: Bools
    density: float


def _cut_out(image: AngularImage, pixel: tuple[int, int], centre: Floats, reach: float) -> _Cut:
    """Return the part of the finest image whose directions pass within `reach` [m] of the centre."""
    level = float(np.hypot(centre[0], centre[1]) / np.linalg.norm(centre))
    half = 1.5 * reach / np.linalg.norm(centre) / np.array([image.step_rows, image.step_columns * max(level, 0.02)])
    low, high = np.maximum(np.array(pixel) - half, 0.0).astype(int), (np.array(pixel) + half + 2.0).astype(int)
    points = image.points[low[0] : high[0], low[1] : high[1]]
    return _Cut(points, np.isfinite(points[..., 0]), image.density(centre))


def _test_sphere(cut: _Cut, start: Floats, radius: float, rules: SphereRules) -> _Sphere | None:
    """Return the sphere at a candidate's place, or None where it is none."""
    points = cut.points[cut.measured]
    centre, is_on = _fit(points, start, radius, free=False)[:2]
    if is_on.sum() < 30 or np.linalg.norm(centre - start) > radius:
        return None
    centre, is_on, free_radius, covariance = _fit(points[is_on], centre, radius, free=True)
    if is_on.sum() < 30:
        return None
    nearest = min(rules.radii, key=lambda r: abs(r - free_radius))
    sigma_radius = float(np.sqrt(max(covariance[3, 3], 0.0)))
    if (
        not abs(free_radius - nearest) <= max(SURE * sigma_radius, rules.size * nearest)
        or sigma_radius > 0.02 * nearest
    ):
        return None
    centre, is_on, _, covariance = _fit(points, centre, nearest, free=False)
    if is_on.sum() < 30:
        return None
    covariance = covariance + _of_radius(points[is_on], centre, (free_radius - nearest) ** 2)
    target = _judge(cut, centre, nearest, (is_on, covariance), rules)
    others = tuple(r for r in rules.radii if r != nearest and abs(r - free_radius) <= SURE * sigma_radius)
    return None if target is None else _Sphere(target, cut, others)


def _judge(
    cut: _Cut, centre: Floats, radius: float, fit: tuple[Bools, Floats], rules: SphereRules
) -> SurveyTarget | None:
    """Return the target where it is complete, as smooth as the noise, and stands free."""
    is_on, covariance = fit
    points = cut.points[cut.measured]
    seen = np.pi * (STEEPEST * radius / np.linalg.norm(centre)) ** 2 * cut.density
    completeness = min(float(is_on.sum()) / seen, 1.0)
    residuals = np.linalg.norm(points[is_on] - centre, axis=1) - radius
    rms = float(np.sqrt(np.mean(residuals**2)))
    if completeness < rules.completeness or rms > max(rules.roughness * _noise(cut, centre, radius), 1e-6):
        return None
    if _share_around(points, cut.density, centre, radius) > 0.5:
        return None
    return SurveyTarget("sphere", centre, covariance, radius, rms, int(is_on.sum()), completeness)


def _fit(points: Floats, start: Floats, radius: float, *, free: bool) -> tuple[Floats, Bools, float, Floats]:
    """Return centre, which points count, radius and covariance of (centre[, radius]) of a robust fit.

    The scale of the residuals starts at what a wrong start allows and shrinks to that of the points themselves.
    """
    centre, gate = start, 0.15 * radius
    for _ in range(N_STEPS):
        rows, residuals, facing = _sphere_rows(points, centre, radius, free)
        keep = facing & (np.abs(residuals) < gate)
        if keep.sum() < 10:
            return centre, keep, radius, np.full((4, 4), np.inf)
        sigma = max(robust_scale(residuals[keep]), 1e-9)
        weights = tukey_weights(residuals[keep] / (1.5 * sigma))
        delta = _solve(rows[keep], residuals[keep], weights)
        centre, radius = centre + delta[:3], radius + (float(delta[3]) if free else 0.0)
        gate = max(min(gate, max(0.5 * gate, 5.0 * sigma)), 5.0 * sigma)
    rows, residuals, facing = _sphere_rows(points, centre, radius, free)
    sigma = max(robust_scale(residuals[facing & (np.abs(residuals) < gate)]), 1e-9)
    is_on = facing & (np.abs(residuals) < 4.0 * sigma)
    if is_on.sum() < 10:
        return centre, is_on, radius, np.full((4, 4), np.inf)
    covariance = clustered_covariance(rows[is_on], residuals[is_on], _blocks(points[is_on], centre, radius))
    return centre, is_on, radius, covariance


def _sphere_rows(points: Floats, centre: Floats, radius: float, free: bool) -> tuple[Floats, Floats, Bools]:
    """Return rows (n, 3 or 4) of d(residual), residuals (n,) [m] outside the sphere, and who faces the scanner."""
    offset = points - centre
    length = np.linalg.norm(offset, axis=1)
    outward = offset / np.maximum(length, 1e-12)[:, None]
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    facing = -np.einsum("ni,ni->n", outward, direction) > np.sqrt(1.0 - STEEPEST**2)
    rows = np.hstack([outward, np.ones((len(points), 1))]) if free else outward
    return rows, length - radius, facing


def _solve(rows: Floats, residuals: Floats, weights: Floats) -> Floats:
    """Return the change of the parameters that lessens the residuals."""
    normal = np.einsum("ni,n,nj->ij", rows, weights, rows)
    return np.linalg.pinv(normal, hermitian=True) @ np.einsum("ni,n,n->i", rows, weights, residuals)


def clustered_covariance(rows: Floats, residuals: Floats, blocks: Ints) -> Floats:
    """Return the covariance of least squares parameters whose residuals err together within blocks (n,).

    A^-1 (sum over blocks of s s') A^-1 with s the sum of rows times residuals (Liang & Zeger 1986), times m / (m - 1)
    for m blocks, and n / (n - u).
    """
    bread = np.linalg.pinv(np.einsum("ni,nj->ij", rows, rows), hermitian=True)
    _, member = np.unique(blocks, return_inverse=True)
    sums = np.stack([np.bincount(member, column * residuals) for column in rows.T], axis=1)
    m, n = len(sums), len(rows)
    factor = m / max(m - 1, 1) * n / max(n - rows.shape[1], 1)
    return np.asarray(factor * bread @ (sums.T @ sums) @ bread)


def _of_radius(points: Floats, centre: Floats, variance: float) -> Floats:
    """Return the covariance (3, 3) [m2] that a wrong radius gives: what the free radius says of footprint and range
    errors, which move the centre along the line of sight."""
    outward = points - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    by_radius = np.linalg.solve(outward.T @ outward, outward.sum(axis=0))
    return np.asarray(variance * np.outer(by_radius, by_radius))


def _blocks(points: Floats, centre: Floats, radius: float) -> Ints:
    """Return the number (n,) of the square across the line of sight that each point lies in."""
    side = np.cross(centre, [0.0, 0.0, 1.0])
    side /= max(np.linalg.norm(side), 1e-12)
    up = np.cross(side, centre / np.linalg.norm(centre))
    uv = (points - centre) @ np.column_stack([side, up]) / radius
    cells = np.floor((uv + 1.0) * 0.5 * N_BLOCKS_ACROSS).astype(int)
    return np.asarray(cells[:, 0] * N_BLOCKS_ACROSS + cells[:, 1])


def _noise(cut: _Cut, centre: Floats, radius: float) -> float:
    """Return the noise [m] of single points on the sphere: second differences along columns, free of its shape."""
    with np.errstate(invalid="ignore"):
        residuals = np.linalg.norm(cut.points - centre, axis=2) - radius
        offset = np.linalg.norm(np.cross(cut.points, centre / np.linalg.norm(centre)), axis=2)
        residuals[~((offset < STEEPEST * radius) & (np.abs(residuals) < 0.2 * radius))] = np.nan
    second = residuals[2:] - 2.0 * residuals[1:-1] + residuals[:-2]
    second = second[np.isfinite(second)]
    return robust_scale(second) / np.sqrt(6.0) if len(second) >= 10 else 0.0


def _share_around(points: Floats, density: float, centre: Floats, radius: float) -> float:
    """Return the share of a ring about the sphere's outline in which something stands as near as the sphere."""
    distance = np.linalg.norm(centre)
    direction = centre / distance
    along = points @ direction
    across = np.linalg.norm(points - along[:, None] * direction, axis=1) * distance / np.maximum(along, 1e-9)
    ring = (across > FREE_RING[0] * radius) & (across < FREE_RING[1] * radius)
    beside = ring & (np.abs(along - distance) < 0.9 * radius)
    pixels = np.pi * (FREE_RING[1] ** 2 - FREE_RING[0] ** 2) * (radius / distance) ** 2 * density
    return float(beside.sum() / max(pixels, 1.0))
