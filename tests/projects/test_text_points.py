"""XYZ, TXT, CSV and PTS: columns by name or content, every separator; what is ambiguous or cut off is refused."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from projects.errors import FormatError
from projects.formats import pts, xyz
from projects.formats.measured import keep_measurements
from projects.formats.units import METRES

POINTS = [[1.5, 2.25, -3.0], [4.0, 5.5, 6.125], [7.0, 8.0, 9.5]]


def read(path, reader=xyz):
    """Return all columns of a file, without the child process."""
    (header,) = reader.list_scans(str(path))
    blocks = [columns for columns, _ in keep_measurements(reader.read_scan(str(path), header), header.is_centred)]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def saved(folder, text, name="a.txt", newline="\n"):
    path = folder / name
    path.write_bytes(text.replace("\n", newline).encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        "1.5 2.25 -3.0\n4.0 5.5 6.125\n7.0 8.0 9.5\n",
        "1.5,2.25,-3.0\n4.0,5.5,6.125\n7.0,8.0,9.5",
        "1.5, 2.25, -3.0\n4.0, 5.5, 6.125\n\n7.0, 8.0, 9.5\n\n",
        "x;y;z\n1.5;2.25;-3.0\n4.0;5.5;6.125\n7.0;8.0;9.5\n",
        "x;y;z\n1,5;2,25;-3,0\n4,0;5,5;6,125\n7,0;8,0;9,5\n",
        "1,5 2,25 -3,0\n4,0 5,5 6,125\n7,0 8,0 9,5\n",
        '"x";"y";"z"\n"1,5";"2,25";"-3,0"\n"4,0";"5,5";"6,125"\n"7,0";"8,0";"9,5"\n',
        "1.5\t2.25\t-3.0\n4.0\t5.5\t6.125\n7.0\t8.0\t9.5\n",
        "//X Y Z\n3\n1.5 2.25 -3.0\n4.0 5.5 6.125\n7.0 8.0 9.5\n",
        "# a comment\n# X [m] Y [m] Z [m]\n1.5 2.25 -3.0\n# another\n4.0 5.5 6.125\n7.0 8.0 9.5\n",
        '"X","Y","Z"\n1.5,2.25,-3.0\n4.0,5.5,6.125\n7.0,8.0,9.5\n',
        "id,Northing,Easting,Height\n1,2.25,1.5,-3.0\n2,5.5,4.0,6.125\n3,8.0,7.0,9.5\n",
        "\ufeffx y z\n1.5 2.25 -3.0\n4.0 5.5 6.125\n7.0 8.0 9.5\n",
        "1.5e0 2.25 -3\n4 5.5 6.125\n7 8 9.5\n",
    ],
    ids=["space", "comma, no last line end", "comma and space", "semicolon", "decimal comma", "decimal comma, space",
         "decimal comma, quotes", "tab", "count", "comments and units", "quotes", "other order", "byte order mark",
         "exponents"],
)  # fmt: skip
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_coordinates_are_right_however_they_are_written(tmp_path, text, newline):
    np.testing.assert_array_equal(read(saved(tmp_path, text, newline=newline))["points"], POINTS)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("1 2 {k} 0.25", {"intensity": 0.25}),
        ("1 2 {k} 51", {"intensity": 0.2}),
        ("1 2 {k} -2048", {"intensity": 0.0}),
        ("1 2 {k} 10 20 30", {"colors": [10, 20, 30]}),
        ("1 2 {k} 0.6 0.0 0.8", {"normals": [0.6, 0.0, 0.8]}),
        ("1 2 {k} -1000 10 20 30", {"colors": [10, 20, 30], "intensity": 1048 / 4095}),
        ("1 2 {k} 10.0 20.0 30.0 255.0", {"colors": [10, 20, 30]}),
        ("1 2 {k} 0.5 10 20 30", {"colors": [10, 20, 30], "intensity": 0.5}),
        ("1 2 {k} 10 20 30 0.6 0.0 0.8", {"colors": [10, 20, 30], "normals": [0.6, 0.0, 0.8]}),
        ("1 2 {k} 0.6 0.0 0.8 10 20 30", {"colors": [10, 20, 30], "normals": [0.6, 0.0, 0.8]}),
        ("1 2 {k} 4095 10 20 {k}", {"colors": [10, 20, 3], "intensity": 1.0}),
        ("1 2 {k} 10 20 30 100{k}", {"colors": [10, 20, 30], "intensity": 1003 / 4095}),
        ("1 2 {k} 17.25 0.001 88.5 3 4", {}),
    ],
)
def test_columns_without_names_are_told_by_what_they_hold(tmp_path, row, expected):
    got = read(saved(tmp_path, "".join(row.format(k=k) + "\n" for k in range(5))))
    assert set(got) == {"points", *expected}
    np.testing.assert_array_equal(got["points"][:, 2], range(5))
    for name, value in expected.items():
        np.testing.assert_allclose(got[name][3], value, atol=1e-6)


def test_whole_numbers_that_may_be_intensity_or_a_colour_are_refused_but_in_pts(tmp_path):
    """Four columns of 0 to 255: PTS puts intensity first, other programs write it last."""
    rows = "".join(f"1 2 {k} {10 + k} 20 30 {40 + k}\n" for k in range(5))
    with pytest.raises(FormatError, match="columns 4 to 7 may be intensity red green blue or red green blue intensity"):
        read(saved(tmp_path, rows))
    for path, reader in ((saved(tmp_path, rows, "a.pts"), pts), (saved(tmp_path, "5\n" + rows, "b.txt"), xyz)):
        np.testing.assert_array_equal(read(path, reader)["colors"][3], [20, 30, 43])


@pytest.mark.parametrize("after", ["", " 100", " 100 20 30"])
def test_rows_and_columns_before_the_points_are_refused_without_names_and_passed_over_with_them(tmp_path, after):
    """FARO writes its XYZ so; row, column and x were taken for x, y and z."""
    rows = "".join(f"{r} {c} 1.{r}5 2.{c}5 3.{r}1{after}\n" for c in range(3) for r in range(4))
    with pytest.raises(FormatError, match="first two columns are whole numbers, as rows and columns of a grid; name"):
        read(saved(tmp_path, rows))
    names = "row column x y z" + {0: "", 1: " intensity", 3: " r g b"}[len(after.split())]
    np.testing.assert_array_equal(read(saved(tmp_path, f"{names}\n{rows}"))["points"][1], [1.15, 2.05, 3.11])


@pytest.mark.parametrize("row", ["{k} {k} 3.25", "{k} 2 3.25 0.6 0 0.8", "{k} 7 3.25 10 20 30", "{k}.5 2 3.5 0.5 1.5"])
def test_whole_coordinates_are_coordinates(tmp_path, row):
    rows = "".join(row.format(k=2 * k) + "\n" for k in range(9))
    assert read(saved(tmp_path, rows))["points"][3, 2] in (3.25, 3.5)


def test_intensity_of_pts_whose_colours_are_all_black_is_read(tmp_path):
    rows = "".join(f"1 2 {k} {-1000 - k} 0 0 0\n" for k in range(5))
    got = read(saved(tmp_path, "5\n" + rows, "a.pts"), pts)
    assert set(got) == {"points", "intensity"}
    np.testing.assert_allclose(got["intensity"][3], 1045 / 4095, atol=1e-6)


def test_colours_of_a_file_that_begins_in_the_dark_are_colours(tmp_path):
    dark = [f"{k}.5 2 3 0 0 0\n" for k in range(2000)]
    bright = [f"{k}.5 2 3 200 100 50\n" for k in range(2000, 4000)]
    got = read(saved(tmp_path, "".join(dark + bright)))
    np.testing.assert_array_equal(got["colors"][[0, -1]], [[0, 0, 0], [200, 100, 50]])


@pytest.mark.parametrize(
    ("row", "unread"),
    [
        ("1 2 {k} 0.25 0.5 0.7{k}", "columns 4 to 6"),
        ("1 2 {k} 10 20 30 0.{k}5", "column 7"),
        ("1 2 {k} 7 0.1", "columns 4 to 5"),
        ("1 2 {k} 10 20 30 255", ""),
        ("1 2 {k} 10 20 30", ""),
    ],
)
def test_columns_that_nobody_can_tell_are_named(tmp_path, row, unread):
    (header,) = xyz.list_scans(str(saved(tmp_path, "".join(row.format(k=k) + "\n" for k in range(5)))))
    assert header.unread == unread


@pytest.mark.parametrize(
    ("names", "unit", "heights"),
    [
        ("X [ft] Y [ft] Z [ft]", "ft", ""),
        ("X(mm),Y(mm),Z(mm)", "mm", ""),
        ("// id; X Coordinate [millimetres]; Y Coordinate [millimetres]; Z Coordinate [Meters]", "mm", "m"),
        ("x y z [cm]", "cm", ""),
        ("# X [m] Y [m] Z [m] i [dB]", "m", ""),
    ],
)
def test_units_in_the_names_of_columns_are_told(tmp_path, names, unit, heights):
    separator = next((mark for mark in ",;" if mark in names), " ")
    n = 3 + ("id" in names) + ("i [" in names)
    rows = "".join(separator.join(str(k + column) for column in range(n)) + "\n" for k in range(3))
    (header,) = xyz.list_scans(str(saved(tmp_path, f"{names}\n{rows}")))
    assert header.system == {"name": "", "unit": unit, "metres": METRES[unit], "heights": heights}


def test_names_without_units_say_nothing_of_them_and_two_units_of_the_plane_are_refused(tmp_path):
    (header,) = xyz.list_scans(str(saved(tmp_path, "X [E] Y (north) Z\n1 2 3\n4 5 6\n")))
    assert header.system is None
    with pytest.raises(FormatError, match="names x in mm and y in m; bring all"):
        xyz.list_scans(str(saved(tmp_path, "X [mm] Y [m] Z [m]\n1 2 3\n4 5 6\n")))


def test_named_columns_of_no_use_are_left_out(tmp_path):
    text = "X,Y,Z,OffsetTime,R,G,B,Intensity\n1,2,3,77,10,20,30,0.5\n4,5,6,78,11,21,31,0.25\n"
    got = read(saved(tmp_path, text))
    assert set(got) == {"points", "colors", "intensity"}
    np.testing.assert_array_equal(got["colors"], [[10, 20, 30], [11, 21, 31]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n4 5\n6 7 8\n", "line 2 has 2 values, the lines before it 3"),
        ("1 2 3\n4 5 6 7\n", "line 2 has 4 values"),
        ("1,2,3\n4,,6\n", "line 2 has 2 values"),
        ("1 2\n3 4\n", "line 1 holds 2 values"),
        ("1 2 3\n4 x 6\n", "line 2 has 'x', which is no number; mend"),
        ("time x y\n1 2 3\n", "line 1 is neither numbers nor names"),
        ("a b c\n1 2 3\n", "line 1 is neither numbers nor names"),
        ("x y\n1 2\n", "line 1 is neither numbers nor names"),
        ("x y z\n", "holds no points"),
        ("3\n1 2 3\n4 5 6\n", "promises 3 points, 2 are there"),
        ("1\n1 2 3\n4 5 6\n", "promises 1 points, 2 are there"),
        ("x y z x\n1 2 3 4\n5 6 7 8\n", "two columns for the same thing"),
        ("x y z\n1 2 3 4\n5 6 7 8\n", "names 3 columns .*, but its lines hold 4"),
        ("1,5,2,5,3,5\n4,5,5,5,6,5\n", "decimal commas"),
        ("10 1.5 2.5 3.5\n11 4.5 5.5 6.5\n12 7.5 8.5 9.5\n13 1.5 2.5 3.5\n", "first column counts the points"),
        ("1.125 2.125 3.125\n1.250 2.250 3.25", "ends in the middle of a number"),
        (
            "nan nan nan\n0 0 0\n0 0 0\n",
            r"none of its 3 points is a measurement \(not finite: 1, at exactly 0 0 0: 2\)",
        ),
        ("1 1 1\n1 1 1\n", "all its 2 points lie at one place"),
        ("1 2 3\r4 5 6\r7 8 9\r", "carriage return alone"),
        ("x;y;z\n1.234,5;2,5;3,5\n4,1;5,2;6,3\n", "line 2 has '1.234,5', which is no number"),
        (
            "x,y,z,name\n1.0,2.0,3.0,P1\n2,3,4,P2\n",
            "line 2 has 'P1', which is no number; .* take a column of words out",
        ),
    ],
)
def test_what_is_wrong_or_ambiguous_is_refused(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read(saved(tmp_path, text))


def test_coordinates_kilometres_away_keep_all_their_digits(tmp_path):
    text = "".join(f"{5_648_349 + k}.123456789 {665_187 + k}.000000001 {k}.5\n" for k in range(50))
    got = read(saved(tmp_path, text))["points"]
    np.testing.assert_allclose(got[:, 0], [5_648_349.123456789 + k for k in range(50)], rtol=3e-16)


def test_large_and_small_files_are_parsed_to_the_same_numbers(tmp_path, rng):
    values = rng.normal(size=(150_000, 3)) * 1e4
    np.savetxt(tmp_path / "a.txt", values, fmt="%.9f")  # larger than what is parsed the slow way
    expected = [[float(word) for word in line.split()] for line in (tmp_path / "a.txt").read_text().splitlines()]
    np.testing.assert_allclose(read(tmp_path / "a.txt")["points"], expected, rtol=3e-16)


def test_pts_may_hold_several_clouds(tmp_path):
    text = "2\n1 2 3 -5 1 2 3\n4 5 6 7 40 50 60\n1\n7 8 9 10 1 2 3\n\n"
    got = read(saved(tmp_path, text, "a.pts"), pts)
    np.testing.assert_array_equal(got["points"], [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(got["colors"][1], [40, 50, 60])


def test_pts_may_begin_with_names_or_comments_before_its_count(tmp_path):
    """CloudCompare writes its header so; it was said that line 1 should be a number and that points were too many."""
    text = "# saved by hand\n//X Y Z R G B\n\n2\n1 2 3 10 20 30\n4 5 6 40 50 60\n1\n7 8 9 1 2 3\n"
    got = read(saved(tmp_path, text, "a.pts"), pts)
    np.testing.assert_array_equal(got["points"], [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(got["colors"][1], [40, 50, 60])
    with pytest.raises(FormatError, match="promises 3 points from line 3 on"):
        read(saved(tmp_path, "//X Y Z\n3\n1 2 3\n4 5 6\n", "a.pts"), pts)


@pytest.mark.parametrize("text", ["3\n1 2 3\n4 5 6\n", "1\n1 2 3\n4 5 6\n", "2\n1 2 3\n4 5 6\n5\n1 2 3\n"])
def test_pts_with_another_count_than_promised_is_refused(tmp_path, text):
    with pytest.raises(FormatError, match="promise"):
        read(saved(tmp_path, text, "a.pts"), pts)


numbers = st.floats(-1e7, 1e7, allow_nan=False).map(lambda v: round(v, 6))


@given(
    points=st.lists(st.tuples(numbers, numbers, numbers), min_size=2, max_size=20, unique=True),
    separator=st.sampled_from([" ", ",", ";", "\t", "  ", ", "]),
    names=st.booleans(),
    count=st.booleans(),
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_points_come_back_as_they_were_written(tmp_path, points, separator, names, count):
    lines = [separator.join(f"{value:.6f}" for value in point) for point in points]
    head = ([separator.join("XYZ")] if names else []) + ([str(len(points))] if count else [])
    got = read(saved(tmp_path, "\n".join([*head, *lines]) + "\n"))["points"]
    origin = [p for p in points if not any(p)]
    expected = [p for p in points if any(p)] + origin  # a point at 0 0 0 comes last
    np.testing.assert_allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("n", [10, 200_000])  # parsed in two ways
def test_words_that_are_no_numbers_are_refused_in_large_files_as_in_small_ones(tmp_path, n):
    rows = [f"{k}.125 {k}.250 1.500" for k in range(n)]
    rows[5] = "nan NaN -nan"
    saved(tmp_path, "\n".join(rows) + "\n")
    assert read(tmp_path / "a.txt")["points"].shape == (n - 1, 3)
    rows[7] = "7.125 NA 1.500"
    with pytest.raises(FormatError, match="line 8 has 'NA', which is no number"):
        read(saved(tmp_path, "\n".join(rows) + "\n"))


@pytest.mark.parametrize(
    ("names", "row"),
    [
        ("//X Y Z Rf Gf Bf Intensity", "1 2 {k} 0.2 0.4 1 51"),
        ("//X Y Z Rf Gf Bf Af Intensity Nx Ny Nz", "1 2 {k} 0.2 0.4 1 1 51 0 0 1"),
        ("//X Y Z R G B Scalar_R Scalar_G Scalar_B Intensity", "1 2 {k} 51 102 255 7 7 7 51"),
        ("//X,Y,Z,R,G,B,scalar_Intensity,Scalar_field", "1,2,{k},51,102,255,51,9"),
        ("//X Y Z scalar_R scalar_G scalar_B scalar_Reflectance", "1 2 {k} 51 102 255 51"),
        ("//X Y Z R G B Reflectance Intensity scalar_X", "1 2 {k} 51 102 255 -12.5 51 77"),
    ],
)
def test_names_of_cloudcompare_are_understood_and_lesser_ones_yield(tmp_path, names, row):
    """Colours and their copies as scalar fields, or intensity beside reflectance, were refused as named twice."""
    got = read(saved(tmp_path, names + "\n" + "".join(row.format(k=k + 0.5) + "\n" for k in range(4))))
    assert got["points"][:, 0].tolist() == [1.0] * 4
    assert got["colors"].tolist() == [[51, 102, 255]] * 4
    np.testing.assert_allclose(got["intensity"], 0.2, atol=1e-6)
