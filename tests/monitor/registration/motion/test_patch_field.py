"""How patches err together under a field that differs within them, and pairs that have a target point in common."""

import numpy as np
import pytest

from monitor.registration.motion.correlation import correlate
from monitor.registration.motion.covariance import Adjusted, partner_share, score_covariance, share_partners
from monitor.registration.motion.patch_field import lay_field, sum_by
from monitor.registration.motion.patches import cut_patches
from projects.model import Floats

UP = np.array([0.0, 0.0, 1.0])


def square(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return n points of a square of 0.6 m and their normals."""
    return np.column_stack([rng.uniform(0.0, 0.6, (n, 2)), np.zeros(n)]), np.tile(UP, (n, 1))


def between(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.linalg.norm(a[:, None] - b[None], axis=2))


def test_patches_correlate_as_the_mean_over_pairs_of_their_parts(rng: np.random.Generator) -> None:
    points, normals = square(600, rng)
    grid = cut_patches(points, normals, 20.0)
    field = lay_field(points, normals, grid)
    assert np.array_equal(field.member, np.unique(grid.numbers(points, normals), return_inverse=True)[1])
    middles = sum_by(field.part, points) / field.part_counts[:, None]
    points = middles[field.part]  # all points of a part in one place, so that the parts tell all
    rows = rng.normal(size=(600, 3))
    found, sums = field.correlate(0.05, sum_by(field.part, rows))
    R = correlate(between(points, points), 0.05)
    share = (field.member[:, None] == np.arange(len(field.counts))) / field.counts
    assert found == pytest.approx(share.T @ R @ share, abs=1e-6)
    assert sums == pytest.approx(rows.T @ R @ rows, abs=1e-4 * np.trace(rows.T @ R @ rows))
    assert np.median(np.diag(found)) < 0.8  # a patch as one place would agree with itself wholly


def test_a_motion_that_differs_within_patches_is_not_stated_too_sure() -> None:
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        points, normals = square(1500, rng)
        truth = 0.7 * correlate(between(points, points), 0.04) + 0.3 * np.eye(1500)
        psi = np.linalg.cholesky(truth) @ rng.normal(size=1500)
        # a wave of 0.12 m on patches of 0.04 m, as the bumps of a body hold a turn; and all points alike
        rows = np.column_stack([np.sin(2.0 * np.pi * points[:, 0] / 0.12), np.ones(1500)])
        adjusted = Adjusted(points, normals, psi, rows, np.ones(1500), 1.0, np.eye(2), np.arange(1500))
        ratios.append(np.diag(score_covariance(adjusted)) / np.diag(rows.T @ truth @ rows))
    wave, whole = np.median(ratios, axis=0)
    assert wave == pytest.approx(1.0, abs=0.08)  # with each patch as one place 0.80
    assert whole < 2.1  # and 2.4: what a field beyond the square would do is known badly


def test_noise_of_a_shared_target_point_counts_in_all_its_pairs(rng: np.random.Generator) -> None:
    partner = rng.integers(0, 4000, 4000)
    scores = np.sqrt(0.7) * rng.normal(size=4000) + np.sqrt(0.3) * rng.normal(size=4000)[partner]
    assert partner_share(scores, partner) == pytest.approx(0.3, abs=0.06)  # of 4000 products each 0.016
    assert partner_share(rng.normal(size=4000), partner) == pytest.approx(0.0, abs=0.05)
    assert partner_share(scores, np.arange(4000)) == 0.0
    points, normals = square(4000, rng)
    rows, member = np.column_stack([np.ones(4000), points[:, 0]]), rng.integers(0, 40, 4000)
    adjusted = Adjusted(points, normals, scores, rows, np.ones(4000), 1.0, np.eye(2), partner)
    own, factor = share_partners(adjusted, scores, member)
    common = partner_share(scores, partner)
    truth = (1.0 - common) * np.eye(4000) + common * (partner[:, None] == partner[None])
    assert own == pytest.approx(rows.T @ truth @ rows)
    share = (member[:, None] == np.arange(40)).astype(float)
    assert factor == pytest.approx(np.diag(share.T @ truth @ share) / share.sum(axis=0))
    assert factor.mean() == pytest.approx(1.0 + common * 100 / 4000, rel=0.02)  # pairs of other patches are not in it
