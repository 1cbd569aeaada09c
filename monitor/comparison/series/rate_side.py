"""The rates of a series as one side of a comparison: what they come to over all of its time, and what limits them.

In: the comparisons of several epochs with one reference, and the lines fitted to their vertices. Out: a `Side` in
metres, which is judged as the difference of two epochs is (`rate_regions`). A rate is a sum of the differences, each
times its weight: what is independent from epoch to epoch adds up by squares, and what the reference brings into all of
them, of noise, scans and registration alike, by the sum of the weights, which is that of the reference itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.distances.perpendicular import unit_normals
from monitor.comparison.distances.rim import distance_to_rim, ends_of
from monitor.comparison.distances.side import Side, expected_change, fringe_of
from monitor.comparison.distances.stars import gather_neighbours, make_mesh, survey_vertices
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.trend import Polynomial, departures, weights_of_last
from monitor.registration.motion.covariance import about
from monitor.registration.motion.propagation import propagate
from projects.model import Assessment, Floats, NotAssessed, Registration, Surface

FEWEST = 3.0  # epochs with the reference, that a vertex must be known in: two tell a difference, and no trend
FURTHER = range(3, 6)  # degrees of the departures from a line that show how errors agree, beside accelerations
LEAST_OWN = 0.1  # of the sigma of a vertex, that is its own: what is stated in common may exceed what stable areas show


@dataclass(frozen=True)
class RateSide:
    """The change over the whole series at its mean rate, as a `side` [m] of the reference surface.

    `still` is the same side with what errors alone make: accelerations, as many of the rates' sigmas as they are of
    their own. They hold the errors of all epochs, and no trend. `further` (m, n) are as many other sums of the same
    errors without a trend, over their sigmas, as there are; independent of each other. `motion` has the covariance of
    all registrations in the rates; the change is over `years`.
    """

    side: Side
    still: Side
    further: Floats
    motion: Registration
    years: float


@dataclass(frozen=True)
class Fits:
    """What is fitted to the differences at n vertices: a `line` and a `curve`; `years` (k,) since the reference,
    `distances`, `sigmas` (k, n) m of the differences, NaN where not known, and `sigma_reference` (n,) m, the
    reference's part."""

    line: Polynomial
    curve: Polynomial
    years: Floats
    distances: Floats
    sigmas: Floats
    sigma_reference: Floats

    def weights(self, fit: Polynomial) -> Floats:
        """Return what a metre of each difference makes of the fit's last parameter (k, n)."""
        return weights_of_last(fit, self.years, self.sigmas, self.sigma_reference)


def make_rate_side(changes: Sequence[EpochChange], fits: Fits) -> RateSide:
    """Return the rates at the vertices of the reference surface as a side; `changes` are k epochs, by their dates."""
    whole, line, curve = float(fits.years[-1]), fits.line, fits.curve
    is_known = np.isfinite(curve.parameters[:, 2]) & (line.n_observed >= FEWEST)
    weights = whole * fits.weights(line)
    part = (fits.sigma_reference / np.fmin.reduce(fits.sigmas)) ** 2  # of a variance, that the reference brings
    typical = np.median(weights[:, is_known], axis=1) if is_known.any() else np.zeros(len(weights))
    common = float(np.median(part[is_known])) if is_known.any() else 0.5
    motion = combine_motions([c.comparison.registration for c in changes], typical, common)
    side = lay_bare(changes[0].side.surface, motion)
    shared2 = shared_variance(changes, weights) + np.nan_to_num(grown_by(weights, typical, part) * side.sigma_motion**2)
    sigma = whole * np.sqrt(line.covariance[:, 1, 1])
    own2 = np.fmax(sigma**2 - side.sigma_motion**2 - shared2, (LEAST_OWN * sigma) ** 2)
    reasons = np.where(is_known & np.isfinite(own2), NotAssessed.ASSESSED, NotAssessed.NOT_SEEN).astype(np.uint8)
    side = replace(
        side, sigma_surfaces=np.sqrt(own2), sigma_shared=np.sqrt(shared2), reasons=reasons,
        is_stable=np.logical_and.reduce([c.side.assessment != Assessment.CHANGED for c in changes]),
        distances=np.where(side.is_assessed & (reasons == NotAssessed.ASSESSED), whole * line.parameters[:, 1], np.nan),
    )  # fmt: skip
    bend = curve.parameters[:, 2] - expected_of(changes, fits.weights(curve), side.normals)
    bend = np.where(side.is_assessed, sigma * bend / np.sqrt(curve.covariance[:, 2, 2]), np.nan)
    further = departures(fits.years, fits.distances, fits.sigmas, fits.sigma_reference, FURTHER)
    if any(c.comparison.mode == "absolute" for c in changes):
        further = further[:0]  # they would hold the motion of the whole
    return RateSide(side, replace(side, distances=bend), further, motion, whole)


