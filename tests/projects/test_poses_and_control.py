"""Poses files, control files and units: exact where they are right, one clear line where they are not."""

import numpy as np
import pytest

from projects.errors import FormatError, ParameterError, UnitError
from projects.formats import (
    metres_per_unit,
    question_unit,
    read_control,
    read_poses,
    read_scans,
    require_known_names,
    sniff_format,
)

TURNED = "0 -1 0 10  1 0 0 20  0 0 1 30  0 0 0 1"


def poses(folder, text, **options):
    (folder / "poses.txt").write_text(text)
    return read_poses(folder / "poses.txt", **options)


def test_matrix_is_read_row_by_row_and_lengths_are_scaled(tmp_path):
    lines = poses(tmp_path, f"# poses\n\na.ply {TURNED}\nb.ply {TURNED} 1 2 1000\n", unit=0.001)
    assert list(lines) == ["a.ply", "b.ply"]
    np.testing.assert_allclose(lines["a.ply"].T_project_scanner[:3, 3], [0.01, 0.02, 0.03])
    np.testing.assert_array_equal(lines["a.ply"].T_project_scanner[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(lines["a.ply"].origin, [0, 0, 0])
    np.testing.assert_allclose(lines["b.ply"].origin, [0.001, 0.002, 1.0])


def test_names_with_spaces_stand_in_quotes(tmp_path):
    assert list(poses(tmp_path, f'"scan 1 left.ply" {TURNED}\n')) == ["scan 1 left.ply"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"a.ply {TURNED} 1\n", r"line 1 \(a\.ply\): 17 numbers after the name; 16 are needed, or 19"),
        ("a.ply 1 2 3\n", "3 numbers after the name"),
        (f"a.ply {TURNED}\na.ply {TURNED}\n", r"line 2: a\.ply has a pose already"),
        (f"a.ply {TURNED.replace('30', 'x')}\n", r"'x' is no number; decimals have a point"),
        (f"{TURNED}\n", r"line 1: begins with a number; the file's name comes first"),
        ("a.ply 2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n", "scales by 2 to 2"),
        ("a.ply 1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1\n", "transform mirrors, as where an axis"),
        ("a.ply 1 0 0 0 0 1 0 0 0 0 1 0 1 2 3 1\n", "translation stands in the last row, as where"),
        ("a.ply 1 0 0 5 0 1 0 0 0 0 1 0 1 2 3 1\n", "with last row 0 0 0 1"),
        (f"a.ply {TURNED.replace('30', 'nan')}\n", "finite numbers"),
        (f"a.ply {TURNED} 1 2 nan\n", "not finite"),
        (f'"a.ply {TURNED}\n', "quote .* is not closed"),
        ("# nothing\n", "holds no poses"),
    ],
)
def test_line_that_is_no_pose_is_refused_with_its_number(tmp_path, text, message):
    with pytest.raises(FormatError, match=message) as caught:
        poses(tmp_path, text)
    assert "poses.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_and_ambiguous_names_are_refused(tmp_path):
    lines = poses(tmp_path, f"a.ply {TURNED}\nb.e57#2 {TURNED}\n")
    require_known_names(lines, [tmp_path / "a.ply", tmp_path / "b.e57"])
    with pytest.raises(FormatError, match=r"b\.e57#2 is none of the files given"):
        require_known_names(lines, [tmp_path / "a.ply"])
    with pytest.raises(FormatError, match=r"a\.ply is the name of several"):
        require_known_names(lines, [tmp_path / "a.ply", tmp_path / "x" / "a.ply", tmp_path / "b.e57"])


@pytest.fixture
def two_scans(tmp_path):
    header = "1\n2\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 0\n4 5 6 0\n"
    (tmp_path / "two.ptx").write_text(header * 2)
    return tmp_path / "two.ptx"


def moved(x):
    return f"1 0 0 {x} 0 1 0 0 0 0 1 0 0 0 0 1\n"


def test_scans_of_a_file_are_counted_from_one_or_where_zero_appears_from_zero(tmp_path, two_scans):
    for first in (0, 1):
        lines = poses(tmp_path, f"two.ptx#{first} {moved(5)}two.ptx#{first + 1} {moved(6)}")
        assert [stream.pose[0, 3] for stream in read_scans(two_scans, pose_lines=lines)] == [5, 6]


