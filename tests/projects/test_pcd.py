"""PCD: text, binary and compressed give the same points; organised clouds keep rows and columns."""

import numpy as np
import pytest

from projects.errors import FormatError
from projects.formats import pcd
from projects.formats.measured import keep_measurements
from projects.open3d_library import load_open3d

HEAD = """# .PCD v0.7
VERSION 0.7
FIELDS x y z _ rgb intensity
SIZE 4 4 4 1 4 4
TYPE F F F U F F
COUNT 1 1 1 3 1 1
WIDTH {width}
HEIGHT {height}
VIEWPOINT {viewpoint}
POINTS {n}
DATA {data}
"""
RECORD = np.dtype([("xyz", "<f4", 3), ("pad", "u1", 3), ("rgb", "<u4"), ("intensity", "<f4")])


def read(path):
    (header,) = pcd.list_scans(str(path))
    blocks = list(keep_measurements(pcd.read_scan(str(path), header), header.is_centred))
    joined = {name: np.concatenate([block[name] for block, _ in blocks]) for name in blocks[0][0]}
    return header, joined, blocks[-1][1]


@pytest.fixture
def records(rng):
    cells = np.zeros(12, RECORD)
    cells["xyz"] = rng.integers(-4, 5, (12, 3)) + 0.5
    cells["rgb"] = 0x010203 + np.arange(12)
    cells["intensity"] = np.arange(12) * 20
    return cells


def head(data, width=12, height=1, viewpoint="0 0 0 1 0 0 0", n=None):
    return HEAD.format(width=width, height=height, viewpoint=viewpoint, n=n or width * height, data=data).encode()


def literal_lzf(body):
    """Return bytes in the LZF form that has no references."""
    return b"".join(bytes([len(part) - 1]) + part for part in (body[k : k + 32] for k in range(0, len(body), 32)))


def as_text(cells):
    rows = []
    for cell in cells:
        packed = cell["rgb"].astype("<u4").view("<f4")
        numbers = [*cell["xyz"], 0, 0, 0, packed, cell["intensity"]]
        rows.append(" ".join(f"{v:.9g}" for v in numbers))
    return ("\n".join(rows) + "\n").encode()


def as_compressed(cells):
    body = b"".join(cells[name].tobytes() if name != "xyz" else cells["xyz"].T.tobytes() for name in RECORD.names)
    packed = literal_lzf(body)
    return np.array([len(packed), len(body)], "<u4").tobytes() + packed


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_points_colours_and_intensity_are_the_same_in_every_encoding(tmp_path, records, data):
    write = {"ascii": as_text, "binary": np.ndarray.tobytes, "binary_compressed": as_compressed}[data]
    (tmp_path / "a.pcd").write_bytes(head(data) + write(records))
    _, got, _ = read(tmp_path / "a.pcd")
    np.testing.assert_array_equal(got["points"], records["xyz"])
    np.testing.assert_array_equal(got["colors"], [[1, 2, 3 + k] for k in range(12)])
    np.testing.assert_allclose(got["intensity"], np.arange(12) * 20 / 255, atol=1e-6)


@pytest.mark.parametrize("options", [{"write_ascii": True}, {}, {"compressed": True}])
def test_files_of_another_program_are_read(tmp_path, rng, options):
    open3d = load_open3d()
    points = rng.integers(-50, 50, (3000, 3)) / 8.0  # repeats, so that compression refers back
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(np.tile([0.0, 0.6, 0.8], (3000, 1)))
    open3d.io.write_point_cloud(str(tmp_path / "a.pcd"), cloud, **options)
    _, got, _ = read(tmp_path / "a.pcd")
    np.testing.assert_array_equal(got["points"], points)
    np.testing.assert_allclose(got["normals"][0], [0, 0.6, 0.8], atol=1e-6)


def test_organised_cloud_has_rows_and_columns_and_drops_what_has_no_range(tmp_path, records):
    records["xyz"][5] = np.nan
    records["xyz"][7] = 0.0
    (tmp_path / "a.pcd").write_bytes(head("binary", width=4, height=3) + records.tobytes())
    header, got, dropped = read(tmp_path / "a.pcd")
    assert header.is_grid
    assert dropped == {"not finite": 1, "no return": 1}
    assert got["rows"].tolist() == [0, 0, 0, 0, 1, 1, 2, 2, 2, 2]
    assert got["columns"].tolist() == [0, 1, 2, 3, 0, 2, 0, 1, 2, 3]


