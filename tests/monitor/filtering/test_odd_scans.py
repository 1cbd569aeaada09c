"""Scans as programs write them that do not mean well: nothing of them passes for a measurement, nothing is lost."""

import dataclasses
import warnings

import numpy as np
import pytest

from monitor.filtering import (
    FilterSettings,
    ThinningSettings,
    average_scans,
    calibrate_range,
    filter_scan_with_record,
    merge_scans,
    voxel_median,
)
from monitor.filtering.copies import find_copies
from monitor.filtering.nearest import canonical_order
from monitor.filtering.seen_through import find_seen_through
from monitor.reconstruction.surface import blend
from projects.errors import ParameterError
from projects.model import PointCloud, Scan


def wall(rng, n_points=3000):
    """Return points of a wall 2 m before the scanner, 0.2 m wide, with 1 mm of noise."""
    return np.c_[rng.uniform(-0.1, 0.1, (n_points, 2)), 2.0 + rng.normal(0, 1e-3, n_points)]


def scan_of(points, **known):
    """Return a scan of points [m], and intensity or colours, whose frame is the project's."""
    return Scan("odd", PointCloud(points, **known), np.eye(4))


def test_one_point_far_away_does_not_undo_the_order_of_the_others(rng):
    """At 10 000 km cells are 5 m wide: by x alone, neighbours in the array would be 0.3 m apart, not 0.02."""
    points = np.r_[rng.uniform(0, 1, (5000, 2)), [[1e7, 0.0]]]
    points = np.c_[points, np.zeros(len(points))]
    steps = np.linalg.norm(np.diff(points[canonical_order(points)][:-1], axis=0), axis=1)
    assert np.mean(steps) < 0.03


def test_points_at_one_place_have_an_order_in_single_precision_too():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        order = canonical_order(np.full((20, 3), 0.1, dtype=np.float32))
    assert sorted(order) == list(range(20))


def test_copies_are_what_lies_at_one_place_unless_rounding_brought_it_there(rng):
    few = np.repeat(np.arange(10.0)[:, None] * np.ones(3), [1, 2, 3, 6, 1, 1, 1, 1, 1, 1], axis=0)
    assert find_copies(few).sum() == 8
    assert not find_copies(few, step=1.0).any()
    piled = np.repeat(np.arange(3.0)[:, None] * np.ones(3), [1, 7, 2], axis=0)
    assert np.array_equal(np.flatnonzero(find_copies(piled, step=1.0)), np.arange(2, 8))


@pytest.mark.parametrize("share", [0.05, 0.5, 0.999])
def test_a_part_of_a_scan_that_a_file_holds_twice_counts_once(rng, share):
    points = wall(rng)
    again = points[: int(share * len(points))]
    once, twice = (filter_scan_with_record(scan_of(p)) for p in (points, np.r_[points, again]))
    assert np.array_equal(once.cloud.sigma, twice.cloud.sigma)
    assert twice.counts["copy"] == len(again)


def test_a_scan_that_a_file_holds_twice_counts_once(rng):
    """Else each sigma would be too small by sqrt(2), and twice as many points would be kept."""
    points = wall(rng)
    once, twice = (filter_scan_with_record(scan_of(p)) for p in (points, np.r_[points, points]))
    assert np.array_equal(once.cloud.points, twice.cloud.points)
    assert np.array_equal(once.cloud.sigma, twice.cloud.sigma)
    assert twice.counts["copy"] == len(points)
    assert twice.counts["in"] == sum(n for reason, n in twice.counts.items() if reason != "in")


def test_points_piled_up_at_one_place_are_no_surface(rng):
    """2000 of them would be 2000 points known to a nanometre; one is left, a speck."""
    points = np.r_[wall(rng), np.tile([0.3, 0.3, 1.0], (2000, 1))]
    found = filter_scan_with_record(scan_of(points))
    assert found.counts["copy"] == 1999
    assert found.cloud.sigma.min() > 1e-5
    assert found.cloud.points[:, 2].min() > 1.9


def test_points_where_the_scanner_stood_are_dropped_and_counted(rng):
    points = wall(rng)
    alone = filter_scan_with_record(scan_of(points))
    found = filter_scan_with_record(scan_of(np.r_[points, np.zeros((50, 3))]))
    assert found.counts["at_scanner"] == 50
    assert found.counts["in"] == 3050
    assert np.array_equal(found.cloud.points, alone.cloud.points)


def test_all_points_at_one_place_leave_nothing():
    found = filter_scan_with_record(scan_of(np.tile([0.1, 0.2, 2.0], (1000, 1))))
    assert dict(found.counts) == {"in": 1000, "copy": 999, "too_few": 1, "merged": 0, "out": 0}


