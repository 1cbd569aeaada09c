"""LAS and LAZ: coordinates, intensity, colours; headers that lie and decoders that panic end in one clear error."""

import struct

import laspy
import numpy as np
import pytest

from projects.errors import FormatError, ShapeError
from projects.formats import las, read_scans, write_las
from projects.model import PointCloud

FAR = np.array([657_123.4, 5_400_321.0, 310.0])


@pytest.fixture
def cloud(rng):
    n = 4000
    return PointCloud(rng.normal(size=(n, 3)) * 4 + FAR, intensity=rng.random(n), colors=rng.integers(0, 256, (n, 3)))


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_points_come_back_to_half_a_micrometre(tmp_path, cloud, read_whole, suffix):
    write_las(tmp_path / f"a{suffix}", cloud)
    (got,) = read_whole(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(got.cloud.points, cloud.points, rtol=0, atol=0.51e-6)
    np.testing.assert_allclose(got.cloud.intensity, cloud.intensity, atol=0.51 / 65535)
    np.testing.assert_array_equal(got.cloud.colors, cloud.colors)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_extra_dimensions_keep_their_names_kinds_and_unknown_values(tmp_path, cloud, suffix):
    distance = np.where(np.arange(4000) % 3, 1e-4, np.nan).astype(np.float32)
    region = np.arange(4000, dtype=np.int32)
    write_las(tmp_path / f"a{suffix}", cloud, {"distance": distance, "lod95": abs(distance), "region": region})
    got = laspy.read(tmp_path / f"a{suffix}")
    assert list(got.point_format.extra_dimension_names) == ["distance", "lod95", "region"]
    np.testing.assert_array_equal(got.distance, distance)
    assert (got.distance.dtype, got.region.dtype) == (np.float32, np.int32)
    np.testing.assert_array_equal(got.region, region)


def test_points_spread_over_many_kilometres_get_a_coarser_step(tmp_path):
    points = np.array([[0.0, 0, 0], [9_000.0, 1, 2], [5.0, 5, 5]])
    write_las(tmp_path / "a.las", PointCloud(points))
    assert laspy.read(tmp_path / "a.las").header.scales[0] == 1e-5


def test_what_does_not_fit_is_not_written(tmp_path, cloud):
    with pytest.raises(ShapeError, match="extra dimension 'short'"):
        write_las(tmp_path / "a.las", cloud, {"short": np.zeros(3)})
    with pytest.raises(FormatError, match="not finite"):
        write_las(tmp_path / "a.las", PointCloud([[np.nan, 0, 0]]))
    with pytest.raises(FormatError, match=r"\.las or \.laz"):
        write_las(tmp_path / "a.xyz", cloud)
    assert not list(tmp_path.iterdir())


def test_eight_bit_colours_and_withheld_points_are_understood(tmp_path, read_whole):
    made = laspy.create(point_format=3, file_version="1.2")
    made.header.scales = [0.001] * 3
    made.x, made.y, made.z = np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), np.array([7.0, 8, 9])
    made.red, made.green, made.blue = [255, 1, 0], [0, 2, 0], [7, 3, 0]
    made.withheld = [0, 0, 1]
    made.write(tmp_path / "a.las")
    (got,) = read_whole(tmp_path / "a.las")
    np.testing.assert_array_equal(got.cloud.colors, [[255, 0, 7], [1, 2, 3]])
    assert got.dropped == {"flagged invalid": 1}
    assert got.cloud.intensity is None  # zero throughout: absent, not black


def patched(path, offset, kind, value):
    """Change a number of a file's header."""
    whole = bytearray(path.read_bytes())
    struct.pack_into(kind, whole, offset, value)
    path.write_bytes(whole)
    return path


@pytest.mark.parametrize(
    ("offset", "kind", "value", "message"),
    [
        (247, "<Q", 4001, r"promises 4001 points, 4000 are there"),
        (247, "<Q", 2**60, r"promises 1152921504606846976 points, 4000 are there"),
        (247, "<Q", 3999, r"promises 3999 points, 4000 are there"),
        (96, "<I", 2**31, "points begin at byte 2147483648"),
        (94, "<H", 3, "points begin at byte"),
        (100, "<I", 2**31, "counts 2147483648 records before the points"),
        (105, "<H", 4, "point format 7 with 4 bytes a point"),
        (104, "B", 40, "point format 40"),
        (131, "<d", 0.0, "scales coordinates by"),
        (139, "<d", float("nan"), "scales coordinates by"),
    ],
    ids=[
        "one more",
        "endless",
        "one less",
        "offset",
        "header size",
        "records",
        "record length",
        "format",
        "scale 0",
        "scale nan",
    ],
)
def test_header_that_lies_is_refused(tmp_path, cloud, read_whole, offset, kind, value, message):
    write_las(tmp_path / "a.las", cloud)
    with pytest.raises(FormatError, match=message):
        read_whole(patched(tmp_path / "a.las", offset, kind, value))


