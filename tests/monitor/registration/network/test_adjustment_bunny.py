"""Ten real scans of one sculpture come back from poses disturbed by 5 degrees and 10 mm, in one adjustment."""

from pathlib import Path

import numpy as np
import pytest
from random_poses import disturb, in_place
from real_scans import read_bunny

from monitor.registration.motion.six_parameters import closest_motion
from monitor.registration.network.adjustment import AdjustmentSettings, adjust_scans
from projects.transforms import apply


@pytest.mark.slow
def test_ten_scans_of_the_bunny_come_back_from_5_degrees_and_10_mm(real_data: Path) -> None:
    rng = np.random.default_rng(3)
    clouds, poses = read_bunny(real_data)
    start = [disturb(T, apply(T, c.points).mean(axis=0), rng) for c, T in zip(clouds, poses, strict=True)]
    found = adjust_scans([in_place(c, T) for c, T in zip(clouds, start, strict=True)])
    assert found.applied, found.reason
    placed = [apply(M @ T, c.points) for M, T, c in zip(found.motions, start, clouds, strict=True)]
    truth = [apply(T, c.points) for T, c in zip(poses, clouds, strict=True)]
    common = closest_motion(np.concatenate(placed), np.concatenate(truth), np.ones(sum(map(len, truth))))
    rms = [
        float(np.sqrt(np.mean(np.sum((apply(common, a) - b) ** 2, axis=1)))) for a, b in zip(placed, truth, strict=True)
    ]
    given = adjust_scans([in_place(c, T) for c, T in zip(clouds, poses, strict=True)])
    as_given = [p.sigma_before for p in given.pairs if p.n >= 1000]
    ours = [p.sigma_after for p in found.pairs if p.n >= 1000]
    print(f"\nrms to bun.conf [mm] {np.round(1e3 * np.array(rms), 3)}; {found.n_iterations} steps")
    print(f"median pair sigma {1e3 * np.median(ours):.4f} mm, with bun.conf {1e3 * np.median(as_given):.4f} mm")
    assert max(rms) < 0.0006
    assert np.median(ours) <= np.median(as_given)


@pytest.mark.slow
def test_the_bunny_scans_as_given_converge(real_data: Path) -> None:
    clouds, poses = read_bunny(real_data)
    found = adjust_scans([in_place(c, T) for c, T in zip(clouds, poses, strict=True)], AdjustmentSettings(seed=1))
    assert found.converged, found.reason
