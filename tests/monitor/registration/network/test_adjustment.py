"""Scans of one epoch with known pose errors come back onto each other; what nothing holds stays where it was given."""

import dataclasses

import numpy as np
import pytest
from network_of_caps import bumpy_cap, displaced

from monitor.registration.network import overlaps
from monitor.registration.network.adjustment import AdjustmentSettings, adjust_scans
from projects.model import PointCloud
from projects.transforms import apply, perturb


def test_scans_around_an_object_come_back_onto_each_other(rng: np.random.Generator) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0003) for turn in np.arange(5) * 2 * np.pi / 5]
    errors = [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0, [0.002] * 3 + [0.0015] * 3, (5, 6))]
    adjustment = adjust_scans([displaced(c, T) for c, T in zip(clouds, errors, strict=True)])
    assert adjustment.applied
    left = [M @ E for M, E in zip(adjustment.motions, errors, strict=True)]
    to_first = [np.linalg.inv(left[0]) @ T for T in left]
    apart = [np.abs(apply(T, c.points) - c.points).max() for T, c in zip(to_first, clouds, strict=True)]
    assert max(apart) < 0.0003  # the noise of one point; errors as given: up to 5 mm
    assert adjustment.sigma_after == pytest.approx(0.0003 * np.sqrt(2), rel=0.15)
    assert adjustment.sigma_before > 2 * adjustment.sigma_after


def test_the_mean_of_the_given_poses_stays(rng: np.random.Generator) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0002) for turn in (0.0, 0.8, 1.6)]
    errors = [perturb(np.eye(4), np.zeros(3), [0, 0, 0, dx, 0, 0]) for dx in (0.002, -0.001, -0.001)]
    adjustment = adjust_scans([displaced(c, T) for c, T in zip(clouds, errors, strict=True)])
    mean = np.mean([M[:3, 3] for M in adjustment.motions], axis=0)
    assert np.abs(mean).max() < 0.0002
    assert adjustment.motions[0][0, 3] == pytest.approx(-0.002, abs=0.0003)


def test_of_scans_that_overlap_many_others_fewer_samples_say_the_same(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0002) for turn in np.arange(4) * np.pi / 2]
    errors = [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0, [0.002] * 3 + [0.0015] * 3, (4, 6))]
    given = [displaced(c, T) for c, T in zip(clouds, errors, strict=True)]
    every = adjust_scans(given)
    monkeypatch.setattr(overlaps, "MOST_MATCHES", 5000)
    monkeypatch.setattr(overlaps, "ENOUGH", 300)
    few = adjust_scans(given)
    assert sum(p.n for p in few.pairs) < 0.6 * sum(p.n for p in every.pairs)
    for a, b, cloud in zip(every.motions, few.motions, clouds, strict=True):
        # three sigma of what 300 pairs of points with 0.3 mm tell of six parameters
        assert np.abs(apply(a, cloud.points) - apply(b, cloud.points)).max() < 3 * 0.0003 * np.sqrt(6 / 300)


def test_switched_off_it_moves_nothing_and_still_says_how_the_scans_fit(rng: np.random.Generator) -> None:
    clouds = [displaced(bumpy_cap(rng, turn, 0.0002), perturb(np.eye(4), np.zeros(3), np.array([0, 0, 0, dx, 0, 0])))
              for turn, dx in ((0.0, 0.001), (0.8, -0.001))]  # fmt: skip
    found = adjust_scans(clouds, AdjustmentSettings(enabled=False))
    assert not found.applied
    assert all((np.eye(4) == M).all() for M in found.motions)
    assert 0.0006 < found.sigma_after < 0.00205  # 2 mm along x, 0 to 80 degrees off the normals, and 0.28 mm of noise


def test_scans_that_fit_already_are_left_alone(rng: np.random.Generator) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0003) for turn in (0.0, 0.8)]
    adjustment = adjust_scans(clouds)
    assert not adjustment.applied
    assert adjustment.reason == "the given poses fit as well"
    assert all(np.array_equal(T, np.eye(4)) for T in adjustment.motions)


def test_noise_of_points_does_not_hide_that_scans_lie_off(rng: np.random.Generator) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0006) for turn in (0.0, 0.8, 1.6)]
    errors = [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0, [0.0003] * 3 + [0.0003] * 3, (3, 6))]
    found = adjust_scans([displaced(c, E) for c, E in zip(clouds, errors, strict=True)])
    assert found.sigma_after > 0.85 * found.sigma_before  # as single points tell it
    assert found.applied
    left = np.array([M @ E for M, E in zip(found.motions, errors, strict=True)])
    assert np.ptp(left[:, :3, 3], axis=0).max() < 0.5 * np.ptp(np.array(errors)[:, :3, 3], axis=0).max()


