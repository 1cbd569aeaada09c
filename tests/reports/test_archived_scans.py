"""Scans in an archive: as they came, where they stood, and what is lost of them is said."""

import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
from example_project import MOTION, TURN, measured, silent
from report_examples import example_object

from monitor.scans import open_scans
from monitor.unit_check import UnitCheck
from projects import Project, Scan
from projects.formats import read_scans, write_e57
from projects.model import EpochRecord
from projects.raw import ScanHeader
from projects.transforms import apply
from reports.archive import write_archive
from reports.survey_tables import pose_of


def test_a_scanner_off_the_origin_of_its_frame_stands_where_its_pose_puts_it(tmp_path: Path) -> None:
    place = np.array([0.5, -0.2, 1.5])
    scan = Scan("station", measured(0), TURN, place)
    write_e57(tmp_path / "a.e57", [scan])
    (read,) = read_scans(tmp_path / "a.e57")
    header = ScanHeader(0, "station", TURN, place, 400, {}, None, "a.e57", "", 0, False, np.zeros((2, 3)))
    np.testing.assert_allclose(pose_of(header, None), read.pose, atol=1e-12)
    np.testing.assert_allclose(pose_of(header, MOTION)[:3, 3], apply(MOTION, apply(TURN, place)), atol=1e-12)


def test_scans_of_which_nobody_knows_where_the_scanner_stood_are_archived_as_they_came(tmp_path: Path) -> None:
    given = np.round(np.add(measured(0).points, (5e5, 4e6, 200.0)), 6)
    np.savetxt(tmp_path / "merged.xyz", given, fmt="%.6f")
    project = Project.create(tmp_path / "p")
    project.add_object(example_object())
    streams = open_scans([tmp_path / "merged.xyz"], {}, UnitCheck())
    project.add_epoch(EpochRecord("column", "e1", datetime.date(2025, 5, 12)), streams)
    assert np.isnan(project.scan_headers("column", "e1")[0].origin).all()
    write_archive(tmp_path / "archive", project, ["column"], silent)
    folder = tmp_path / "archive" / "data" / "column" / "e1"
    (scan,) = open_scans([folder / "column_e1_scans.e57"], {}, UnitCheck())
    points = np.concatenate([block.cloud.points for block in scan.chunks()])
    np.testing.assert_allclose(points, given, rtol=0.0, atol=1.1e-6)
    assert np.isnan(scan.origin).all()  # and it stays unknown, whatever its points look like
    np.testing.assert_array_equal(np.loadtxt(folder / "column_e1_GRmatrices_scan1.txt"), np.eye(4))
    assert pd.read_csv(folder / "column_e1_scans.csv")[["station_x", "station_y", "station_z"]].isna().all(axis=None)


def test_scans_with_points_beside_their_grid_are_archived_whole_and_without_it(tmp_path: Path) -> None:
    (tmp_path / "a.e57").write_bytes(b"as it came")
    cloud, rows = measured(0), np.arange(400) // 20
    whole = Scan("station", cloud, TURN, rows=np.where(rows < 19, rows, -1), columns=np.arange(400) % 20)
    stream = SimpleNamespace(
        name="station", index=0, path=tmp_path / "a.e57", pose=TURN, origin=np.zeros(3), scanner=None, is_grid=True,
        chunks=lambda: (whole.take(rows < 9), whole.take(rows >= 9)),
    )  # fmt: skip
    project = Project.create(tmp_path / "p")
    project.add_object(example_object())
    project.add_epoch(EpochRecord("column", "e1", datetime.date(2025, 5, 12)), [stream])
    told = write_archive(tmp_path / "archive", project, ["column"], silent).minds
    assert any("of the scans of epoch e1 of column, station are archived without their grid" in mind for mind in told)
    (scan,) = read_scans(tmp_path / "archive/data/column/e1/column_e1_scans.e57")
    assert sum(len(block.cloud) for block in scan.chunks()) == 400
