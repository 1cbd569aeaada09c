"""How well scans agree: a known misfit between scans comes out as the sigma that it is."""

import numpy as np
import pytest

from monitor.registration.network.agreement import assess_agreement
from monitor.registration.network.steepness import Views, expected_at, join_views, steepness_of_points


def patch_of_points(rng: np.random.Generator, x_from: float, x_to: float) -> np.ndarray:
    n = int(20_000 * (x_to - x_from))
    return np.column_stack([rng.uniform(x_from, x_to, n), rng.uniform(0, 1, n), np.zeros(n)])


def offsets_by_cube(points: np.ndarray, rng: np.random.Generator, sigma: float) -> np.ndarray:
    """Return errors that whole patches share: one draw a cube of 0.1 m."""
    cell = np.floor(points[:, :2] / 0.1).astype(int)
    draws = rng.normal(0.0, sigma, (40, 40))
    return draws[cell[:, 0], cell[:, 1]]


def test_misfit_of_two_scans_is_the_sigma_of_one_over_the_root_of_two(rng: np.random.Generator) -> None:
    points = [patch_of_points(rng, 0.0, 1.0) for _ in range(2)]
    noise = 0.0003
    distances = [offsets_by_cube(p, rng, 0.001) + rng.normal(0, noise, len(p)) for p in points]
    middle = np.array([[0.5, 0.5, 0.0]])
    agreement = assess_agreement(middle, points, distances, 0.01)
    assert agreement.sigma_scan == pytest.approx(0.001, rel=0.12)
    assert agreement.n_overlapping == agreement.n_patches == 100


def test_two_scans_that_agree_are_not_twice_as_sure(rng: np.random.Generator) -> None:
    points = [patch_of_points(rng, 0.0, 2.0), patch_of_points(rng, 1.0, 2.0)]
    distances = [offsets_by_cube(p, rng, 0.001) for p in points]
    x = np.column_stack([np.linspace(0.05, 1.95, 39), np.full(39, 0.5), np.zeros(39)])
    sigma = assess_agreement(x, points, distances, 0.01).sigma
    alone, both = np.sqrt(np.mean(sigma[:18] ** 2)), np.sqrt(np.mean(sigma[21:] ** 2))
    assert alone == pytest.approx(0.001, rel=0.15)
    assert both == pytest.approx(0.001, rel=0.25)  # divided by the root of two it would be 0.0007


def test_a_patch_where_scans_disagree_more_is_less_sure(rng: np.random.Generator) -> None:
    points = [patch_of_points(rng, 0.0, 1.0) for _ in range(2)]
    distances = [offsets_by_cube(p, rng, 0.0005) for p in points]
    bad = [(p[:, 0] > 0.5) & (p[:, 0] < 0.7) & (p[:, 1] > 0.4) & (p[:, 1] < 0.6) for p in points]
    distances[0][bad[0]] += 0.004
    where = np.array([[0.6, 0.5, 0.0], [0.15, 0.5, 0.0]])
    here, elsewhere = assess_agreement(where, points, distances, 0.01).sigma
    assert here > 1.5 * elsewhere


def test_noise_alone_is_not_taken_for_misfit(rng: np.random.Generator) -> None:
    points = [patch_of_points(rng, 0.0, 1.0) for _ in range(3)]
    distances = [rng.normal(0.0, 0.001, len(p)) for p in points]
    assert assess_agreement(points[0][:10], points, distances, 0.01).sigma_scan < 0.0001


def test_without_overlap_the_misfit_is_unknown_and_not_zero(rng: np.random.Generator) -> None:
    points = [patch_of_points(rng, 0.0, 0.9), patch_of_points(rng, 1.1, 2.0)]
    distances = [np.zeros(len(p)) for p in points]
    agreement = assess_agreement(points[0][:10], points, distances, 0.01)
    assert np.isnan(agreement.sigma).all()
    assert np.isnan(agreement.sigma_scan)


UP = np.array([0.0, 0.0, 1.0])  # the normal of the plane that all points lie on


def beams_at(degrees: np.ndarray) -> np.ndarray:
    """Return beams that fall on the plane at these angles of incidence."""
    angle = np.radians(degrees)
    return np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)])


def views_of(where: np.ndarray, incidence: list[np.ndarray], is_rim: list[np.ndarray] | None = None) -> Views:
    """Return how scans saw points at these angles [degrees], of a plane with vertices `where`."""
    rims = is_rim or [np.zeros(len(i), dtype=bool) for i in incidence]
    return join_views([beams_at(i) for i in incidence], rims, np.tile(UP, (len(where), 1)))


def test_a_scan_that_saw_a_place_steeply_is_less_sure_there(rng: np.random.Generator) -> None:
    points = [patch_of_points(rng, 0.0, 2.0) for _ in range(2)]
    steep = points[0][:, 0] > 1.0  # the first scan sees the farther half at 75 degrees
    incidence = [np.where(steep, 75.0, 0.0), np.zeros(len(points[1]))]
    errors = np.where(steep, offsets_by_cube(points[0], rng, 0.003), offsets_by_cube(points[0], rng, 0.0004))
    distances = [errors, offsets_by_cube(points[1], rng, 0.0004)]
    where = points[0][:5]
    found = assess_agreement(where, points, distances, 0.01, views_of(where, incidence))
    assert found.sigma_by_incidence[0] == pytest.approx(0.0004, rel=0.15)  # all in one class: 0.0016
    assert found.sigma_by_incidence[3] == pytest.approx(0.003, rel=0.15)
    assert found.sigma_by_incidence[5] == found.sigma_by_incidence[3]  # steeper than anything that overlaps
    alone = patch_of_points(rng, 3.0, 4.0)  # seen by the first scan only, as steeply
    more = [np.concatenate([points[0], alone]), points[1]]
    incidence[0] = np.append(incidence[0], np.full(len(alone), 75.0))
    distances[0] = np.concatenate([distances[0], np.zeros(len(alone))])
    where = np.array([[3.5, 0.5, 0.0], [0.5, 0.5, 0.0]])
    sigma = assess_agreement(where, more, distances, 0.01, views_of(where, incidence)).sigma
    assert sigma[0] == pytest.approx(0.003, rel=0.2)
    assert sigma[1] == pytest.approx(0.0004, rel=0.6)


def test_steep_rims_are_a_class_of_their_own_and_flat_ones_are_none() -> None:
    incidence = np.array([0.0, 50.0, 65.0, 75.0, 85.0])
    for is_rim, classes in ((False, [0, 1, 2, 3, 5]), (True, [0, 1, 4, 4, 5])):
        views = views_of(np.zeros((5, 3)), [incidence], [np.full(5, is_rim)])
        assert views.classes(slice(None), views.normals).tolist() == classes


def test_a_few_steep_points_pull_a_surface_by_their_share(rng: np.random.Generator) -> None:
    points, variances = patch_of_points(rng, 0.0, 1.0), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 4.0])
    where = np.array([[0.5, 0.5, 0.0]])
    near = np.argsort(np.linalg.norm(points - where, axis=1))
    for n_steep in (1, 16, 64):
        incidence = np.zeros(len(points))
        incidence[near[:n_steep]] = 85.0
        views = views_of(where, [incidence])
        steepness = steepness_of_points(views, where, points)
        assert np.bincount(steepness, minlength=6)[5] == n_steep
        pulled = np.sqrt(expected_at(views, where, points, steepness, variances)[0])
        assert pulled == pytest.approx(2.0 * n_steep / 64.0)