def test_extended_record_of_endless_length_is_refused(tmp_path, cloud):
    write_las(tmp_path / "a.las", cloud)
    whole = bytearray((tmp_path / "a.las").read_bytes())
    struct.pack_into("<QI", whole, 235, len(whole), 1)
    whole += struct.pack("<H16sHQ32s", 0, b"x", 1, 2**62, b"")
    (tmp_path / "a.las").write_bytes(whole)
    with pytest.raises(FormatError, match="records after the points that are not there"):
        las.require_sound_header(str(tmp_path / "a.las"))


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.9, 0.999])
def test_file_that_is_cut_off_is_refused(tmp_path, cloud, suffix, share):
    write_las(tmp_path / f"a{suffix}", cloud)
    whole = (tmp_path / f"a{suffix}").read_bytes()
    (tmp_path / f"cut{suffix}").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(FormatError, match=rf"cut\{suffix}: "):
        [list(stream.chunks()) for stream in read_scans(tmp_path / f"cut{suffix}")]


def test_every_way_in_which_the_decoder_fails_is_a_format_error(tmp_path, cloud):
    write_las(tmp_path / "a.laz", cloud)
    whole = (tmp_path / "a.laz").read_bytes()
    n_points = struct.unpack_from("<I", whole, 96)[0]
    for k, change in enumerate([(n_points, b"\xff" * 8), (n_points + 8, b"\xff" * 64), (450, b"\0" * 30)]):
        at, new = change
        (tmp_path / f"{k}.laz").write_bytes(whole[:at] + new + whole[at + len(new) :])
        with pytest.raises(FormatError, match=rf"{k}\.laz: "):
            [list(stream.chunks()) for stream in read_scans(tmp_path / f"{k}.laz")]


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_intensity_and_colours_that_begin_late_in_the_file_are_read(tmp_path, rng, read_whole, suffix):
    """Of a scan whose first million points were black all lost their colours and intensities."""
    n, late = 1_000_200, slice(1_000_100, None)
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales = np.full(3, 1e-4)
    made = laspy.LasData(header)
    made.x, made.y, made.z = rng.random((3, n))
    values = np.zeros(n, np.uint16)
    values[late] = 25_700
    made.intensity = made.red = made.green = made.blue = values
    made.write(tmp_path / f"a{suffix}")
    (got,) = read_whole(tmp_path / f"a{suffix}")
    assert got.cloud.colors[late].tolist() == [[100, 100, 100]] * 100
    assert not got.cloud.colors[:1_000_100].any()
    np.testing.assert_allclose(got.cloud.intensity[late], 25_700 / 65_535, rtol=1e-6)


@pytest.mark.parametrize(("kind", "version", "n_noise"), [(6, "1.4", 3), (0, "1.2", 2)])
def test_points_classified_as_noise_are_counted_and_left_out(tmp_path, read_whole, kind, version, n_noise):
    """Class 18 is high noise from point format 6 on, and reserved before. A withheld point is counted as that alone."""
    made = laspy.create(point_format=kind, file_version=version)
    made.header.scales = [0.001] * 3
    made.x, made.y, made.z = np.arange(1.0, 8.0), np.arange(1.0, 8.0) ** 2, np.ones(7)
    made.classification, made.withheld = [7, 0, 18, 1, 7, 7, 2], [0, 0, 0, 0, 0, 1, 1]
    made.write(tmp_path / "a.las")
    (got,) = read_whole(tmp_path / "a.las")
    assert got.dropped == {"flagged invalid": 2, "classified as noise": n_noise}
    assert got.cloud.points[:, 0].round(3).tolist() == ([2.0, 4.0] if kind else [2.0, 3.0, 4.0])


def test_a_file_that_holds_noise_alone_says_so(tmp_path, read_whole):
    made = laspy.create(point_format=6, file_version="1.4")
    made.x, made.y, made.z = np.arange(3.0), np.arange(3.0), np.arange(3.0)
    made.classification = [7, 7, 18]
    made.write(tmp_path / "a.las")
    with pytest.raises(FormatError, match=r"none of its 3 points is a measurement \(classified as noise: 3"):
        read_whole(tmp_path / "a.las")
