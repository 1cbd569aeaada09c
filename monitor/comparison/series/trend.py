"""How a change goes on in time: rate, acceleration, onset, and what the next epoch should show.

In: the differences of several epochs from one reference epoch, with their sigmas, and the times. Out: fits with
covariance. The reference epoch's own error is common to all of its differences, and a fit that takes
them for independent states the wrong sigma. So the reference counts as an observation of its own, "0 at time 0".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from monitor.blocks import blocks
from monitor.comparison.detection.family import adjust_together, share_as_small
from monitor.comparison.series.kinds_of_course import MISFIT, choose_kind
from projects.errors import ParameterError, ShapeError
from projects.model import Floats

N_DRAWS = 4000  # of courses on which nothing goes on, which say how often chance looks otherwise
LEVEL = 0.05  # how often, at most, a course on which nothing goes on gets another name than "none"


@dataclass(frozen=True)
class Polynomial:
    """Polynomials in time fitted at n places by least squares with known variances.

    `parameters` (n, p): offset [m], rate [m/year], half the acceleration [m/year2]; `covariance` (n, p, p); `chi2` (n,)
    of the residuals and `n_observed` (n,), the reference included. NaN where fewer epochs are known than parameters.
    """

    parameters: Floats
    covariance: Floats
    chi2: Floats
    n_observed: Floats


@dataclass(frozen=True)
class Course:
    """How one region goes on.

    Attributes
    ----------
    model : "none" (nothing goes on), "steady", "accelerating" (faster and faster, or slower and slower, by a constant
        acceleration), "bending" (so by another), "onset" (nothing before a moment, then on), "stopped" (on up to a
        moment, then nothing), "jump" (at once, nothing before and after), "jump and rate" (at once, and on all along or
        from then); several of these joined by " or " where the epochs do not tell which; "irregular" (none of these
        fits: what comes and goes, or goes on by several jumps), "single" (one epoch after the reference is known, which
        leaves all of them open).
    rate, sigma_rate : m/year, of the steady model; p_rate: two-sided, of a rate of zero.
    acceleration, sigma_acceleration, p_acceleration : m/year2; NaN with fewer than two epochs after the reference.
    p_onset : how often chance looks as much like an onset, a stop or a jump where nothing goes on; NaN with one epoch
        after the reference.
    onset : years since the reference between which the change began, or stopped; NaN where the model has no such
        moment, or it is open whether it has.
    p_fit : of the residuals of the steady model; NaN without any to spare.

    Each p value is that of one test by itself. The model rests on all of them together (`adjust_together`): a course on
    which nothing goes on gets another name than "none" in at most `LEVEL`, a steady one seldom gets another than its
    own. A p value just below 0.05 by itself makes no name.
    """

    model: str
    rate: float
    sigma_rate: float
    p_rate: float
    acceleration: float
    sigma_acceleration: float
    p_acceleration: float
    p_onset: float
    onset: tuple[float, float]
    p_fit: float


def fit_polynomial(years: Floats, distances: Floats, sigmas: Floats, sigma_reference: Floats,
                   degree: int = 1) -> Polynomial:  # fmt: skip
    """Fit offset, rate and (degree 2) acceleration to the differences of several epochs from one reference.

    Parameters
    ----------
    years : (k,) since the reference epoch, ascending, above 0.
    distances : (k, n) m, positive = gained; NaN where an epoch was not assessable.
    sigmas : (k, n) m, one sigma of each difference, the reference's own part included.
    sigma_reference : (n,) m, that part.

    Notes
    -----
    With x_0 = 0 observed at t = 0 with sigma_reference, and d_i at t_i with variance sigma_i^2 - sigma_reference^2, all
    independent, the fit is that of the differences with their full covariance.
    """
    times, values, variances = _with_reference(years, distances, sigmas, sigma_reference)
    design = times[:, None] ** np.arange(degree + 1)
    weight = np.where(np.isfinite(values) & (variances > 0.0), 1.0 / np.where(variances > 0.0, variances, 1.0), 0.0)
    values = np.where(weight > 0.0, values, 0.0)
    n_observed = np.count_nonzero(weight, axis=0).astype(float)
    normal = np.einsum("kn,kp,kq->npq", weight, design, design)
    right = np.einsum("kn,kp,kn->np", weight, design, values)
    known = n_observed > degree
    normal[~known] = np.eye(degree + 1)
    covariance = np.linalg.inv(normal)
    parameters = np.einsum("npq,nq->np", covariance, right)
    chi2 = (weight * (values - design @ parameters.T) ** 2).sum(axis=0)
    nothing = ~known
    parameters[nothing], covariance[nothing], chi2[nothing] = np.nan, np.nan, np.nan
    return Polynomial(parameters, covariance, chi2, n_observed)


def weights_of_last(fit: Polynomial, years: Floats, sigmas: Floats, sigma_reference: Floats) -> Floats:
    """Return what a metre of each difference makes of the last parameter of a fit, (k, n) 1/year or 1/year2; 0 where it
    is not known.

    The weights of all observations sum to zero, so minus their sum is that of the reference, which is 0 at time 0.
    """
    variances = sigmas**2 - sigma_reference**2
    weight = np.where(variances > 0.0, 1.0 / np.where(variances > 0.0, variances, 1.0), 0.0)
    powers = np.asarray(years)[:, None] ** np.arange(fit.parameters.shape[1])
    return np.nan_to_num(weight * (powers @ fit.covariance[:, -1].T))


def departures(years: Floats, distances: Floats, sigmas: Floats, sigma_reference: Floats,
               degrees: range) -> Floats:  # fmt: skip
    """Return what differences show beyond a line, over its sigma, (m, n): the last parameters of polynomials of these
    `degrees`, as far as there are epochs for them; see `fit_polynomial`. NaN where too few are known.

    Each is what its power of time adds to all lower ones, so they are independent of each other and of the line.
    """
    degrees, n = range(degrees.start, min(degrees.stop, len(years) + 1)), len(sigma_reference)
    out = np.empty((len(degrees), n))
    for block in blocks(n):  # a covariance of degree 5 is a quarter of a KiB a vertex
        given = distances[:, block], sigmas[:, block], sigma_reference[block]
        for k, degree in enumerate(degrees):
            fit = fit_polynomial(years / years[-1], *given, degree)
            out[k, block] = fit.parameters[:, -1] / np.sqrt(fit.covariance[:, -1, -1])
    return out


def _with_reference(years: Floats, distances: Floats, sigmas: Floats,
                    sigma_reference: Floats) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Return times (k + 1,), values and variances (k + 1, n) with the reference as the first observation."""
    years = np.asarray(years, dtype=float)
    if years.ndim != 1 or not len(years) or not (np.diff(years, prepend=0.0) > 0.0).all():
        raise ParameterError(f"years {years.tolist()}: ascending times above 0, the reference's, are needed")
    if distances.shape != sigmas.shape or distances.shape[1:] != sigma_reference.shape or len(distances) != len(years):
        raise ShapeError(
            f"{len(years)} times, differences {distances.shape}, sigmas {sigmas.shape}, reference "
            f"{sigma_reference.shape}; (k,), (k, n), (k, n) and (n,) are needed"
        )
    own2 = sigmas**2 - sigma_reference**2
    return (
        np.append(0.0, years),
        np.vstack([np.zeros(distances.shape[1]), distances]),
        np.vstack([sigma_reference**2, own2]),
    )


