"""All scans of one epoch onto each other, in one adjustment, from the poses that they were given.

In: the filtered clouds of the scans in the project's frame, the targets seen in them, and control points. Out: a small
motion for each scan with its covariance, and how well pairs, targets and control fit. Every pair of overlapping scans
takes part at once, so errors do not add up around the object (hybrid adjustment: Akca and Gruen 2007; Dorninger and
Nothegger 2009 call the rest "remaining discrepancies of the registration").
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from monitor.declare import check_settings, given_or_default, setting
from monitor.registration.motion.covariance import about, moved_by
from monitor.registration.motion.matching import make_samples
from monitor.registration.motion.sampling import sample_source
from monitor.registration.motion.sides import Side, prepare_side
from monitor.registration.network.astray import noise_of, say_astray
from monitor.registration.network.equations import (
    Pairs,
    Scales,
    Solution,
    TieScales,
    estimate_prior,
    pair_equations,
    solve_network,
)
from monitor.registration.network.network_covariance import mean_motion, network_covariance
from monitor.registration.network.overlaps import (
    Overlaps,
    PairFit,
    Steepest,
    describe_pairs,
    first_radius,
    lie_near,
    match_overlaps,
    misfit_of,
)
from monitor.registration.network.scan_rivals import find_scan_rivals
from monitor.registration.network.snooping import TieFit, describe_ties, estimate_components, find_blunder
from monitor.registration.network.ties import Ties, no_ties
from monitor.registration.network.witnesses import count_sharers, explains_misfit, gather_witnesses, pair_factors
from projects.model import Floats, PointCloud
from projects.transforms import apply, perturb

PATCH_IN_SPACINGS = 10.0  # errors of neighbouring points agree: a patch of this edge is one witness
SETTLED = 0.01  # of the sigma of residuals: steps below this change nothing
NEARLY_SETTLED = 0.1  # of the sigma of residuals: where pairs swap to and fro, steps come no lower
MOST_POINTS = 300_000  # of a scan that others are matched with: 40 scans then need two gigabytes
SHRINK = 0.7  # of the search radius, from step to step
MANY_MORE = 1.5  # times as many points that find partners: the motions are right, whatever the misfit was
N_TIE_STEPS = 4  # steps by targets alone, before surfaces are matched
NEAR = 4.0  # spacings: scans whose first search radius is no larger lie on each other as well as points can tell
N_TIES_HOLD = 3  # targets of a scan that tell where it is
LEAST_MISFIT = 1e-7  # of the lever: copies of one scan miss each other by nothing, which no equations can be scaled by
TOO_LITTLE = "what two scans share is too little, or was seen too steeply, to hold them"
LOST = "their overlaps, small as they are, were lost on the way"
TURN_BACK = 0.7  # of the length of steps is kept where a step goes back


@dataclass(frozen=True, kw_only=True)
class AdjustmentSettings:
    """Adjustment of the scans of one epoch."""

    enabled: bool = setting(True, unit="", meaning="fit the scans of an epoch onto each other before merging them")
    n_samples: int = setting(5000, unit="", low=200, meaning="points of each scan that are matched with the others")
    search_radius: float | None = setting(
        None, unit="m", low=1e-6, meaning="how far apart scans may lie as given; ten spacings of the points"
    )
    max_iterations: int = setting(30, unit="", low=1, meaning="steps of the adjustment")
    seed: int = setting(0, unit="", low=0, meaning="of the samples that are matched")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class Adjustment:
    """The motion T_project_given of each scan, identity where nothing could be bettered, and how pairs and ties fit.

    `applied` is False, with its `reason`, where the given poses stay. `converged` is False, with its `reason`, where
    nothing may be built on the result. `covariances` (n, 6, 6) are of each scan's motion about `centres` (n, 3) [m]
    (turn first, rad, then shift, m): relative to the mean of all scans, or, where control holds every motion (three
    points that are not on one line), in the project's frame; then
    `joint_covariance` (6 n, 6 n) is of all of them together, so that what they do in common is known too, and
    `covariance` (6, 6) is that of the epoch as a whole about `centre`, NaN otherwise. `ties` and `components` are the
    residuals of targets and control points and the variance components (1: as stated). `doubt` says which scans
    would fit as well elsewhere, so that only the poses as given tell where they are.
    """

    motions: tuple[Floats, ...]
    pairs: tuple[PairFit, ...]
    applied: bool
    reason: str
    sigma_before: float
    sigma_after: float
    n_iterations: int
    converged: bool = True
    covariances: Floats = field(default_factory=lambda: np.empty((0, 6, 6)))
    centres: Floats = field(default_factory=lambda: np.empty((0, 3)))
    joint_covariance: Floats = field(default_factory=lambda: np.empty((0, 0)))
    covariance: Floats = field(default_factory=lambda: np.full((6, 6), np.nan))
    centre: Floats = field(default_factory=lambda: np.full(3, np.nan))
    ties: tuple[TieFit, ...] = ()
    components: TieScales = field(default_factory=TieScales)
    doubt: str = ""

    @property
    def blunders(self) -> tuple[TieFit, ...]:
        """Targets and control points that contradict the others and were left out."""
        return tuple(t for t in self.ties if t.is_blunder)


@dataclass(frozen=True)
class _Network:
    """The scans, less `shift`, and the ties; partners are looked for within `radius`, at last `finest_radius` [m], at
    once so where the scans lie near each other as given."""

    overlaps: Overlaps
    radius: float
    finest_radius: float
    shift: Floats
    ties: Ties
    lies_near: bool = False

    @property
    def lever(self) -> float:
        """Root mean square distance [m] of the samples from the origin."""
        return float(np.sqrt(np.mean([np.mean(np.sum(s.points**2, axis=1)) for s in self.overlaps.samples])))


@dataclass(frozen=True)
class _State:
    """Where the iteration stands: motions, places of the points tied [m], the last step, and whether it settled."""

    motions: list[Floats]
    places: Floats
    ties: Ties
    matches: Pairs
    scales: Scales
    components: TieScales
    solution: Solution
    n_iterations: int
    reason: str


def adjust_scans(
    clouds: Iterable[PointCloud], settings: AdjustmentSettings | None = None, ties: Ties | None = None
) -> Adjustment:
    """Fit the scans of one epoch onto each other, onto their common targets and onto control points.

    Parameters
    ----------
    clouds : one a scan, in the project's frame, with normals; poses near enough that the scans overlap within
        `settings.search_radius`. They are read once, one at a time.
    ties : targets and control points of `identify_targets`.

    Returns
    -------
    Adjustment
        Motions about the project's origin. Without control the mean of all stays where it was given: what is not seen
        between scans (the whole, a scan without overlap, a slide along a plane) is not moved.

    Notes
    -----
    Minimizes sum w rho(n' (T_i p - T_j q) / sigma) + sum v' C^-1 v + sum |delta_i|^2 / prior^2 over point-to-plane
    pairs of all overlapping scans and over targets and control points, Huber first and Tukey when settled, by
    Gauss-Newton steps. Neighbouring residuals agree, so each pair of scans counts as many witnesses as it has patches.
    The stated variances of targets and of control are raised by what their residuals show, and those that contradict
    the rest are left out (Baarda 1968). The prior on each scan's motion, turns and ways apart, is the misfit as given
    or, once the scans lie on each other, the variance component that the motions themselves show: it holds what few
    patches hold, such as a ring of scans that could bend, or scans around a body that all move outward together. Of the
    whole it holds nothing where control does: it would draw an epoch back to a frame that control contradicts.
    Scans that lie near each other as given are matched finely at once: the first, wide matching would draw them out,
    and from there they come back only in part. Without targets a good network of poses is better than what
    five scans can say of themselves, so the given poses stay unless the motions explain a third of the misfit of
    patches, where the noise of single points is averaged out.
    """
    settings, ties = given_or_default(settings, AdjustmentSettings), ties or no_ties()
    network = _prepare(clouds, settings, ties)
    n = len(network.overlaps.sides)
    unmoved = tuple(np.eye(4) for _ in range(n))
    is_tied = len(ties) > 0
    if not n or (n < 2 and not is_tied):
        return Adjustment(unmoved, (), False, "nothing to adjust", float("nan"), float("nan"), 0)
    before = match_overlaps(network.overlaps, unmoved, network.finest_radius, fine=True)
    if not settings.enabled:
        given = misfit_of(before)
        return Adjustment(unmoved, describe_pairs(before, before), False, "switched off", given, given, 0)
    if not (is_tied or before or match_overlaps(network.overlaps, unmoved, network.radius, fine=False)):
        reason = TOO_LITTLE if _lie_as_given(network) else "no two scans overlap"
        return Adjustment(unmoved, (), False, reason, float("nan"), float("nan"), 0)
    network = replace(network, lies_near=network.lies_near and len(before) > 0)
    state = _settle(network, before, settings.max_iterations)
    if state.reason and not (is_tied or before) and (state.reason == LOST or _lie_as_given(network)):
        return Adjustment(unmoved, (), False, TOO_LITTLE, float("nan"), float("nan"), state.n_iterations)
    after = match_overlaps(network.overlaps, state.motions, network.finest_radius, fine=True)
    pairs = describe_pairs(before, after)
    sigma_before, sigma_after = misfit_of(before), misfit_of(after)
    found = Adjustment(
        unmoved, pairs, False, state.reason, sigma_before, sigma_after, state.n_iterations, not state.reason,
        ties=describe_ties(state.solution, state.ties, network.ties), components=state.components,
    )  # fmt: skip
    if state.reason:
        return found
    if astray := say_astray(pairs, n, network.overlaps.spacing, noise_of(network.overlaps.sides)):
        return replace(found, converged=False, reason=astray)
    n_before, n_after = (sum(len(m) for m in matches.values()) for matches in (before, after))
    patch = PATCH_IN_SPACINGS * network.overlaps.spacing
    witnesses = gather_witnesses(before, unmoved, patch), gather_witnesses(after, state.motions, patch)
    if not is_tied and not explains_misfit(*witnesses, 6 * (n - 1)) and n_after <= MANY_MORE * n_before:
        return _beside_rivals(replace(found, reason="the given poses fit as well"), network, unmoved)
    found = _beside_rivals(found, network, state.motions)
    if not found.converged:
        return found
    moved = tuple(_about(T, network.shift) for T in state.motions)
    return _with_covariances(replace(found, motions=moved, applied=True), replace(state, matches=after), network)


def _lie_as_given(network: _Network) -> bool:
    """Return whether scans lie on each other as given, as near as places tell that were seen at any incidence."""
    unmoved = [np.eye(4) for _ in network.overlaps.sides]
    at_any = dict.fromkeys(network.overlaps.pairs, 0.0)
    near = match_overlaps(network.overlaps, unmoved, network.finest_radius, fine=True, steepest=at_any)
    return bool(near) and misfit_of(near) < network.overlaps.spacing


def _beside_rivals(found: Adjustment, network: _Network, motions: Sequence[Floats]) -> Adjustment:
    """Return the adjustment, refused where a scan fits as well elsewhere and its pose as given is no help, in doubt
    where that pose alone tells."""
    n_ties = np.bincount(network.ties.scan, minlength=len(motions))
    rivals = find_scan_rivals(network.overlaps, motions, np.flatnonzero(n_ties >= N_TIES_HOLD).tolist())
    doubt = "; ".join(rival.words for rival in rivals)
    ambiguous = "; ".join(rival.words for rival in rivals if rival.is_ambiguous)
    if ambiguous:
        return replace(found, converged=False, reason=f"{ambiguous}, and the poses as given do not tell", doubt=doubt)
    return replace(found, doubt=doubt)


def _with_covariances(found: Adjustment, state: _State, network: _Network) -> Adjustment:
    """Return the adjustment with the covariance of each scan and, with control, of the whole."""
    is_absolute = state.ties.holds_the_whole
    full = network_covariance(state.matches, state.motions, state.scales, state.solution, is_absolute=is_absolute)
    centres = np.array(
        [apply(T, s.points.mean(axis=0)) for T, s in zip(state.motions, network.overlaps.samples, strict=True)]
    )
    to_centres = block_diag(*(moved_by(centre) for centre in centres))
    joint = to_centres @ full @ to_centres.T
    each = np.array([joint[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(len(centres))])
    found = replace(found, covariances=each, joint_covariance=joint, centres=centres + network.shift)
    if not is_absolute:
        return found
    middle = centres.mean(axis=0)
    return replace(found, covariance=about(mean_motion(full), middle), centre=middle + network.shift)


def _prepare(clouds: Iterable[PointCloud], settings: AdjustmentSettings, ties: Ties) -> _Network:
    """Return the network of scans about the middle of all, each cloud read once and thinned where it is large."""
    rng = np.random.default_rng(settings.seed)
    sides: list[Side] = []
    means: list[Floats] = []
    origin: Floats = np.zeros(3)
    for cloud in clouds:
        means.append(cloud.points.mean(axis=0))
        origin = means[0]
        if len(cloud) > MOST_POINTS:
            cloud = cloud.take(np.sort(rng.choice(len(cloud), MOST_POINTS, replace=False)))
        sides.append(prepare_side(cloud, origin))
    if not sides:
        return _Network(Overlaps((), (), (), np.nan), np.nan, np.nan, origin, ties)
    offset = np.mean(means, axis=0) - origin
    sides = [side.shifted(offset) for side in sides]
    chosen = [sample_source(side, settings.n_samples, rng) for side in sides]
    samples = tuple(make_samples(side, which) for side, which in zip(sides, chosen, strict=True))
    spacing = float(np.median([np.median(side.spacing_of(w)) for side, w in zip(sides, chosen, strict=True)]))
    finest = settings.search_radius or 10.0 * spacing
    first = first_radius(sides, samples)
    radius = settings.search_radius or max(finest, first)
    low = np.array([side.points.min(axis=0) - radius for side in sides])
    high = np.array([side.points.max(axis=0) for side in sides])
    n = len(sides)
    meet = [(i, j) for i in range(n) for j in range(n) if i != j and np.all((low[i] < high[j]) & (low[j] < high[i]))]
    shift = origin + offset
    lies_near = first <= NEAR * spacing
    for side in sides:  # else two scans may share too little besides, and swing
        side.has_wide_rims = lies_near
    overlaps = Overlaps(tuple(sides), samples, tuple(meet), spacing)
    return _Network(overlaps, radius, finest, shift, ties.shifted(shift), lies_near)


def _settle(network: _Network, before: Pairs, max_iterations: int) -> _State:
    """Return where the iteration ends, begun as far and wide as scans seem to lie apart.

    Scans that see little of each other seem to lie far apart, most of their points having no partner; what is then
    taken for one draws them to and fro. Where that does not settle, and scans lie on each other as given, it begins by
    matching finely.
    """
    state = _iterate(network, max_iterations)
    if not state.reason or network.lies_near:
        return state
    unmoved = [np.eye(4) for _ in network.overlaps.sides]
    wide = match_overlaps(network.overlaps, unmoved, network.radius, fine=False)
    if not lie_near(before, wide, len(unmoved), network.overlaps.spacing):
        return state
    again = _iterate(replace(network, lies_near=True), max_iterations)
    return state if again.reason else again


def _iterate(network: _Network, max_iterations: int) -> _State:
    """Return where the iteration ends: first by targets alone, then with surfaces, without blunders."""
    n = len(network.overlaps.sides)
    motions, places = _start_by_ties(network, [np.eye(4) for _ in range(n)])
    ties, components, radius = network.ties, TieScales(), network.radius
    prior, fine, pace, last = np.full(2, np.nan), network.lies_near, 1.0, np.zeros((n, 6))
    steepest: Steepest = {}
    state: _State | None = None
    least = LEAST_MISFIT * network.lever
    for step in range(1, max_iterations + 1):
        matches = match_overlaps(network.overlaps, motions, radius, fine=fine, steepest=steepest)
        if not matches and state is not None and not len(ties):
            return replace(state, reason=LOST)
        sigma = max(misfit_of(matches) if matches else _tie_sigma(network.ties), least)
        prior = np.full(2, max(sigma, _given_misfit(network))) if step == 1 else prior
        scales = replace(_scales(network, matches, sigma, prior, fine, motions), in_control=_in_control(ties, matches))
        solution = solve_network(pair_equations(matches, motions, scales), ties, places, motions, (scales, components))
        way = solution.delta * np.repeat([scales.lever, 1.0], 3)
        # where pairs swap to and fro the poses swing about a place without a zero: go there by ever shorter steps
        pace *= TURN_BACK if fine and np.sum(way * last) < 0.0 else 1.0
        last, length = way, float(np.abs(pace * way).max())
        motions = [perturb(T, np.zeros(3), pace * d) for T, d in zip(motions, solution.delta, strict=True)]
        places = places + solution.shift
        state = _State(motions, places, ties, matches, scales, components, solution, step, "")
        if fine and length < SETTLED * sigma:
            blunder = find_blunder(solution, ties)
            if blunder is None:
                return state
            ties, pace = blunder, 1.0
        elif fine or not matches:
            components = estimate_components(solution, components)
            prior = np.clip(estimate_prior(solution, motions, scales), least, prior)
        shrunk = radius <= network.finest_radius
        radius = max(SHRINK * radius, network.finest_radius)
        fine = fine or not matches or (shrunk and length < 0.3 * sigma)
    assert state is not None  # at least one step is allowed
    if length < NEARLY_SETTLED * sigma:
        return state
    return replace(state, reason=f"still moving by {1e6 * length:.0f} micrometres after {max_iterations} iterations")


def _start_by_ties(network: _Network, motions: list[Floats]) -> tuple[list[Floats], Floats]:
    """Return motions and places of the points after a few steps by targets and control alone."""
    ties = network.ties
    places = _first_places(ties)
    if not len(ties):
        return motions, places
    u = 6 * len(motions)
    scales = Scales(1.0, np.full(2, max(_given_misfit(network), 1e-6)), network.lever, 1.0, False)
    if ties.holds_the_whole:  # scans without targets go with the others
        scales = replace(scales, in_control=tuple(range(len(motions))))
    for _ in range(N_TIE_STEPS):
        step = solve_network((np.zeros((u, u)), np.zeros(u)), ties, places, motions, (scales, TieScales()))
        motions = [perturb(T, np.zeros(3), d) for T, d in zip(motions, step.delta, strict=True)]
        places = places + step.shift
    return motions, places


def _first_places(ties: Ties) -> Floats:
    """Return about where the points tied lie (m, 3) [m]: the mean of their targets as given."""
    count = np.maximum(np.bincount(ties.point, minlength=len(ties.names)), 1)
    return (
        np.stack([np.bincount(ties.point, column, len(ties.names)) for column in ties.positions.T], axis=1)
        / (count[:, None])
    )


def _given_misfit(network: _Network) -> float:
    """Return the root mean square [m] of what targets miss each other and control by, as given; 0 without any."""
    ties = network.ties
    if not len(ties):
        return 0.0
    places = np.where(ties.has_control[:, None], ties.control, _first_places(ties))
    return float(np.sqrt(np.mean((ties.positions - places[ties.point]) ** 2)))


def _tie_sigma(ties: Ties) -> float:
    """Return a typical sigma [m] of targets, the scale of an adjustment without surfaces."""
    return float(np.sqrt(np.median(np.trace(ties.covariances, axis1=1, axis2=2)) / 3.0))


def _scales(
    network: _Network, matches: Pairs, sigma: float, prior: Floats, fine: bool, motions: Sequence[Floats]
) -> Scales:
    """Return the scales of the weights; beside targets, patches have the variance that the means of their pair show."""
    scales = Scales(sigma, prior, network.lever, PATCH_IN_SPACINGS * network.overlaps.spacing, fine)
    if not len(network.ties) or not matches:
        return scales
    return replace(
        scales, pair_factors=pair_factors(matches, motions, scales),
        pair_sharers=count_sharers(matches, motions, scales.patch),
    )  # fmt: skip


def _in_control(ties: Ties, matches: Pairs) -> tuple[int, ...]:
    """Return the scans that control holds together: where it holds the whole, all that have targets or overlap."""
    if not ties.holds_the_whole:
        return ()
    return tuple(sorted({*ties.scan[ties.kept].tolist(), *(k for pair in matches for k in pair)}))


def _about(T: Floats, shift: Floats) -> Floats:
    """Return a transform of coordinates less `shift` as one of the coordinates themselves."""
    moved = T.copy()
    moved[:3, 3] = T[:3, 3] + shift - T[:3, :3] @ shift
    return moved
