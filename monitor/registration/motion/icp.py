"""Registration of two surfaces or clouds that lie near each other: the motion, its covariance, and what was stable.

In: source and target in one frame, off by a few degrees and by a small part of their size. Out: `Registration`.
Point-to-plane ICP with robust weights (symmetric, Rusinkiewicz 2019), on samples that hold every motion, then on the
stable areas alone (`papers/002`: local registration of a stove that was rebuilt at a slightly different place).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from monitor.declare import check_settings, given_or_default, setting
from monitor.registration.motion.alignment import Alignment, AlignmentRules, align
from monitor.registration.motion.conclusion import Settled, conclude, failed
from monitor.registration.motion.degeneracy import find_free_motions
from monitor.registration.motion.held import Frames, FreeMotions, without_free_part
from monitor.registration.motion.layer import find_layer
from monitor.registration.motion.layer_on_most import find_layer_on_most
from monitor.registration.motion.matching import Samples, make_samples, with_relief
from monitor.registration.motion.partners import Partners
from monitor.registration.motion.patches import cut_patches
from monitor.registration.motion.rivals import judge_rivals
from monitor.registration.motion.sampling import sample_source
from monitor.registration.motion.scale import find_scale
from monitor.registration.motion.self_likeness import Fit
from monitor.registration.motion.sides import Side, prepare_side
from monitor.registration.motion.stable_areas import StableSamples, find_stable, keep_stable
from monitor.threads import with_one_blas_thread
from projects.errors import ParameterError
from projects.model import Bools, Floats, Ints, PointCloud, Registration, Surface, require_noun
from projects.transforms import apply, perturb, require_rigid

N_ROUNDS_STABLE = 5
N_FOR_CENTRE = 10_000
N_COARSE = 5_000  # samples suffice to come near
N_PER_PATCH = 25  # samples: small enough to follow a change, large enough for a mean
SEARCH_SHARE = 0.1  # of the smaller object's diagonal: what is farther off is not "near"
SEARCH_MEDIANS = 4.0  # the search reaches so many median distances between the two as given

Within = Callable[[Floats], Bools]


@dataclass(frozen=True, kw_only=True)
class IcpSettings:
    """Fine registration of two surfaces that lie near each other."""

    search_radius: float | None = setting(
        None, unit="m", low=1e-6,
        meaning="farthest partner of a point; from the distances as given, at most a tenth of the object's diagonal",
    )  # fmt: skip
    normal_limit: float = setting(math.radians(60.0), unit="rad", low=0.01, high=math.pi / 2,
                                  meaning="largest angle between the normals of partners")  # fmt: skip
    n_samples: int = setting(40_000, unit="points", low=100, meaning="points of the source that are matched")
    min_overlap: float = setting(0.05, unit="", low=0.0, high=1.0,
                                 meaning="smallest share of the source that must find partners")  # fmt: skip
    precision: float = setting(1e-6, unit="m", low=0.0, meaning="the motion is settled when a step is smaller")
    max_iterations: int = setting(100, unit="iterations", low=1, meaning="of one alignment")
    seed: int = setting(0, unit="", low=0, meaning="of the choice of samples")

    def __post_init__(self) -> None:
        check_settings(self)


def register(source: Surface | PointCloud, target: Surface | PointCloud, settings: IcpSettings | None = None, *,
             T_target_source: Floats | None = None, T_given: Floats | None = None, frames: Frames | None = None,
             within: Within | None = None) -> Registration:  # fmt: skip
    """Estimate the motion that brings the stable areas of a source onto a target.

    Parameters
    ----------
    source, target : surfaces or clouds in metres, near each other. Normals are fitted where there are none.
    settings : see `IcpSettings`.
    T_target_source : (4, 4), where to start; as given where left out.
    T_given : (4, 4), the pose as given, which may tell where the surfaces fit as well elsewhere; `T_target_source`
        where left out, which somebody stated then. A start found by shape tells nothing more.
    frames : how far the frames that both are given in may differ, where control holds them. Then what the shape does
        not hold (a staircase's slide along its steps) stays as given, with that uncertainty, and `held_by_frames` says
        so; what it does hold is found by the shape alone.
    within : tells which points (n, 3) [m] of the target's frame lie where the user says that nothing moved; stable
        areas are looked for there alone. Everywhere where left out.

    Returns
    -------
    Registration
        With covariance about the centre of the stable areas, `is_stable` for each vertex or point of the source,
        `overlap` the share of samples with a partner and `stable_share` the share of these that is stable. Without
        overlap, with a motion that the shape does not hold (a plane, a vase), where less than half of the surface
        follows one motion, where it fits as well elsewhere and what is given does not tell (`rivals`), or unsettled:
        `converged` is False, and `reason` says why.

    References
    ----------
    Rusinkiewicz 2019, A symmetric objective function for ICP; Chen & Medioni 1992; `papers/002`.
    """
    require_noun(source, "the source of a registration", Surface, PointCloud)
    require_noun(target, "the target of a registration", Surface, PointCloud)
    settings = given_or_default(settings, IcpSettings)
    if T_target_source is not None:
        require_rigid(T_target_source, "T_target_source, the motion to start from")
    shift = find_centre(target)
    sides = prepare_side(source, shift), prepare_side(target, shift)
    T_start = into_local(np.eye(4) if T_target_source is None else np.asarray(T_target_source, dtype=float), shift)
    given = T_start if T_given is None else into_local(T_given, shift)
    if within is not None:
        sides = (
            sides[0].take(within(apply(T_start, sides[0].points) + shift)),
            sides[1].take(within(sides[1].points + shift)),
        )
    n_source = len(source.vertices if isinstance(source, Surface) else source.points)
    frames = None if frames is None else frames.shifted(shift)
    local = register_sides(*sides, T_start, n_source, settings, frames, given)
    return replace(local, T_target_source=into_local(local.T_target_source, -shift), centre=local.centre + shift)


def find_centre(target: Surface | PointCloud) -> Floats:
    """Return about the middle (3,) [m] of the target's finite points, where the local frame is put."""
    points = target.vertices if isinstance(target, Surface) else target.points
    some = points[:: max(len(points) // N_FOR_CENTRE, 1)]
    some = some[np.isfinite(some).all(axis=1)]
    if not len(some):
        some = points[np.isfinite(points).all(axis=1)]
    if not len(some):
        raise ParameterError("the target of a registration has no points; give one that was measured")
    return some.mean(axis=0)


def into_local(T_target_source: Floats, shift: Floats) -> Floats:
    """Return the transform between frames that are both moved by `-shift` (3,) [m]."""
    local = T_target_source.copy()
    local[:3, 3] += T_target_source[:3, :3] @ shift - shift
    return local


@with_one_blas_thread
def register_sides(source: Side, target: Side, T_start: Floats, n_source: int, settings: IcpSettings,
                   frames: Frames | None = None, T_given: Floats | None = None) -> Registration:  # fmt: skip
    """Return the registration of two prepared sides, in their local frame."""
    given = (T_start if T_given is None else T_given, frames)
    rng = np.random.default_rng(settings.seed)
    if min(len(source), len(target)) < 10:
        return failed(T_start, f"{len(source)} and {len(target)} usable points are too few", n_source)
    which = sample_source(source, settings.n_samples, rng)
    samples = with_relief(make_samples(source, which), source)
    rules = make_rules(samples, target, T_start, settings)
    both_oriented = source.is_oriented and target.is_oriented
    partners = Partners(target.tree, len(samples.points))
    found = approach(samples, target, T_start, rules, both_oriented, partners)
    if not len(found.weights) or not found.weights.any():
        return failed(T_start, found.reason, n_source, found, len(samples.points))
    grid = cut_patches(samples.points, samples.normals if source.is_oriented else None, N_PER_PATCH)
    numbers = grid.numbers(samples.points, samples.normals)
    found, stable, n_iterations = align_stable(samples, target, found, rules, numbers, rng, both_oriented, partners)
    free = None if frames is None else free_motions(found, stable.is_kept, numbers)
    if free is None or frames is None:
        layered = find_layer_on_most(samples, target, found, rules, numbers, rng.spawn(1)[0], both_oriented)
        if layered is None:
            layered = find_layer(samples, target, found, rules, numbers, rng, both_oriented)
        if layered is not None:
            samples, found, stable = layered.samples, layered.found, layered.stable
            n_iterations += layered.n_iterations
        scale = None if layered is not None else find_scale(samples, target, found, rules, numbers, both_oriented)
        settled = Settled(source, target, grid, samples, numbers, found, stable, n_iterations)
        concluded = conclude(settled, n_source, layered=layered, scale=scale)
        return beside_rivals(concluded, settled, rules, both_oriented, given)
    T = without_free_part(found.T_target_source, np.eye(4), free)
    found = align(samples, target, T, replace(rules, locked=free), is_kept=stable.is_kept, fine=True,
                  both_oriented=both_oriented, partners=partners, shared=stable.shared)  # fmt: skip
    settled = Settled(source, target, grid, samples, numbers, found, stable, n_iterations + found.n_iterations)
    concluded = conclude(settled, n_source, held=(free, frames))
    return beside_rivals(concluded, settled, rules, both_oriented, given)


def beside_rivals(concluded: Registration, settled: Settled, rules: AlignmentRules, both_oriented: bool,
                  given: tuple[Floats, Frames | None]) -> Registration:  # fmt: skip
    """Return a registration that settled, judged by whether it fits as well elsewhere than found from what is given."""
    if not concluded.converged:
        return concluded
    found = settled.found
    sigma = float(np.median(found.sigma[settled.stable.is_kept[found.matches.source]]))
    fit = Fit(settled.samples, settled.target, found.T_target_source, found.matches, sigma, rules, both_oriented)
    return judge_rivals(concluded, fit, *given)


def approach(samples: Samples, target: Side, T_start: Floats, rules: AlignmentRules, both_oriented: bool,
             partners: Partners) -> Alignment:  # fmt: skip
    """Return the alignment of all samples, reached by a few of them first where there are many."""
    if len(samples.points) > 2 * N_COARSE:
        step = len(samples.points) // N_COARSE
        few = replace(rules, n_pairs=max(rules.n_pairs // step, 30))
        T_start = align(samples.every(step), target, T_start, few, both_oriented=both_oriented).T_target_source
    return align(samples, target, T_start, rules, fine=len(samples.points) > 2 * N_COARSE, both_oriented=both_oriented,
                 partners=partners)  # fmt: skip


def make_rules(samples: Samples, target: Side, T_start: Floats, settings: IcpSettings) -> AlignmentRules:
    """Return the limits of the alignment, the search radius found from the distances as given."""
    radius = settings.search_radius
    if radius is None:
        radius = find_search_radius(samples, target, T_start)
    n_pairs = max(30, math.ceil(settings.min_overlap * len(samples.points)))
    n_pairs = min(n_pairs, len(samples.points))
    return AlignmentRules(radius, settings.normal_limit, n_pairs, settings.precision, settings.max_iterations)


def find_search_radius(samples: Samples, target: Side, T_start: Floats) -> float:
    """Return how far partners are looked for [m]: a few median distances as given, within a tenth of the object."""
    few = samples.every(max(len(samples.points) // N_COARSE, 1))
    moved = few.points @ T_start[:3, :3].T + T_start[:3, 3]
    sizes = np.ptp(few.points, axis=0), target.tree.maxes - target.tree.mins
    limit = SEARCH_SHARE * float(min(np.linalg.norm(size) for size in sizes))
    distance, nearest = target.tree.query(moved, distance_upper_bound=limit)
    found = np.isfinite(distance)
    if not found.any():
        return limit
    spacing = float(np.median(target.spacing_of(nearest[found])))
    return float(np.clip(SEARCH_MEDIANS * np.median(np.minimum(distance, limit)), min(5.0 * spacing, limit), limit))


def align_stable(samples: Samples, target: Side, found: Alignment, rules: AlignmentRules, numbers: Ints,
                 rng: np.random.Generator, both_oriented: bool, partners: Partners,
                 ) -> tuple[Alignment, StableSamples, int]:  # fmt: skip
    """Return the alignment of the stable areas alone, which samples these are, and the iterations taken."""
    n_iterations, n = found.n_iterations, len(samples.points)
    stable = StableSamples(np.ones(n, dtype=bool), np.ones(n))
    for _ in range(N_ROUNDS_STABLE):
        pairs = found.matches
        motion, pair_is_stable, pair_shared = find_stable(pairs, numbers[pairs.source], found.centre, rng)
        previous, stable = stable, keep_stable(n, pairs, pair_is_stable, pair_shared)
        T = perturb(found.T_target_source, found.centre, motion)
        again = align(samples, target, T, rules, is_kept=stable.is_kept, fine=True, both_oriented=both_oriented,
                      partners=partners, shared=stable.shared)  # fmt: skip
        n_iterations += again.n_iterations
        if not again.weights.any():
            return again, stable, n_iterations
        found = again
        if np.mean(previous.is_kept != stable.is_kept) < 1e-3:
            break
    return found, stable, n_iterations


def free_motions(found: Alignment, is_kept: Bools, numbers: Ints) -> FreeMotions | None:
    """Return what the shape of the stable areas leaves free, None where it holds all or nothing is left of it."""
    stable = found.matches.take(is_kept[found.matches.source])
    if not found.weights.any():
        return None
    return find_free_motions(stable, stable.points.mean(axis=0), numbers[stable.source])
