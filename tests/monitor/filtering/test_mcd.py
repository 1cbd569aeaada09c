"""The minimum covariance determinant against plain NumPy and against FAST-MCD with many random starts."""

import itertools

import numpy as np
import pytest
from numba import njit

from monitor.filtering import covariance, mcd, tangents
from monitor.filtering.sizes import clean_limits

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
def run_kernel(coordinates, h, determinants, weights, wide, narrow, pairs):
    """Run the kernel over neighbourhoods given as (m, 3, n)."""
    for i in range(len(coordinates)):
        x, y, z = coordinates[i, 0], coordinates[i, 1], coordinates[i, 2]
        determinants[i] = mcd.minimum_covariance_determinant(
            x, y, z, len(x), h, weights[i], wide[0], wide[1], narrow, pairs
        )


def minimum_determinants(neighbourhoods, h=H):
    """Return determinant (m,) and weights (m, n) of neighbourhoods (m, n, 3)."""
    m, n, _ = neighbourhoods.shape
    determinants, weights = np.empty(m), np.empty((m, n))
    coordinates = np.ascontiguousarray(neighbourhoods.transpose(0, 2, 1))
    narrow, pairs = np.empty((mcd.NARROW_ROWS, n), dtype=np.float32), np.empty((2, n), dtype=np.int64)
    run_kernel(coordinates, h, determinants, weights, np.empty((2, n)), narrow, pairs)
    return determinants, weights


@njit
def run_fast_mcd(coordinates, h, subsets, determinants):
    """Run FAST-MCD from each of the subsets (s, 4); every step is that of Rousseeuw and van Driessen, in float64."""
    n = coordinates.shape[2]
    w, d2, work = np.empty(n), np.empty(n), np.empty(n)
    for i in range(len(coordinates)):
        x, y, z, best = coordinates[i, 0], coordinates[i, 1], coordinates[i, 2], np.inf
        for subset in subsets:
            w[:] = 0.0
            w[subset] = 1.0
            _, m, c = covariance.moments(x, y, z, w, n)
            last = np.inf
            for _ in range(100):
                covariance.mahalanobis2(x, y, z, n, m, c, d2)
                covariance.keep_smallest(d2, n, h, 5.0, w, work)
                _, m, c = covariance.moments(x, y, z, w, n)
                det = covariance.determinant(c)
                if det >= last:
                    break
                last = det
            best = min(best, last)
        determinants[i] = best


def fast_mcds(neighbourhoods, h, n_starts, rng):
    """Return the determinants that FAST-MCD reaches from random starts; each kernel of it has its own twin here."""
    m, n, _ = neighbourhoods.shape
    subsets, determinants = np.argsort(rng.random((n_starts, n)), axis=1)[:, :4], np.empty(m)
    run_fast_mcd(np.ascontiguousarray(neighbourhoods.transpose(0, 2, 1)), h, subsets, determinants)
    return determinants


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
        assert np.allclose(covariance.eigenvalues(six), values[::-1], rtol=1e-9, atol=1e-14 * values[2])
        assert abs(vectors[:, 0] @ covariance.eigenvector(six, covariance.eigenvalues(six)[2])) > 1 - 1e-9


def test_mahalanobis_distances_are_those_of_the_inverse(rng):
    points, root = rng.normal(size=(20, 3)), rng.normal(size=(3, 3))
    cov, mean, d2 = root @ root.T, rng.normal(size=3), np.empty(20)
    covariance.mahalanobis2(*points.T.copy(), 20, tuple(mean), tuple(cov[np.triu_indices(3)]), d2)
    away = points - mean
    assert np.allclose(d2, np.einsum("ni,ij,nj->n", away, np.linalg.inv(cov), away))


