"""Which kind of course the epochs of one region bear out: those that fit within the sigmas, the likeliest of them.

In: standardized observations of one region, the reference's among them. Out: a `Choice`. Where epochs are too few to
tell two kinds apart, both are named, and no date is given that only one of them has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from projects.model import Floats

MISFIT = 0.01  # a kind whose residuals chance leaves less often is none that fits
AS_LIKELY = 2.0 * np.log(20.0)  # in the criterion: a kind that is 20 times less likely than another is told from it
KINDS = ("accelerating", "bending", "jump", "onset", "stopped", "jump and rate")  # in the order in which they are named
UNDATED, DATED = KINDS[:2], ("onset", "stopped")  # without a moment, and with another one than a jump's
# Kinds that come as close to one as one likes and fit no worse: they are no rivals of the one that needs less.
CONTAINS = {"jump": ("onset", "stopped", "bending"), "accelerating": ("bending",)}
LEAST_BESIDE = 2  # epochs on each side of a jump beside a rate: one alone may be off by itself


@dataclass(frozen=True)
class Candidate:
    """A course as it fits: its kind, the chi-square that it leaves, how many numbers were fitted, how many choices were
    made for it (a scan over dates is one more), and the years between which it has its moment, NaN without."""

    kind: str
    chi2: float
    n_fitted: int
    n_chosen: int
    between: tuple[float, float] = (np.nan, np.nan)

    @property
    def criterion(self) -> float:
        """Akaike's for known sigmas: less is likelier."""
        return self.chi2 + 2.0 * self.n_chosen


@dataclass(frozen=True)
class Choice:
    """The kinds that epochs do not tell apart, in the order of `KINDS`, none where none fits; and the years between
    which the moment lies, NaN unless all of them have the same one."""

    kinds: tuple[str, ...]
    between: tuple[float, float]


def choose_kind(times: Floats, values: Floats, sigma: Floats) -> Choice:
    """Return which kind of course observations of one region bear out.

    Parameters
    ----------
    times : (k + 1,) years, ascending; the first is the reference's, 0. k is 2 or more.
    values, sigma : (k + 1,) m, independent: what each epoch adds to the difference, positive = gained, the reference's
        0; one sigma of each.

    Notes
    -----
    A candidate must leave residuals that chance does in `MISFIT` of cases or more. Of those the least criterion is the
    kind, and others within `AS_LIKELY` of it are named with it: chance makes the wrong one of two given courses 20
    times as likely as the right one in at most one of 20 cases. (Kinds are fitted, not given: how often a wrong one is
    named by itself is measured, `test_trend_courses.py`.) Two changes in one course, a jump beside a rate, are told
    only where all courses with one, those that do not fit as well, are 20 times less likely.

    References
    ----------
    Akaike (1974), A new look at the statistical model identification; Royall (2000), On the probability of observing
    misleading statistical evidence, for the bound.
    """
    one, two = list(single_changes(times, values, sigma)), list(double_changes(times, values, sigma))
    fit_one, fit_two = ([c for c in tried if fits(c, len(times))] for tried in (one, two))
    likelier = min((c.criterion for c in fit_two), default=np.inf) + AS_LIKELY < min(c.criterion for c in one)
    return summarize(fit_two if likelier else fit_one)


def fits(candidate: Candidate, n_observed: int) -> bool:
    """Return whether chance leaves as large residuals often enough; so without any to spare."""
    n_spare = n_observed - candidate.n_fitted
    return n_spare <= 0 or bool(chi2.sf(candidate.chi2, n_spare) >= MISFIT)


def summarize(candidates: list[Candidate]) -> Choice:
    """Return the kinds of which none is told from the likeliest, and from when to when their moment may be."""
    least: dict[str, float] = {}
    for c in sorted(candidates, key=lambda c: c.criterion):
        least.setdefault(c.kind, c.criterion)
    if not least:
        return Choice((), (np.nan, np.nan))
    first = next(iter(least))
    rivals = {k for k, v in least.items() if v <= least[first] + AS_LIKELY} - set(CONTAINS.get(first, ()))
    if "accelerating" in rivals:
        rivals.discard("bending")  # no other bend is needed where a constant acceleration does
    kinds = tuple(k for k in KINDS if k in rivals)
    if rivals & set(UNDATED) or {"stopped"} < rivals:  # no moment for sure, or a beginning or an end
        return Choice(kinds, (np.nan, np.nan))
    moments = [c.between for c in candidates if c.kind in kinds and c.criterion <= least[c.kind] + AS_LIKELY]
    moments += [c.between for c in candidates if c.kind in DATED and c.criterion <= least[first] + AS_LIKELY]
    return Choice(kinds, (min(m[0] for m in moments), max(m[1] for m in moments)))


