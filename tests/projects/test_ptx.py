"""PTX: grids, transforms, no-returns; what scales or is cut off is refused."""

import dataclasses

import numpy as np
import pytest

from projects.errors import FormatError
from projects.formats import read_poses, read_scans, write_ptx
from projects.model import PointCloud, Scan
from projects.transforms import apply, rotation_from_vector

HEADER = "2\n3\n{position}\n1 0 0\n0 1 0\n0 0 1\n{matrix}\n"
IDENTITY = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1"
ROWS = ["1 0 0 0.1", "2 0 0 0.2", "3 0 0 0.3", "0 0 0 0.5", "5 0 0 0.5", "6 0 0 0.6"]


def ptx(rows=ROWS, matrix=IDENTITY, position="0 0 0"):
    return HEADER.format(matrix=matrix, position=position) + "\n".join(rows) + "\n"


@pytest.fixture
def station(rng):
    n = 200
    rows, columns = np.divmod(rng.choice(30 * 20, n, replace=False), 20)
    T_project_scanner = np.eye(4)
    T_project_scanner[:3, :3] = rotation_from_vector(np.array([0.2, -0.4, 2.0]))
    T_project_scanner[:3, 3] = [412_000.25, 5_700_000.5, 88.125]
    cloud = PointCloud(rng.normal(size=(n, 3)) * 5, intensity=rng.random(n), colors=rng.integers(0, 256, (n, 3)))
    return Scan("S", cloud, T_project_scanner, rows=rows, columns=columns)


def test_scans_come_back_with_pose_grid_and_colours(tmp_path, station, read_whole):
    write_ptx(tmp_path / "a.ptx", [station, station])
    first, second = read_whole(tmp_path / "a.ptx")
    order = np.lexsort((station.rows, station.columns))
    for got in (first, second):
        np.testing.assert_allclose(got.cloud.points, station.cloud.points[order], atol=0.51e-6)
        np.testing.assert_allclose(got.pose, station.pose, atol=1e-9)
        np.testing.assert_array_equal(got.rows, station.rows[order])
        np.testing.assert_array_equal(got.columns, station.columns[order])
        np.testing.assert_array_equal(got.cloud.colors, station.cloud.colors[order])
        np.testing.assert_allclose(got.cloud.intensity, station.cloud.intensity[order], atol=1e-6)
        np.testing.assert_array_equal(got.origin, [0, 0, 0])
        assert got.dropped == {"no return": (station.rows.max() + 1) * (station.columns.max() + 1) - 200}


def test_points_follow_column_by_column(tmp_path, read_whole):
    (tmp_path / "a.ptx").write_text(ptx())
    (got,) = read_whole(tmp_path / "a.ptx")
    assert got.rows.tolist() == [0, 1, 2, 1, 2]
    assert got.columns.tolist() == [0, 0, 0, 1, 1]
    assert got.cloud.points[:, 0].tolist() == [1, 2, 3, 5, 6]
    assert got.dropped == {"no return": 1}


def test_transform_is_read_for_row_vectors(tmp_path, read_whole):
    quarter_turn_about_z = "0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1"
    (tmp_path / "a.ptx").write_text(ptx(matrix=quarter_turn_about_z, position="10 20 30"))
    (got,) = read_whole(tmp_path / "a.ptx")
    np.testing.assert_allclose(apply(got.pose, np.array([1.0, 0.0, 0.0])), [10.0, 21.0, 30.0])
    np.testing.assert_array_equal(got.origin, [0, 0, 0])


def test_station_of_a_scan_in_project_coordinates_is_its_origin(tmp_path):
    (tmp_path / "a.ptx").write_text(ptx(position="7 8 9"))
    (stream,) = read_scans(tmp_path / "a.ptx")
    np.testing.assert_array_equal(stream.origin, [7, 8, 9])
    assert stream.is_origin_stated


def test_a_scan_whose_station_nobody_knows_says_nothing_of_it(tmp_path, station):
    unknown = dataclasses.replace(station, origin=np.full(3, np.nan))
    write_ptx(tmp_path / "a.ptx", [unknown])
    assert "nan" not in (tmp_path / "a.ptx").read_text()
    (tmp_path / "b.ptx").write_text(ptx(position="nan nan nan"))
    bare = dataclasses.replace(unknown, pose=np.eye(4))
    write_ptx(tmp_path / "c.ptx", [bare])
    for name in "abc":
        (stream,) = read_scans(tmp_path / f"{name}.ptx")
        np.testing.assert_array_equal(stream.origin, [0, 0, 0])


def test_transform_that_scales_is_refused_with_its_scale(tmp_path):
    (tmp_path / "a.ptx").write_text(ptx(matrix="1000 0 0 0\n0 1000 0 0\n0 0 1000 0\n0 0 0 1"))
    with pytest.raises(FormatError, match=r"a\.ptx: transform .* scales by 1000 to 1000"):
        list(read_scans(tmp_path / "a.ptx"))


