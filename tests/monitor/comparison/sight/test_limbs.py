"""What one epoch saw only steeply, at a limb, errs alike by what is stated of it: no change, however small the rest."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.sight.stations import StationSight, gather_sight
from projects.model import Bools, Comparison, Floats, Registration, Surface

N, EDGE, NOISE = 121, 2e-3, 5e-5  # vertices along a sheet; m
X, Y = (EDGE * k.ravel() for k in np.divmod(np.arange(N * N), N))
STRIP = (np.abs(X - 0.12) < 0.0085) & (np.abs(Y - 0.12) < 0.025)  # m
OFF = 2.0e-3  # m, by which the strip lies outside: 2.7 of its sigmas, beyond the usual, and 7 of the usual as it shows
STATED, ELSEWHERE = 9e-4, 5e-4  # m, of the strip and of the rest
ABOVE = [np.array([0.12, y, 1.0]) for y in np.linspace(0.0, 0.24, 7)]  # m, stations
GRAZING = np.array([-1.0, 0.12, 0.1])  # sees the strip at 85 degrees


def sheet(rng: np.random.Generator, heights: Floats, shared: Floats) -> Surface:
    """Return a sheet of these heights (n,) [m] with noise, and what its scans disagree by (n,) [m]."""
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])
    points = np.c_[X, Y, heights + rng.normal(scale=NOISE, size=len(X))]
    return Surface(points, faces, sigma=np.full(len(X), NOISE), sigma_shared=shared)


def sights(origins: list[Floats], seen: Bools) -> list[StationSight]:
    """Return what stations saw that measured the sheet where `seen` (n,)."""
    found = [gather_sight(origin, [np.c_[X, Y, np.zeros(len(X))][seen]]) for origin in origins]
    return [s for s in found if s is not None]


def compared(rng: np.random.Generator, seen_before: list[StationSight]) -> Comparison:
    """Return the comparison of a sheet whose strip lay outside with one as it is, seen from above."""
    fixed = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(len(X), dtype=bool))  # fmt: skip
    before = sheet(rng, OFF * STRIP, np.where(STRIP, STATED, ELSEWHERE))
    after = sheet(rng, np.zeros(len(X)), np.full(len(X), ELSEWHERE))
    return compare(before, after, fixed, sights=(seen_before, sights(ABOVE, X >= 0.0)))


def test_where_only_a_grazing_station_saw_it_a_strip_that_lies_off_within_its_sigma_is_no_region(
    rng: np.random.Generator,
) -> None:
    at_limb = compared(rng, sights(ABOVE, ~STRIP) + sights([GRAZING], STRIP))
    assert not len(at_limb.regions)
    level = at_limb.on_compared.lod95
    assert np.nanmedian(level[STRIP]) > 1.96 * np.sqrt(STATED**2 - ELSEWHERE**2)
    from_above = compared(rng, sights(ABOVE, X >= 0.0))
    assert len(from_above.regions) == 1  # most places show that scans err by less than is stated
    rest = np.nanmedian(from_above.on_compared.lod95[~STRIP])
    assert np.nanmedian(level[~STRIP]) == pytest.approx(rest, rel=0.25)  # what lies beside is as sure