def test_the_smallest_are_kept_and_of_equal_ones_the_first(rng):
    for values in (rng.chisquare(3, 31), np.repeat([3.0, 1.0, 2.0], 5), np.zeros(9), np.r_[1e12, rng.random(20)]):
        for h, guess in itertools.product((1, len(values) // 2, len(values)), (1e-9, 1.0, 1e9)):
            weights = np.empty(len(values))
            covariance.keep_smallest(values, len(values), h, guess, weights, np.empty(len(values)))
            assert weights.sum() == h
            assert set(np.flatnonzero(weights)) == set(np.argsort(values, kind="stable")[:h])


def test_determinant_is_that_of_the_points_it_names(rng):
    points = scene(rng, "outliers", 5)
    determinants, weights = minimum_determinants(points)
    for p, det, w in zip(points, determinants, weights, strict=True):
        assert w.sum() == H
        assert np.isclose(det, np.linalg.det(np.cov(p[w > 0].T, bias=True)), rtol=1e-6)


@pytest.mark.parametrize("name", ["flat", "outliers", "two sheets", "edge", "bowl"])
def test_determinant_is_within_a_hundredth_of_fast_mcd_with_500_random_starts(rng, name):
    """Of 99 % of neighbourhoods; of 600, three standard errors more may miss it where 99 % are true."""
    points = scene(rng, name, 600)
    theirs = fast_mcds(points, H, 500, rng)
    ours, _ = minimum_determinants(points)
    assert (ours > 1.01 * theirs).sum() <= 6 + 7
    assert (ours <= 1.5 * theirs).all()


def test_fast_mcd_of_the_kernels_is_that_of_plain_numpy(rng):
    points = scene(rng, "edge", 4)
    theirs = fast_mcds(points, H, 60, np.random.default_rng(1))
    plain = [fast_mcd(p, H, 60, np.random.default_rng(1)) for p in points]
    assert np.allclose(theirs, plain, rtol=1e-6)


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


@pytest.mark.parametrize("n", [9, 11, 13, 15, 16, 24, 48, 100])
def test_lambda3_of_noise_alone_is_the_noise_variance(rng, n):
    """Noise unknown to the estimator: the median over many neighbourhoods is the true one within 8 %."""
    points = discs(rng, 1500, n=n)
    flat = points.reshape(-1, 3)
    near = np.arange(len(flat), dtype=np.int32).reshape(-1, n)
    sizes, unknown, limits = np.full(len(points), n), np.zeros(len(points)), np.full(n + 1, 2.0)
    rows = tangents.fit_tangents(flat, near[:, 0].astype(np.int64), near, sizes, unknown, limits, 0.55)
    assert np.isclose(np.median(rows[:, tangents.COLUMNS.index("lambda3")]), 0.1**2, rtol=0.08)


def test_a_plane_that_most_points_keep_to_is_taken_without_a_search_and_is_the_right_one(rng):
    """Ten per cent of outliers: noise alone in the others says so. Two sheets, or an edge, are searched through."""
    n_discs, n_bad = 300, 5
    points = discs(rng, n_discs)
    points[:, 1 : 1 + n_bad, 2] += rng.uniform(1, 4, (n_discs, n_bad))
    for neighbourhoods, searched in ((points, 0.0), (scene(rng, "two sheets", 300), 1.0)):
        neighbourhoods[:, 0] = [0.0, 0.0, 0.0]
        flat, k = neighbourhoods.reshape(-1, 3), neighbourhoods.shape[1]
        near = np.arange(len(flat), dtype=np.int32).reshape(-1, k)
        which, sizes, noise = near[:, 0].astype(np.int64), np.full(n_discs, k), np.full(n_discs, 0.1)
        rows = tangents.fit_tangents(flat, which, near, sizes, noise, clean_limits(k), 0.55)
        assert np.isclose(np.isfinite(rows[:, tangents.COLUMNS.index("det")]).mean(), searched, atol=0.05)
        tilt = np.arccos(np.minimum(np.abs(rows[:, 2]), 1.0))
        assert np.sqrt((tilt**2).mean()) < 1.5 * np.sqrt(2.0) * 0.1 / np.sqrt((k - k // 10) * k / (4 * np.pi))
        assert np.isclose(np.median(rows[:, tangents.COLUMNS.index("lambda3")]), 0.1**2, rtol=0.1)
