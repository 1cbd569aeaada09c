"""Three scans around a body, which see little of each other: most of their points have no partner in another scan."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from network_of_caps import seen_targets

from monitor.registration.network import adjustment
from monitor.registration.network.adjustment import AdjustmentSettings, adjust_scans
from monitor.registration.network.ties import identify_targets
from projects.model import Floats, PointCloud
from projects.transforms import apply, perturb

RADIUS, NEAR = 0.15, 3e-4  # m; how far off scans are given
STEP = 1e-4  # rad, between directions that tell a normal


def scans_around(seed: int, reach: float, noise: float, limb: float, n: int) -> list[PointCloud]:
    """Return three scans of a bumpy ball that see it as far as `reach` [degrees] from their middles, with noise [m];
    at their limbs points lie outside by `limb` [m] at most, as where part of a spot misses the surface."""
    rng = np.random.default_rng(seed)
    waves, phases = rng.normal(size=(12, 3)) * 3.0, rng.uniform(0.0, 2.0 * np.pi, 12)
    fine, shift = rng.normal(size=(30, 3)) * 60.0, rng.uniform(0.0, 2.0 * np.pi, 30)

    def at(directions: Floats) -> Floats:
        """Return the points (n, 3) of the ball's surface in some directions."""
        d = directions / np.linalg.norm(directions, axis=1)[:, None]
        bumps = 0.0015 * np.cos(d @ waves.T + phases).sum(1) + 0.00016 * np.cos(d @ fine.T + shift).sum(1)
        return np.asarray((RADIUS + bumps)[:, None] * d)

    scans = []
    for turn in np.arange(3) * 2.0 * np.pi / 3.0:
        view = np.array([np.cos(turn), np.sin(turn), 0.1]) / np.sqrt(1.01)
        d = rng.normal(size=(6 * n, 3))
        d /= np.linalg.norm(d, axis=1)[:, None]
        d = d[d @ view > np.cos(np.radians(reach))][:n]
        aside = np.cross(d, [0.0, 0.0, 1.0])
        aside /= np.linalg.norm(aside, axis=1)[:, None]
        along = [at(d + STEP * t) - at(d - STEP * t) for t in (aside, np.cross(d, aside))]
        normals = np.cross(*along)
        normals *= np.sign((normals * d).sum(axis=1))[:, None] / np.linalg.norm(normals, axis=1)[:, None]
        off = rng.normal(0.0, noise, len(d)) + limb * np.clip(1.0 - 2.0 * d @ view, 0.0, 1.0) ** 2
        error = perturb(np.eye(4), np.zeros(3), rng.normal(0.0, [2.0 * NEAR] * 3 + [NEAR] * 3))
        scans.append(PointCloud(apply(error, at(d) + off[:, None] * normals), normals=normals @ error[:3, :3].T,
                                origins=apply(error, 2.0 * view[None])[0]))  # fmt: skip
    return scans


def test_what_does_not_settle_from_far_is_begun_near() -> None:
    """By what has no partner, these scans seem to lie far apart: the search starts wide and ends after 12 steps."""
    scans = scans_around(1, reach=72.0, noise=3e-4, limb=5e-4, n=2500)
    found = adjust_scans(scans, AdjustmentSettings(max_iterations=5))
    assert found.converged
    assert found.applied
    assert found.n_iterations <= 5
    assert max(np.linalg.norm(T[:3, 3]) for T in found.motions) < 5.0 * NEAR


@pytest.mark.parametrize("reach", [62.0, 63.0])
def test_scans_that_share_too_little_of_what_both_saw_stay_as_given(reach: float) -> None:
    """Matched far and wide, points past limbs find partners; matched finely none do: nothing was lost."""
    found = adjust_scans(scans_around(0, reach=reach, noise=8e-4, limb=2e-3, n=2500))
    assert found.converged
    assert not found.applied
    assert found.pairs == ()
    assert found.reason == "what two scans share is too little, or was seen too steeply, to hold them"


def test_scans_that_targets_hold_and_that_do_not_settle_are_refused(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They share too little besides; as given they would stand where their targets contradict."""
    settle = adjustment._settle
    moving = "still moving by 12 micrometres after 30 iterations"
    monkeypatch.setattr(adjustment, "_settle", lambda *given: dataclasses.replace(settle(*given), reason=moving))
    places = np.array([[1.0, 0.0, 0.0], [-0.5, 0.9, 0.0], [-0.5, -0.9, 0.3], [0.0, 0.0, 1.0]])
    errors = [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0.0, 2e-3, (3, 6))]
    ties = identify_targets(seen_targets(rng, places, errors))
    found = adjust_scans(scans_around(0, reach=63.0, noise=8e-4, limb=2e-3, n=2500), ties=ties)
    assert not found.converged
    assert found.reason == moving
