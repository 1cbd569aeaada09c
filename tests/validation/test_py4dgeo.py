"""M3C2 against the numbers that py4dgeo gave for the same two clouds (stored, with how they were made)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monitor.comparison import lague_lod95, m3c2

FOLDER = Path(__file__).parent / "py4dgeo"


def test_m3c2_agrees_with_py4dgeo() -> None:
    clouds = np.load(FOLDER / "clouds.npz")
    stored = np.genfromtxt(FOLDER / "m3c2.csv", delimiter=",", names=True)
    found = m3c2(clouds["reference"], clouds["compared"], clouds["cores"], cylinder_radius=0.05, max_depth=0.12,
                 normal_radius=0.08, registration_error=0.001)  # fmt: skip
    np.testing.assert_array_equal(found.n_reference, stored["num_samples1"])
    np.testing.assert_array_equal(found.n_compared, stored["num_samples2"])
    known = np.isfinite(found.distances)
    assert 0.9 < known.mean() < 1.0  # no points in one corner
    np.testing.assert_array_equal(known, (found.n_reference >= 4) & (found.n_compared >= 4))
    np.testing.assert_allclose(found.distances[known], stored["distance"][known], atol=1e-12)
    n1, n2, stored = found.n_reference[known], found.n_compared[known], stored[known]
    by_n1, by_n2 = np.sqrt(n1 / (n1 - 1.0)), np.sqrt(n2 / (n2 - 1.0))  # py4dgeo divides by n - 1
    np.testing.assert_allclose(found.spread_reference[known] * by_n1, stored["spread1"], atol=1e-12)
    np.testing.assert_allclose(found.spread_compared[known] * by_n2, stored["spread2"], atol=1e-12)
    np.testing.assert_allclose(
        lague_lod95(found.spread_reference[known] * by_n1, n1, found.spread_compared[known] * by_n2, n2, 0.001),
        stored["lodetection"],
        rtol=1e-12,
    )
