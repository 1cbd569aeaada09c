"""Black-and-white boards in a scan: four fields, two black and two white, that meet in the target's centre.

In: the scan as an image with intensity. Out: `SurveyTarget`s. Where the intensity around a pixel goes twice up and
down in one turn, at two radii and in the same directions, the plane and the pattern are fitted to the points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.signal import fftconvolve
from scipy.special import erf

from monitor.registration.targets.angular_image import AngularImage
from monitor.registration.targets.spheres import clustered_covariance
from monitor.robust import robust_scale, tukey_weights
from projects.model import Bools, Floats, Ints, SurveyTarget

RINGS = 4.0, 6.0  # pixels: radii at which the intensity is followed around
SHARE_TWICE = 0.5  # of the variance on a ring that goes twice around; two black quarters have 0.81
CONTRAST = 0.2  # least standard deviation of the intensity on a ring over its mean
PEAK = 7  # pixels, within which only the best candidate is kept
MOST_CANDIDATES = 300  # of one image
EXPLAINED = 0.8  # of the variance of intensity that the pattern must explain
AGREES = 0.9  # share of points that have the colour of their field, at the board's edge
STEPS_OUT = 1.15  # by which the size is increased while the pattern goes on
SHARPEST = 0.7  # spacings of the points, that an edge is taken to be blurred over at least
CHEQUERED = 0.75  # share of points beyond the board that go on as a chequered floor would
N_STEPS = 30
N_BLOCKS_ACROSS = 6


@dataclass(frozen=True)
class BoardRules:
    """What a board must be: half its width [m] `smallest` to `largest`, its completeness and roughness (see
    TargetSettings)."""

    smallest: float
    largest: float
    completeness: float
    roughness: float


@dataclass(frozen=True)
class _Pattern:
    """Intensity = mean + height erf(x / blur) erf(y / blur) in the board's plane, x and y along its edges.

    `place` (2,) [m] of the centre, `turn` [rad] of the edges, `blur` [m] of the footprint.
    """

    place: Floats
    turn: float
    mean: float
    height: float
    blur: float

    def along_edges(self, uv: Floats) -> Floats:
        """Return places (n, 2) [m] in the plane along the board's edges from its centre."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return (uv - self.place) @ np.array([[c, -s], [s, c]])


@dataclass(frozen=True)
class _Plane:
    """A plane through `origin` with unit `normal` and `axes` (2, 3) in it."""

    origin: Floats
    normal: Floats
    axes: Floats


def find_boards(finest: AngularImage, rules: BoardRules) -> list[SurveyTarget]:
    """Return the black-and-white boards of a scan, with centres about the scanner."""
    if not np.isfinite(finest.intensity).any():
        return []
    found: list[SurveyTarget] = []
    image = finest
    while min(image.intensity.shape) >= 3 * RINGS[1]:
        for i, j in _candidates(image, rules):
            centre, reach = image.points[i, j], _reach(image, i, j)
            if np.isfinite(centre).all() and not any(np.linalg.norm(t.centre - centre) < t.radius for t in found):
                target = _test_board(finest, (i, j, image.factor), reach, rules)
                found += [] if target is None else [target]
        image = image.coarser()
    return found


def _reach(image: AngularImage, i: int, j: int) -> float:
    """Return the outer ring's radius [m] at a pixel."""
    return float(RINGS[1] * image.step_rows * np.linalg.norm(image.points[i, j]))


def _candidates(image: AngularImage, rules: BoardRules) -> list[tuple[int, int]]:
    """Return the pixels about which the intensity goes twice up and down at both rings alike, best first."""
    score = _twice_around(image.intensity)
    ring = image.ranges * image.step_rows * RINGS[1]
    with np.errstate(invalid="ignore"):
        score[~((ring > 0.3 * rules.smallest) & (ring < rules.largest))] = 0.0
    peaks = (score > SHARE_TWICE) & (score == maximum_filter(score, size=PEAK))
    rows, columns = np.nonzero(peaks)
    order = np.argsort(-score[rows, columns], kind="stable")[:MOST_CANDIDATES]
    return list(zip(rows[order].tolist(), columns[order].tolist(), strict=True))


