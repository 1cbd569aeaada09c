"""Simulated scans as E57 and PTX files, as an instrument's software leaves them, and back through the reader."""

import dataclasses
import datetime

import numpy as np
import pye57
import pytest

from monitor.simulation import INSTRUMENTS, Scene, Window, misregister, simulate_scan, stand_at
from monitor.simulation.scenes import make_ball, make_box
from projects.formats import read_scans, write_e57, write_ptx
from projects.model import PointCloud
from projects.transforms import apply

POSES = [stand_at([3.0, -2.0, 1.6], facing=[0.0, 0.0, 1.0]), stand_at([-2.5, -2.5, 1.4], facing=[0.0, 0.0, 1.0])]


@pytest.fixture(scope="module")
def scans():
    """Return two scans of a ball on a block before the open sky: a good part of each grid has no return."""
    block = make_box("block", [-0.3, -0.3, 0.0], [0.3, 0.3, 1.0], reflectance=0.8)
    scene = Scene("ball", (block, make_ball("ball", np.array([0.0, 0.0, 1.2]), 0.2, reflectance=0.4)))
    rng = np.random.default_rng(5)
    return [
        simulate_scan(
            scene, INSTRUMENTS["phase-2020"], pose, Window(-0.2, 0.2, -0.35, 0.05), step=0.004, seed=k,
            registered=misregister(pose, rng, sigma_position=1e-3, sigma_angle=1e-4), name=f"station {k + 1}",
        )
        for k, pose in enumerate(POSES)
    ]  # fmt: skip


def read_back(path):
    return [list(stream.chunks()) for stream in read_scans(path)]


@pytest.mark.parametrize(("write", "name"), [(write_e57, "survey.e57"), (write_ptx, "survey.ptx")])
def test_scans_come_back_through_the_reader_as_they_were_measured(scans, tmp_path, write, name):
    write(tmp_path / name, scans)
    back = read_back(tmp_path / name)
    assert len(back) == 2
    for chunks, scan in zip(back, scans, strict=True):
        (found,) = chunks
        order, other = (np.lexsort((s.rows, s.columns)) for s in (scan, found))
        np.testing.assert_array_equal(found.rows[other], scan.rows[order])
        np.testing.assert_array_equal(found.columns[other], scan.columns[order])
        np.testing.assert_allclose(found.pose, scan.pose, atol=1e-9)
        # Both formats round to a micrometre in the scanner's frame.
        np.testing.assert_allclose(found.cloud.points[other], scan.cloud.points[order], atol=1.01e-6)
        np.testing.assert_allclose(found.cloud.intensity[other], scan.cloud.intensity[order], atol=2e-6)
        np.testing.assert_allclose(
            apply(found.pose, found.cloud.points[other]), apply(scan.pose, scan.cloud.points[order]), atol=2e-6
        )


def test_a_ptx_file_holds_the_whole_grid_with_zeros_where_nothing_returned(scans, tmp_path):
    write_ptx(tmp_path / "survey.ptx", scans)
    lines = (tmp_path / "survey.ptx").read_text().splitlines()
    for scan in scans:
        n_columns, n_rows = int(lines[0]), int(lines[1])
        assert n_columns == scan.columns.max() + 1
        assert n_rows == scan.rows.max() + 1
        np.testing.assert_allclose(np.array(lines[2].split(), dtype=float), scan.pose[:3, 3], atol=1e-9)
        transform = np.array([line.split() for line in lines[6:10]], dtype=float)
        np.testing.assert_allclose(transform.T, scan.pose, atol=1e-9)
        cells = np.array([line.split() for line in lines[10 : 10 + n_columns * n_rows]], dtype=float)
        empty = (cells[:, :3] == 0.0).all(axis=1)
        assert empty.sum() == n_columns * n_rows - len(scan.cloud)
        assert empty.sum() > 1000
        np.testing.assert_array_equal(cells[empty, 3], 0.5)
        assert np.all((cells[~empty, 3] >= 0.0) & (cells[~empty, 3] <= 1.0))
        # Column by column, in each from the lowest row: elevation rises within a column.
        place = np.flatnonzero(~empty)
        np.testing.assert_array_equal(np.sort(scan.columns.astype(np.int64) * n_rows + scan.rows), place)
        lines = lines[10 + n_columns * n_rows :]
    assert not lines


def test_an_e57_file_can_hold_the_empty_cells_too_and_they_are_counted_as_no_return(scans, tmp_path):
    write_e57(tmp_path / "filled.e57", scans, fill_grid=True)
    for chunks, scan in zip(read_back(tmp_path / "filled.e57"), scans, strict=True):
        assert sum(len(chunk.cloud) for chunk in chunks) == len(scan.cloud)
        n_cells = (scan.rows.max() + 1) * (scan.columns.max() + 1)
        assert sum(sum(chunk.dropped.values()) for chunk in chunks) == n_cells - len(scan.cloud)


def test_the_header_of_an_e57_file_tells_no_time_that_is_not_known(scans, tmp_path):
    write_e57(tmp_path / "undated.e57", scans[:1])
    with pye57.E57(str(tmp_path / "undated.e57")) as document:
        assert not document.root.isDefined("creationDateTime")
        assert not document.data3d[0].isDefined("acquisitionStart")


def test_the_header_of_an_e57_file_tells_when_and_over_which_field_as_instruments_do(scans, tmp_path):
    when = datetime.datetime(2025, 5, 12, 9, 30, tzinfo=datetime.UTC)
    turned = [scans[0], scans[1]]
    write_e57(tmp_path / "survey.e57", turned, acquired=when)
    seconds = (when - datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)).total_seconds()
    with pye57.E57(str(tmp_path / "survey.e57")) as document:
        assert document.root["creationDateTime"]["dateTimeValue"].value() == seconds
        for k, scan in enumerate(turned):
            node = document.data3d[k]
            assert node["acquisitionStart"]["dateTimeValue"].value() == seconds
            field = {name: node["sphericalBounds"][name].value() for name in (
                "rangeMinimum", "rangeMaximum", "elevationMinimum", "elevationMaximum", "azimuthStart", "azimuthEnd"
            )}  # fmt: skip
            x, y, z = scan.cloud.points.T
            found = [np.hypot(np.hypot(x, y), z), np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)]
            expected = [v for a in found for v in (a.min(), a.max())]
            np.testing.assert_allclose(list(field.values()), expected, atol=1e-12)


def test_a_field_across_the_seam_of_azimuths_goes_on_beyond_pi(scans, tmp_path):
    about = np.diag([-1.0, -1.0, 1.0])
    scan = dataclasses.replace(scans[0], cloud=PointCloud(scans[0].cloud.points @ about, origins=np.zeros(3)))
    write_e57(tmp_path / "survey.e57", [scan])
    azimuth = np.arctan2(*scans[0].cloud.points[:, 1::-1].T)
    with pye57.E57(str(tmp_path / "survey.e57")) as document:
        bounds = document.data3d[0]["sphericalBounds"]
        found = [bounds[name].value() for name in ("azimuthStart", "azimuthEnd")]
    np.testing.assert_allclose(found, np.array([azimuth.min(), azimuth.max()]) + np.pi, atol=1e-12)