def lay_bare(surface: Surface, motion: Registration) -> Side:
    """Return a surface as a side of which nothing is told yet but its shape and what a motion's uncertainty makes."""
    mesh = make_mesh(surface.vertices, surface.faces)
    survey = survey_vertices(mesh)
    normals = unit_normals(surface, survey.normals)
    n, nothing = len(normals), np.zeros(len(normals))
    no_foot, one_class = np.full(n, -1, dtype=np.int32), np.zeros(n, dtype=np.uint8)
    ends = ends_of(surface, mesh, survey, 0.0)
    to_rim = distance_to_rim(ends.rim, surface.vertices)
    sigma = propagate(motion.covariance, motion.centre, surface.vertices, normals)
    return Side(
        surface, surface, no_foot, no_foot, normals, gather_neighbours(mesh, survey.n_neighbours), ends.areas,
        fringe_of(surface, to_rim, ends.areas), nothing, to_rim, nothing, nothing, nothing, sigma, nothing > 0.0,
        one_class, nothing, sigma, one_class, one_class, one_class, one_class,
    )  # fmt: skip


def combine_motions(registrations: Sequence[Registration], weights: Floats, part: float) -> Registration:
    """Return a motion with the covariance of sum weights (k,) times the errors of k registrations, about the centre of
    the first; the reference's `part` of their variance is common to all."""
    centre = registrations[0].centre
    covariances = np.stack([about(r.covariance, centre - r.centre) for r in registrations])
    own = np.einsum("k,kij->ij", weights**2, covariances)
    common = weights.sum() ** 2 * covariances.mean(axis=0)
    return Registration(np.eye(4), (1.0 - part) * own + part * common, centre, True)


def grown_by(weights: Floats, typical: Floats, part: Floats) -> Floats:
    """Return by how much (n,) the variance of errors that are alike in all epochs exceeds, with the `weights` (k, n),
    that with the `typical` ones (k,), as a share of it: where epochs are missing; 0 where it does not."""
    both = np.stack([(1.0 - part) * (w**2).sum(axis=0) + part * w.sum(axis=0) ** 2
                     for w in (weights, np.broadcast_to(typical[:, None], weights.shape))])  # fmt: skip
    return np.asarray(np.maximum(both[0] / np.maximum(both[1], 1e-300) - 1.0, 0.0))


def shared_variance(changes: Sequence[EpochChange], weights: Floats) -> Floats:
    """Return the variance (n,) [m2] that what the scans of each epoch disagree by brings into their sum with the
    `weights` (k, n); what no epoch states is 0, and left to the floor."""
    surface = changes[0].side.surface
    total = weights.sum(axis=0) ** 2 * stated_shared(surface) ** 2
    for change, weight in zip(changes, weights, strict=True):
        later = change.comparison.on_compared.surface
        if later.sigma_shared is not None:
            _, nearest = cKDTree(later.vertices).query(surface.vertices)
            total = total + (weight * stated_shared(later)[nearest]) ** 2
    return np.asarray(total)


def stated_shared(surface: Surface) -> Floats:
    """Return what the scans of a surface disagree by (n,) [m], 0 where that is not stated."""
    return np.nan_to_num(np.zeros(len(surface.vertices)) if surface.sigma_shared is None else surface.sigma_shared)


def expected_of(changes: Sequence[EpochChange], weights: Floats, normals: Floats) -> Floats:
    """Return what the motions of the whole that stay in the differences make of what these sum up to, with `weights`
    (k, n); the change that they make is along the `normals` (n, 3)."""
    total = np.zeros(len(normals))
    for change, weight in zip(changes, weights, strict=True):
        if change.comparison.mode == "absolute":
            motion = change.comparison.registration
            total += weight * expected_change(change.side.surface.vertices, normals, motion, -1.0)
    return total
