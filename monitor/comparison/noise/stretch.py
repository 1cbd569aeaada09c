"""How much farther errors agree in some places than in others: fits are wide where points are few or noise is large.

In: errors of calm vertices, one sigma of each, and how all of them agree. Out: `Stretch`, by what factor that reaches
farther where a vertex has so much sigma, 1 or more. One fit over many points makes a small error that reaches far, one
over few a large one that ends soon: where the spacing of points varies, as in a room seen from two places, means of
patches err by a third more than one correlation says in the former places, and by less in the latter. Only the former
is used: where errors end sooner, means are surer than is said.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monitor.comparison.noise.asked_scale import believe
from monitor.comparison.noise.correlation import Correlation, draw_pairs, longest_lag
from monitor.robust import MAD_TO_SIGMA
from projects.model import Bools, Floats, Ints

N_CLASSES = 5  # of vertices, as many in each, from the surest on
N_BINS = 16  # of lags
FEWEST_PLACES = 1000  # calm vertices, of which fewer tell nothing of classes
FEWEST_PAIRS = 2000  # of a class, that its stretch is asked of
LEAST_MEAN = 0.02  # a correlation as small as this is none
HELD_BY = 64.0  # witnesses that no stretch counts for: it may be one of 1.13, one sigma
CHANCE = 0.95  # one sigma of a factor's logarithm, of one witness: 12 draws of an even wall show 0.7 to 1.4 of that
CHANCE_OF_PAIRS = 4.7  # the same of one pair: other 6000 pairs of the same errors move it by 0.06
TRIED = np.geomspace(0.4, 2.5, 61)  # factors
OUTLIER = 3.0  # robust sigmas, beyond which a change speaks


@dataclass(frozen=True)
class Stretch:
    """Errors agree `factors` (k,) times as far as in all, where one sigma of a vertex is `sigmas` (k,) [m], rising;
    between these by their logarithms, beyond them as at the last."""

    sigmas: Floats
    factors: Floats

    def square_of(self, variance: Floats) -> Floats:
        """Return the square (n,) of the factor where vertices have a `variance` (n,) [m2]."""
        if len(self.sigmas) < 2:
            return np.ones(np.shape(variance))
        at = 0.5 * np.log(np.maximum(variance, 1e-300))
        return np.asarray(np.exp(2.0 * np.interp(at, np.log(self.sigmas), np.log(self.factors))))

    def square_over(self, weight: Floats, variance: Floats) -> float:
        """Return the square of the factor by which the area over which errors agree counts in the mean over some
        vertices, by `weight` (n,) of each; 1 of none."""
        total = float(weight @ variance)
        return float(weight @ (variance * self.square_of(variance))) / total if total > 0.0 else 1.0


EVEN = Stretch(np.zeros(0), np.zeros(0))


def learn_stretch(points: Floats, places: Ints, areas: Floats, errors_of: Callable[[Ints], tuple[Floats, Floats]],
                  correlation: Correlation, rng: np.random.Generator) -> Stretch:  # fmt: skip
    """Return how far errors agree, by the sigma of the vertices, over how far `correlation` says they do in all.

    Parameters
    ----------
    points, areas : (n, 3) m and (n,) m2, of all vertices; `places` (k,) are the calm ones, rising.
    errors_of : returns the standardized errors (m,) and one sigma (m,) [m] of the vertices that it is given.

    Notes
    -----
    Vertices fall in classes of equal number by their sigma. Of the pairs that lie in one class the mean products are
    held against the correlation of all, its distances stretched: the factor that fits best counts by what lies beyond
    chance, one sigma of its witnesses. (Of classes that reach equally far chance makes 1.1 in the mean otherwise, as
    those below 1 do not count, and that hid a quarter of faint steps.)
    """
    if not correlation.area > 0.0 or len(places) < FEWEST_PLACES:
        return EVEN
    spacing, longest = longest_lag(points, places, areas)
    pairs = draw_pairs(points, places, spacing, longest, rng)
    asked, back = _number(np.concatenate([pairs.first, pairs.second]), len(points))
    errors, sigmas = errors_of(asked)
    size = MAD_TO_SIGMA * float(np.nanmedian(np.abs(errors)))
    errors = np.where(np.abs(errors) <= OUTLIER * size, errors, np.nan)
    edges = np.quantile(sigmas, np.linspace(0.0, 1.0, N_CLASSES + 1)[1:-1])
    in_class = np.searchsorted(edges, sigmas, side="right")
    standard = errors / _size_by_class(errors, in_class)[in_class]
    products = standard[back[: len(pairs.first)]] * standard[back[len(pairs.first) :]]
    ends = in_class[back[: len(pairs.first)]], in_class[back[len(pairs.first) :]]
    alike = np.isfinite(products) & (ends[0] == ends[1])
    area = float(areas[places].sum()) / N_CLASSES
    found = [_stretch_of(pairs.lags, products, alike & (ends[0] == k), correlation, area) for k in range(N_CLASSES)]
    middles = [float(np.median(sigmas[in_class == k])) if (in_class == k).any() else np.nan for k in range(N_CLASSES)]
    return _rising(np.array(middles), np.array(found))


def _number(vertices: Ints, n: int) -> tuple[Ints, Ints]:
    """Return which of n vertices are among these (m,), rising, and where each of these is among those (m,): what
    `np.unique` does by sorting."""
    is_asked = np.zeros(n, dtype=np.bool_)
    is_asked[vertices] = True
    asked = np.flatnonzero(is_asked)
    rank = np.empty(n, dtype=np.int32)
    rank[asked] = np.arange(len(asked), dtype=np.int32)
    return asked, rank[vertices]


def _believed(factor: float, n_witnesses: float, n_pairs: int) -> float:
    """Return what is believed of a factor of so many witnesses, asked of so many of their pairs: one sigma less than
    they say, and held as a rule to be near 1.

    A change that is no region yet teaches its class, too, and of a small object a class is not much more.
    """
    chance = np.hypot(CHANCE / np.sqrt(n_witnesses), CHANCE_OF_PAIRS / np.sqrt(n_pairs))
    return believe(factor * float(np.exp(-chance)), n_witnesses, HELD_BY)


def _size_by_class(errors: Floats, in_class: Ints) -> Floats:
    """Return the root mean square (`N_CLASSES`,) of the errors of each class, NaN of none."""
    known = np.isfinite(errors)
    count = np.bincount(in_class[known], minlength=N_CLASSES)
    total = np.bincount(in_class[known], errors[known] ** 2, minlength=N_CLASSES)
    return np.sqrt(np.divide(total, count, out=np.full(N_CLASSES, np.nan), where=count > 0))


def _stretch_of(lags: Floats, products: Floats, which: Bools, correlation: Correlation, area: float) -> float:
    """Return the factor of a class of so much `area` [m2], whose pairs are `which`; NaN of too few that lie near
    enough."""
    reach = TRIED[-1] * float(correlation.ranges[correlation.sills > LEAST_MEAN].max(initial=0.0))
    own = which & (lags <= reach)
    n_pairs = int(own.sum())
    if n_pairs < FEWEST_PAIRS:
        return np.nan
    lags, products = lags[own], products[own]
    edges = np.quantile(lags, np.linspace(0.0, 1.0, N_BINS + 1))
    in_bin = np.clip(np.searchsorted(edges, lags, side="right") - 1, 0, N_BINS - 1)
    count = np.maximum(np.bincount(in_bin, minlength=N_BINS), 1)
    lag, rho = (np.bincount(in_bin, v, N_BINS) / count for v in (lags, products))
    misfit = [float(count @ (rho - correlation.at(lag / s)) ** 2) for s in TRIED]
    best = float(TRIED[int(np.argmin(misfit))])
    return max(_believed(best, area / (correlation.area * best**2), n_pairs), 1.0)


def _rising(sigmas: Floats, factors: Floats) -> Stretch:
    """Return the stretch of the classes that are known, each of another sigma than the one before."""
    known = (sigmas > 0.0) & np.isfinite(factors)
    sigmas, factors = sigmas[known], factors[known]
    kept = np.append(True, np.diff(sigmas) > 0.0)[: len(sigmas)]
    return Stretch(sigmas[kept], factors[kept]) if kept.sum() > 1 else EVEN
