"""Other poses at which two surfaces fit as well: the next step of a staircase, the next period of a relief or a flute.

In: where an alignment ended. Out: the best of other minima of its cost, by how much more or less of the surface fits
there. An iteration that goes downhill from where it starts cannot know of them; what can be given beside the right pose
by more than half a period comes out at a wrong one, settled and with a small sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monitor.lengths import in_millimetres
from monitor.registration.motion.alignment import align
from monitor.registration.motion.degeneracy import describe
from monitor.registration.motion.held import Frames
from monitor.registration.motion.matching import MatchLimits, match
from monitor.registration.motion.sampling import lever_of
from monitor.registration.motion.self_likeness import Fit, Steps, alike_shifts, alike_turns
from monitor.robust import robust_scale, tukey_weights
from projects.model import Floats, Registration
from projects.transforms import apply, invert, motion_about, perturb

N_SAMPLES = 1_500  # tell 3 % of the surface that fits from none
N_REFINED, N_ITERATIONS = 400, 8  # samples and steps that lead to the bottom of another minimum
N_FIRST, HOPELESS = 3, 5.0  # steps after which it is given up where pairs still scatter by so many sigmas
SURE = 3.0  # sigmas
LEAST_DIFFERENCE = 0.02  # of the surface: no less is believed, since rims do not fall alike
PARTWAY = (0.382, 0.5)  # of the way to a rival; one of them is between periods where the other meets one
BARRIER = 0.8  # of what fits at both ends
TELLING = 4.0  # times farther from the pose as given than the one found: then the given one tells which is right


@dataclass(frozen=True)
class Rival:
    """Another minimum: its pose, the rms `way` [m] from the pose found to there, in `words`, the shares of the surface
    that fit `here` and `there`, and the difference of these that would be `telling`."""

    T_target_source: Floats
    way: float
    words: str
    here: float
    there: float
    telling: float

    @property
    def is_as_good(self) -> bool:
        """Whether as much of the surface fits there."""
        return self.there >= self.here - self.telling

    @property
    def is_better(self) -> bool:
        """Whether more of the surface fits there."""
        return self.there > self.here + self.telling

    def describe(self) -> str:
        """Return in words how much fits there and here."""
        return (
            f"{100 * self.there:.0f} % of the surface fit {in_millimetres(self.way)} off, by a {self.words}; "
            f"here {100 * self.here:.0f} %"
        )


def find_rival(fit: Fit) -> Rival | None:
    """Return another minimum where as much of the surface fits as at the one found: that where most does, if it is
    more, or the nearest. None where there is none.

    The weights of Tukey of as many samples, zero without a partner, are compared sample by sample.
    """
    few = replace(fit, samples=fit.samples.every(max(len(fit.samples.points) // N_SAMPLES, 1)))
    here = support(few, few.T_target_source)
    tried = [refine(few, T, steps, here) for steps in (alike_shifts(fit), alike_turns(few)) for T in steps.motions]
    rivals = [rival for rival in tried if rival is not None]
    better = [rival for rival in rivals if rival.is_better]
    if better:
        return max(better, key=lambda rival: rival.there)
    return min(rivals, key=lambda rival: rival.way, default=None)


def support(fit: Fit, T_target_source: Floats) -> Floats:
    """Return how well each sample fits at a pose (n,): Tukey's weight of its distance, 0 without a partner."""
    limits = MatchLimits(fit.rules.distance, 0.0, fit.rules.angle)
    pairs = match(fit.samples, fit.target, T_target_source, limits, fit.both_oriented)
    fits = np.zeros(len(fit.samples.points))
    fits[pairs.source] = tukey_weights(pairs.residuals / np.hypot(fit.sigma, pairs.sigma))
    return fits


