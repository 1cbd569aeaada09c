"""The mean of a region is not raised by the noise that chose its vertices, and what was taken off is told."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.follow import follow
from projects.model import ComparedSurface, Floats, Registration, Surface

N, HALF, NOISE = 61, 0.15, 5e-5  # vertices along a side; m
WORN, RADIUS = np.array([0.05, 0.0]), 0.05  # m
STILL = Registration(np.eye(4), np.diag([1e-12] * 6), np.zeros(3), True)


def worn_by(points: Floats, depth: float) -> Floats:
    """Return how much (n,) [m] a place of a panel is worn, upright."""
    r = np.minimum(np.hypot(*(points[:, :2] - WORN).T) / RADIUS, 1.0)
    return 0.5 * depth * (1.0 + np.cos(np.pi * r))


def panel(rng: np.random.Generator, depth: float) -> Surface:
    """Return a wavy panel, worn at a place, each of whose vertices errs by itself."""
    axis = np.linspace(-HALF, HALF, N)
    flat = np.column_stack([a.ravel() for a in np.meshgrid(axis, axis, indexing="ij")])
    z = 0.02 * np.sin(21.0 * flat[:, 0]) * np.cos(17.0 * flat[:, 1])
    z = z - worn_by(flat, depth) + rng.normal(0.0, NOISE, len(flat))
    i = np.arange(N * N).reshape(N, N)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Surface(np.column_stack([flat, z]), faces)


def true_mean(side: ComparedSurface, number: int, depth: float) -> float:
    """Return the true mean change [m] over a region's vertices along the surface's normal."""
    at = side.surface.vertices[(side.region == number) & np.isfinite(side.distances)]
    x, y = at[:, 0], at[:, 1]
    slopes = 0.42 * np.cos(21.0 * x) * np.cos(17.0 * y), 0.34 * np.sin(21.0 * x) * np.sin(17.0 * y)
    return float(np.mean(-worn_by(at, depth) / np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)))


def test_noise_that_chose_vertices_does_not_raise_their_mean() -> None:
    """A change little larger than the level of detection: a third of the mean over what was chosen is noise."""
    depth, raw, freed, z = 1.6e-4, [], [], []
    for seed in range(900, 906):
        rng = np.random.default_rng(seed)
        found = compare(panel(rng, 0.0), panel(rng, depth), STILL)
        region = found.regions.iloc[0]
        truth = np.mean([true_mean(side, 1, depth) for side in (found.on_reference, found.on_compared)])
        choice = found.statistics["region_shapes"][0]["choice_m"]
        sides = [side.distances[(side.region == 1) & np.isfinite(side.distances)]
                 for side in (found.on_reference, found.on_compared)]  # fmt: skip
        assert region.mean_m + choice == pytest.approx(np.mean([np.mean(s) for s in sides]), rel=0.02)
        raw.append((region.mean_m + choice) / truth)
        freed.append(region.mean_m / truth)
        z.append((region.mean_m - truth) / region.sigma_mean_m)
    assert np.mean(raw) > 1.25
    assert np.mean(freed) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_noise_of_the_reference_that_chose_vertices_is_no_rate() -> None:
    """It is in the differences of all epochs alike: a region's rate came out 1.3 times the true one."""
    years, rate, told, inside = (2021, 2022, 2023, 2024), 4e-5, [], 0
    for seed in range(500, 506):
        rng = np.random.default_rng(seed)
        first = panel(rng, 0.0)
        changes = [EpochChange(f"e{y}", datetime.date(y, 1, 1), compare(first, panel(rng, rate * (y - 2020)), STILL))
                   for y in years]  # fmt: skip
        series = follow(changes, "e2020", datetime.date(2020, 1, 1))
        row = series.regions.sort_values("area_m2").iloc[-1]
        side = changes[0].side
        at = np.where(np.isfinite(side.distances), series.identity, 0)
        truth = true_mean(ComparedSurface(**{**vars(side), "region": at}), int(row.identity), rate)
        told.append(row.rate_m_per_year / truth)
        inside += abs(row.rate_m_per_year - truth) < 1.96 * row.sigma_rate_m_per_year
    assert np.mean(told) == pytest.approx(1.0, abs=0.1)
    assert inside >= 5