def test_intensity_is_the_mean_of_the_members_that_know_it(rng):
    """Four of five points know it, 0.5 all: no mean is anything else, and few representatives have none."""
    known = rng.random(3000) < 0.8
    intensity = np.where(known, 0.5, np.where(rng.random(3000) < 0.5, np.nan, np.inf))
    found = filter_scan_with_record(scan_of(wall(rng), intensity=intensity)).cloud.intensity
    assert set(np.unique(found[np.isfinite(found)])) == {0.5}
    assert np.isnan(found[~np.isfinite(found)]).all()
    assert np.isnan(found).mean() < 0.15  # of one to three members each; with NaN of any 0.35


@pytest.mark.parametrize("turn", [np.nan, 0.0, 2.0])
def test_a_pose_that_is_no_motion_is_refused_with_the_name_of_the_scan(rng, turn):
    pose = np.eye(4)
    pose[:3, :3] *= turn
    with pytest.raises(ParameterError, match="scan 'odd': its pose: "):
        filter_scan_with_record(Scan("odd", PointCloud(wall(rng)), pose))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e13])
def test_coordinates_of_no_place_are_refused_by_every_step(rng, bad):
    points = np.r_[wall(rng), [[0.0, 0.0, bad]]]
    whole = PointCloud(points, normals=0 * points + [0, 0, 1], sigma=0 * points[:, 0] + 1e-3, spacing=points[:, 0] + 1)
    steps = (
        lambda: filter_scan_with_record(scan_of(points)),
        lambda: calibrate_range(scan_of(points)),
        lambda: average_scans([scan_of(points), scan_of(points + 1e-4)]),
        lambda: merge_scans([whole]),
        lambda: voxel_median(whole),
    )
    for step in steps:
        with pytest.raises(ParameterError, match="1 of 3001 points have coordinates that are not finite or exceed"):
            step()


def test_a_place_of_the_scanner_that_is_infinite_is_not_known(rng):
    scan = dataclasses.replace(scan_of(wall(rng)), origin=np.array([0.0, np.inf, 0.0]))
    assert np.isnan(filter_scan_with_record(scan).cloud.origins).all()


def test_intensity_that_one_scan_lacks_is_kept_of_the_other_and_lost_colours_are_told(rng):
    points = wall(rng)
    known = {"intensity": np.full(3000, 0.5), "colors": np.full((3000, 3), 200)}
    clouds = [filter_scan_with_record(s).cloud for s in (scan_of(points, **known), scan_of(points[::-1] + 1e-5))]
    merged = merge_scans(clouds)
    finite = np.isfinite(merged.cloud.intensity)
    assert 0.4 < finite.mean() < 1.0
    assert (merged.cloud.intensity[finite] == 0.5).all()
    assert merged.automatic["colors_left_out"] == "1 of 2 scans have none"
    assert "colors_left_out" not in merge_scans(clouds[:1]).automatic


def test_what_cannot_be_merged_is_refused(rng):
    cloud = filter_scan_with_record(scan_of(wall(rng))).cloud
    with pytest.raises(ParameterError, match=r"slack = -1 m; .* is 0 or more"):
        merge_scans([cloud], slack=-1.0)
    with pytest.raises(ParameterError, match="cloud 0: a point stands for 0 measurements"):
        merge_scans([dataclasses.replace(cloud, n_merged=np.zeros(len(cloud)))])
    with pytest.raises(ParameterError, match=r"to merge were given 3 points, .* at least 8 must be left"):
        merge_scans([cloud.take(np.arange(3))])


def test_points_thinned_away_are_laid_to_the_spacing_asked_for(rng):
    settings = FilterSettings(thinning=ThinningSettings(target_spacing=10.0))
    cloud = filter_scan_with_record(scan_of(wall(rng)), settings).cloud
    said = r"target_spacing = 10 m thins \d{4} measurements to 1; at least 8 points must be left: set a smaller one"
    with pytest.raises(ParameterError, match=said):
        merge_scans([cloud], settings)
    fine = filter_scan_with_record(scan_of(wall(rng))).cloud  # enough of them, and none left by the second pass
    with pytest.raises(ParameterError, match=said):
        merge_scans([fine], settings)


def test_the_noise_of_one_scan_alone_is_not_known(rng):
    averaged = average_scans([scan_of(wall(rng))])
    assert len(averaged.scan.cloud) == 3000
    assert np.isnan(averaged.scan.cloud.sigma).all()
    assert np.isnan(averaged.automatic["noise_of_one_scan"])