def _twice_around(intensity: Floats) -> Floats:
    """Return for each pixel (h, w) the smaller share of variance that goes twice around, of both rings, in phase."""
    measured = np.isfinite(intensity)
    level = float(np.median(intensity[measured]))
    values = np.where(measured, intensity - level, 0.0)
    shares, waves = [], []
    for radius in RINGS:
        ring, twice = _ring_kernels(radius)
        mean = fftconvolve(values, ring, mode="same")
        variance = np.maximum(fftconvolve(values**2, ring, mode="same") - mean**2, 0.0)
        # a real convolution at a time: half the memory of a complex one
        wave = fftconvolve(values, twice.real, mode="same") + 1j * fftconvolve(values, twice.imag, mode="same")
        is_bold = np.sqrt(variance) > CONTRAST * np.maximum(np.abs(mean + level), 1e-6)
        shares.append(np.where(is_bold, 2.0 * np.abs(wave) ** 2 / np.maximum(variance, 1e-12), 0.0))
        waves.append(wave)
    together = np.abs(waves[0] + waves[1]) / np.maximum(np.abs(waves[0]) + np.abs(waves[1]), 1e-12)
    return np.asarray(np.minimum(shares[0], shares[1]) * together**4)


def _ring_kernels(radius: float) -> tuple[Floats, np.ndarray]:
    """Return the mean over a ring one pixel and a half wide, and the wave that goes twice around it, as kernels."""
    half = int(np.ceil(radius + 1))
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    ring = np.clip(1.25 - np.abs(np.hypot(x, y) - radius), 0.0, 1.0)
    ring /= ring.sum()
    return ring, ring * np.exp(-2j * np.arctan2(y, x))


def _test_board(
    image: AngularImage, pixel: tuple[int, int, int], reach: float, rules: BoardRules
) -> SurveyTarget | None:
    """Return the board about a candidate pixel, or None where it is none."""
    points, intensity = _cut_out(image, pixel, 3.5 * rules.largest / reach)
    near = np.linalg.norm(points - np.median(_cut_out(image, pixel, 0.5)[0], axis=0), axis=1)
    core = near < reach
    if core.sum() < 30:
        return None
    plane, _, sigma = _fit_plane(points[core])
    uv = (points - plane.origin) @ plane.axes.T
    height = (points - plane.origin) @ plane.normal
    flat = np.abs(height) < 5.0 * max(sigma, 1e-6)
    pattern = _start_pattern(uv[flat & core], intensity[flat & core])
    pattern = None if pattern is None else _fit_pattern(uv[flat & core], intensity[flat & core], pattern)[0]
    if pattern is None:
        return None
    half = _half_width(pattern, uv[flat], intensity[flat], 0.5 * reach, rules.largest)
    if not rules.smallest <= half <= rules.largest:
        return None
    return _judge(image, (points[flat], intensity[flat], uv[flat]), plane, (pattern, half), rules)


def _judge(
    image: AngularImage, seen: tuple[Floats, Floats, Floats], plane: _Plane, start: tuple[_Pattern, float],
    rules: BoardRules,
) -> SurveyTarget | None:  # fmt: skip
    """Return the target where pattern, completeness and flatness are those of a board."""
    points, intensity, uv = seen
    pattern, half = start
    xy = pattern.along_edges(uv)
    inside = np.abs(xy).max(axis=1) < 0.9 * half
    if inside.sum() < 30 or _goes_on(pattern, xy, intensity, half):
        return None
    found, explained, covariance = _fit_pattern(uv[inside], intensity[inside], pattern)
    if found is None or explained < EXPLAINED or np.linalg.norm(found.place - pattern.place) > 0.3 * half:
        return None
    plane2, is_on, sigma = _fit_plane(points[inside])
    rms = float(np.sqrt(np.mean(((points[inside][is_on] - plane2.origin) @ plane2.normal) ** 2)))
    centre, covariance3 = _place_centre(points[inside][is_on], plane, plane2, (found, covariance))
    expected = (1.8 * half) ** 2 * abs(float(plane2.normal @ centre)) * image.density(centre)
    expected /= float(np.linalg.norm(centre)) ** 3
    completeness = min(float(inside.sum()) / expected, 1.0)
    quarters = np.bincount(2 * (xy[inside, 0] > 0) + (xy[inside, 1] > 0), minlength=4)
    if completeness < rules.completeness or quarters.min() < 0.5 * quarters.mean():
        return None
    if rms > rules.roughness * max(sigma, 1e-6):
        return None
    return SurveyTarget("board", centre, covariance3, half, rms, int(inside.sum()), completeness)


