"""What is questioned when scans are added: files that are copies, poses in another unit than the points."""

import shutil

import numpy as np
import pytest

from monitor.scans import open_scans
from monitor.unit_check import UnitCheck, question_place, with_questioned_unit
from projects.errors import ParameterError, UnitError
from projects.formats import read_poses


def written(folder, rng, places):
    """Write a scan of a sheet 0.3 m wide for each place [m], and the poses; return files and poses file."""
    files, lines = [], []
    for k, place in enumerate(places):
        files.append(folder / f"scan{k}.xyz")
        np.savetxt(files[-1], np.c_[rng.uniform(0, 0.3, (50, 2)), np.ones(50)], fmt="%.6f")
        lines.append(f"scan{k}.xyz 1 0 0 {place} 0 1 0 0 0 0 1 0 0 0 0 1")
    poses = folder / "scans.poses"
    poses.write_text("\n".join(lines) + "\n")
    return files, poses


def read_all(files, poses, unit):
    """Read the scans to their ends; return how many points there are."""
    streams = with_questioned_unit(open_scans(files, read_poses(poses), unit), unit)
    return sum(len(scan.cloud) for stream in streams for scan in stream.chunks())


def test_poses_in_millimetres_beside_points_in_metres_are_questioned(tmp_path, rng):
    """Stations 2 m apart read as 2 km: 1699.7 m between the boxes of scans 0.3 m wide."""
    files, poses = written(tmp_path, rng, [0, 1700])
    message = r"scan1\.xyz lies 1\.7e\+03 m from the scans before it, .* wider than 0\.\d+ m: its pose"
    with pytest.raises(UnitError, match=message):
        read_all(files, poses, UnitCheck())
    assert read_all(files, poses, UnitCheck(was_stated=True)) == 100


def test_windows_on_one_facade_are_not_questioned(tmp_path, rng):
    files, poses = written(tmp_path, rng, [0, 20, 40])
    assert read_all(files, poses, UnitCheck()) == 150


def test_the_nearest_scan_before_decides(rng):
    """Widths of 1 m and gaps of 199, 201: from the wrong end, or by the farthest, each would be questioned."""
    at = [np.array([[x, 0, 0], [x + 1, 0.5, 0.5]]) for x in (0.0, 200.0, 402.0, 601.0)]
    question_place(at[:2], "near")
    with pytest.raises(UnitError, match="far lies 201 m"):
        question_place(at[:3], "far")
    question_place([at[0], at[3], at[2]], "between")


def test_two_files_with_the_same_content_are_refused(tmp_path, rng):
    files, poses = written(tmp_path, rng, [0, 1])
    shutil.copy(files[0], files[1])
    with pytest.raises(ParameterError, match=r"scan1\.xyz: the same content as .*scan0\.xyz; give each scan once"):
        open_scans(files, read_poses(poses), UnitCheck())