def test_a_repeat_that_is_a_copy_is_refused(rng):
    """The noise of two scans that agree to the bit would be none."""
    scan = scan_of(wall(rng))
    with pytest.raises(ParameterError, match="scan 'second' is a copy of 'odd'; give each scan once"):
        average_scans([scan, dataclasses.replace(scan, name="second")])


def test_averaged_intensity_is_that_of_the_scans_that_know_it(rng):
    points = wall(rng)
    unknown = np.where(np.arange(3000) < 1000, np.nan, 0.2)
    scans = [scan_of(points, intensity=unknown), scan_of(points * (1 + 1e-5), intensity=np.full(3000, 0.6))]
    cloud = average_scans([*scans, scan_of(points * (1 - 1e-5))]).scan.cloud
    assert np.isclose(np.sort(cloud.intensity), np.r_[np.full(2000, 0.4), np.full(1000, 0.6)], atol=1e-6).all()


def test_vertices_blend_what_is_known_of_the_samples_around():
    values, index = np.array([1.0, np.nan, 3.0]), np.array([[0, 1], [0, 2], [1, 1]])
    blended = blend(values, index, np.full((3, 2), 0.5))
    assert blended[:2].tolist() == [1.0, 2.0]
    assert np.isnan(blended[2])


def test_a_scan_of_unknown_place_looks_the_way_that_the_others_do(rng):
    """A flat wall does not tell its outside: merged with the wrong one, half of the normals would look away."""
    known = filter_scan_with_record(scan_of(wall(rng))).cloud
    nowhere = np.full(3, np.nan)
    for sign in (1.0, -1.0):
        unknown = dataclasses.replace(known, points=known.points + 1e-4, normals=sign * known.normals, origins=nowhere)
        assert (merge_scans([known, unknown]).cloud.normals[:, 2] < 0.0).all()


def test_normals_that_are_unknown_are_turned_to_the_scanners(rng):
    for z in (-1.0, 5.0):
        cloud = PointCloud(wall(rng), normals=np.full((3000, 3), np.nan), origins=np.array([0.0, 0.0, z]))
        assert ((z - 2.0) * merge_scans([cloud]).cloud.normals[:, 2] > 0.0).all()


def test_a_cloud_merged_with_itself_counts_once(rng):
    cloud = filter_scan_with_record(scan_of(wall(rng))).cloud
    once, twice = merge_scans([cloud]), merge_scans([cloud, cloud])
    assert np.array_equal(once.cloud.sigma, twice.cloud.sigma)
    assert twice.counts["copy"] == len(cloud)


def test_rows_and_columns_that_are_all_the_same_are_no_grid(rng):
    """By row and column all points would be one cell, and one point left."""
    points, zeros = wall(rng), np.zeros(3000)
    scans = [dataclasses.replace(scan_of(p), rows=zeros, columns=zeros) for p in (points, points * (1 + 1e-5))]
    averaged = average_scans(scans)
    assert averaged.automatic["by"] == "nearest direction"
    assert averaged.counts["out"] == 3000


def test_a_repeat_without_points_changes_nothing(rng):
    places = np.arange(3000)
    scan = dataclasses.replace(scan_of(wall(rng)), rows=places // 60, columns=places % 60)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = average_scans([scan.take(places[:0]), scan])
    assert np.allclose(np.sort(both.scan.cloud.points, axis=0), np.sort(scan.cloud.points, axis=0), atol=1e-12)


def test_a_scan_of_kilometres_is_not_searched_for_waves_without_end(rng):
    """Beyond the reach of phase-shift scanners nothing is looked for: 100 km would be five million wavelengths."""
    assert calibrate_range(scan_of(1e6 * wall(rng))).reason.startswith("0 plane patches")


def test_voxels_without_a_size_are_refused():
    with pytest.raises(ParameterError, match="half of the 100 points have no spacing"):
        voxel_median(PointCloud(np.zeros((100, 3))))


def test_a_point_where_another_scanner_stood_says_nothing_of_it(rng):
    here = PointCloud(np.r_[wall(rng), np.zeros((1, 3))], origins=np.zeros(3))
    there = PointCloud(wall(rng), origins=np.ones(3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not any(mask.any() for mask in find_seen_through([here, there]))


def test_a_repeat_with_a_point_where_the_scanner_stood_is_averaged_without_it(rng):
    """A text file may hold one: it has no direction, and is no reason to refuse the others."""
    points = wall(rng)
    scans = [scan_of(p) for p in (np.r_[points, np.zeros((1, 3))], points * (1 + 1e-5))]
    averaged = average_scans(scans)
    assert averaged.counts["at_scanner"] == 1
    assert averaged.counts["in"] == sum(n for reason, n in averaged.counts.items() if reason != "in") == 6001
    assert np.isfinite(averaged.scan.cloud.points).all()
