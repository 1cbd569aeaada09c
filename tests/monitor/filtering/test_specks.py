"""Specks: what is far from all others for how densely the scanner looked there, and what is not."""

import numpy as np
import pytest

from monitor.filtering import filter_scan_with_record
from monitor.filtering.specks import find_isolated
from projects.model import PointCloud, Scan

SCANNER = np.array([0.0, 0.0, 3.0])


def kept(points, where):
    """Return the share of the measurements `where` (a function of points) that a filtered scan still stands for."""
    cloud = filter_scan_with_record(Scan("s", PointCloud(points), np.eye(4), origin=SCANNER)).cloud
    return cloud.n_merged[where(cloud.points)].sum() / where(points).sum()


def wall(rng, n, half):
    """Return points of a wall with 0.3 mm noise."""
    return np.column_stack([rng.uniform(-half, half, (n, 2)), rng.normal(0, 0.0003, n)])


def window_and_overview(rng):
    """Return a window of 0.5 mm steps within an overview of 5 mm, as many points each, from one station."""
    return np.concatenate([wall(rng, 20_000, 0.035), wall(rng, 20_000, 0.35)])


def outside(points):
    """Return which points lie well outside of the window, and not in the air."""
    return (np.abs(points[:, :2]) > 0.05).any(axis=1) & (np.abs(points[:, 2]) < 0.01)


def test_specks_are_judged_by_the_spacing_at_their_range():
    """Spacing grows with range: 6 mm at 6 m is the scan's own, at 1 m it is a speck."""
    ranges = np.r_[np.linspace(1, 6, 50), 1.0]
    reach = 0.001 * ranges
    reach[-1] = 0.006
    assert np.flatnonzero(find_isolated(reach, ranges, 4.0)).tolist() == [50]


def test_an_overview_around_a_finer_window_is_no_speck(rng):
    """One median of the whole scan dropped 99 of 100 points of the overview."""
    assert kept(window_and_overview(rng), outside) > 0.99


@pytest.mark.parametrize("n_beside", [1, 3, 5])
def test_strays_and_small_clumps_before_an_overview_go(rng, n_beside):
    """Before the wall, and on each side of it where there is nothing behind."""
    beams = np.column_stack([rng.uniform(-0.3, 0.3, (40, 2)), np.full(40, -3.0)])
    beams[:4, :2] = 0.45 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    centres = SCANNER + beams * np.r_[np.ones(4), rng.uniform(0.3, 0.9, 36)][:, None]
    clumps = np.repeat(centres, n_beside, axis=0) + rng.normal(0, 0.0005, (40 * n_beside, 3))
    points = np.concatenate([window_and_overview(rng), clumps])

    def in_air(points):
        return (np.abs(points[:, 2]) > 0.01) | (np.abs(points[:, :2]) > 0.4).any(axis=1)

    assert kept(points, in_air) < 0.05
    assert kept(points, outside) > 0.99
