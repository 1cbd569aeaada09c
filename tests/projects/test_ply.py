"""PLY: every encoding and order of properties gives the same points; what is cut off or misread is refused."""

import numpy as np
import pytest

from projects.errors import FormatError
from projects.formats import ply
from projects.formats.measured import keep_measurements

POINTS = np.array([[1.5, 2.25, -3.0], [4.0, 5.5, 6.125], [7.0, 8.0, 9.5]])
ENDIAN = {"binary_little_endian": "<", "binary_big_endian": ">"}


def read(path):
    (header,) = ply.list_scans(str(path))
    blocks = [columns for columns, _ in keep_measurements(ply.read_scan(str(path), header), header.is_centred)]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def head(encoding, *lines):
    return "\n".join(["ply", f"format {encoding} 1.0", *lines, "end_header"]) + "\n"


XYZ = ("element vertex 3", "property double x", "property double y", "property double z")


def write(path, encoding, kinds, extra=(), body_after=b"", newline="\n"):
    """Write POINTS with properties of `kinds` (name -> numpy type) and lines `extra` after them."""
    names = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    values = {"x": POINTS[:, 0], "y": POINTS[:, 1], "z": POINTS[:, 2], "red": [1, 2, 3], "green": [4, 5, 6],
              "blue": [7, 8, 255], "nx": [0, 0, 1], "ny": [0, 1, 0], "nz": [1, 0, 0], "scalar_Intensity": [0, 0.5, 1],
              "confidence": [9, 9, 9]}  # fmt: skip
    lines = [f"property {names[kind]} {name}" for name, kind in kinds.items()]
    text = head(encoding, "comment made by hand", "element vertex 3", *lines, *extra).replace("\n", newline)
    if encoding == "ascii":
        rows = zip(*(values[name] for name in kinds), strict=True)
        body = "".join(" ".join(str(v) for v in row) + "\n" for row in rows).encode()
    else:
        records = np.zeros(3, [(name, ENDIAN[encoding] + kind) for name, kind in kinds.items()])
        for name in kinds:
            records[name] = values[name]
        body = records.tobytes()
    path.write_bytes(text.encode() + body + body_after)
    return path


ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]
ALL = {"confidence": "f4", "z": "f8", "x": "f8", "red": "u1", "nx": "f4", "y": "f8", "green": "u1", "blue": "u1",
       "ny": "f4", "nz": "f4", "scalar_Intensity": "f4"}  # fmt: skip


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_properties_are_found_by_name_in_any_order(tmp_path, encoding, newline):
    got = read(write(tmp_path / "a.ply", encoding, ALL, newline=newline))
    np.testing.assert_array_equal(got["points"], POINTS)
    np.testing.assert_array_equal(got["colors"], [[1, 4, 7], [2, 5, 8], [3, 6, 255]])
    np.testing.assert_array_equal(got["normals"], [[0, 0, 1], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(got["intensity"], np.float32([0, 0.5, 1]))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_unknown_word_in_the_header_is_passed_over(tmp_path, encoding):
    path = write(tmp_path / "a.ply", encoding, {"x": "f4", "y": "f4", "z": "f4"}, extra=["epoch 2021-07-01"])
    np.testing.assert_array_equal(read(path)["points"], POINTS)


def test_unknown_word_that_hides_a_property_is_refused(tmp_path):
    path = write(tmp_path / "a.ply", "binary_little_endian", {"x": "f4", "y": "f4", "z": "f4", "red": "u1"})
    path.write_bytes(path.read_bytes().replace(b"property uchar red", b"propertx uchar red"))
    with pytest.raises(FormatError, match=r"goes on for 3 bytes .* a line that PLY does not know: .propertx uchar red"):
        read(path)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_elements_with_lists_before_the_points_are_skipped(tmp_path, encoding):
    order = ENDIAN.get(encoding, "")
    text = head(encoding, "element junk 2", "property list uchar int a", "property float b", *XYZ)
    if encoding == "ascii":
        body = b"2 5 6 0.5\n3 1 2 3 1.5\n" + "".join(" ".join(map(str, p)) + "\n" for p in POINTS).encode()
    else:
        junk = [np.array(v, order + k).tobytes() for v, k in ((2, "u1"), ([5, 6], "i4"), (0.5, "f4"), (3, "u1"),
                                                              ([1, 2, 3], "i4"), (1.5, "f4"))]  # fmt: skip
        body = b"".join(junk) + POINTS.astype(order + "f8").tobytes()
    (tmp_path / "a.ply").write_bytes(text.encode() + body)
    np.testing.assert_array_equal(read(tmp_path / "a.ply")["points"], POINTS)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("mixed", [False, True])
def test_faces_become_triangles(tmp_path, encoding, mixed):
    polygons = [[0, 1, 2], [2, 1, 0, 1]] if mixed else [[0, 1, 2], [2, 1, 0]]
    extra = ["element face 2", "property list uchar uint vertex_indices", "property uchar tag"]
    if encoding == "ascii":
        body = "".join(f"{len(p)} {' '.join(map(str, p))} 7\n" for p in polygons).encode()
    else:
        kinds = ENDIAN[encoding] + "u4"
        body = b"".join(bytes([len(p)]) + np.array(p, kinds).tobytes() + b"\7" for p in polygons)
    path = write(tmp_path / "a.ply", encoding, {"x": "f8", "y": "f8", "z": "f8"}, extra, body)
    mesh = ply.read_mesh(str(path))
    expected = [[0, 1, 2], [2, 1, 0], [2, 0, 1]] if mixed else [[0, 1, 2], [2, 1, 0]]
    np.testing.assert_array_equal(mesh["faces"], expected)
    np.testing.assert_array_equal(mesh["points"], POINTS)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("n_cut", [1, 7, 30])
def test_file_that_is_cut_off_is_refused(tmp_path, encoding, n_cut):
    path = write(tmp_path / "a.ply", encoding, {"x": "f8", "y": "f8", "z": "f8"})
    path.write_bytes(path.read_bytes()[: -n_cut - (encoding == "ascii")])
    with pytest.raises(FormatError, match=r"promises 3|cut off|has \d values"):
        read(path)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "ascii"])