def fit_course(years: Floats, means: Floats, sigmas: Floats, sigma_reference: float, *, seed: int = 0) -> Course:
    """Return how the mean change of one region goes on: `means`, `sigmas` (k,) m at `years` (k,), NaN unknown.

    Raises
    ------
    ParameterError
        Where no epoch is known.
    """
    seen = np.isfinite(means) & np.isfinite(sigmas)
    if not seen.any():
        raise ParameterError("the region is not assessable in any epoch; a course needs one at least")
    years, means, sigmas = years[seen], means[seen], sigmas[seen]
    column = (years, means[:, None], sigmas[:, None], np.array([sigma_reference]))
    line, curve = fit_polynomial(*column, degree=1), fit_polynomial(*column, degree=2)
    rate, sigma_rate = float(line.parameters[0, 1]), float(np.sqrt(line.covariance[0, 1, 1]))
    bend, sigma_bend = 2.0 * float(curve.parameters[0, 2]), 2.0 * float(np.sqrt(curve.covariance[0, 2, 2]))
    p_rate, p_bend = two_sided(rate / sigma_rate), two_sided(bend / sigma_bend)
    spare, onset = len(years) - 1, (np.nan, np.nan)
    p_fit = p_of_chi2(line.chi2[0], spare)
    if spare == 0:
        return Course("single", rate, sigma_rate, p_rate, bend, sigma_bend, p_bend, np.nan, onset, p_fit)
    p_onset, chance = judge_moments(*column, seed)
    goes_on, bends, begins = adjust_together(np.array([p_rate, p_bend, p_onset]), chance) <= LEVEL - MISFIT
    model, fits = "steady" if goes_on else "none", bool(p_fit >= MISFIT)
    if bends or begins or not fits:
        times, values, variances = _with_reference(*column)
        choice = choose_kind(times, values[:, 0], np.sqrt(variances[:, 0]))
        onset = choice.between
        model = " or ".join(choice.kinds) or (model if fits else "irregular")
    return Course(model, rate, sigma_rate, p_rate, bend, sigma_bend, p_bend, p_onset, onset, p_fit)


