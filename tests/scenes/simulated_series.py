"""Series of comparisons with known noise: correlated along the surface, and the reference's part common to all epochs.

A plane of 60 x 60 vertices, 148 mm wide; each epoch's difference is stated as it is known, 1 mm at 95 %.
"""

from __future__ import annotations

import datetime

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter

from monitor.comparison.series.epoch_change import EpochChange
from projects.model import REGION_COLUMNS, Z95, Bools, ComparedSurface, Comparison, Floats, Registration, Surface

N, STEP = 60, 2.5e-3  # vertices along an edge; m
SIGMA, PART = 1e-3 / Z95, 0.5  # m, of a difference; of its variance, the reference's
REACH, NUGGET = 1.5, 0.3  # steps, of the Gaussian that smooths the noise; of its variance, what is not smoothed
YEARS = np.arange(1.0, 11.0)
START = datetime.date(2010, 1, 1)


def plane() -> Surface:
    """Return the plane z = 0 about the origin."""
    axis = (np.arange(N) - 0.5 * (N - 1)) * STEP
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    index = np.arange(N * N).reshape(N, N)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return Surface(
        np.column_stack([x, y, 0.0 * x]), np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    )


def square(half: float) -> Bools:
    """Return which vertices lie within `half` [m] of the middle, along both axes."""
    vertices = plane().vertices
    return np.asarray((np.abs(vertices[:, :2]) < half).all(axis=1))


def draw_noise(rng: np.random.Generator, sigma: float) -> Floats:
    """Return noise (n,) [m] that neighbours share."""
    smooth = gaussian_filter(rng.standard_normal((N, N)), REACH, mode="wrap") * 2.0 * np.sqrt(np.pi) * REACH
    return sigma * (np.sqrt(1.0 - NUGGET) * smooth + np.sqrt(NUGGET) * rng.standard_normal((N, N))).ravel()


def simulate_series(rng: np.random.Generator, years: Floats, rate: Floats | float = 0.0) -> list[EpochChange]:
    """Return epochs at `years` that change by `rate` (n,) [m/year], none of which shows a region by itself."""
    surface, reference = plane(), draw_noise(rng, np.sqrt(PART) * SIGMA)
    known = Registration(np.eye(4), np.diag([1e-9] * 6) ** 2, np.zeros(3), True)
    table = pd.DataFrame(columns=list(REGION_COLUMNS))
    changes = []
    for k, year in enumerate(years):
        distances = rate * year + draw_noise(rng, np.sqrt(1.0 - PART) * SIGMA) - reference
        side = ComparedSurface(surface, distances, np.full(N * N, Z95 * SIGMA), np.ones(N * N, dtype=np.uint8),
                               np.zeros(N * N, dtype=np.int32), np.zeros(N * N, dtype=np.uint8))  # fmt: skip
        date = START + datetime.timedelta(days=round(365.25 * year))
        changes.append(EpochChange(f"e{k + 1}", date, Comparison(side, side, table, known, "relative", {})))
    return changes
