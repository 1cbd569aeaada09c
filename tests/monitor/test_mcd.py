"""The minimum covariance determinant against plain NumPy and against FAST-MCD with many random starts."""

import numpy as np
import pytest
from numba import njit

from monitor.filtering import mcd, tangents

N_POINTS = 48
H = int(0.55 * N_POINTS)


def discs(rng, n_discs, n=N_POINTS, noise=0.1):
    """Return discs (n_discs, n, 3) of a flat surface, spacing 1, with noise across."""
    angle, radius = rng.uniform(0, 2 * np.pi, (n_discs, n)), np.sqrt(n / np.pi * rng.uniform(0, 1, (n_discs, n)))
    across = noise * rng.normal(size=(n_discs, n))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), across], axis=-1)


def scene(rng, name, n_discs, n=N_POINTS):
    """Return neighbourhoods with 40 % outliers, a second sheet of 40 %, across a right-angled edge, or in a bowl."""
    points, n_bad = discs(rng, n_discs, n), int(0.4 * n)
    if name == "outliers":
        points[:, :n_bad, 2] += rng.uniform(1, 4, (n_discs, n_bad))
    elif name == "two sheets":
        points[:, :n_bad, 2] += 1.5
    elif name == "edge":
        corner = 0.15 * np.sqrt(n / np.pi)
        beyond, height = points[..., 0] > corner, points[..., 2].copy()
        points[..., 2] = np.where(beyond, points[..., 0] - corner, height)
        points[..., 0] = np.where(beyond, corner + height, points[..., 0])
    elif name == "bowl":
        points[..., 2] += 0.1 * (points[..., 0] ** 2 + points[..., 1] ** 2)
    return points


@njit
def run_kernel(coordinates, h, determinants, weights, scratch):
    """Run the kernel over neighbourhoods given as (m, 3, n)."""
    for i in range(len(coordinates)):
        x, y, z = coordinates[i, 0], coordinates[i, 1], coordinates[i, 2]
        determinants[i] = mcd.minimum_covariance_determinant(
            x, y, z, len(x), h, weights[i], scratch[0], scratch[1], scratch[2:]
        )


def minimum_determinants(neighbourhoods, h=H):
    """Return determinant (m,) and weights (m, n) of neighbourhoods (m, n, 3)."""
    m, n, _ = neighbourhoods.shape
    determinants, weights = np.empty(m), np.empty((m, n))
    coordinates = np.ascontiguousarray(neighbourhoods.transpose(0, 2, 1))
    run_kernel(coordinates, h, determinants, weights, np.empty((2 + mcd.N_STARTS, n)))
    return determinants, weights


def fast_mcd(points, h, n_starts, rng):
    """Return the determinant that FAST-MCD reaches from random starts of four points (plain NumPy twin)."""
    subsets = np.argsort(rng.random((n_starts, len(points))), axis=1)[:, :4]
    determinants = np.full(n_starts, np.inf)
    for _ in range(60):
        chosen = points[subsets]
        mean = chosen.mean(axis=1)
        centred = chosen - mean[:, None]
        cov = np.einsum("sik,sil->skl", centred, centred) / subsets.shape[1] + 1e-12 * np.eye(3)
        new = np.linalg.det(cov)
        if (new >= determinants * (1 - 1e-10)).all():
            break
        determinants = new if subsets.shape[1] == h else np.full(n_starts, np.inf)
        away = points[None] - mean[:, None]
        d2 = np.einsum("sik,skl,sil->si", away, np.linalg.inv(cov), away)
        subsets = np.argsort(d2, axis=1, kind="stable")[:, :h]
    return determinants.min()


def test_eigenvalues_and_vectors_are_those_of_lapack(rng):
    for scale in (1.0, 1e-6):
        root = rng.normal(size=(3, 3)) * [1.0, 0.5, 1e-3]
        matrix = scale * root @ root.T
        six = tuple(matrix[np.triu_indices(3)])
        values, vectors = np.linalg.eigh(matrix)
        assert np.allclose(mcd.eigenvalues(six), values[::-1], rtol=1e-9, atol=1e-14 * values[2])
        assert abs(vectors[:, 0] @ mcd.eigenvector(six, mcd.eigenvalues(six)[2])) > 1 - 1e-9