def single_changes(times: Floats, values: Floats, sigma: Floats) -> Iterator[Candidate]:
    """Yield the courses with one change: of the rate all along, at once, from a moment on, or up to one."""
    left, n_fitted = parabola(times, values, sigma)
    yield Candidate("accelerating", left, n_fitted, 3)
    if len(times) > 3:
        yield Candidate("bending", chi2_of_exponential(times, values, sigma), 3, 3)
    ones = np.ones_like(times)
    for j in range(1, len(times)):
        left, _ = leave([ones, times >= times[j]], values, sigma)
        yield Candidate("jump", left, 2, 3, (float(times[j - 1]), float(times[j])))
    for left, between in hinges(times, values, sigma):
        yield Candidate("onset", left, 3, 4, between)
    end = times[-1]
    for left, (first, last) in hinges(end - times[::-1], values[::-1], sigma[::-1]):
        yield Candidate("stopped", left, 3, 4, (float(end - last), float(end - first)))


def double_changes(times: Floats, values: Floats, sigma: Floats) -> Iterator[Candidate]:
    """Yield the jumps beside a rate: one rate all along, or from the jump on; none with no epoch to spare."""
    if len(times) < 5:
        return
    ones = np.ones_like(times)
    for j in range(LEAST_BESIDE, len(times) - LEAST_BESIDE + 1):
        after = times >= times[j]
        for rate in (times, np.maximum(times - times[j], 0.0)):
            left, _ = leave([ones, after, rate], values, sigma)
            yield Candidate("jump and rate", left, 3, 4, (float(times[j - 1]), float(times[j])))


def parabola(times: Floats, values: Floats, sigma: Floats) -> tuple[float, int]:
    """Return the chi-square that the best parabola leaves which does not turn back between the first epoch and the
    last, and how many numbers it fits.

    What turns back comes and goes. Where the best of all does, the best that does not stands still at one end.
    """
    ones, end = np.ones_like(times), times[-1]
    left, (_, rate, half) = leave([ones, times, times**2], values, sigma)
    if rate * (rate + 2.0 * half * end) >= 0.0:
        return left, 3
    ends = ([ones, times**2], [ones, times * (times - 2.0 * end)])
    return min(leave(columns, values, sigma)[0] for columns in ends), 2


def chi2_of_exponential(times: Floats, values: Floats, sigma: Floats) -> float:
    """Return the chi-square that the best growth or decay by equal shares in equal times leaves.

    It is exp(t / T), |T| from the span of all epochs down to the mean time between two: a longer one is no other than a
    parabola to these epochs, a shorter one no other than a jump.
    """
    ones, unit, most = np.ones_like(times), times / times[-1], float(np.log(len(times) - 1))

    def left(power: float, sign: float) -> float:
        return leave([ones, np.exp(sign * np.exp(power) * unit)], values, sigma)[0]

    return min(
        float(minimize_scalar(left, bounds=(0.0, most), args=(sign,), method="bounded").fun) for sign in (1.0, -1.0)
    )


def hinges(times: Floats, values: Floats, sigma: Floats) -> Iterator[tuple[float, tuple[float, float]]]:
    """Yield what courses leave that rest up to a moment and go on at one rate from then, and between which epochs it
    lies: at each epoch, and between each two where the line after meets the rest before in between.

    At the first epoch that is a line, at the last but one or later a jump to the last: neither is tried.
    """
    ones, last = np.ones_like(times), len(times) - 1
    for j in range(1, last):
        after = times >= times[j]
        since = np.maximum(times - times[j], 0.0)
        left, (_, step, rate) = leave([ones, after, since], values, sigma)
        if rate != 0.0 and 0.0 < step / rate < times[j] - times[j - 1]:
            yield left, (float(times[j - 1]), float(times[j]))
        if j < last - 1:
            yield leave([ones, since], values, sigma)[0], (float(times[j - 1]), float(times[j + 1]))


def leave(columns: list[Floats], values: Floats, sigma: Floats) -> tuple[float, Floats]:
    """Return the chi-square that the best sum of columns (k + 1,) leaves, and its factors."""
    design = np.column_stack(columns) / sigma[:, None]
    factors = np.linalg.lstsq(design, values / sigma, rcond=None)[0]
    return float(((values / sigma - design @ factors) ** 2).sum()), factors
