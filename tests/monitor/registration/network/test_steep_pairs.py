"""Scans around a round body see its limbs steeply; what misses there must not draw the scans outwards."""

import numpy as np
import pytest
import trimesh

from monitor.filtering import filter_scan
from monitor.registration.motion.sides import prepare_side
from monitor.registration.network.adjustment import adjust_scans
from monitor.registration.network.network_covariance import _information
from monitor.simulation import INSTRUMENTS, Body, Scene, misregister, simulate_scan, stand_at, window_around
from projects.model import PointCloud
from projects.transforms import apply, invert


@pytest.fixture(scope="module")
def body() -> Scene:
    """A bumpy body 0.3 m wide: a bare ball is held by nothing."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    waves = np.random.default_rng(3).normal(size=(12, 3)) * 3.0
    radius = 0.13 * np.linalg.norm(mesh.vertices * [0.85, 1.1, 1.0], axis=1)
    radius += 0.004 * np.cos(mesh.vertices @ waves.T).sum(axis=1)
    return Scene("body", (Body("body", mesh.vertices * radius[:, None], mesh.faces.astype(np.int32), 0.6),))


def scan_around(body: Scene, seed: int, n_stations: int = 4) -> tuple[list[PointCloud], list[np.ndarray]]:
    """Filtered clouds of stations all around as registered, 1 mm off, and the true motions back."""
    rng = np.random.default_rng(seed)
    clouds, back = [], []
    for k in range(n_stations):
        turn = 2.0 * np.pi / n_stations * k + 0.1 * seed
        pose = stand_at(np.array([2.0 * np.cos(turn), 2.0 * np.sin(turn), 0.3]), facing=np.zeros(3))
        given = misregister(pose, rng, sigma_position=0.001, sigma_angle=1e-4)
        window = window_around(body.bounds(), pose, margin=0.01)
        scan = simulate_scan(
            body, INSTRUMENTS["phase-2020"], pose, window, step=0.0023, seed=seed + k, registered=given
        )
        clouds.append(filter_scan(scan))
        back.append(pose @ invert(given))
    return clouds, back


def outwards(clouds: list[PointCloud], motions: tuple[np.ndarray, ...], back: list[np.ndarray]) -> float:
    """Mean displacement [m] of the fronts away from the middle, after the adjustment."""
    ways = []
    for cloud, moved, true in zip(clouds, motions, back, strict=True):
        assert cloud.origins is not None
        station = np.reshape(cloud.origins, (-1, 3))[0]
        front = station / np.linalg.norm(station)
        ways.append(float((apply(moved, 0.13 * front[None]) - apply(true, 0.13 * front[None]))[0] @ front))
    return float(np.mean(ways))


def test_a_ring_of_scans_is_not_drawn_outwards_by_what_is_seen_steeply(body: Scene) -> None:
    found = []
    for seed in range(2):
        clouds, back = scan_around(body, seed)
        adjustment = adjust_scans(clouds)
        assert adjustment.applied
        found.append(outwards(clouds, adjustment.motions, back))
    assert abs(np.mean(found)) < 1.5e-4  # by all pairs 0.28 mm


@pytest.mark.parametrize("seed", [1, 3])
def test_three_scans_are_not_drawn_outwards_by_limbs_that_pass_for_flat(body: Scene, seed: int) -> None:
    """They share strips that both see at 60 degrees and more; past a limb normals are poor and say less."""
    clouds, back = scan_around(body, seed, n_stations=3)
    adjustment = adjust_scans(clouds)
    assert adjustment.applied
    assert abs(outwards(clouds, adjustment.motions, back)) < 2.5e-4  # by their own normals alone 0.44 and 1.9 mm


def test_rims_are_the_points_with_all_neighbours_to_one_side(rng: np.random.Generator) -> None:
    points = np.column_stack([rng.uniform(0.0, 1.0, (4000, 2)), np.zeros(4000)])
    cloud = PointCloud(points, normals=np.tile([0.0, 0.0, 1.0], (4000, 1)), origins=np.array([0.5, 0.5, 3.0]))
    side = prepare_side(cloud, np.zeros(3))
    frontal = side.frontality_of(np.arange(4000))
    to_rim = np.minimum(points[:, :2], 1.0 - points[:, :2]).min(axis=1)
    spacing = 1.0 / np.sqrt(4000)
    assert np.mean(frontal[to_rim < 0.5 * spacing] == 0.0) > 0.95
    assert np.mean(frontal[to_rim > 4.0 * spacing] == 0.0) < 0.02
    assert frontal.max() == pytest.approx(1.0, abs=0.01)


def test_noise_of_the_normals_makes_no_negative_information(rng: np.random.Generator) -> None:
    points = rng.normal(size=(20, 3))
    a, b = rng.normal(size=(2, 20, 3))
    assert np.linalg.eigvalsh(_information(points, (a, b), np.ones(20), 1.0)).min() > -1e-9