def fit_rate(years: Floats, values: Floats, sigmas: Floats, sigma_reference: float) -> tuple[float, float]:
    """Return the rate of a steady course and its sigma [a year]; arguments as of `fit_course`."""
    seen = np.isfinite(values) & np.isfinite(sigmas)
    if not seen.any():
        return float("nan"), float("nan")
    line = fit_polynomial(years[seen], values[seen, None], sigmas[seen, None], np.array([sigma_reference]))
    return float(line.parameters[0, 1]), float(np.sqrt(line.covariance[0, 1, 1]))


def p_of_chi2(value: float, n_spare: int) -> float:
    """Return how often chance leaves residuals as large; NaN without any to spare."""
    return float(chi2.sf(value, n_spare)) if n_spare > 0 else float("nan")


def two_sided(z: float) -> float:
    """Return the two-sided p value of a standard normal z; NaN stays NaN."""
    return float(2.0 * norm.sf(abs(z)))


def judge_moments(years: Floats, means: Floats, sigmas: Floats, sigma_reference: Floats,
                  seed: int) -> tuple[float, Floats]:  # fmt: skip
    """Return how often chance looks as much like a course with a moment, and what chance makes of the tests of rate,
    acceleration and moment at once, p values (3, `N_DRAWS`).

    `means`, `sigmas` (k, 1) are of k > 1 epochs, `sigma_reference` (1,). Tried are a jump between each two epochs and a
    line that starts or ends at each epoch, against a line from the reference on; the evidence is the fall of
    chi-square, its law that of courses with the same sigmas on which nothing goes on.
    """
    times, values, variances = _with_reference(years, means, sigmas, sigma_reference)
    sigma = np.sqrt(variances[:, 0])
    line = times[:, None] ** np.arange(2)
    designs = [line, *list_moments(times)]
    draws = np.random.default_rng(seed).standard_normal((len(times), N_DRAWS))
    fall, falls = _fall_of_chi2(designs, values[:, 0] / sigma, sigma), _fall_of_chi2(designs, draws, sigma)
    chance = [two_sided_of_last(d, draws, sigma) for d in (line, times[:, None] ** np.arange(3))]
    return float(share_as_small(-fall, -falls)), np.stack([*chance, share_as_small(-falls, -falls)])


def two_sided_of_last(design: Floats, draws: Floats, sigma: Floats) -> Floats:
    """Return the two-sided p values (m,) of the last parameter of a design (k, p) fitted to standardized values `draws`
    (k, m): over its sigma it is their product with the last column of Q of the standardized design."""
    q, _ = np.linalg.qr(design / sigma[:, None])
    return np.asarray(2.0 * norm.sf(np.abs(q[:, -1] @ draws)))


def list_moments(times: Floats) -> list[Floats]:
    """Return the columns (k + 1, 2) of courses with a moment that epochs at `times` (k + 1,) can tell apart."""
    ones, last = np.ones_like(times), len(times) - 1
    found = [np.column_stack([ones, times >= times[j]]) for j in range(1, last + 1)]
    # A line that starts at the last epoch but one, or ends at the first but one, is a jump.
    found += [np.column_stack([ones, np.maximum(times - times[j], 0.0)]) for j in range(1, last - 1)]
    return found + [np.column_stack([ones, np.minimum(times, times[j])]) for j in range(2, last)]


def _fall_of_chi2(designs: list[Floats], values: Floats, sigma: Floats) -> Floats:
    """Return by how much the best moment lowers the chi-square of standardized values under that of a line."""
    left = []
    for design in designs:
        q, _ = np.linalg.qr(design / sigma[:, None])
        left.append(((values - q @ (q.T @ values)) ** 2).sum(axis=0))
    return np.asarray(left[0] - np.stack(left[1:]).min(axis=0))


def predict(years: Floats, means: Floats, sigmas: Floats, sigma_reference: float, at: Floats,
            degree: int = 1) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the difference from the reference [m] that an epoch at times `at` (m,) [years] should show, and its sigma.

    The sigma holds the fit's and that of a new epoch as good as the present ones in the mean: an epoch outside of 1.96
    of it does not go on as before.
    """
    seen = np.isfinite(means) & np.isfinite(sigmas)
    fit = fit_polynomial(years[seen], means[seen, None], sigmas[seen, None], np.array([float(sigma_reference)]), degree)
    rows = np.asarray(at, dtype=float)[:, None] ** np.arange(degree + 1)
    new2 = float(np.mean(sigmas[seen] ** 2)) - sigma_reference**2
    spread2 = np.einsum("mp,pq,mq->m", rows, fit.covariance[0], rows)
    return rows @ fit.parameters[0], np.sqrt(spread2 + new2)
