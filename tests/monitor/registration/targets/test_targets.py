"""Spheres and boards are found in simulated scans where they are, as sure as stated, and nowhere else."""

import dataclasses

import numpy as np
import pytest
from survey_targets import SCANNER, board, sphere

from monitor.registration.targets.angular_image import make_image
from monitor.registration.targets.finding import TargetSettings, find_targets
from monitor.simulation import (
    Body,
    Scene,
    carved_figure,
    simulate_scan,
    stand_at,
    window_around,
)
from monitor.simulation.scenes import make_box
from projects.errors import ParameterError
from projects.model import PointCloud, Scan
from projects.transforms import apply, invert

STATION = stand_at(np.array([0.0, 0.0, 1.5]), facing=np.array([1.0, 0.2, 1.5]))
WALL = make_box("wall", np.array([4.6, -2.0, -1.0]), np.array([4.7, 2.0, 3.0]))


def look(*bodies: Body, at: np.ndarray, reach: float = 0.25, step: float = 0.001, seed: int = 0) -> Scan:
    """Return a scan of what stands within `reach` about a place."""
    margin = 0.001 * float(np.random.default_rng(seed).uniform())  # so that no edge always lies between two columns
    window = window_around(np.array([at - reach, at + reach]), STATION, margin=margin)
    return simulate_scan(Scene("targets", bodies), SCANNER, STATION, window, step=step, seed=seed)


def mean_squared_error(kind: str) -> tuple[float, float]:
    """Return the mean of e' C^-1 e over simulated scans of a target at 4 m, and the largest error [m]."""
    squared, errors = [], []
    for seed in range(12):
        at = np.array([4.0, 0.3, 1.0]) + np.random.default_rng(seed).uniform(-0.02, 0.02, 3)
        body = sphere(at) if kind == "sphere" else board(at)
        (found,) = find_targets(look(WALL, body, at=at, seed=seed, reach=0.15))
        assert found.kind == kind
        error = found.centre - apply(invert(STATION), at)
        squared.append(error @ np.linalg.solve(found.covariance, error))
        errors.append(np.linalg.norm(error))
    return float(np.mean(squared)), float(max(errors))


def test_centre_of_a_sphere_is_as_sure_as_stated() -> None:
    squared, largest = mean_squared_error("sphere")
    assert 1.5 < squared < 6.0  # 3 with exact covariances; 12 trials: 1.7 to 4.6; the footprint adds a little
    assert largest < 0.0001  # noise of a point: 0.26 mm


def test_centre_of_a_board_is_as_sure_as_stated() -> None:
    squared, largest = mean_squared_error("board")
    assert 0.5 < squared < 5.0  # edges along the scanner's columns are known to a part of the spacing only
    assert largest < 0.001  # the points lie 4 mm apart


def test_radius_is_told_from_the_usual_ones() -> None:
    for radius in (0.05, 0.06985, 0.0725, 0.0762, 0.1):
        at = np.array([3.0, 0.3, 1.2])
        (found,) = find_targets(look(WALL, sphere(at, radius), at=at))
        assert found.radius == radius
        assert found.n_points > 100
        assert found.completeness > 0.8


def test_sphere_of_another_size_is_no_target() -> None:
    at = np.array([3.0, 0.3, 1.2])
    scan = look(WALL, sphere(at, 0.085), at=at)
    assert find_targets(scan) == ()
    assert len(find_targets(scan, TargetSettings(sphere_radius=0.085))) == 1


def test_half_hidden_sphere_is_refused_as_incomplete() -> None:
    at = np.array([3.0, 0.3, 1.2])
    screen = make_box("screen", at - [0.5, 0.3, 0.3], at - [0.45, 0.01, -0.3])
    assert find_targets(look(WALL, sphere(at), screen, at=at)) == ()


def test_chequered_floor_is_no_board() -> None:
    at = np.array([4.0, 0.3, 1.0])
    assert find_targets(look(board(at, width=0.9, n_fields=6), at=at, reach=0.3)) == ()


def test_targets_are_found_without_a_grid() -> None:
    at = np.array([3.5, 0.3, 1.2])
    other = at + np.array([0.0, 0.35, 0.0])
    scan = look(WALL, sphere(at), board(other), at=at, reach=0.5)
    order = np.random.default_rng(1).permutation(len(scan.cloud))
    bare = dataclasses.replace(scan.take(order), rows=None, columns=None)
    assert [t.kind for t in find_targets(bare)] == ["sphere", "board"]
    for found, same in zip(find_targets(bare), find_targets(scan), strict=True):
        assert np.linalg.norm(found.centre - same.centre) < 0.0003


