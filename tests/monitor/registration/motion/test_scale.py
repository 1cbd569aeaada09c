"""An epoch of another scale: told as that, and nothing else is told as a scale."""

import re

import numpy as np
import pytest
from bumpy_body import NOISE, bumpy_points, move, noisy_cloud, unit

from monitor.registration import register
from monitor.registration.motion.sampling import parameter_rows
from monitor.registration.motion.scale import Scale
from projects.model import PointCloud
from projects.transforms import perturb
from reports.quantities import estimate

TOLD = re.compile(
    r"the compared epoch is ([\d.]+) ± ([\d.]+) times as large as the reference, .* correct its scale and"
)


def scaled(cloud: PointCloud, ratio: float) -> PointCloud:
    return PointCloud(cloud.points * ratio, cloud.normals)


@pytest.mark.parametrize("ratio", [0.97, 0.998, 1.003, 1.02, 1.1])
def test_a_scale_is_told_with_its_margin(rng: np.random.Generator, ratio: float) -> None:
    """The differences of 6 mm that a scale of 1.02 makes were told as no change, and as pieces that moved."""
    turned = perturb(np.eye(4), np.zeros(3), np.array([0.01, -0.02, 0.01, 0.004, 0.003, -0.002]))
    found = register(move(scaled(noisy_cloud(20_000, rng), ratio), turned), noisy_cloud(20_000, rng))
    assert found.converged
    told = TOLD.match(found.doubt)
    assert told is not None, found.doubt
    value, margin = float(told[1]), float(told[2])
    assert found.scale == pytest.approx(value, abs=0.17 * margin)  # rounded to half of a third
    assert 1.96 * found.sigma_scale == pytest.approx(margin, rel=0.17)
    assert abs(value - ratio) < 2.0 * margin  # four sigmas
    assert margin < 3e-4  # of a body of 0.6 m, 0.1 mm


@pytest.mark.parametrize("margin", [0.0, 3e-7, 1.2e-6, 4.5e-5, 2.96e-4, 0.0031, 0.012])
def test_the_doubt_and_the_headline_tell_one_scale(margin: float) -> None:
    """One report held 1.0203 ± 0.0005 and 1.02031 ± 0.00045."""
    words = Scale(1.0203142, margin / 1.96, 0.01).words
    headline = estimate(1.0203142, max(margin, 1e-6) / 1.96, 1.0, "").text.replace("\u00a0", " ")
    assert f"is {headline} times" in words


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(None, id="nothing"),
        pytest.param(lambda d: -1e-3 * np.ones(len(d)), id="a layer all over"),
        pytest.param(lambda d: -2e-3 * (d[:, 0] > 0.2), id="a layer on a part"),
        pytest.param(lambda d: 3e-3 * (d[:, 2] > 0.6), id="a gain on top"),
        pytest.param(lambda d: 1e-3 * d[:, 2] ** 2, id="longer, and no wider"),
    ],
)
def test_what_is_no_scale_is_not_told_as_one(rng: np.random.Generator, change) -> None:
    found = register(noisy_cloud(20_000, rng, change), noisy_cloud(20_000, rng))
    assert "times as large" not in found.doubt
    assert np.isnan(found.scale)


def test_the_row_of_a_scale_is_the_slope_of_the_residual(rng: np.random.Generator) -> None:
    """A source too large by a share e lies e n'(x - c) outside: made smaller it lies less so."""
    points, normals = bumpy_points(50, rng)
    centre, step = np.array([0.1, -0.2, 0.05]), 1e-6
    normals = unit(normals + rng.normal(0.0, NOISE, normals.shape))

    def residual(e: float) -> np.ndarray:
        return np.sum(normals * (centre + (points - centre) / (1.0 + e) - points), axis=1)

    slope = (residual(step) - residual(-step)) / (2.0 * step)
    np.testing.assert_allclose(parameter_rows(points, normals, centre, "scale")[:, 6], slope, rtol=1e-6, atol=1e-9)
