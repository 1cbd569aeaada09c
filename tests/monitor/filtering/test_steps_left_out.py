"""A step that could not be done is said to be left out: no count of 0 stands for what nobody looked for."""

import dataclasses

import numpy as np
import pytest

from monitor.filtering import filter_scan_with_record, merge_scans
from projects.model import PointCloud, Scan

NOWHERE = np.full(3, np.nan)


def wall_scan(rng, **known):
    """Return a scan of a wall 2 m before the scanner with 0.5 mm of noise."""
    points = np.c_[rng.uniform(-0.1, 0.1, (3000, 2)), 2.0 + rng.normal(0, 5e-4, 3000)]
    return Scan("wall", PointCloud(points), np.eye(4), **known)


def test_without_a_known_place_silhouettes_are_said_to_be_left_out(rng):
    told = filter_scan_with_record(wall_scan(rng, origin=NOWHERE))
    assert told.automatic["silhouettes_left_out"] == "it is not known where the scanner stood"
    assert not {"mixed_pixel", "rim", "grazing"} & set(told.counts)
    assert "silhouettes_left_out" not in filter_scan_with_record(wall_scan(rng)).automatic


@pytest.mark.parametrize(
    ("origins", "slack", "reason"),
    [
        (None, 0.0, None),
        (NOWHERE, 0.0, "of 1 of 2 scans it is not known where the scanner stood"),
        (None, np.nan, "it is not known how far the scans lie off each other"),
    ],
)
def test_a_merge_says_why_it_did_not_look_for_what_was_seen_through(rng, origins, slack, reason):
    clouds = [filter_scan_with_record(wall_scan(rng)).cloud for _ in range(2)]
    if origins is not None:
        clouds[1] = dataclasses.replace(clouds[1], origins=origins)
    assert merge_scans(clouds, slack=slack).automatic.get("seen_through_left_out") == reason
    assert "seen_through_left_out" not in merge_scans(clouds[:1], slack=slack).automatic
