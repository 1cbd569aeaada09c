"""All scans of one epoch onto each other, in one adjustment, from the poses that they were given.

In: the filtered clouds of the scans in the project's frame. Out: a small motion for each scan, and how well each pair
fits before and after. Every pair of overlapping scans takes part at once, so errors do not add up around the object
(Akca and Gruen 2007; Dorninger and Nothegger 2009 call the rest "remaining discrepancies of the registration").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.declare import check_settings, setting
from monitor.registration.matching import Matches, MatchLimits, Samples, make_samples, match
from monitor.registration.sampling import cell_numbers, motion_rows, sample_source
from monitor.registration.sides import Side, prepare_side
from monitor.registration.weights import huber_weights, robust_scale, tukey_weights
from projects.model import Floats, PointCloud
from projects.transforms import invert, perturb

FEWEST_PAIRS = 100  # points that two scans must share to be held together
PATCH_IN_SPACINGS = 10.0  # errors of neighbouring points agree: a patch of this edge is one witness
SETTLED = 0.01  # of the sigma of residuals: steps below this change nothing
BETTER = (2 / 3) ** 0.5  # of the misfit as given: the poses must explain a third of its variance, or they stay


@dataclass(frozen=True, kw_only=True)
class AdjustmentSettings:
    """Adjustment of the scans of one epoch."""

    enabled: bool = setting(True, unit="", meaning="fit the scans of an epoch onto each other before merging them")
    n_samples: int = setting(5000, unit="", low=200, meaning="points of each scan that are matched with the others")
    search_radius: float | None = setting(
        None, unit="m", low=0.0, meaning="how far apart scans may lie as given; ten spacings of the points"
    )
    max_iterations: int = setting(30, unit="", low=1, meaning="steps of the adjustment")
    seed: int = setting(0, unit="", low=0, meaning="of the samples that are matched")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class PairFit:
    """How two scans fit: shared points, and bias and robust sigma [m] of their distances, before and after."""

    first: int
    second: int
    n: int
    bias_before: float
    sigma_before: float
    bias_after: float
    sigma_after: float


@dataclass(frozen=True)
class Adjustment:
    """The motion T_project_given of each scan, identity where nothing could be bettered, and how pairs fit.

    `applied` is False, with its `reason`, where the given poses stay.
    """

    motions: tuple[Floats, ...]
    pairs: tuple[PairFit, ...]
    applied: bool
    reason: str
    sigma_before: float
    sigma_after: float
    n_iterations: int


@dataclass(frozen=True)
class _Network:
    """The scans as sides and samples, and the pairs of them whose boxes meet."""

    sides: tuple[Side, ...]
    samples: tuple[Samples, ...]
    pairs: tuple[tuple[int, int], ...]
    spacing: float
    radius: float


def adjust_scans(clouds: Sequence[PointCloud], settings: AdjustmentSettings | None = None) -> Adjustment:
    """Fit the scans of one epoch onto each other.

    Parameters
    ----------
    clouds : one a scan, in the project's frame, with normals; poses near enough that the scans overlap within
        `settings.search_radius`.

    Returns
    -------
    Adjustment
        Motions about the project's origin. The mean of all stays where it was given: what is not seen between scans
        (the whole, a scan without overlap, a slide along a plane) is not moved.

    Notes
    -----
    Minimizes sum rho(n' (T_i p - T_j q) / sigma) + sum |delta_i|^2 / prior^2 over point-to-plane pairs of all
    overlapping scans, Huber first and Tukey when settled, by Gauss-Newton steps. Neighbouring residuals agree, so each
    pair of scans counts as many witnesses as it has patches. The prior on each scan's motion is the misfit as given: it
    holds what few patches hold, such as a ring of scans that could bend. A good network of poses is better than what
    five scans can say of themselves, so the given poses stay unless they explain a third of the variance of the misfit.
    """
    settings = settings or AdjustmentSettings()
    unmoved = tuple(np.eye(4) for _ in clouds)
    if len(clouds) < 2 or not settings.enabled:
        return Adjustment(unmoved, (), False, "nothing to adjust", float("nan"), float("nan"), 0)
    shift = np.mean([c.points.mean(axis=0) for c in clouds], axis=0)
    network = _prepare(clouds, shift, settings)
    before = _match_all(network, unmoved, fine=True)
    if not before:
        return Adjustment(unmoved, (), False, "no two scans overlap", float("nan"), float("nan"), 0)
    motions, n_iterations = _iterate(network, settings.max_iterations)
    after = _match_all(network, motions, fine=True)
    pairs = _describe(before, after)
    sigma_before, sigma_after = _misfit(before), _misfit(after)
    if not sigma_after <= BETTER * sigma_before:
        reason = "the given poses fit as well"
        return Adjustment(unmoved, pairs, False, reason, sigma_before, sigma_after, n_iterations)
    moved = tuple(_about(T, shift) for T in motions)
    return Adjustment(moved, pairs, True, "", sigma_before, sigma_after, n_iterations)


def _prepare(clouds: Sequence[PointCloud], shift: Floats, settings: AdjustmentSettings) -> _Network:
    """Return the network of scans, less `shift`."""
    rng = np.random.default_rng(settings.seed)
    sides = tuple(prepare_side(cloud, shift) for cloud in clouds)
    chosen = [sample_source(side, settings.n_samples, rng) for side in sides]
    samples = tuple(make_samples(side, which) for side, which in zip(sides, chosen, strict=True))
    spacing = float(np.median([np.median(side.spacing_of(w)) for side, w in zip(sides, chosen, strict=True)]))
    radius = settings.search_radius or 10.0 * spacing
    low = np.array([side.points.min(axis=0) - radius for side in sides])
    high = np.array([side.points.max(axis=0) for side in sides])
    n = len(sides)
    meet = [(i, j) for i in range(n) for j in range(n) if i != j and np.all((low[i] < high[j]) & (low[j] < high[i]))]
    return _Network(sides, samples, tuple(meet), spacing, radius)


def _match_all(network: _Network, motions: Sequence[Floats], *, fine: bool) -> dict[tuple[int, int], Matches]:
    """Return the matches of every pair of scans that share enough points, in the frame of the second as given."""
    aside = 1.5 * network.spacing if fine else network.radius
    limits = MatchLimits(network.radius, aside, np.radians(30.0 if fine else 45.0))
    found = {}
    for i, j in network.pairs:
        matches = match(network.samples[i], network.sides[j], invert(motions[j]) @ motions[i], limits, True)
        if len(matches) >= FEWEST_PAIRS:
            found[i, j] = matches
    return found


def _iterate(network: _Network, max_iterations: int) -> tuple[list[Floats], int]:
    """Return the motion of each scan and the number of steps taken."""
    n = len(network.sides)
    motions: list[Floats] = [np.eye(4) for _ in range(n)]
    lever = np.sqrt(np.mean([np.mean(np.sum(s.points**2, axis=1)) for s in network.samples]))
    prior, fine = float("nan"), False
    patch = PATCH_IN_SPACINGS * network.spacing
    for step in range(1, max_iterations + 1):
        matches = _match_all(network, motions, fine=fine)
        sigma = _misfit(matches)
        prior = sigma if step == 1 else prior
        delta = _solve(matches, motions, (sigma, prior, float(lever), patch), fine)
        motions = [perturb(T, np.zeros(3), d) for T, d in zip(motions, delta, strict=True)]
        length = float(np.abs(delta * np.repeat([lever, 1.0], 3)).max())
        if fine and length < SETTLED * sigma:
            return motions, step
        fine = fine or length < 0.3 * sigma
    return motions, max_iterations


def _solve(
    matches: dict[tuple[int, int], Matches],
    motions: Sequence[Floats],
    scales: tuple[float, float, float, float],
    fine: bool,
) -> Floats:
    """Return the motions (n, 6) [rad, m] about the origin that lessen all residuals at once."""
    sigma, prior, lever, patch = scales
    n = len(motions)
    unit = np.repeat([1.0 / lever, 1.0], 3)  # rotations as the way they move a point at the lever
    normal = np.zeros((n, 6, n, 6))
    right = np.zeros((n, 6))
    for (i, j), pair in matches.items():
        T = motions[j]
        points, normals = pair.points @ T[:3, :3].T + T[:3, 3], pair.normals @ T[:3, :3].T
        rows = motion_rows(points, normals, np.zeros(3)) * unit
        weights = (tukey_weights if fine else huber_weights)(pair.residuals / sigma)
        weights *= len(np.unique(cell_numbers(points, patch))) / len(points)
        block = (rows * weights[:, None]).T @ rows
        pull = rows.T @ (weights * pair.residuals)
        normal[i, :, i] += block
        normal[j, :, j] += block
        normal[i, :, j] -= block
        normal[j, :, i] -= block
        right[i] -= pull
        right[j] += pull
    hold = (sigma / prior) ** 2
    gone = np.array([_as_motion(T, lever) for T in motions])
    matrix = normal.reshape(6 * n, 6 * n) + np.eye(6 * n) * hold
    return np.asarray(np.linalg.solve(matrix, (right - hold * gone).ravel()).reshape(n, 6) * unit)


def _as_motion(T: Floats, lever: float) -> Floats:
    """Return the motion (6,) that a transform has made so far, rotations as metres at the lever."""
    R = T[:3, :3]
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return np.concatenate([w * lever, T[:3, 3]])


def _misfit(matches: dict[tuple[int, int], Matches]) -> float:
    """Return the robust sigma [m] of all residuals about zero, each pair of scans counting by its points."""
    return robust_scale(np.concatenate([m.residuals for m in matches.values()]))


def _describe(before: dict[tuple[int, int], Matches], after: dict[tuple[int, int], Matches]) -> tuple[PairFit, ...]:
    """Return how each pair of scans, counted once, fits before and after."""
    fits = []
    for i, j in sorted({(min(p), max(p)) for p in before}):
        was, now = _residuals(before, i, j), _residuals(after, i, j)
        bias = [float(np.median(r)) if len(r) else float("nan") for r in (was, now)]
        fits.append(PairFit(i, j, len(was), bias[0], robust_scale(was), bias[1], robust_scale(now)))
    return tuple(fits)


def _residuals(matches: dict[tuple[int, int], Matches], i: int, j: int) -> Floats:
    """Return the residuals [m] of a pair of scans from both sides, positive where scan i lies outside of scan j."""
    parts = [matches[i, j].residuals] if (i, j) in matches else []
    parts += [-matches[j, i].residuals] if (j, i) in matches else []
    return np.concatenate(parts) if parts else np.empty(0)


def _about(T: Floats, shift: Floats) -> Floats:
    """Return a transform of coordinates less `shift` as one of the coordinates themselves."""
    moved = T.copy()
    moved[:3, 3] = T[:3, 3] + shift - T[:3, :3] @ shift
    return moved