def refine(fit: Fit, step: Floats, steps: Steps, here: Floats) -> Rival | None:
    """Return the minimum near the pose found moved by one of the `steps`, None where it is the same one or less
    of the surface fits there."""
    few = fit.samples.every(max(len(fit.samples.points) // N_REFINED, 1))
    rules = replace(fit.rules, distance=steps.reach, max_iterations=N_ITERATIONS, n_pairs=len(few.points) // 3,
                    locked=None, precision=0.3 * fit.sigma)  # fmt: skip
    first = replace(rules, max_iterations=N_FIRST)
    found = align(few, fit.target, step @ fit.T_target_source, first, both_oriented=fit.both_oriented)
    if robust_scale(found.matches.residuals) > HOPELESS * fit.sigma:
        return None
    found = align(few, fit.target, found.T_target_source, rules, both_oriented=fit.both_oriented)
    if not found.weights.any():
        return None
    places = apply(fit.T_target_source, fit.samples.points)
    gone = found.T_target_source @ invert(fit.T_target_source)
    way = float(np.sqrt(np.mean(np.sum((apply(gone, places) - places) ** 2, axis=1))))
    if way < steps.least:
        return None
    there = support(fit, found.T_target_source)
    telling = SURE * float(np.std(there - here)) / np.sqrt(len(here))
    rival = Rival(found.T_target_source, way, name_way(gone, places), float(here.mean()), float(there.mean()),
                 max(telling, LEAST_DIFFERENCE))  # fmt: skip
    return rival if rival.is_as_good and has_barrier(fit, gone, min(rival.here, rival.there)) else None


def has_barrier(fit: Fit, step: Floats, low: float) -> bool:
    """Return whether less fits on the way by `step` (4, 4), so that it leads to another minimum and not along a slide
    that nothing holds; `low` is the share that fits at the worse of both ends."""
    middle = apply(fit.T_target_source, fit.samples.points).mean(axis=0)
    motion = motion_about(step, middle)
    between = [perturb(fit.T_target_source, middle, part * motion) for part in PARTWAY]
    return min(float(support(fit, T).mean()) for T in between) < BARRIER * low


def name_way(T: Floats, places: Floats) -> str:
    """Return a motion of places (n, 3) [m] in words."""
    centre = places.mean(axis=0)
    return describe(motion_about(T, centre), lever_of(places, centre) + 1e-12)


def judge_rivals(found: Registration, fit: Fit, T_start: Floats, frames: Frames | None) -> Registration:
    """Return the registration, refused where another minimum is better or the pose as given does not tell the two
    apart, in doubt where that pose alone does.

    `T_start` (4, 4) is the pose as given; with `frames`, how far the pose found and the rival lie off what control
    says is counted in its sigmas, and a better fit elsewhere is no reason against control.
    """
    rival = find_rival(fit)
    if rival is None:
        return found
    there = rival.describe()
    ways = [away_from_given(T, fit, T_start, frames) for T in (fit.T_target_source, rival.T_target_source)]
    if rival.is_better and frames is None:
        return refuse(found, f"it lies in a local minimum: {there}; give a better start, targets or control points")
    if ways[1] <= TELLING * ways[0]:
        return refuse(found, f"it is ambiguous: {there}, and the poses as given do not tell which is right; give "
                      "targets or control points")  # fmt: skip
    if frames is not None:
        return found
    doubt = f"the poses as given alone tell where it is: {there}"
    return replace(found, doubt=f"{found.doubt}; {doubt}" if found.doubt else doubt)


def away_from_given(T: Floats, fit: Fit, T_start: Floats, frames: Frames | None) -> float:
    """Return how far a pose lies from the one given, the rms way [m] of the samples; in sigmas of the frames, at least
    one, where they are known."""
    if frames is None:
        way = apply(T, fit.samples.points) - apply(T_start, fit.samples.points)
        return float(np.sqrt(np.mean(np.sum(way**2, axis=1))))
    motion = motion_about(T, frames.centre)
    return max(float(np.sqrt(motion @ np.linalg.pinv(frames.covariance, hermitian=True) @ motion)), 1.0)


def refuse(found: Registration, reason: str) -> Registration:
    """Return a registration on which nothing may be built."""
    return replace(found, converged=False, reason=reason, covariance=np.full((6, 6), np.nan))