def test_directions_without_a_grid_leave_no_pixel_empty_above_and_below_the_scanner() -> None:
    elevation, azimuth = np.meshgrid(np.arange(-1.2, 0.5, 0.006), np.arange(-1.0, 1.0, 0.008), indexing="ij")
    directions = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                           np.sin(elevation)], axis=-1).reshape(-1, 3)  # fmt: skip
    image = make_image(Scan("scan", PointCloud(3.0 * directions), np.eye(4), np.zeros(3)))
    assert image is not None
    assert np.isfinite(image.intensity).sum() == 0
    assert np.isfinite(image.points[..., 0]).mean() > 0.99
    assert image.points.shape[0] == pytest.approx(elevation.shape[0] / 1.2, rel=0.01)
    assert image.points.shape[1] == pytest.approx(elevation.shape[1] / 1.2, rel=0.01)


def few_points_of_spheres(at: list[np.ndarray], seed: int) -> Scan:
    """Return a scan so coarse and noisy that the farther spheres do not tell 145 from 152 mm across."""
    noisy = dataclasses.replace(SCANNER, noise_floor=0.0008)
    around = np.array([np.min(at, axis=0) - 0.3, np.max(at, axis=0) + 0.3])
    return simulate_scan(Scene("targets", (WALL, *map(sphere, at))), noisy, STATION, window_around(around, STATION),
                         step=0.0045, seed=seed)  # fmt: skip


def test_a_sphere_that_may_have_two_radii_has_that_of_the_others_or_says_so() -> None:
    near, far = np.array([2.0, 0.5, 1.4]), np.array([3.6, 0.1, 1.3])
    n_wide = 0
    for seed in range(12):
        for at in ([near, far], [far]):
            for target in find_targets(few_points_of_spheres(at, seed)):
                error = target.centre - min((apply(invert(STATION), p) for p in at),
                                            key=lambda p, t=target: np.linalg.norm(t.centre - p))  # fmt: skip
                assert error @ np.linalg.solve(target.covariance, error) < 30.0
                n_wide += len(at) == 1 and np.sqrt(np.trace(target.covariance)) > 0.003
                assert len(at) == 1 or (target.radius == 0.0725 and np.linalg.norm(error) < 0.001)
    assert n_wide > 0


def test_scan_without_intensity_has_spheres_alone() -> None:
    at = np.array([3.5, 0.3, 1.2])
    scan = look(WALL, sphere(at), board(at + np.array([0.0, 0.35, 0.0])), at=at, reach=0.5)
    blind = dataclasses.replace(scan, cloud=dataclasses.replace(scan.cloud, intensity=None))
    assert [t.kind for t in find_targets(blind)] == ["sphere"]


def test_centre_is_in_the_scans_frame_also_where_the_scanner_is_not_its_origin() -> None:
    at = np.array([4.0, 0.3, 1.0])
    scan = look(WALL, sphere(at), at=at)
    shift = np.array([100.0, -50.0, 7.0])
    cloud = dataclasses.replace(scan.cloud, points=scan.cloud.points + shift, origins=shift)
    (found,), (same,) = find_targets(dataclasses.replace(scan, cloud=cloud, origin=shift)), find_targets(scan)
    assert np.abs(found.centre - same.centre - shift).max() < 1e-9


def test_nothing_is_found_on_a_carved_figure_or_among_boxes(rng: np.random.Generator) -> None:
    figure = carved_figure(1, cell=0.006)
    low, high = figure.body.vertices.min(axis=0), figure.body.vertices.max(axis=0)
    middle = 0.5 * (low + high)
    station = stand_at(middle + np.array([2.5, 0.3, 0.0]), facing=middle)
    boxes = []
    for k in range(30):
        corner = middle + rng.uniform([-2, -1.5, -1], [-0.7, 1.5, 1])
        size = rng.uniform(0.03, 0.3, 3)
        boxes.append(make_box(f"box{k}", corner, corner + size, reflectance=float(rng.uniform(0.05, 0.9))))
    scene = Scene("figure", (figure.body, *boxes))
    window = window_around(np.array([middle - 0.8, middle + 0.8]), station)
    scan = simulate_scan(scene, SCANNER, station, window, step=0.002, seed=1, n_subrays=1)
    assert find_targets(scan) == ()


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(ParameterError, match="completeness"):
        TargetSettings(completeness=2.0)
