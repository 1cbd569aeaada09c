"""Simulated scans as E57 and PTX files, as an instrument's software leaves them, and back through the reader."""

import dataclasses
import datetime
import weakref

import numpy as np
import pye57
import pytest

from monitor.simulation import INSTRUMENTS, Scene, Window, misregister, simulate_scan, stand_at, stream_scan
from monitor.simulation.scenes import make_ball, make_box
from projects.errors import FormatError
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


def in_parts(scan, n, seen=None):
    """Yield a scan as n blocks of whole columns; `seen` gathers a weak reference to each."""
    for part in np.array_split(np.arange(scan.columns.max() + 1), n):
        block = scan.take(np.isin(scan.columns, part))
        if seen is not None:
            seen.append(weakref.ref(block))
        yield block
        del block


@pytest.mark.parametrize(("write", "name"), [(write_e57, "survey.e57"), (write_ptx, "survey.ptx")])
def test_a_scan_written_block_by_block_is_the_file_of_the_whole(scans, tmp_path, write, name):
    whole, parts = tmp_path / f"whole-{name}", tmp_path / f"parts-{name}"
    write(whole, scans)
    write(parts, (in_parts(scan, 7) for scan in scans))
    for one, other in zip(read_back(whole), read_back(parts), strict=True):
        for expected, found in zip(one, other, strict=True):
            np.testing.assert_array_equal(found.cloud.points, expected.cloud.points)
            np.testing.assert_array_equal(found.cloud.intensity, expected.cloud.intensity)
            np.testing.assert_array_equal(found.columns, expected.columns)
            assert found.dropped == expected.dropped
    if name.endswith("ptx"):
        assert parts.read_bytes() == whole.read_bytes()
    else:
        assert header(parts) == header(whole)


def header(path):
    """Return the bounds that an E57 file states of its scans."""
    with pye57.E57(str(path)) as document:
        return [
            [scan[group][name].value() for group in GROUPS for name in GROUPS[group]] for scan in document.data3d
        ]  # fmt: skip


GROUPS = {
    "cartesianBounds": [f"{a}{m}" for a in "xyz" for m in ("Minimum", "Maximum")],
    "sphericalBounds": ["rangeMinimum", "rangeMaximum", "elevationMinimum", "elevationMaximum", "azimuthStart",
                        "azimuthEnd"],
    "indexBounds": ["rowMinimum", "rowMaximum", "columnMinimum", "columnMaximum"],
}  # fmt: skip


@pytest.mark.parametrize(("write", "name"), [(write_e57, "survey.e57"), (write_ptx, "survey.ptx")])
def test_the_writer_lets_each_block_go_before_it_asks_for_the_one_after_the_next(scans, tmp_path, write, name):
    seen = []

    def watched():
        for block in in_parts(scans[0], 6, seen):
            assert sum(reference() is not None for reference in seen) <= 2
            yield block

    write(tmp_path / name, [watched()])
    assert len(seen) == 6


def test_blocks_that_are_not_of_one_scan_are_refused_and_leave_no_file(scans, tmp_path):
    blocks = list(in_parts(scans[0], 3))
    grey = dataclasses.replace(blocks[1], cloud=PointCloud(blocks[1].cloud.points, origins=np.zeros(3)))
    with pytest.raises(FormatError, match="has intensity in some of its blocks only"):
        write_e57(tmp_path / "a.e57", [[blocks[0], grey]])
    with pytest.raises(FormatError, match="order of their columns"):
        write_ptx(tmp_path / "a.ptx", [blocks[::-1]])
    with pytest.raises(FormatError, match="fill_grid needs whole scans"):
        write_e57(tmp_path / "a.e57", [blocks], fill_grid=True)
    for write in (write_e57, write_ptx):
        with pytest.raises(FormatError, match="holds no points"):
            write(tmp_path / "a.e57", [[blocks[0].take(np.zeros(len(blocks[0].cloud), bool))]])
    assert not list(tmp_path.iterdir())


def test_intensity_unknown_in_one_block_only_is_unknown_there_alone(scans, tmp_path):
    first, second = in_parts(scans[0], 2)
    unknown = np.full(len(second.cloud), np.nan)
    dark = dataclasses.replace(second, cloud=dataclasses.replace(second.cloud, intensity=unknown))
    write_e57(tmp_path / "a.e57", [[first, dark]])
    ((found,),) = read_back(tmp_path / "a.e57")
    np.testing.assert_allclose(found.cloud.intensity[: len(first.cloud)], first.cloud.intensity, atol=1e-6)
    assert np.isnan(found.cloud.intensity[len(first.cloud) :]).all()


def test_what_a_scanner_streams_goes_to_a_file_as_it_comes(tmp_path):
    """The grid is many blocks of the scanner's; sky, which yields blocks without a point, is left out."""
    scene = Scene("wall", (make_box("wall", [2.0, -1.0, -1.0], [2.2, 1.0, 1.0], reflectance=0.8),))
    field = (INSTRUMENTS["phase-2020"], np.eye(4), Window(-1.5, 1.5, -0.4, 0.4))
    write_e57(tmp_path / "a.e57", [stream_scan(scene, *field, step=0.002, n_subrays=1, seed=3)])
    whole = simulate_scan(scene, *field, step=0.002, n_subrays=1, seed=3)
    ((found,),) = read_back(tmp_path / "a.e57")
    np.testing.assert_allclose(found.cloud.points, whole.cloud.points, atol=1.01e-6)
    np.testing.assert_array_equal(found.columns, whole.columns)