def test_mesh_that_is_cut_off_is_refused(tmp_path, encoding):
    faces = b"\3\0\0\0\0\1\0\0\0\2\0\0\0" * 4 if encoding != "ascii" else b"3 0 1 2\n" * 4
    extra = ["element face 4", "property list uchar int vertex_index"]
    path = write(tmp_path / "a.ply", encoding, {"x": "f8", "y": "f8", "z": "f8"}, extra, faces)
    assert len(ply.read_mesh(str(path))["faces"]) == 4
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(FormatError, match=r"cut off|fewer numbers"):
        ply.read_mesh(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n", "no end"),
        ("ply\nformat ebcdic 1.0\nend_header\n", "names none of the formats"),
        ("ply\nformat ascii 1.0\nend_header\n", "no element vertex"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n", "x, y, z"),
        ("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "line 3 of its header"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty complex x\nend_header\n", "line 4 of its header"),
    ],
)
def test_header_that_makes_no_sense_is_refused(tmp_path, text, message):
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(FormatError, match=message):
        read(tmp_path / "a.ply")


def test_doubles_far_from_the_origin_are_exact(tmp_path):
    far = POINTS + np.array([665_187.522077, 5_648_349.895035, 241.767693])
    (tmp_path / "a.ply").write_bytes(head("binary_little_endian", *XYZ).encode() + far.tobytes())
    np.testing.assert_array_equal(read(tmp_path / "a.ply")["points"], far)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian"])
def test_count_that_is_too_small_is_refused(tmp_path, encoding):
    path = write(tmp_path / "a.ply", encoding, {"x": "f8", "y": "f8", "z": "f8"})
    path.write_bytes(path.read_bytes().replace(b"element vertex 3", b"element vertex 2"))
    with pytest.raises(FormatError, match="after what its header promises"):
        read(path)


def test_lines_after_the_number_promised_are_counted_and_many_are_refused(tmp_path, read_whole):
    path = write(tmp_path / "a.ply", "ascii", {"x": "f8", "y": "f8", "z": "f8"})
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"element vertex 3", b"element vertex 2"))
    (got,) = read_whole(path)
    np.testing.assert_array_equal(got.cloud.points, POINTS[:2])
    assert got.dropped == {"after the number promised": 1}
    path.write_bytes(whole.replace(b"element vertex 3", b"element vertex 1"))
    with pytest.raises(FormatError, match="goes on for 2 lines"):
        read(path)


@pytest.mark.parametrize("name", ["scalar_Intensity", "scalar_Reflectance", "Reflectance", "scalar_intensity"])
def test_scalar_fields_of_cloudcompare_are_intensity_and_colours_and_never_coordinates(tmp_path, name):
    lines = [f"property float {n}" for n in ("scalar_X", "x", "y", "z", name, "scalar_R", "scalar_G", "scalar_B")]
    rows = ["99 1 2 3 0 255 0 0", "99 2 2 3 100 0 9 0", "99 3 2 3 255 0 0 7"]
    (tmp_path / "a.ply").write_text(head("ascii", "element vertex 3", *lines) + "\n".join(rows) + "\n")
    got = read(tmp_path / "a.ply")
    assert got["points"][:, 0].tolist() == [1, 2, 3]
    np.testing.assert_allclose(got["intensity"], np.array([0, 100, 255]) / 255, atol=1e-6)
    np.testing.assert_array_equal(got["colors"], [[255, 0, 0], [0, 9, 0], [0, 0, 7]])


def test_colours_come_before_their_copies_as_scalar_fields(tmp_path):
    names = ("x", "y", "z", "red", "green", "blue", "scalar_R", "scalar_G", "scalar_B")
    (tmp_path / "a.ply").write_text(
        head("ascii", "element vertex 2", *[f"property float {n}" for n in names])
        + "1 2 3 10 20 30 1 1 1\n2 2 3 40 50 60 1 1 1\n"
    )
    np.testing.assert_array_equal(read(tmp_path / "a.ply")["colors"], [[10, 20, 30], [40, 50, 60]])