def test_line_of_a_poses_file_takes_the_place_of_the_transform(tmp_path, read_whole):
    (tmp_path / "a.ptx").write_text(ptx(matrix="2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1"))
    (tmp_path / "poses.txt").write_text("a.ptx 1 0 0 5  0 1 0 6  0 0 1 7  0 0 0 1\n")
    (got,) = read_whole(tmp_path / "a.ptx", pose_lines=read_poses(tmp_path / "poses.txt"))
    np.testing.assert_array_equal(got.pose[:3, 3], [5, 6, 7])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ptx(ROWS[:5]), "promises 6 points from line 11 on, fewer are there"),
        (ptx([*ROWS[:4], "5 0 0", ROWS[5]]), "line 15 has 3 values, the lines before it 4"),
        (ptx([*ROWS[:4], "5 zero 0 1", ROWS[5]]), "'zero', which is no number"),
        (ptx(["0 0 0 0.5"] * 6), r"none of its 6 points is a measurement \(no return: 6\)"),
        (ptx() + "3\n", "scan 2: line 18 should hold 1 number"),
        (ptx().replace("1 0 0\n0 1 0\n0 0 1\n", "", 1), "scan 1: line 4 should hold 3 numbers"),
        (ptx() + ptx(ROWS[:2]), "promises 6 points from line 27 on"),
        (ptx()[:-4], "ends in the middle of a number|has 3 values|promises 6"),
        ("99999999\n99999999" + ptx()[3:], "promises 9999999800000001 points"),
    ],
    ids=["short", "missing value", "a word", "no returns", "cut header", "no axes", "second short", "cut", "endless"],
)
def test_what_is_broken_is_refused_with_its_line(tmp_path, read_whole, text, message):
    (tmp_path / "b.ptx").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_whole(tmp_path / "b.ptx")


def test_grid_with_two_points_in_a_cell_cannot_be_written(tmp_path, station):
    with pytest.raises(FormatError, match="several points in one cell"):
        write_ptx(tmp_path / "a.ptx", [station.take(np.r_[0, 0:200])])


def test_scan_without_grid_is_one_column(tmp_path, read_whole):
    scan = Scan("S", PointCloud(np.array([[1.0, 2, 3], [4, 5, 6]])), np.eye(4))
    write_ptx(tmp_path / "a.ptx", [scan])
    (got,) = read_whole(tmp_path / "a.ptx")
    np.testing.assert_array_equal(got.cloud.points, scan.cloud.points)


def test_scan_without_a_single_cell_is_passed_over_and_a_file_of_such_refused(tmp_path):
    empty = ptx([]).replace("2\n3\n", "0\n0\n", 1)
    (tmp_path / "a.ptx").write_text(empty + ptx() + empty + ptx())
    assert [(stream.name, stream.index) for stream in read_scans(tmp_path / "a.ptx")] == [
        ("a.ptx#2", 1),
        ("a.ptx#4", 3),
    ]
    (tmp_path / "b.ptx").write_text(empty + empty)
    with pytest.raises(FormatError, match="holds no points"):
        list(read_scans(tmp_path / "b.ptx"))


def test_intensities_of_all_scans_of_a_file_have_one_range(tmp_path, read_whole):
    """200 was 0.78 of a scan that reaches 200, and 0.05 of the next, which reaches 4000."""
    dark = ptx([f"{k} 1 2 {i}" for k, i in enumerate((10, 100, 200, 50, 60, 70))])
    bright = ptx([f"{k} 1 2 {i}" for k, i in enumerate((200, 4000, 200, 3000, 9, 9))])
    (tmp_path / "a.ptx").write_text(dark + bright + dark)
    first, second, third = read_whole(tmp_path / "a.ptx")
    np.testing.assert_allclose(first.cloud.intensity, np.array([10, 100, 200, 50, 60, 70]) / 4095, atol=1e-6)
    np.testing.assert_allclose(second.cloud.intensity[[0, 1]], np.array([200, 4000]) / 4095, atol=1e-6)
    np.testing.assert_array_equal(first.cloud.intensity, third.cloud.intensity)


def test_what_stands_at_the_place_of_a_return_that_never_came_says_nothing_of_the_range(tmp_path, read_whole):
    rows = [f"{k} 1 2 {i}" for k, i in enumerate((10, 100, 200, 50, 60))]
    (tmp_path / "a.ptx").write_text(ptx([*rows, "0 0 0 4000"]) + ptx([*rows, "5 5 5 51"]))
    first, second = read_whole(tmp_path / "a.ptx")
    assert first.cloud.intensity[2] == second.cloud.intensity[2] == np.float32(200 / 255)
