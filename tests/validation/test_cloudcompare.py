"""Distances against the numbers that CloudCompare gave for the same two surfaces (stored, with how they were made)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monitor.comparison import normal_distances
from monitor.comparison.distances.perpendicular import Feet
from projects.formats import read_mesh
from projects.model import Floats, NotAssessed

FOLDER = Path(__file__).parent / "cloudcompare"


@pytest.fixture(scope="module")
def both() -> tuple[Feet, Floats]:
    """Return our distances and CloudCompare's."""
    reference, compared = (read_mesh(FOLDER / f"{name}.ply", unit=1.0) for name in ("reference", "compared"))
    return normal_distances(compared, reference, 0.05), np.loadtxt(FOLDER / "c2m.csv", skiprows=1)


def test_distances_agree_with_cloudcompare_where_both_define_them(both: tuple[Feet, Floats]) -> None:
    feet, stored = both
    assessed = feet.reasons == NotAssessed.ASSESSED
    assert assessed.mean() > 0.98
    # single precision holds 2^-24 of 0.2 m = 12 nm; distances run from -10 to +11 mm
    np.testing.assert_allclose(feet.distances[assessed], stored[assessed], atol=2e-9)
    assert np.ptp(stored) > 0.02


def test_cloudcompare_gives_a_number_where_the_surface_ends_and_this_program_does_not(
    both: tuple[Feet, Floats],
) -> None:
    feet, stored = both
    unknown = feet.reasons != NotAssessed.ASSESSED
    assert unknown.sum() == 32
    assert set(feet.reasons[unknown]) == {NotAssessed.FREE_EDGE}
    assert np.abs(stored[unknown]).max() > 0.01