def _cut_out(image: AngularImage, pixel: tuple[int, int, int], rings: float) -> tuple[Floats, Floats]:
    """Return points and intensities of the finest image within some outer rings about a pixel of a coarser one."""
    i, j, factor = pixel
    row, column, half = (2 * i + 1) * factor // 2, (2 * j + 1) * factor // 2, int(RINGS[1] * factor * rings) + 1
    rows = slice(max(row - half, 0), row + half + 1)
    tall = image.points[min(row, len(image.points) - 1), min(column, image.points.shape[1] - 1)]
    cosine = np.hypot(tall[0], tall[1]) / np.linalg.norm(tall) if np.isfinite(tall).all() else 1.0
    half = int(half / max(float(cosine), 0.1))
    columns = slice(max(column - half, 0), column + half + 1)
    points, intensity = image.points[rows, columns], image.intensity[rows, columns]
    measured = np.isfinite(points[..., 0]) & np.isfinite(intensity)
    return points[measured], intensity[measured]


def _fit_plane(points: Floats) -> tuple[_Plane, Bools, float]:
    """Return a robust plane of points (n, 3), which of them lie on it, and their sigma [m]."""
    weights: Floats = np.ones(len(points))
    for _ in range(8):
        origin = np.average(points, axis=0, weights=weights)
        offset = points - origin
        _, vectors = np.linalg.eigh((offset * weights[:, None]).T @ offset)
        heights = offset @ vectors[:, 0]
        sigma = max(robust_scale(heights), 1e-9)
        weights = tukey_weights(heights / (1.5 * sigma)) + 1e-12
    return _Plane(origin, vectors[:, 0], vectors[:, :0:-1].T), np.abs(heights) < 4.0 * sigma, sigma


def _start_pattern(uv: Floats, intensity: Floats) -> _Pattern | None:
    """Return a first pattern: black and white from the extremes, the turn from the wave that goes twice around."""
    if len(uv) < 30:
        return None
    low, high = np.percentile(intensity, [10.0, 90.0])
    place = uv.mean(axis=0)
    angle = np.arctan2(*(uv - place).T[::-1])
    wave = np.sum((intensity - intensity.mean()) * np.exp(2j * angle))
    # height erf(x) erf(y) is like sin(2 angle): its wave points to -i
    turn = 0.5 * (np.angle(wave) + 0.5 * np.pi) - 0.5 * np.pi
    reach = float(np.abs(uv - place).max())
    return _Pattern(place, float(turn), 0.5 * (low + high), 0.5 * (high - low), 0.1 * reach)


def _model(pattern: _Pattern, uv: Floats) -> tuple[Floats, Floats]:
    """Return the intensity (n,) of the pattern and its derivatives (n, 6) by place, turn, mean, height and blur."""
    xy = pattern.along_edges(uv)
    scaled = xy / pattern.blur
    e, d = erf(scaled), 2.0 / np.sqrt(np.pi) * np.exp(-(scaled**2)) / pattern.blur
    by_x, by_y = pattern.height * d[:, 0] * e[:, 1], pattern.height * e[:, 0] * d[:, 1]
    c, s = np.cos(pattern.turn), np.sin(pattern.turn)
    rows = np.column_stack([
        -c * by_x + s * by_y, -s * by_x - c * by_y, by_x * xy[:, 1] - by_y * xy[:, 0], np.ones(len(uv)),
        e[:, 0] * e[:, 1], -(by_x * xy[:, 0] + by_y * xy[:, 1]) / pattern.blur,
    ])  # fmt: skip
    return pattern.mean + pattern.height * e[:, 0] * e[:, 1], rows


def _fit_pattern(uv: Floats, intensity: Floats, start: _Pattern) -> tuple[_Pattern | None, float, Floats]:
    """Return the pattern fitted to intensities, the share of variance it explains, and the covariance (2, 2) of its
    place; None where it runs away. Levenberg-Marquardt."""
    pattern, damping = start, 1e-2
    model, rows = _model(pattern, uv)
    left = float(np.sum((intensity - model) ** 2))
    reach = float(np.abs(uv - start.place).max())
    # an edge sharper than the points are dense lies anywhere between two of them
    sharpest = SHARPEST * 2.0 * reach / np.sqrt(len(uv))
    for _ in range(N_STEPS):
        normal = rows.T @ rows
        scaled = normal + damping * np.diag(np.diag(normal) + 1e-12)
        delta = np.linalg.solve(scaled, rows.T @ (intensity - model))
        tried = _Pattern(pattern.place + delta[:2], pattern.turn + float(delta[2]), pattern.mean + float(delta[3]),
                         pattern.height + float(delta[4]), max(pattern.blur + float(delta[5]), sharpest))  # fmt: skip
        new_model, new_rows = _model(tried, uv)
        new_left = float(np.sum((intensity - new_model) ** 2))
        if new_left > left:
            damping *= 5.0
            continue
        settled = left - new_left < 1e-9 * left
        pattern, model, rows, left, damping = tried, new_model, new_rows, new_left, 0.3 * damping
        if settled:
            break
    if np.abs(pattern.place - start.place).max() > reach or pattern.blur > reach:
        return None, 0.0, np.full((2, 2), np.inf)
    explained = 1.0 - left / max(float(np.sum((intensity - intensity.mean()) ** 2)), 1e-12)
    return pattern, explained, _place_covariance(pattern, uv, rows, intensity - model)