@pytest.mark.parametrize(
    ("viewpoint", "origin"),
    [
        ("0 0 0 1 0 0 0", None),
        ("1 2 3 1 0 0 0", [1, 2, 3]),
        ("1 2 3 0 0 0 0", None),
        ("1 nan 3 1 0 0 0", None),
        ("1 2 3", None),
    ],
)
def test_viewpoint_is_the_origin_where_it_is_one(tmp_path, records, viewpoint, origin):
    (tmp_path / "a.pcd").write_bytes(head("binary", viewpoint=viewpoint) + records.tobytes())
    header, _, _ = read(tmp_path / "a.pcd")
    assert header.origin == origin
    assert header.pose is None


def test_fields_in_capitals_are_read(tmp_path, records):
    path = tmp_path / "a.pcd"
    named = head("binary").replace(b"x y z _ rgb intensity", b"X Y Z _ RGB Intensity")
    path.write_bytes(named + records.tobytes())
    _, got, _ = read(path)
    np.testing.assert_array_equal(got["points"], records["xyz"])
    np.testing.assert_allclose(got["intensity"], records["intensity"] / 255.0, atol=1e-6)
    assert got["colors"][0].tolist() == [1, 2, 3]


def test_references_back_that_overlap_themselves_are_decompressed():
    assert pcd.decompress_lzf(bytes([0, 97, 0xE0, 3, 0]), 13) == b"a" * 13
    assert pcd.decompress_lzf(bytes([2, 97, 98, 99, 0x80, 2]), 9) == b"abcabcabc"


@pytest.mark.parametrize("packed", [bytes([0xE0]), bytes([0, 97, 0x20, 9]), bytes([0, 97])])
def test_damaged_compression_is_refused(packed):
    with pytest.raises(FormatError, match="damaged"):
        pcd.decompress_lzf(packed, 20)


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("n_cut", [3, 5, 40])
def test_file_that_is_cut_off_is_refused(tmp_path, records, data, n_cut):
    write = {"ascii": as_text, "binary": np.ndarray.tobytes, "binary_compressed": as_compressed}[data]
    whole = (head(data) + write(records)).rstrip(b"\n")
    (tmp_path / "a.pcd").write_bytes(whole[:-n_cut])
    with pytest.raises(FormatError, match=r"promises|cut off|has \d values"):
        read(tmp_path / "a.pcd")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("POINTS 12", "POINTS 13", "is not POINTS 13"),
        ("FIELDS x y z", "FIELDS x y w", "x y z in ascii"),
        ("SIZE 4", "SIZE 3", "no PCD header"),
        ("DATA binary", "DATA braille", "data braille"),
        ("DATA", "FACTS", "no line DATA"),
        ("TYPE F", "TYPE Q", "no PCD header"),
        ("COUNT 1", "COUNT 0", "no size"),
    ],
)
def test_header_that_makes_no_sense_is_refused(tmp_path, records, old, new, message):
    (tmp_path / "a.pcd").write_bytes(head("binary").replace(old.encode(), new.encode()) + records.tobytes())
    with pytest.raises(FormatError, match=message):
        read(tmp_path / "a.pcd")


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_count_that_is_too_small_is_refused(tmp_path, records, data):
    body = as_text(records) if data == "ascii" else records.tobytes()
    (tmp_path / "a.pcd").write_bytes(head(data, width=11) + body)
    with pytest.raises(FormatError, match=r"promises 11|goes on after line 22"):
        read(tmp_path / "a.pcd")


@pytest.mark.parametrize("data", ["ascii", "binary"])
@pytest.mark.parametrize(("names", "kind"), [("r g b", "u1"), ("red green blue", "u1"), ("R G B", "f4")])
def test_colours_as_fields_of_their_own_are_read(tmp_path, data, names, kind):
    size, letter = {"u1": ("1", "U"), "f4": ("4", "F")}[kind]
    text = f"FIELDS x y z {names}\nSIZE 4 4 4 {f'{size} ' * 3}\nTYPE F F F {f'{letter} ' * 3}\nCOUNT 1 1 1 1 1 1\n"
    text += f"WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA {data}\n"
    cells = np.zeros(2, [("xyz", "<f4", 3), ("rgb", f"<{kind}", 3)])
    cells["xyz"], cells["rgb"] = [[1, 2, 3], [4, 5, 6]], [[255, 2, 3], [0, 128, 9]]
    body = b"1 2 3 255 2 3\n4 5 6 0 128 9\n" if data == "ascii" else cells.tobytes()
    (tmp_path / "a.pcd").write_bytes(text.encode() + body)
    np.testing.assert_array_equal(read(tmp_path / "a.pcd")[1]["colors"], cells["rgb"])