def test_pose_for_a_scan_that_is_not_there_is_refused(tmp_path, two_scans):
    with pytest.raises(FormatError, match=r"two\.ptx#3 is named, but the file holds 2 scans"):
        list(read_scans(two_scans, pose_lines=poses(tmp_path, f"two.ptx#3 {moved(1)}")))
    with pytest.raises(FormatError, match=r"write two\.ptx#1 to two\.ptx#2"):
        list(read_scans(two_scans, pose_lines=poses(tmp_path, f"two.ptx {moved(1)}")))


def control(folder, text, **options):
    (folder / "control.csv").write_text(text)
    return read_control(folder / "control.csv", **options)


@pytest.mark.parametrize("separator", [",", ";", "\t", ", "])
def test_control_points_are_read_with_and_without_sigma(tmp_path, separator):
    text = "# net 2024\nname,x,y,z,sigma\nT1,1,2,3,0.5\nT2,4,5,6\n\nT3,7,8,9,\n".replace(",", separator)
    points = control(tmp_path, text, unit=0.001)
    assert [point.name for point in points] == ["T1", "T2", "T3"]
    np.testing.assert_allclose(points[0].position, [0.001, 0.002, 0.003])
    assert points[0].sigma == 0.0005
    assert np.isnan(points[1].sigma)
    assert np.isnan(points[2].sigma)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("T1,1,2\n", "line 1: 3 values"),
        ("T1,1,2,3\nT2,1,two,3\n", "line 2: .* are not all numbers"),
        ("T1,1,2,3,0\n", "sigma 0 is not positive"),
        ("T1,1,2,3,inf\n", "sigma inf is not positive and finite"),
        ("name;x;y;z\nT1;one;two;three\nT2;1;2;3\n", "line 2: .* are not all numbers"),
        ("T1,1,2,3\nT1,4,5,6\n", "line 2: control point T1 is there already"),
        ("T1,1,inf,3\n", "not finite"),
        ("name,x,y,z\n", "holds no control points"),
    ],
)
def test_control_that_is_none_is_refused_with_its_line(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        control(tmp_path, text)


@pytest.mark.parametrize(
    "text",
    [
        "name,northing,easting,height,sigma\nT1,5,4,6,0.5\n",
        "Punktnummer;Hochwert;Rechtswert;Höhe;Sigma\nT1;5,0;4,0;6,0;0,5\n",
        "E [m],N [m],H [m],sigma [mm],Nr.\n4,5,6,500,T1\n",
        "Sigma;X;Y;Z;ID;\n0,5;4;5;6;T1;\n",
        "target,Z,Y,X,std\nT1,6,5,4,0.5\n",
        "# net 2024\n#name,northing,easting,height,sigma\n# Graz, 2 days\nT1,5,4,6,0.5\n",
        "# northing, easting and height, 2024\nT1,4,5,6,0.5\n",
    ],
)
def test_columns_are_what_the_first_line_names_them(tmp_path, text):
    (point,) = control(tmp_path, text)
    assert point.name == "T1"
    np.testing.assert_allclose(point.position, [4, 5, 6])
    assert point.sigma == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,x,y,z,code\nT1,1,2,3,4\n", "line 1: 'code' is no known name of a column"),
        ("name,lat,lon,height\nT1,1,2,3\n", "'lat' is no known name"),
        ("name,easting,height,sigma\nT1,1,2,3\n", "names no column for y;"),
        ("x,y,z\n1,2,3\n", "names no column for name;"),
        ("name,x,y,z,height\nT1,1,2,3,4\n", "names two columns for z;"),
        ("name,x [mm],y [mm],z [mm]\nT1,1,2,3\n", "coordinates in mm, but they are read with 1 m to the unit"),
        ("name,x [m],y [m],z [mm]\nT1,1,2,3\n", "coordinates in m and mm,"),
        ("name,x [m],y [mm],z [m]\nT1,1,2,3\n", "line 1: names x in m and y in mm"),
        ("name,x,y,z,sigma [µm]\nT1,1,2,3,4\n", r"\[µm\] is no known unit"),
        ("name,x,y,z\nT1,1,2,3,4\n", "line 2: 5 values; name,x,y,z is needed"),
        ("name,x,sigma,y,z\nT1,1,2,3\n", "line 2: 4 values; name,x,sigma,y,z is needed"),
    ],
)
def test_a_first_line_whose_names_do_not_tell_the_columns_is_refused(tmp_path, text, message):
    with pytest.raises(FormatError, match=message) as told:
        control(tmp_path, text)
    assert "\n" not in str(told.value)


