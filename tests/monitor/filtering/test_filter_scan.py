"""The chain of one scan and the merging of several, on walls of known place and on real scans."""

import dataclasses

import numba
import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.filtering import (
    FilterSettings,
    SilhouetteSettings,
    ThinningSettings,
    filter_scan,
    filter_scan_with_record,
    merge_scans,
)
from monitor.filtering.merging import concatenate_clouds
from monitor.simulation import INSTRUMENTS, build_scene, simulate_scan, stand_at, window_around
from monitor.simulation.model import Model, box_part
from projects.errors import ParameterError
from projects.model import PointCloud, Scan
from projects.transforms import apply, invert, rotation_from_vector

NOISE = 1e-3


def pose_of(turn, shift):
    """Return T_project_scanner."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_from_vector(np.array(turn)), shift
    return pose


def wall_scan(rng, offset=0.0, shift=(0.0, 0.0, 3.0), n_points=12_000, name="a", noise=NOISE):
    """Return a scan of the wall z = `offset` (project frame), 1 mm spacing, 1 mm noise, from 3 m before it."""
    side = 0.001 * np.sqrt(n_points)
    on_wall = np.c_[rng.uniform(0, side, (n_points, 2)), offset + rng.normal(0, noise, n_points)]
    pose = pose_of([0.3, -0.2, 0.5], shift)
    cloud = PointCloud(
        apply(invert(pose), on_wall),
        intensity=np.full(n_points, 0.5),
        colors=np.tile(np.array([10, 200, 30], dtype=np.uint8), (n_points, 1)),
    )
    return Scan(name, cloud, pose)


def test_a_wall_is_thinned_into_the_projects_frame_with_its_noise_reduced(rng):
    scan = wall_scan(rng)
    result = filter_scan_with_record(scan)
    cloud = result.cloud
    assert np.isclose(result.automatic["noise_before"], NOISE, rtol=0.1)
    assert len(cloud) < 0.4 * len(scan.cloud)
    z = cloud.points[:, 2]
    assert abs(z.mean()) < 4 * NOISE / np.sqrt(len(scan.cloud))
    assert np.isclose(np.sqrt(((z / cloud.sigma) ** 2).mean()), 1.0, atol=0.12)
    assert cloud.sigma.max() < 1.5 * NOISE
    assert np.quantile(cloud.normals[:, 2], 0.01) > 0.9
    assert np.allclose(cloud.origins, [0, 0, 3.0])
    assert (cloud.colors == [10, 200, 30]).all()
    assert np.allclose(cloud.intensity, 0.5)


@pytest.mark.parametrize("times", [3, 6])
def test_a_dense_scan_of_a_noisy_scanner_states_the_noise_it_has(rng, times):
    """Noise of 3 and 6 spacings; told by neighbourhoods within it, sigma would be 1.3 and 2 times too small."""
    result = filter_scan_with_record(wall_scan(rng, n_points=90_000, noise=times * 1e-3))
    cloud = result.cloud
    assert np.isclose(result.automatic["noise_before"], times * 1e-3, rtol=0.08)
    assert result.automatic["stride_quartiles"][1] >= times
    inside = (np.abs(cloud.points[:, :2] - 0.15) < 0.12).all(axis=1)
    z = (cloud.points[:, 2] / cloud.sigma)[inside]
    assert np.isclose(np.sqrt((z**2).mean()), 1.0, atol=0.1)
    assert np.median(cloud.sigma[inside]) < 0.3 * times * 1e-3
    assert np.quantile(cloud.normals[inside, 2], 0.05) > 0.99
    lost = {reason: n for reason, n in result.counts.items() if reason in ("outlier", "rim", "grazing", "speck")}
    assert sum(lost.values()) < 0.01 * len(cloud.points) + 0.01 * result.counts["in"]
    assert np.isclose(np.median(cloud.spacing), 0.001, rtol=0.15)


def test_every_point_that_came_in_is_accounted_for(rng):
    result = filter_scan_with_record(wall_scan(rng))
    counts = dict(result.counts)
    assert counts.pop("in") == 12_000
    assert counts.pop("out") == len(result.cloud)
    assert sum(counts.values()) + len(result.cloud) == 12_000
    assert result.cloud.n_merged.sum() == 12_000 - sum(n for reason, n in counts.items() if reason != "merged")


def test_order_in_the_file_and_number_of_threads_change_nothing(rng):
    scan = wall_scan(rng)
    here = filter_scan(scan)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    there = filter_scan(scan.take(rng.permutation(len(scan.cloud))))
    numba.set_num_threads(threads)
    for f in dataclasses.fields(PointCloud):
        a, b = getattr(here, f.name), getattr(there, f.name)
        assert (a is None and b is None) or np.array_equal(a, b), f.name


def test_specks_and_outliers_are_dropped_with_their_reason(rng):
    scan = wall_scan(rng)
    points = scan.cloud.points.copy()
    points[:40] *= rng.uniform(0.5, 0.9, (40, 1))  # along the beam, towards the scanner
    points[40:140] *= 1.0 - 5.2e-3 / 3.0
    result = filter_scan_with_record(dataclasses.replace(scan, cloud=PointCloud(points)))
    assert result.counts["speck"] >= 38
    assert result.counts["outlier"] >= 75  # at 5.2 sigma, with noise of their own, some pass for noise
    assert np.quantile(np.abs(result.cloud.points[:, 2]), 0.99) < 3e-3


def test_a_grid_loses_its_mixed_pixels(rng):
    """Two walls, 3 and 3.4 m away, with the columns between them smeared; nothing is lost away from rims."""
    rows, columns = (a.ravel() for a in np.meshgrid(np.arange(100), np.arange(100), indexing="ij"))
    directions = np.c_[np.tan((columns - 50) * 1e-3), np.tan((rows - 50) * 1e-3), np.ones(10_000)]
    depth = np.where(columns < 50, 3.0, 3.4)
    mixed = columns == 50
    depth[mixed] = rng.uniform(3.05, 3.35, mixed.sum())
    points = directions * (depth + rng.normal(0, 0.5e-3, 10_000))[:, None]
    scan = Scan("grid", PointCloud(points), np.eye(4), rows=rows, columns=columns)
    bordered = FilterSettings(silhouettes=SilhouetteSettings(drop_border=True))
    for settings, most_rims in ((FilterSettings(), 2 * 100), (bordered, 4 * 99 + 2 * 100)):
        result = filter_scan_with_record(scan, settings)
        z = result.cloud.points[:, 2]
        assert ((np.abs(z - 3.0) < 0.01) | (np.abs(z - 3.4) < 0.01)).mean() > 0.999
        inner = (np.abs(rows - 49.5) < 48) & (np.abs(columns - 49.5) < 48) & (np.abs(columns - 50) > 2)
        assert result.cloud.n_merged.sum() > 0.99 * inner.sum()
        assert result.counts["rim"] < 1.2 * most_rims  # one column on either side of the jump, and the border
    kept = filter_scan_with_record(scan).cloud.n_merged.sum()
    assert kept > 0.97 * (~mixed).sum()
    rims = FilterSettings(silhouettes=SilhouetteSettings(drop_rims=False))
    assert filter_scan_with_record(scan, rims).cloud.n_merged.sum() > 0.99 * (~mixed).sum()


def test_a_bar_on_a_wall_that_two_or_three_columns_of_a_scan_met_stays():
    """20 mm wide and 10 mm high, points 8 mm apart: a third of its points were dropped."""
    wall = box_part("wall", np.array([-0.5, 0.0, -0.5]), np.array([0.5, 0.1, 0.5]), cell=0.02, reflectance=0.7)
    bar = box_part("bar", np.array([-0.01, -0.01, -0.4]), np.array([0.01, 0.001, 0.4]), cell=0.005, reflectance=0.7)
    pose, box = (
        stand_at(np.array([-0.6, -3.5, 0.1]), facing=np.zeros(3)),
        np.array([[-0.2, -0.1, -0.3], [0.2, 0.0, 0.3]]),
    )
    window = window_around(box, pose, margin=0.002)
    scan = simulate_scan(
        build_scene(Model("bar", (wall, bar))), INSTRUMENTS["phase-2020"], pose, window, step=0.008 / 3.5, seed=1
    )
    given, kept = apply(pose, scan.cloud.points), filter_scan(scan)
    on_bar = given[:, 1] < -0.005
    assert on_bar.sum() > 150
    apart, _ = cKDTree(kept.points).query(given[on_bar])
    assert (apart < 4e-3).mean() > 0.97
    front = kept.points[:, 1] < -0.008
    assert np.median(kept.normals[front, 1]) < -0.99  # as the wall looks, and not aside


def test_a_scan_without_enough_points_gives_an_empty_cloud(rng):
    scan = wall_scan(rng).take(np.arange(7))
    result = filter_scan_with_record(scan)
    assert len(result.cloud) == 0
    assert result.counts == {"in": 7, "too_few": 7, "merged": 0, "out": 0}


def test_an_unknown_station_leaves_out_what_needs_it(rng):
    scan = dataclasses.replace(wall_scan(rng), origin=np.full(3, np.nan))
    result = filter_scan_with_record(scan)
    assert "grazing" not in result.counts
    assert abs(result.cloud.normals[:, 2].sum()) > 0.9 * len(result.cloud)
    assert np.isnan(result.cloud.origins).all()


def test_points_that_are_not_finite_are_refused(rng):
    scan = wall_scan(rng)
    points = scan.cloud.points.copy()
    points[5] = np.inf
    with pytest.raises(ParameterError, match="1 of 12000 points have coordinates that are not finite"):
        filter_scan(dataclasses.replace(scan, cloud=PointCloud(points)))


def test_merged_scans_keep_scan_origins_and_measurements(rng):
    clouds = [filter_scan(wall_scan(rng)), filter_scan(wall_scan(rng, shift=(0.5, 0, 2.5), name="b"))]
    result = merge_scans([*clouds, PointCloud(np.empty((0, 3)))])
    cloud = result.cloud
    assert result.counts["in"] == sum(map(len, clouds))
    assert cloud.n_merged.sum() == sum(c.n_merged.sum() for c in clouds) or result.counts["outlier"] > 0
    first = cloud.scan_index == 0
    assert np.allclose(cloud.origins[first], [0, 0, 3.0])
    assert np.allclose(cloud.origins[~first], [0.5, 0, 2.5])
    assert len(cloud) < 0.8 * result.counts["in"]


def test_sigma_of_merged_points_holds_the_discrepancy_between_scans(rng):
    """Two scans thinned to 0.2 mm that disagree by 2 mm: points between them are not known to 0.2 mm."""
    settings = FilterSettings(thinning=ThinningSettings(target_spacing=6e-3))
    agree = [filter_scan(wall_scan(rng), settings), filter_scan(wall_scan(rng), settings)]
    differ = [agree[0], filter_scan(wall_scan(rng, offset=2e-3), settings)]
    sigma = [np.median(merge_scans(clouds, settings).cloud.sigma) for clouds in (agree, differ)]
    assert sigma[0] < 0.25e-3
    assert sigma[1] > 0.6e-3


def test_nothing_to_merge_is_refused():
    with pytest.raises(ParameterError, match="no points were given to merge"):
        merge_scans([PointCloud(np.empty((0, 3)))])


def test_a_real_scan_keeps_its_surface(real_data):
    """Bunny, first view: 0.5 mm spacing, noise below a tenth of it: nearly every point stays where it was measured."""
    path = real_data / "stanford_bunny" / "range" / "bun000.ply"
    lines = path.read_text(encoding="latin-1").split("end_header\n")[1].splitlines()[:40256]
    points = np.array([line.split()[:3] for line in lines], dtype=float)
    result = filter_scan_with_record(Scan("bun000", PointCloud(points), np.eye(4), origin=np.array([0, 0, 1.0])))
    assert len(result.cloud) > 0.95 * len(points)
    assert 0.03e-3 < result.automatic["noise_before"] < 0.12e-3
    dropped = result.counts["outlier"] + result.counts["speck"]
    assert dropped < 0.01 * len(points)


def test_merged_scans_of_unknown_stations_look_one_way(rng, monkeypatch):
    monkeypatch.setattr("monitor.filtering.normals.BLOCK", 3000)  # so that the cloud has several

    def relief(sign):
        x, y = rng.uniform(-0.3, 0.3, (2, 4000))
        z = 0.03 * np.sin(11 * x) * np.cos(9 * y) + rng.normal(0, 0.0003, 4000)
        normals = np.tile([0.0, 0.0, sign], (4000, 1))
        return PointCloud(np.column_stack([x, y, z]), normals=normals, origins=np.full(3, np.nan))

    up = merge_scans([relief(1.0), relief(-1.0)]).cloud.normals[:, 2] > 0
    assert up.mean() in (0.0, 1.0)


def test_what_another_scan_looked_through_is_dropped_before_merging(rng):
    """Forty points float 0.2 m before the wall in one scan; the other measured the wall behind them."""
    keeping = FilterSettings(silhouettes=SilhouetteSettings(drop_seen_through=False))
    clouds = [filter_scan(wall_scan(rng)), filter_scan(wall_scan(rng, shift=(0.5, 0, 2.5), name="b"))]
    floating = clouds[0].take(np.arange(40))
    centre = np.median(clouds[0].points, axis=0) + np.array([0.0, 0.0, 0.2])
    floating = dataclasses.replace(floating, points=centre + rng.uniform(-0.01, 0.01, (40, 3)))
    clouds[0] = concatenate_clouds([clouds[0], floating])
    clouds[0] = dataclasses.replace(clouds[0], origins=floating.origins)
    result = merge_scans(clouds)
    assert result.counts["seen_through"] == 40
    assert result.counts["in"] == sum(map(len, clouds))
    assert merge_scans(clouds, keeping).counts["seen_through"] == 0
