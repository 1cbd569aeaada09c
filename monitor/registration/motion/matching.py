"""Correspondences between the moved samples of the source and the target, and their residuals.

The residual is the symmetric point-to-plane distance of Rusinkiewicz (2019): along the mean of both normals, zero for
any two points of one sphere, so that curvature and coarse sampling do not pull. A pair counts only where the normals
agree and where the source point stands over the target (not beside its free edge).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monitor.filtering.orientation import consistent_signs
from monitor.registration.motion.partners import Partners
from monitor.registration.motion.sides import Side
from projects.model import Bools, Floats, Ints
from projects.transforms import apply, rotate

TANGENTIAL_SPACINGS = 1.5  # within a sheet the nearest point is never farther aside than this many spacings


@dataclass(frozen=True)
class Samples:
    """The source's points that are matched: positions, unit normals, sigma [m] (0 where not stated), m; their
    numbers in their side, one sigma [m] of the error that their neighbourhood shares, the cosines of the
    incidence at which they were seen (1 where that is not known), and what the points around them scatter by, `relief`
    [m] (0 before `with_relief`)."""

    points: Floats
    normals: Floats
    sigma: Floats
    index: Ints
    shared: Floats
    cosines: Floats
    relief: Floats

    def every(self, step: int) -> Samples:
        """Return every `step`-th sample."""
        return Samples(**{name: value[::step] for name, value in vars(self).items()})

    def take(self, which: Ints) -> Samples:
        """Return the samples selected."""
        return Samples(**{name: value[which] for name, value in vars(self).items()})


@dataclass(frozen=True)
class Matches:
    """Pairs of a moved source point and a target point; all arrays have one row per pair.

    `residuals` [m] are positive where the source lies outside of the target along `normals`; `source` numbers the
    samples, `target` the target's points; `sigma` [m] is of both points together (0 where neither states one),
    `shared` [m] of the errors that the neighbourhoods of both share. Of the points of a pair, `steepness` is one less
    the smaller cosine of incidence, `disagreement` one less that of the angle between their normals, and `relief` [m]
    what the smoother side scatters by around its point (0 before `compare_relief`).
    """

    source: Ints
    points: Floats
    residuals: Floats
    normals: Floats
    normals_source: Floats
    normals_target: Floats
    sigma: Floats
    tangential: Floats
    target: Ints
    shared: Floats
    steepness: Floats
    disagreement: Floats
    relief: Floats

    def __len__(self) -> int:
        return len(self.source)

    def take(self, which: Bools) -> Matches:
        """Return the pairs selected."""
        return Matches(**{name: value[which] for name, value in vars(self).items()})

    @property
    def causes(self) -> tuple[Floats, ...]:
        """What pairs are the less certain for, the more of it they have, (n,) each: sigma, relief, angles."""
        return self.sigma, self.relief, self.steepness, self.disagreement


@dataclass(frozen=True)
class MatchLimits:
    """Pairs farther apart than `distance` [m], aside more than `tangential` [m] (but never less than the spacing of
    the target allows), or with normals more than `angle` [rad] apart are refused."""

    distance: float
    tangential: float
    angle: float


def make_samples(side: Side, which: Ints) -> Samples:
    """Return the samples `which` of a side; fitted normals, whose sign is anybody's, look the same way as those around.

    Residuals are along normals: where signs changed from point to point, a place that moved would show a mean of zero.
    """
    sigma = np.zeros(len(which)) if side.sigma is None else side.sigma[which]
    points, normals = side.points[which], side.normals_of(which)
    if not side.is_oriented and len(which):
        normals = normals * consistent_signs(points, normals)[:, None]
    return Samples(points, normals, sigma, which, side.shared[which],
                   side.cosines[which], np.zeros(len(which)))  # fmt: skip


def with_relief(samples: Samples, side: Side) -> Samples:
    """Return samples of a side with what the points around them scatter by."""
    return replace(samples, relief=side.relief_of(samples.index))


def match(samples: Samples, target: Side, T_target_source: Floats, limits: MatchLimits, both_oriented: bool,
          partners: Partners | None = None) -> Matches:  # fmt: skip
    """Return the pairs of the moved samples with their nearest target points that pass the limits.

    `partners`, of these samples and this target, spare the search where the pose differs little from the last one's.
    """
    moved = apply(T_target_source, samples.points)
    if partners is None:
        distance, nearest = target.tree.query(moved, distance_upper_bound=limits.distance)
    else:
        distance, nearest = partners.find(moved, limits.distance)
    source = np.flatnonzero(np.isfinite(distance))
    nearest, moved = nearest[source], moved[source]
    n_source = rotate(T_target_source, samples.normals[source])
    n_target = target.normals_of(nearest)
    agreement = np.einsum("ij,ij->i", n_source, n_target)
    if not both_oriented:
        turned = np.where(agreement < 0, -1.0, 1.0)[:, None]
        n_source, n_target = (n_source * turned, n_target) if target.is_oriented else (n_source, n_target * turned)
        agreement = np.abs(agreement)
    normals = n_source + n_target
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    offset = moved - target.points[nearest]
    residuals = np.einsum("ij,ij->i", offset, normals)
    tangential = np.sqrt(np.maximum(distance[source] ** 2 - residuals**2, 0.0))
    keep = (agreement > np.cos(limits.angle)) & (tangential <= limits.tangential)
    far = np.flatnonzero((agreement > np.cos(limits.angle)) & ~keep)
    keep[far] = tangential[far] <= TANGENTIAL_SPACINGS * target.spacing_of(nearest[far])
    sigma_target = 0.0 if target.sigma is None else target.sigma[nearest]
    sigma = np.hypot(samples.sigma[source], sigma_target)
    shared = np.hypot(samples.shared[source], target.shared[nearest])
    steepness = 1.0 - np.minimum(samples.cosines[source], target.cosines[nearest])
    pairs = Matches(source, moved, residuals, normals, n_source, n_target, sigma, tangential, nearest, shared,
                    steepness, 1.0 - agreement, np.zeros(len(source)))  # fmt: skip
    return pairs.take(keep)


def compare_relief(pairs: Matches, samples: Samples, target: Side) -> Matches:
    """Return the pairs with what the smoother of both sides scatters by around its point.

    A rough place is rough in both; where only one side is, it has changed, and nothing is to be allowed for.
    """
    return replace(pairs, relief=np.minimum(samples.relief[pairs.source], target.relief_of(pairs.target)))
