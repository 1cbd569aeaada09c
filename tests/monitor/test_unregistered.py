"""Files that put all scans at one place are not believed where the scans contradict it."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from monitor.scans import open_scans
from monitor.unit_check import UnitCheck
from monitor.unregistered import UNEVEN, are_of_two_places, forget_common_place, unevenness
from projects.formats import ScanStream, write_ptx
from projects.model import PointCloud, Scan
from projects.transforms import apply

ROOM = np.array([4.0, 3.2, 2.6])  # m
HERE, THERE = np.array([1.3, 1.4, 1.5]), np.array([2.9, 2.1, 1.2])


def scan_room(place: np.ndarray, heading: float, *, flat: bool = False, reach: float = np.pi) -> Scan:
    """Return a grid scan of the bare room with 0.5 mm of noise, in its own frame or (`flat`) in the room's."""
    columns, rows = np.meshgrid(np.arange(int(2 * reach / 0.02)), np.arange(110), indexing="ij")
    azimuth, elevation = columns.ravel() * 0.02 - reach, rows.ravel() * 0.02 - 0.9
    ways = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]], place
    turned = ways @ pose[:3, :3].T
    ranges = np.where(turned > 0.0, ROOM - place, -place) / np.where(turned == 0.0, 1e-12, turned)
    points = ways * (ranges.min(axis=1) + np.random.default_rng(1).normal(scale=5e-4, size=len(ways)))[:, None]
    cloud = PointCloud(apply(pose, points) if flat else points)
    return Scan("s", cloud, np.eye(4), rows=rows.ravel(), columns=columns.ravel())


def stream(scan: Scan, pose: np.ndarray | None = None) -> ScanStream:
    def chunks() -> Iterator[Scan]:
        yield scan

    own = np.eye(4) if pose is None else pose
    return ScanStream("s", 0, Path("s.ptx"), own, np.zeros(3), True, None, None, True, "", "ptx", chunks)


def test_scans_of_two_places_at_one_pose_have_none() -> None:
    forgotten = forget_common_place([stream(scan_room(HERE, 0.3)), stream(scan_room(THERE, 2.0))])
    assert [s.pose for s in forgotten] == [None, None]
    assert all(s.is_origin_stated and not s.origin.any() for s in forgotten)


def test_a_window_beside_the_panorama_of_its_place_keeps_the_pose() -> None:
    streams = [stream(scan_room(HERE, 0.3)), stream(scan_room(HERE, 0.3, reach=0.4))]
    assert [s.pose is not None for s in forget_common_place(streams)] == [True, True]


def test_scans_that_were_brought_into_one_frame_before_keep_their_poses() -> None:
    """From 0 0 0, in a corner of the room, steps of their grids go with the ranges."""
    scans = [scan_room(HERE, 0.3, flat=True), scan_room(THERE, 2.0, flat=True)]
    assert min(unevenness(scan) for scan in scans) > 2.0 * UNEVEN
    assert [s.pose is not None for s in forget_common_place([stream(s) for s in scans])] == [True, True]


def test_one_identity_among_other_poses_is_the_scan_that_gives_the_frame() -> None:
    pose = np.eye(4)
    pose[0, 3] = 1.0
    streams = [stream(scan_room(HERE, 0.3)), stream(scan_room(THERE, 2.0), pose)]
    assert [s.pose is not None for s in forget_common_place(streams)] == [True, True]


def test_steps_of_a_grid_are_even_from_where_it_was_measured() -> None:
    assert unevenness(scan_room(HERE, 0.3)) == pytest.approx(0.0, abs=1e-3)


def test_windows_in_other_directions_contradict_nothing() -> None:
    behind = scan_room(HERE, 0.3, reach=0.4).cloud.points * [-1.0, -1.0, 1.0]
    assert not are_of_two_places(scan_room(THERE, 2.0, reach=0.4).cloud.points, behind)


@pytest.mark.parametrize(("flat", "is_known"), [(False, True), (True, False)])
def test_the_untouched_station_of_a_ptx_is_believed_where_the_grid_is_even_from_there(
    tmp_path: Path, flat: bool, is_known: bool
) -> None:
    """A scan of a room in its own frame, and the same in the room's, which a program wrote without its station."""
    scan = scan_room(HERE, 0.3, flat=flat)
    unknown = np.full(3, np.nan)
    write_ptx(tmp_path / "a.ptx", [dataclasses.replace(scan, origin=unknown)])
    (opened,) = open_scans([tmp_path / "a.ptx"], {}, UnitCheck())
    assert np.isfinite(opened.origin).all() == opened.is_origin_stated == is_known
    write_ptx(tmp_path / "b.ptx", [dataclasses.replace(scan, origin=np.array([0.0, 0.0, 0.5]))])
    (stated,) = open_scans([tmp_path / "b.ptx"], {}, UnitCheck())
    np.testing.assert_array_equal(stated.origin, [0.0, 0.0, 0.5])