def _place_covariance(pattern: _Pattern, uv: Floats, rows: Floats, residuals: Floats) -> Floats:
    """Return the covariance (2, 2) [m2] of the place.

    Where the scanner's columns run along an edge, all points beside it err together: the place across each edge has
    the residuals of strips along that edge as its witnesses.
    """
    xy = pattern.along_edges(uv)
    width = 2.0 * float(np.abs(xy).max()) / np.sqrt(len(xy))
    variances = []
    for axis in (0, 1):
        strips = np.floor(xy[:, axis] / width).astype(int)
        full = clustered_covariance(rows, residuals, strips)[:2, :2]
        c, s = np.cos(pattern.turn), np.sin(pattern.turn)
        edge = np.array([[c, s], [-s, c]])[axis]
        variances.append((float(edge @ full @ edge), np.outer(edge, edge)))
    return sum((v * e for v, e in variances), np.zeros((2, 2)))


def _blocks(uv: Floats, place: Floats, reach: float) -> Ints:
    """Return the number (n,) of the square of the plane that each point lies in."""
    cells = np.floor(((uv - place) / reach + 1.0) * 0.5 * N_BLOCKS_ACROSS).astype(int)
    return np.asarray(cells[:, 0] * 100 + cells[:, 1])


def _half_width(pattern: _Pattern, uv: Floats, intensity: Floats, start: float, largest: float) -> float:
    """Return how far [m] from the centre the four fields keep their colours, NaN where they have none."""
    xy = pattern.along_edges(uv)
    reach = np.abs(xy).max(axis=1)
    clear = np.abs(xy).min(axis=1) > pattern.blur
    agrees = np.sign(xy[:, 0] * xy[:, 1] * pattern.height) == np.sign(intensity - pattern.mean)
    half = float("nan")
    edge = start
    while edge <= STEPS_OUT * largest:
        ring = clear & (reach > edge / STEPS_OUT) & (reach <= edge)
        if ring.sum() < 8 or agrees[ring].mean() < AGREES:
            break
        half, edge = edge, edge * STEPS_OUT
    return half


def _goes_on(pattern: _Pattern, xy: Floats, intensity: Floats, half: float) -> bool:
    """Return whether the plane beyond the board is chequered in the same way: a tiled floor, no target."""
    reach = np.abs(xy).max(axis=1)
    beyond = (reach > 1.15 * half) & (reach < 1.7 * half) & (np.abs(xy).min(axis=1) > pattern.blur)
    if beyond.sum() < 20:
        return False
    # past each edge of a field the colour changes
    sign = np.prod(np.sign(xy) * np.where(np.abs(xy) > 1.07 * half, -1.0, 1.0), axis=1)
    same = np.sign(sign * pattern.height) == np.sign(intensity - pattern.mean)
    return bool(same[beyond].mean() > CHEQUERED)


def _place_centre(
    points: Floats, plane: _Plane, plane2: _Plane, found: tuple[_Pattern, Floats]
) -> tuple[Floats, Floats]:
    """Return the centre (3,) [m] on the plane and its covariance (3, 3) [m2]: the pattern's in the plane, the plane's
    across it."""
    pattern, covariance = found
    place = plane.origin + pattern.place @ plane.axes
    centre = place - ((place - plane2.origin) @ plane2.normal) * plane2.normal
    uv = (points - centre) @ plane.axes.T
    rows = np.column_stack([np.ones(len(uv)), uv])
    heights = (points - plane2.origin) @ plane2.normal
    across = clustered_covariance(rows, heights, _blocks(uv, np.zeros(2), float(np.abs(uv).max()) + 1e-12))[0, 0]
    normal = plane2.normal
    return centre, plane.axes.T @ covariance @ plane.axes + across * np.outer(normal, normal)