def test_mahalanobis_distances_are_those_of_the_inverse(rng):
    points, root = rng.normal(size=(20, 3)), rng.normal(size=(3, 3))
    cov, mean, d2 = root @ root.T, rng.normal(size=3), np.empty(20)
    mcd.mahalanobis2(*points.T.copy(), 20, tuple(mean), tuple(cov[np.triu_indices(3)]), d2)
    away = points - mean
    assert np.allclose(d2, np.einsum("ni,ij,nj->n", away, np.linalg.inv(cov), away))


def test_the_smallest_are_kept_and_of_equal_ones_the_first(rng):
    for values in (rng.chisquare(3, 31), np.repeat([3.0, 1.0, 2.0], 5), np.zeros(9), np.r_[1e12, rng.random(20)]):
        for h in (1, len(values) // 2, len(values)):
            weights = np.empty(len(values))
            mcd.keep_smallest(values, len(values), h, weights, np.empty(len(values)))
            assert weights.sum() == h
            assert set(np.flatnonzero(weights)) == set(np.argsort(values, kind="stable")[:h])


def test_determinant_is_that_of_the_points_it_names(rng):
    points = scene(rng, "outliers", 5)
    determinants, weights = minimum_determinants(points)
    for p, det, w in zip(points, determinants, weights, strict=True):
        assert w.sum() == H
        assert np.isclose(det, np.linalg.det(np.cov(p[w > 0].T, bias=True)), rtol=1e-6)


@pytest.mark.parametrize(("name", "share"), [("outliers", 0.95), ("two sheets", 0.9), ("edge", 0.88), ("bowl", 0.82)])
def test_determinant_is_within_a_hundredth_of_fast_mcd_with_500_random_starts(rng, name, share):
    points = scene(rng, name, 60)
    theirs = np.array([fast_mcd(p, H, 500, rng) for p in points])
    ours, _ = minimum_determinants(points)
    assert (ours <= 1.01 * theirs).mean() >= share
    assert (ours <= 1.5 * theirs).all()


def test_an_exchange_lowers_what_concentration_steps_leave(rng):
    """At the optimum no pair may be exchanged with profit: tried one by one."""
    points = scene(rng, "edge", 3, n=20)
    determinants, weights = minimum_determinants(points, h=11)
    for p, det, w in zip(points, determinants, weights, strict=True):
        for leave in np.flatnonzero(w == 1):
            for enter in np.flatnonzero(w == 0):
                other = p[np.r_[np.setdiff1d(np.flatnonzero(w), leave), enter]]
                assert np.linalg.det(np.cov(other.T, bias=True)) >= det * (1 - 1e-6)


@pytest.mark.parametrize("n", [16, 24, 48, 100])
def test_factors_make_the_variance_across_a_flat_disc_consistent(rng, n):
    """The factors are functions fitted to this simulation; 0.06 is three standard errors of 1500 discs at n = 16."""
    points = discs(rng, 1500, n=n)
    _, weights = minimum_determinants(points, h=max((n + 4) // 2, int(0.55 * n)))
    across, along = tangents.raw_factors(n)
    raw = np.array([np.linalg.eigvalsh(np.cov(p[w > 0].T, bias=True)) for p, w in zip(points, weights, strict=True)])
    assert np.isclose(across * raw[:, 0].mean() / 0.1**2, 1.0, atol=0.06)
    assert np.isclose(along * raw[:, 1:].mean() / (n / np.pi / 4), 1.0, atol=0.08)


@pytest.mark.parametrize("n", [16, 24, 48, 100])
def test_lambda3_of_noise_alone_is_the_noise_variance(rng, n):
    """Noise unknown to the estimator: the median over many neighbourhoods is the true one within 8 %."""
    points = discs(rng, 1500, n=n)
    flat = points.reshape(-1, 3)
    near = np.arange(len(flat), dtype=np.int32).reshape(-1, n)
    sizes, unknown, limits = np.full(len(points), n), np.zeros(len(points)), np.full(n + 1, 2.0)
    rows = tangents.fit_tangents(flat, near[:, 0].astype(np.int64), near, sizes, unknown, limits, 0.55)
    assert np.isclose(np.median(rows[:, tangents.COLUMNS.index("lambda3")]), 0.1**2, rtol=0.08)