def test_a_unit_named_in_the_first_line_is_the_one_that_was_stated(tmp_path):
    (point,) = control(tmp_path, "name,y [mm],x [mm],z [mm],sigma [mm]\nT1,1,2,3,4\n", unit=0.001)
    np.testing.assert_allclose([*point.position, point.sigma], [0.002, 0.001, 0.003, 0.004])


def test_decimal_commas_are_understood_between_other_marks(tmp_path):
    points = control(tmp_path, "T1;1,5;2,25;3,125;0,5\nT2;4;5;6\n")
    assert [point.name for point in points] == ["T1", "T2"]
    np.testing.assert_array_equal(points[0].position, [1.5, 2.25, 3.125])
    assert points[0].sigma == 0.5


def box(size):
    return np.array([[5e5, 5e6, 0.0], [5e5 + size, 5e6 + size / 2, 0.1 * size]])


@pytest.mark.parametrize(("name", "metres"), [("m", 1.0), ("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("ft", 0.3048)])
def test_units_have_their_exact_length(name, metres):
    assert metres_per_unit(name) == metres


def test_unknown_units_are_refused():
    with pytest.raises(UnitError, match="m, mm, cm, in, ft"):
        metres_per_unit("yd")
    with pytest.raises(ParameterError, match="positive"):
        list(read_scans("a.xyz", unit=0.0))


@pytest.mark.parametrize("size", [0.006, 0.3, 2.0, 40.0, 99.0])
def test_size_of_a_monument_in_metres_is_not_questioned_and_a_grain_of_dust_is(size):
    question_unit(box(size), unit_stated=False)  # raises where it questions
    with pytest.raises(UnitError, match="m if in mm"):
        question_unit(box(1e-5 * size), unit_stated=False)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (0.001, r"0\.001 m across .*0\.000001"),
        (150.0, r"150 m across .*0\.15"),
        (319.88, r"320 m across .*0\.32"),
        (30_000.0, r"30000 m across .*30"),
    ],
)
def test_improbable_size_is_questioned_with_what_it_would_be(size, expected):
    with pytest.raises(UnitError, match=rf"{expected} m if in mm.*--unit"):
        question_unit(box(size), unit_stated=False, name="owl.ply")
    question_unit(box(size), unit_stated=True)
    question_unit(box(0.0), unit_stated=False)  # one point has no size in any unit


def test_surroundings_in_a_format_that_defines_metres_are_not_questioned():
    question_unit(box(400.0), unit_stated=False, format_name="e57")
    with pytest.raises(UnitError, match="40 m if in mm"):
        question_unit(box(40_000.0), unit_stated=False, format_name="e57")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.las", b"not a point cloud", "named .las but does not begin like one"),
        ("a.e57", b"\x89PNG\r\n", "named .e57 but"),
        ("a.png", b"\x89PNG\r\n\0\0", "no known format"),
        ("a.md", b"# Notes\nabout nothing\n", "no known format"),
        ("a.xyz", b"", "is empty"),
        ("a.txt", "1 2 3\n".encode("utf-16"), "UTF-16"),
        ("a.stl", b"\0" * 100, "named .stl"),
    ],
)
def test_file_of_no_known_format_is_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FormatError, match=message):
        sniff_format(tmp_path / name)


def test_missing_file_and_folder_are_refused(tmp_path):
    with pytest.raises(FormatError, match=r"none\.e57: cannot be opened"):
        sniff_format(tmp_path / "none.e57")
    with pytest.raises(FormatError, match="is a folder"):
        sniff_format(tmp_path)


@pytest.mark.parametrize(("name", "format_name"), [("a.xyz", "ptx"), ("a.ptx", "ptx"), ("a", "ptx")])
def test_ptx_is_known_by_its_content(tmp_path, two_scans, name, format_name):
    (tmp_path / name).write_bytes(two_scans.read_bytes())
    assert sniff_format(tmp_path / name) == format_name
