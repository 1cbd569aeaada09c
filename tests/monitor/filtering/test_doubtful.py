"""What one scan drops for strays: kept where another station bears it out, a pit of few points, and only there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.filtering import filter_scan_with_record, merge_scans
from monitor.filtering.doubtful import find_borne_out
from projects.errors import ParameterError
from projects.model import Floats, PointCloud, Scan

SPACING, NOISE, SLACK = 2.7e-3, 2e-4, 3e-4  # m
PLACES = (np.array([-1.5, 0.0, 2.0]), np.array([1.5, 0.2, 2.0]))
RADIUS, DEEP = 4.3e-3, 3e-3  # m, of the pit
WIDE, STEEP = 6.5e-3, 9e-3  # m, of one that no plane fits


def bowl(points: Floats, high: float, radius: float = RADIUS) -> Floats:
    """Return the heights of a pit (`high` is negative) or a knob amid a plane."""
    return high * np.clip(1.0 - (points[:, :2] ** 2).sum(axis=1) / radius**2, 0.0, None)


def measure(rng: np.random.Generator, high: float = -DEEP, radius: float = RADIUS) -> Floats:
    """Return a plane with a pit in it, as one station measures it."""
    x = np.arange(-0.06, 0.06, SPACING)
    points = np.column_stack([np.repeat(x, len(x)), np.tile(x, len(x)), np.zeros(len(x) ** 2)])
    points[:, :2] += rng.uniform(-0.3, 0.3, 2) * SPACING + rng.normal(0, 0.1 * SPACING, (len(points), 2))
    points[:, 2] = bowl(points, high, radius) + rng.normal(0, NOISE, len(points))
    return points


def filtered(points: Floats, place: Floats) -> tuple[PointCloud, PointCloud]:
    """Return what a scan keeps and what it doubts."""
    found = filter_scan_with_record(Scan("s", PointCloud(points), np.eye(4), origin=place))
    assert found.doubtful is not None
    return found.cloud, found.doubtful


def judge(seen: list[Floats], places: tuple[Floats, ...] = PLACES, slack: float = SLACK) -> tuple[Floats, Floats]:
    """Return the doubtful points of all scans that are borne out, and those that are not."""
    pairs = [filtered(points, place) for points, place in zip(seen, places, strict=True)]
    clouds, doubtful = [p[0] for p in pairs], [p[1] for p in pairs]
    masks = find_borne_out(clouds, doubtful, slack)
    return tuple(np.concatenate([d.points[m == kept] for d, m in zip(doubtful, masks, strict=True)])
                 for kept in (True, False))  # type: ignore[return-value]  # fmt: skip


@pytest.mark.parametrize(("high", "radius"), [(-DEEP, RADIUS), (-STEEP, WIDE)])
def test_a_pit_of_few_points_that_two_stations_see_stays(rng, high, radius):
    """Flat at its bottom, or a bowl that no plane fits: what a scan does not keep by itself the other bears out."""
    seen = [measure(rng, high, radius) for _ in PLACES]
    kept, lost = judge(seen)
    in_pit = [p[bowl(p, high, radius) < -5.0 * NOISE] for p in seen]
    own = [filtered(points, place)[0].points for points, place in zip(seen, PLACES, strict=True)]
    stay = [cKDTree(np.r_[cloud, kept]).query(p)[0] < NOISE for cloud, p in zip(own, in_pit, strict=True)]
    assert len(kept) >= 4
    assert np.concatenate(stay).mean() > 0.75  # some are thinned into one
    assert (np.abs(kept[:, 2] - bowl(kept, high, radius)) < 5.0 * NOISE).all()
    assert len(lost) <= 2


@pytest.mark.parametrize("aside", [0.0, 0.05])  # m, from one station to the other: 1.4 degrees
def test_stations_at_one_place_bear_nothing_out(rng, aside):
    assert not len(judge([measure(rng) for _ in PLACES], (PLACES[0], PLACES[0] + [0.0, aside, 0.0]))[0])


def test_strays_of_one_scan_go_though_they_lie_in_a_bowl(rng):
    kept, lost = judge([measure(rng, -STEEP, WIDE), measure(rng, high=0.0)])
    assert not len(kept)
    assert len(lost) >= 6


def test_fewer_than_a_surface_has_go(rng):
    kept, lost = judge([measure(rng, radius=2.4e-3) for _ in PLACES])
    assert not len(kept)
    assert len(lost) >= 2


def test_strays_of_two_scans_that_lie_on_no_surface_go(rng):
    seen = [measure(rng, high=0.0) for _ in PLACES]
    for points in seen:
        near = np.flatnonzero((points[:, :2] ** 2).sum(axis=1) < WIDE**2)
        points[near, 2] -= rng.uniform(2e-3, 14e-3, len(near))
    kept, lost = judge(seen)
    assert len(kept) <= 2
    assert len(lost) >= 16


def test_what_hangs_before_a_surface_goes(rng):
    assert not len(judge([measure(rng, high=DEEP) for _ in PLACES])[0])


@pytest.mark.parametrize("goes_on", [True, False])
def test_what_lies_behind_a_plane_beyond_its_edge_goes(rng, goes_on):
    """As much of it as of a pit, and on the same side: but nothing is around it."""
    seen = []
    for _ in PLACES:
        points = measure(rng, high=0.0)
        is_sunk = (np.abs(points[:, :2]) < 0.003).all(axis=1)
        points[is_sunk, 2] -= DEEP
        seen.append(points[is_sunk | goes_on | (points[:, 0] < -0.003)])
    kept, _ = judge(seen)
    assert len(kept) >= 3 if goes_on else not len(kept)


def test_nothing_is_borne_out_where_scans_may_lie_anywhere_or_a_scanner_stood_anywhere(rng):
    seen = [measure(rng) for _ in PLACES]
    assert not len(judge(seen, slack=np.nan)[0])
    assert not len(judge(seen, (PLACES[0], np.full(3, np.nan)))[0])


@pytest.mark.parametrize("sides", [(1.0, 1.0), (1.0, -1.0)])
def test_stations_behind_a_plate_bear_nothing_out_of_its_front(rng, sides):
    """The back of a plate lies behind its front, as a pit does, and another station sees it."""
    front, back = measure(rng), measure(rng, high=0.0)
    if sides[1] > 0.0:
        back = measure(rng)
    else:
        back[:, 2] -= DEEP
    places = (PLACES[0], PLACES[1] * [1.0, 1.0, sides[1]])
    kept = judge([front, back], places)[0]
    assert (len(kept) > 0) == (sides[1] > 0.0)


def test_where_nothing_could_be_borne_out_the_merge_says_why(rng):
    pairs = [filtered(measure(rng), place) for place in PLACES]
    clouds, doubtful = [p[0] for p in pairs], [p[1] for p in pairs]
    unknown = merge_scans(clouds, slack=np.nan, doubtful=doubtful)
    assert unknown.counts["borne_out"] == 0
    assert unknown.automatic["borne_out_left_out"] == "it is not known how far the scans lie off each other"
    assert "borne_out_left_out" not in merge_scans(clouds, slack=SLACK, doubtful=doubtful).automatic
    with pytest.raises(ParameterError, match="1 clouds of doubtful points were given with 2 clouds"):
        merge_scans(clouds, doubtful=doubtful[:1])


def test_the_merged_cloud_holds_the_pit_and_counts_it(rng):
    pairs = [filtered(measure(rng), place) for place in PLACES]
    clouds, doubtful = [p[0] for p in pairs], [p[1] for p in pairs]
    without, result = merge_scans(clouds, slack=SLACK), merge_scans(clouds, slack=SLACK, doubtful=doubtful)
    assert "borne_out" not in without.counts
    assert result.counts["borne_out"] == sum(m.sum() for m in find_borne_out(clouds, doubtful, SLACK))
    assert result.counts["in"] == sum(map(len, clouds)) + result.counts["borne_out"]

    def deepest(cloud: PointCloud) -> float:
        return float(cloud.points[(cloud.points[:, :2] ** 2).sum(axis=1) < RADIUS**2, 2].min())

    assert deepest(without.cloud) > -0.5 * DEEP
    assert deepest(result.cloud) == pytest.approx(-DEEP, abs=0.25 * DEEP)
    again = merge_scans([dataclasses.replace(c) for c in clouds], slack=SLACK, doubtful=doubtful)
    assert np.array_equal(again.cloud.points, result.cloud.points)