def test_scans_without_overlap_are_not_moved(rng: np.random.Generator) -> None:
    far = displaced(bumpy_cap(rng, 0.0, 0.0003), perturb(np.eye(4), np.zeros(3), [0, 0, 0, 5.0, 0, 0]))
    adjustment = adjust_scans([bumpy_cap(rng, 0.0, 0.0003), far])
    assert not adjustment.applied
    assert "overlap" in adjustment.reason


def test_the_answer_is_the_same_far_from_the_origin(rng: np.random.Generator) -> None:
    clouds = [bumpy_cap(rng, turn, 0.0003) for turn in (0.0, 0.7)]
    clouds[1] = displaced(clouds[1], perturb(np.eye(4), np.zeros(3), [0.002, 0, 0.001, 0.001, 0, 0]))
    away = perturb(np.eye(4), np.zeros(3), [0, 0, 0, 4.0e5, -3.0e5, 200.0])
    near = adjust_scans(clouds, AdjustmentSettings(seed=4)).motions
    far = adjust_scans([displaced(c, away) for c in clouds], AdjustmentSettings(seed=4)).motions
    for a, b, cloud in zip(near, far, clouds, strict=True):
        moved = apply(np.linalg.inv(away), apply(b, apply(away, cloud.points)))
        assert np.abs(moved - apply(a, cloud.points)).max() < 2e-6


def lift_oblique(cloud: PointCloud, station: np.ndarray) -> PointCloud:
    """Return the cloud scanned from a station by a wide spot, as it falls on a bent surface.

    Off the middle of a Gaussian spot of sigma s a surface bent by 1 / r lies u tan(a) + u^2 / (2 r cos(a)^3) deeper;
    what lies nearer is seen less steeply and sends more light back, in proportion to the cosine. Together the mean lies
    s^2 / (2 r) (tan(a)^2 - 1) outside of the surface; here s^2 / (2 r) is 0.02 mm, at 70 degrees 0.13 mm.
    """
    assert cloud.normals is not None
    beams = station - cloud.points
    cosine = np.einsum("ij,ij->i", beams, cloud.normals) / np.linalg.norm(beams, axis=1)
    steepness = np.minimum(cosine**-2 - 1.0, np.tan(np.radians(85.0)) ** 2)
    lift = 2e-5 * np.maximum(steepness - 1.0, 0.0)
    return PointCloud(cloud.points + lift[:, None] * cloud.normals, normals=cloud.normals, origins=station)


def test_points_seen_obliquely_do_not_push_the_scans_outward(rng: np.random.Generator) -> None:
    turns = np.arange(4) * np.pi / 2
    outward = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(4)])
    clouds = [lift_oblique(bumpy_cap(rng, t, 0.0002), 3.0 * d) for t, d in zip(turns, outward, strict=True)]
    errors = [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0, [0.001] * 3 + [0.0008] * 3, (4, 6))]
    given = [displaced(c, E) for c, E in zip(clouds, errors, strict=True)]
    given = [dataclasses.replace(c, origins=3.0 * d) for c, d in zip(given, outward, strict=True)]
    found = adjust_scans(given)
    assert found.applied, found.reason
    left = np.array([(M @ E)[:3, 3] for M, E in zip(found.motions, errors, strict=True)])
    breathing = np.mean(np.sum((left - left.mean(axis=0)) * outward, axis=1))
    assert abs(breathing) < 0.0005  # 0.28 mm of six rings; 0.57 with all up to 80 degrees, with limbs 2.9


def test_copies_of_one_scan_stay_where_they_were_given(rng: np.random.Generator) -> None:
    cap = bumpy_cap(rng, 0.0, 0.0003)
    adjustment = adjust_scans([cap, cap, cap])
    assert (adjustment.applied, adjustment.converged) == (False, True)
    assert adjustment.reason == "the given poses fit as well"
    assert adjustment.sigma_before == adjustment.sigma_after == 0.0


def test_a_copy_that_was_moved_comes_back_to_the_micrometre(rng: np.random.Generator) -> None:
    cap, error = bumpy_cap(rng, 0.0, 0.0003), perturb(np.eye(4), np.zeros(3), [1e-3, 0, 1e-3, 1e-3, 0, 0])
    adjustment = adjust_scans([cap, displaced(cap, error)])
    assert adjustment.applied
    left = np.linalg.inv(adjustment.motions[0]) @ adjustment.motions[1] @ error
    assert np.abs(left - np.eye(4)).max() < 1e-6
