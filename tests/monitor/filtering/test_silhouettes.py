"""Grazing points, mixed pixels and rims, by hand-made geometry."""

import math

import numpy as np
import pytest

from monitor.filtering import FilterSettings, filter_scan_with_record
from monitor.filtering.silhouettes import SilhouetteSettings, find_grazing, find_mixed, find_rims
from projects.model import PointCloud, Scan


def test_grazing_is_beyond_the_largest_incidence():
    normals = np.array([[math.sin(a), 0, math.cos(a)] for a in np.deg2rad([0, 60, 79, 81, 99, 101])])
    beams = np.tile([0, 0, 5.0], (6, 1))
    grazing = find_grazing(-beams, np.zeros(3), normals, math.radians(80))
    assert np.flatnonzero(grazing).tolist() == [3, 4]


def grid_scan(n=40, step=0.001):
    """Return directions, rows and columns of a grid that looks along z."""
    rows, columns = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    directions = np.c_[np.tan((columns - n / 2) * step), np.tan((rows - n / 2) * step), np.ones(n * n)]
    return directions / np.linalg.norm(directions, axis=1)[:, None], rows, columns


def test_points_between_the_two_sides_of_a_jump_are_mixed_and_no_others(rng):
    """Left half at 3 m, right half at 4 m, one column between at ranges in between."""
    directions, rows, columns = grid_scan()
    between = columns == 20
    ranges = np.where(columns < 20, 3.0, 4.0)
    ranges[between] = rng.uniform(3.1, 3.9, between.sum())
    ranges += rng.normal(0, 0.001, len(ranges))
    shuffle = rng.permutation(len(ranges))
    mixed = find_mixed(
        (directions * ranges[:, None])[shuffle],
        np.zeros(3),
        rows[shuffle],
        columns[shuffle],
        np.full(1600, 0.001),
        math.radians(80),
    )
    assert np.array_equal(mixed, between[shuffle])


def test_a_wall_seen_at_75_degrees_has_no_mixed_pixels(rng):
    directions, rows, columns = grid_scan()
    slope = math.tan(math.radians(75))
    ranges = 3.0 / (directions[:, 2] - slope * directions[:, 0]) + rng.normal(0, 0.001, 1600)
    mixed = find_mixed(directions * ranges[:, None], np.zeros(3), rows, columns, np.full(1600, 0.001), math.radians(80))
    assert not mixed.any()


def test_neighbours_in_the_grid_must_be_adjacent():
    """With the pixels beside it missing nothing is known of the two sides."""
    directions, rows, columns = grid_scan()
    ranges = np.where(columns < 20, 3.0, 4.0)
    ranges[columns == 20] = 3.5
    keep = (columns != 19) & (columns != 21)
    mixed = find_mixed(
        (directions * ranges[:, None])[keep], np.zeros(3), rows[keep], columns[keep], np.full(keep.sum(), 1e-3), 1.4
    )
    assert not mixed.any()


def test_points_without_a_place_in_the_grid_are_never_mixed():
    directions, rows, columns = grid_scan()
    ranges = np.where(columns < 20, 3.0, 4.0)
    ranges[columns == 20] = 3.5
    nowhere = np.full_like(rows, -1)
    assert not find_mixed(directions * ranges[:, None], np.zeros(3), nowhere, nowhere, np.full(1600, 1e-3), 1.4).any()


def rims_of(beams, noise, **how):
    """Return the rims (n,) of a scan from the origin with this noise [m] everywhere."""
    return find_rims(beams, np.zeros(3), np.full(len(beams), noise), math.radians(80), **how)


def test_rims_are_the_pixels_beside_a_jump_and_at_a_border_and_no_others(rng):
    directions, rows, columns = grid_scan()
    ranges = np.where(columns < 20, 3.0, 4.0) + rng.normal(0, 0.001, 1600)
    shuffle = rng.permutation(1600)
    rims = np.empty(1600, dtype=bool)
    rims[shuffle] = rims_of((directions * ranges[:, None])[shuffle], 0.001, border=True)
    border = (np.minimum(rows, columns) == 0) | (np.maximum(rows, columns) == 39)
    expected = border | (columns == 19) | (columns == 20)
    cornered = (np.minimum(rows, 39 - rows) < 3) & (np.min([columns, 39 - columns, abs(columns - 19.5)], axis=0) < 3)
    assert np.array_equal(rims[~cornered], expected[~cornered])
    assert not rims[~expected].any()
    beside = rims_of(directions * ranges[:, None], 0.001)
    inside = (rows > 0) & (rows < 39)  # at the border the eight nearest reach one column farther
    assert np.array_equal(beside[inside], ((columns == 19) | (columns == 20))[inside])


def test_a_stray_point_makes_no_rims_of_its_neighbours_where_it_is_known_for_one(rng):
    directions, _, _ = grid_scan()
    stray = np.arange(1600) == 20 * 40 + 20
    beams = directions * np.where(stray, 2.5, 3.0 + rng.normal(0, 0.001, 1600))[:, None]
    assert rims_of(beams, 0.001).sum() == 8
    assert not rims_of(beams, 0.001, known=~stray).any()


def test_a_thin_thing_that_is_all_rim_stays(rng):
    """An arm two pixels wide before a chest, and an ornament of fourteen points: nothing within them to hold on to."""
    directions, rows, columns = grid_scan()
    inside = (np.abs(rows - 10) < 2) & (np.abs(columns - 20) < 2)
    for thing in ((columns == 20) | (columns == 21), inside, inside | ((rows == 12) & (np.abs(columns - 20) < 2))):
        ranges = np.where(thing, 2.9, 3.0) + rng.normal(0, 0.0003, 1600)
        rims = rims_of(directions * ranges[:, None], 0.0003, border=True)
        assert not rims[thing].any()
        assert rims.sum() > 4 * 30  # those of the field


def test_points_in_no_order_have_few_rims(rng):
    """Directions at random: of sixteen neighbours one in six hundred leaves such a gap."""
    beams = np.c_[rng.uniform(-0.3, 0.3, (8000, 2)), np.full(8000, 3.0)]
    assert not rims_of(beams, 0.001).any()
    rims = rims_of(beams, 0.001, border=True)
    assert rims[(np.abs(beams[:, :2]) < 0.28).all(axis=1)].mean() < 0.004


@pytest.mark.parametrize("max_incidence", [math.radians(80), 1.2, 0.9])
def test_a_steep_face_goes_for_its_incidence_and_what_lies_between_two_surfaces_as_mixed(rng, max_incidence):
    """At 72 degrees, with at most 69 asked for, all of it was counted among the mixed pixels."""
    directions, rows, columns = grid_scan()
    aside = np.array([math.sin(math.radians(72)), 0.0, math.cos(math.radians(72))])
    ranges = 3.0 * aside[2] / (directions @ aside) + rng.normal(0, 3e-4, 1600)
    behind = columns >= 30
    ranges[behind] = 6.0 + rng.normal(0, 3e-4, behind.sum())
    between = columns == 30
    ranges[between] = rng.uniform(4.0, 5.0, between.sum())
    scan = Scan("steep", PointCloud(directions * ranges[:, None]), np.eye(4), rows=rows, columns=columns)
    settings = FilterSettings(silhouettes=SilhouetteSettings(max_incidence=max_incidence))
    counts = filter_scan_with_record(scan, settings).counts
    assert counts["mixed_pixel"] + counts["outlier"] <= 1.5 * between.sum()
    if max_incidence < math.radians(72):
        assert counts["grazing"] > 0.9 * 40 * 28
    assert sum(n for reason, n in counts.items() if reason != "in") == 1600
