"""Points that another station looked through: specular errors go, arms, wires and what nobody else saw stay."""

import numpy as np

from monitor.filtering.seen_through import find_seen_through
from projects.model import PointCloud

LEFT, RIGHT = np.array([-2.0, 0.0, 4.0]), np.array([2.0, 0.0, 4.0])
SIGMA = 0.5e-3


def wall(rng, origin, n=20_000, more=None):
    """Return a wall z = 0, 1 m wide, 7 mm spacing, seen from `origin`, with `more` points (m, 3) at its end."""
    points = np.c_[rng.uniform(-0.5, 0.5, (n, 2)), rng.normal(0, SIGMA, n)]
    points = points if more is None else np.concatenate([points, more])
    return PointCloud(points, origins=origin, spread=np.full(len(points), SIGMA))


def blob(rng, centre, size, n):
    """Return n points in a cube of `size` [m]."""
    return np.asarray(centre) + rng.uniform(-0.5, 0.5, (n, 3)) * size


def test_a_specular_error_before_the_wall_is_removed_and_the_wall_stays(rng):
    """Nothegger and Dorninger, fig. 8 b: 60 points of one scan float 0.3 m before the wall that the other scan saw."""
    ghost = blob(rng, [0.0, 0.1, 0.3], 0.04, 60)
    first, second = find_seen_through([wall(rng, LEFT, more=ghost), wall(rng, RIGHT)])
    assert first[-60:].mean() > 0.95
    assert first[:-60].sum() == 0
    assert second.sum() == 0


def test_a_real_body_stays_where_both_stations_saw_it(rng):
    """A plate 0.3 m before the wall shadows it for both."""
    n = 3000
    plate = np.c_[rng.uniform(-0.1, 0.1, (n, 2)), 0.3 + rng.normal(0, SIGMA, n)]
    clouds = []
    for origin in (LEFT, RIGHT):
        full = wall(rng, origin).points
        on_plate = origin + (full - origin) * ((0.3 - origin[2]) / (full[:, 2] - origin[2]))[:, None]
        clear = (np.abs(on_plate[:, :2]) > 0.1).any(axis=1)
        points = np.concatenate([full[clear], plate])
        clouds.append(PointCloud(points, origins=origin, spread=np.full(len(points), SIGMA)))
    masks = find_seen_through(clouds)
    assert max(mask[-n:].mean() for mask in masks) < 0.01
    assert sum(mask[:-n].sum() for mask in masks) == 0


def test_the_silhouette_of_a_body_whose_rim_the_other_scan_dropped_stays(rng):
    """Of a plate 0.3 m before the wall the second scan has no rim, 8 mm: beams pass beside it, and none within."""
    n = 6000
    plate = np.c_[rng.uniform(-0.1, 0.1, (n, 2)), 0.3 + rng.normal(0, SIGMA, n)]
    whole = wall(rng, LEFT, more=plate)
    full = wall(rng, RIGHT).points
    on_plate = RIGHT + (full - RIGHT) * ((0.3 - RIGHT[2]) / (full[:, 2] - RIGHT[2]))[:, None]
    clear = (np.abs(on_plate[:, :2]) > 0.1).any(axis=1)
    inner = (np.abs(plate[:, :2]) < 0.092).all(axis=1)
    points = np.concatenate([full[clear], plate[inner]])
    cut = PointCloud(points, origins=RIGHT, spread=np.full(len(points), SIGMA))
    first, second = find_seen_through([whole, cut])
    assert first.sum() == 0
    assert second.sum() == 0


def test_what_a_third_scan_measured_too_stays(rng):
    """A thin blade that the second scan lacks altogether, its beams on all sides; a third has half of it."""
    blade = np.c_[np.zeros(400), rng.uniform(-0.05, 0.05, 400), rng.uniform(0.2, 0.3, 400)]
    first, *_ = find_seen_through([wall(rng, LEFT, more=blade), wall(rng, RIGHT)])
    assert first[-400:].mean() > 0.9
    third = wall(rng, LEFT, more=blade[:200] + rng.normal(0, SIGMA, (200, 3)))
    first, *_ = find_seen_through([wall(rng, LEFT, more=blade), wall(rng, RIGHT), third])
    assert first[-400:].sum() == 0


def test_a_wire_between_the_beams_stays(rng):
    """A wire seen by one scan, too thin for the spacing of the other, whose wall shows through beside it."""
    wire = np.c_[np.linspace(-0.1, 0.1, 60), np.full(60, 0.1), np.full(60, 0.01)]
    first, _ = find_seen_through([wall(rng, LEFT, more=wire), wall(rng, RIGHT)])
    assert first[-60:].sum() == 0


def test_what_lies_beyond_the_other_scan_stays(rng):
    """Nobody looked there: a niche behind the wall is no contradiction, nor what stands beside it."""
    hidden = np.concatenate([blob(rng, [0.0, 0.0, -0.2], 0.05, 40), blob(rng, [0.9, 0.0, 0.2], 0.05, 40)])
    first, _ = find_seen_through([wall(rng, LEFT, more=hidden), wall(rng, RIGHT)])
    assert first[-80:].sum() == 0


def test_clouds_that_lie_off_each_other_by_less_than_the_slack_stay_whole(rng):
    off = wall(rng, RIGHT)
    off = PointCloud(off.points - [0.0, 0.0, 5e-3], origins=RIGHT, spread=off.spread)
    assert sum(mask.sum() for mask in find_seen_through([wall(rng, LEFT), off], slack=5e-3)) == 0


def test_where_it_is_not_known_how_far_clouds_lie_off_nothing_is_said(rng):
    ghost = blob(rng, [0.0, 0.1, 0.3], 0.04, 60)
    first, _ = find_seen_through([wall(rng, LEFT, more=ghost), wall(rng, RIGHT)], slack=np.nan)
    assert first.sum() == 0


def test_without_known_stations_nothing_is_said(rng):
    ghost = blob(rng, [0.0, 0.1, 0.3], 0.04, 60)
    unknown = wall(rng, np.full(3, np.nan))
    first, _ = find_seen_through([wall(rng, LEFT, more=ghost), unknown])
    assert first.sum() == 0
