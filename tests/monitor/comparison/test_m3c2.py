"""M3C2 as a second opinion: a slow twin, published numbers, and what is unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monitor.comparison.m3c2 import M3C2Result, m3c2
from projects.errors import ParameterError, ShapeError


def sheet(rng: np.random.Generator, n: int, height: float) -> np.ndarray:
    return np.column_stack([rng.uniform(0, 1, (n, 2)), height + rng.normal(0, 0.01, n)])


def slow_twin(points: np.ndarray, core: np.ndarray, normal: np.ndarray, radius: float, depth: float):
    """Return number, mean and standard deviation of the points in one cylinder."""
    inside = []
    for p in points:
        height = (p - core) @ normal
        if abs(height) <= depth and np.linalg.norm(p - core - height * normal) <= radius:
            inside.append(height)
    return len(inside), np.mean(inside), np.std(inside)


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_cylinders_agree_with_their_slow_twin(rng: np.random.Generator, far: float) -> None:
    reference, compared = sheet(rng, 3000, 0.0), sheet(rng, 2000, 0.03)
    cores = sheet(rng, 20, 0.0)
    normals = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.2, (20, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    found = m3c2(reference + far, compared + far, cores + far, cylinder_radius=0.05, max_depth=0.18, normals=normals)
    for k in range(20):
        n1, mean1, spread1 = slow_twin(reference, cores[k], normals[k], 0.05, 0.18)
        n2, mean2, spread2 = slow_twin(compared, cores[k], normals[k], 0.05, 0.18)
        assert (found.n_reference[k], found.n_compared[k]) == (n1, n2)
        assert found.distances[k] == pytest.approx(mean2 - mean1, abs=1e-9)
        assert found.spread_reference[k] == pytest.approx(spread1, abs=1e-9)
        assert found.lod95[k] == pytest.approx(1.96 * np.sqrt(spread1**2 / n1 + spread2**2 / n2), rel=1e-6)


def test_gain_is_positive_loss_negative_and_the_registration_is_added_linearly(rng: np.random.Generator) -> None:
    low, high, cores = sheet(rng, 5000, 0.0), sheet(rng, 5000, 0.02), np.array([[0.5, 0.5, 0.0]])
    sizes = {"cylinder_radius": 0.1, "max_depth": 0.2, "normal_radius": 0.2}
    gain, loss = m3c2(low, high, cores, **sizes), m3c2(high, low, cores, **sizes)
    assert gain.distances[0] == pytest.approx(0.02, abs=4 * 0.01 * np.sqrt(2 / 157))
    assert loss.distances[0] == pytest.approx(-0.02, abs=4 * 0.01 * np.sqrt(2 / 157))
    wider = m3c2(low, high, cores, registration_error=0.015, **sizes)
    assert wider.lod95[0] - gain.lod95[0] == pytest.approx(1.96 * 0.015, rel=1e-9)
    assert gain.is_significant[0]
    assert not wider.is_significant[0]


def test_where_one_cloud_has_too_few_points_nothing_is_known(rng: np.random.Generator) -> None:
    reference = sheet(rng, 3000, 0.0)
    compared = reference[reference[:, 0] < 0.5]
    cores = np.array([[0.25, 0.5, 0.0], [0.75, 0.5, 0.0], [0.75, 5.0, 0.0]])
    found = m3c2(reference, compared, cores, cylinder_radius=0.05, max_depth=0.1, normal_radius=0.1)
    np.testing.assert_array_equal(np.isnan(found.distances), [False, True, True])
    np.testing.assert_array_equal(np.isnan(found.lod95), [False, True, True])
    assert not found.is_significant[1:].any()
    assert np.isnan(found.normals[2]).all()


def published(real_data: Path) -> M3C2Result:
    laspy = pytest.importorskip("laspy")
    folder = real_data / "m3c2_autzen_bmx"
    clouds = []
    for year in (2010, 2023):
        las = laspy.read(folder / f"autzen-bmx-{year}.las")
        clouds.append(np.column_stack([las.x, las.y, las.z]))
    cores = np.loadtxt(folder / "autzen-bmx-cores.txt", skiprows=1, delimiter=",")
    return m3c2(*clouds, cores, cylinder_radius=10.4882815, max_depth=2.763006, normal_radius=5.24414)


def test_published_figures_hold(real_data: Path) -> None:
    found = published(real_data)  # its X and Y are metres, its Z is feet: as published, in the file's own numbers
    np.testing.assert_allclose(found.distances, [1.396, 0.670, 1.246], atol=0.005)
    np.testing.assert_allclose(found.lod95, [0.275, 0.140, 0.226], atol=0.005)
    assert (found.n_reference[0], found.n_compared[0]) == (118, 166)
    assert found.spread_reference[0] == pytest.approx(0.732, abs=0.005)
    assert found.spread_compared[0] == pytest.approx(1.582, abs=0.005)


def test_what_cannot_be_is_refused() -> None:
    points = np.zeros((5, 3))
    with pytest.raises(ShapeError, match=r"core_points have shape \(3,\)"):
        m3c2(points, points, np.zeros(3), cylinder_radius=1.0, max_depth=1.0, normal_radius=1.0)
    with pytest.raises(ParameterError, match="cylinder_radius"):
        m3c2(points, points, points, cylinder_radius=0.0, max_depth=1.0, normal_radius=1.0)
    with pytest.raises(ParameterError, match="neither normals nor normal_radius"):
        m3c2(points, points, points, cylinder_radius=1.0, max_depth=1.0)


@pytest.mark.parametrize("wrong", [{"registration_error": -0.01}, {"registration_error": float("nan")},
                                   {"max_depth": float("inf")}, {"cylinder_radius": 0.0}])  # fmt: skip
def test_lengths_that_are_none_are_refused_by_name(rng: np.random.Generator, wrong: dict[str, float]) -> None:
    low, sizes = sheet(rng, 500, 0.0), {"cylinder_radius": 0.1, "max_depth": 0.2, "normal_radius": 0.2}
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        m3c2(low, low, low[:1], **{**sizes, **wrong})


def test_normals_of_another_length_are_refused_for_they_scale_distances(rng: np.random.Generator) -> None:
    """Ten times as long, they made 0.2 of a distance of 0.02 m."""
    low, high, cores = sheet(rng, 500, 0.0), sheet(rng, 500, 0.02), np.array([[0.5, 0.5, 0.0]])
    with pytest.raises(ParameterError, match="1 of 1 are no unit vectors, the first is 10 long"):
        m3c2(low, high, cores, cylinder_radius=0.2, max_depth=2.0, normals=np.array([[0.0, 0.0, 10.0]]))
    unknown = m3c2(low, high, cores, cylinder_radius=0.2, max_depth=2.0, normals=np.full((1, 3), np.nan))
    assert np.isnan(unknown.distances).all()


def test_points_radii_and_directions_that_are_none_are_refused_by_name(rng: np.random.Generator) -> None:
    low, sizes = sheet(rng, 500, 0.0), {"cylinder_radius": 0.1, "max_depth": 0.2, "normal_radius": 0.2}
    holed = np.vstack([low, np.full((2, 3), np.nan)])
    with pytest.raises(ShapeError, match="compared_points: 2 of 502 are not finite"):
        m3c2(low, holed, low[:1], **sizes)
    with pytest.raises(ShapeError, match="core_points: 2 of 502 are not finite"):
        m3c2(low, low, holed, **sizes)
    with pytest.raises(ShapeError, match="orientation"):
        m3c2(low, low, low[:1], orientation=np.array([0.0, 1.0]), **sizes)
    with pytest.raises(ParameterError, match=r"cylinder_radius = '0\.1'"):
        m3c2(low, low, low[:1], **{**sizes, "cylinder_radius": "0.1"})
