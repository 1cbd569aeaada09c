"""E57: what an instrument writes comes back; what is invalid is dropped and counted; what is broken is refused."""

import dataclasses
import datetime

import numpy as np
import pye57
import pytest
from pye57 import libe57

from projects.errors import FormatError, ParameterError
from projects.formats import read_scans, write_e57, write_ptx
from projects.model import PointCloud, Scan
from projects.transforms import apply, rotation_from_vector

HALF_STEP = 0.51e-6  # m, coordinates are stored to a micrometre


@pytest.fixture
def stations(rng):
    """Return two scans with poses, grid, intensity and colour; the second one far from the origin."""
    scans = []
    for k, where in enumerate(([1.0, 2.0, 3.0], [657_000.0, 5_400_000.0, 310.0])):
        n = 500
        rows, columns = np.divmod(rng.choice(40 * 30, n, replace=False), 30)
        T_project_scanner = np.eye(4)
        T_project_scanner[:3, :3] = rotation_from_vector(rng.normal(size=3))
        T_project_scanner[:3, 3] = where
        cloud = PointCloud(rng.normal(size=(n, 3)) * 9, intensity=rng.random(n), colors=rng.integers(0, 256, (n, 3)))
        scans.append(Scan(f"S{k}", cloud, T_project_scanner, rows=rows, columns=columns, scanner="Model 7"))
    return scans


def assert_same_scan(got, expected):
    np.testing.assert_allclose(got.cloud.points, expected.cloud.points, atol=HALF_STEP)
    np.testing.assert_allclose(got.pose, expected.pose, atol=1e-9)
    np.testing.assert_array_equal(got.rows, expected.rows)
    np.testing.assert_array_equal(got.columns, expected.columns)
    np.testing.assert_array_equal(got.cloud.intensity, expected.cloud.intensity)
    np.testing.assert_array_equal(got.cloud.colors, expected.cloud.colors)


def test_scans_come_back_with_pose_grid_intensity_and_colour(tmp_path, stations, read_whole):
    write_e57(tmp_path / "a.e57", stations)
    got = read_whole(tmp_path / "a.e57")
    assert [scan.name for scan in got] == ["a.e57#1", "a.e57#2"]
    for ours, theirs in zip(stations, got, strict=True):
        assert_same_scan(theirs, ours)
        assert theirs.dropped == {}


def test_another_program_reads_the_same_pose_and_points(tmp_path, stations):
    write_e57(tmp_path / "a.e57", stations)
    with pye57.E57(str(tmp_path / "a.e57")) as document:
        for k, scan in enumerate(stations):
            header = document.get_header(k)
            np.testing.assert_allclose(header.rotation_matrix, scan.pose[:3, :3], atol=1e-12)
            np.testing.assert_allclose(header.translation, scan.pose[:3, 3])
            fields = document.read_scan_raw(k)
            np.testing.assert_allclose(fields["cartesianY"], scan.cloud.points[:, 1], atol=HALF_STEP)
            np.testing.assert_array_equal(fields["columnIndex"], scan.columns)


def test_characters_that_xml_does_not_have_leave_a_file_that_others_read(tmp_path, stations, read_whole):
    odd = "soft\x0bbreak \x07 \x1b[31m \ufffe & <b> ]]> žΩ"
    named = [dataclasses.replace(scan, name=odd) for scan in stations]
    write_e57(tmp_path / "a.e57", named, description=odd)
    read = pye57.E57(str(tmp_path / "a.e57"))
    header = read.get_header(1)
    shown = "soft\ufffdbreak \ufffd \ufffd[31m \ufffd & <b> ]]> žΩ"
    assert header.node["name"].value() == shown
    assert header.node["description"].value() == shown
    assert len(read_whole(tmp_path / "a.e57")) == 2


def test_cells_without_return_are_written_flagged_and_dropped_when_read(tmp_path, stations, read_whole):
    write_e57(tmp_path / "full.e57", stations[:1], fill_grid=True)
    (stream,) = read_scans(tmp_path / "full.e57")
    n_cells = (stations[0].rows.max() + 1) * (stations[0].columns.max() + 1)
    assert (stream.n_declared, stream.is_grid, stream.scanner, stream.label) == (n_cells, True, "Model 7", "S0")
    (got,) = read_whole(tmp_path / "full.e57")
    assert got.dropped == {"flagged invalid": n_cells - 500}
    order = np.lexsort((stations[0].rows, stations[0].columns))
    assert_same_scan(got, stations[0].take(order))


def test_several_points_in_a_cell_cannot_fill_a_grid(tmp_path, stations):
    scan = stations[0]
    twice = scan.take(np.r_[0, 0:500])
    with pytest.raises(FormatError, match="several points in one cell"):
        write_e57(tmp_path / "a.e57", [twice], fill_grid=True)
    assert not list(tmp_path.iterdir())


def test_unit_scales_points_and_pose_alike(tmp_path, stations, read_whole):
    write_e57(tmp_path / "a.e57", stations[:1])
    (got,) = read_whole(tmp_path / "a.e57", unit=0.001)
    np.testing.assert_allclose(got.cloud.points, 0.001 * stations[0].cloud.points, atol=1e-9)
    np.testing.assert_allclose(got.pose[:3, 3], [0.001, 0.002, 0.003])
    np.testing.assert_allclose(got.pose[:3, :3], stations[0].pose[:3, :3], atol=1e-12)


def test_scan_about_another_point_is_written_about_its_scanner(tmp_path, stations, read_whole):
    scan = dataclasses.replace(stations[0], origin=np.array([0.0, 0.0, 1.0]))
    write_e57(tmp_path / "a.e57", [scan])
    (got,) = read_whole(tmp_path / "a.e57")
    np.testing.assert_allclose(apply(got.pose, got.cloud.points), apply(scan.pose, scan.cloud.points), atol=1e-6)
    np.testing.assert_allclose(got.pose[:3, 3], apply(scan.pose, scan.origin))
    np.testing.assert_array_equal(got.origin, np.zeros(3))


def test_unknown_intensity_stays_unknown(tmp_path, stations, read_whole):
    cloud = stations[0].cloud
    intensity = np.where(np.arange(len(cloud)) % 4, cloud.intensity, np.nan)
    scan = dataclasses.replace(stations[0], cloud=dataclasses.replace(cloud, intensity=intensity))
    write_e57(tmp_path / "a.e57", [scan])
    (got,) = read_whole(tmp_path / "a.e57")
    np.testing.assert_array_equal(got.cloud.intensity, intensity.astype(np.float32))


@pytest.mark.parametrize(("high", "stored", "expected"), [(255, 200, 200), (65535, 257 * 200, 200), (1, 1, 255)])
def test_colours_are_scaled_by_their_limits(tmp_path, read_whole, high, stored, expected):
    names = ("colorRed", "colorGreen", "colorBlue")
    kinds = {name: lambda i: libe57.IntegerNode(i, 0, 0, high) for name in names}
    write_raw(tmp_path / "c.e57", {**XYZ, **{name: [0, stored, 0] for name in names}}, kinds=kinds)
    (got,) = read_whole(tmp_path / "c.e57")
    assert got.cloud.colors.tolist() == [[0] * 3, [expected] * 3, [0] * 3]


def test_colours_beyond_the_limits_that_the_file_states_are_as_bright_as_these(tmp_path, read_whole):
    names = ("colorRed", "colorGreen", "colorBlue")
    kinds = {name: lambda i: libe57.IntegerNode(i, 0, 0, 255) for name in names}
    limits = {f"{name}{end}": value for name in names for end, value in (("Minimum", 50), ("Maximum", 200))}
    write_raw(tmp_path / "c.e57", {**XYZ, **{name: [0, 125, 255] for name in names}}, kinds=kinds,
              extra={"colorLimits": limits})  # fmt: skip
    (got,) = read_whole(tmp_path / "c.e57")
    assert got.cloud.colors.tolist() == [[0] * 3, [128] * 3, [255] * 3]


def write_raw(path, fields, *, kinds=None, extra=None, pose=None):
    """Write one scan with any point fields; `kinds` name -> node maker, `extra` header entries."""
    with pye57.E57(str(path), mode="w") as document:
        image = document.image_file
        scan, prototype = libe57.StructureNode(image), libe57.StructureNode(image)
        scan.set("guid", libe57.StringNode(image, "{1}"))
        for name, entries in (extra or {}).items():
            node = libe57.StructureNode(image)
            for key, value in entries.items():
                node.set(key, libe57.FloatNode(image, value))
            scan.set(name, node)
        if pose is not None:
            node = libe57.StructureNode(image)
            part = libe57.StructureNode(image)
            for key, value in zip("wxyz", pose, strict=True):
                part.set(key, libe57.FloatNode(image, value))
            node.set("rotation", part)
            scan.set("pose", node)
        for name in fields:
            prototype.set(name, (kinds or {}).get(name, libe57.FloatNode)(image))
        points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
        scan.set("points", points)
        document.data3d.append(scan)
        buffers = libe57.VectorSourceDestBuffer()
        arrays = {name: np.asarray(values, dtype=float) for name, values in fields.items()}
        for name, values in arrays.items():
            buffers.append(libe57.SourceDestBuffer(image, name, values, len(values), True, True))
        writer = points.writer(buffers)
        writer.write(len(next(iter(arrays.values()))))
        writer.close()


XYZ = {"cartesianX": [1.0, 2.0, 3.0], "cartesianY": [4.0, 5.0, 6.0], "cartesianZ": [7.0, 8.0, 9.5]}


def test_spherical_coordinates_become_cartesian(tmp_path, read_whole):
    azimuth, elevation = np.array([0.3, 2.0, -1.0]), np.array([0.1, -0.7, 1.2])
    write_raw(
        tmp_path / "s.e57",
        {"sphericalRange": [2.0, 3.0, 0.0], "sphericalAzimuth": azimuth, "sphericalElevation": elevation},
    )
    (got,) = read_whole(tmp_path / "s.e57")
    assert got.dropped == {"no return": 1}
    expected = [
        [r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)]
        for r, a, e in zip([2.0, 3.0], azimuth, elevation, strict=False)
    ]
    np.testing.assert_allclose(got.cloud.points, expected, rtol=1e-12)


def test_points_flagged_invalid_and_not_finite_are_counted_apart(tmp_path, read_whole):
    fields = {**XYZ, "cartesianInvalidState": [0, 2, 0]}
    fields["cartesianX"] = [1.0, 2.0, np.inf]
    write_raw(tmp_path / "i.e57", fields, kinds={"cartesianInvalidState": lambda i: libe57.IntegerNode(i, 0, 0, 2)})
    (got,) = read_whole(tmp_path / "i.e57")
    assert got.dropped == {"flagged invalid": 1, "not finite": 1}
    np.testing.assert_array_equal(got.cloud.points, [[1.0, 4.0, 7.0]])


@pytest.mark.parametrize(
    ("kind", "limits", "stored", "expected"),
    [
        (lambda i: libe57.FloatNode(i), (10.0, 30.0), [10.0, 20.0, 30.0], [0.0, 0.5, 1.0]),
        (lambda i: libe57.IntegerNode(i, 0, 0, 2000), None, [0, 500, 2000], [0.0, 0.25, 1.0]),
        (lambda i: libe57.FloatNode(i), None, [-4.0, 0.0, 12.0], [0.0, 0.25, 1.0]),
        (lambda i: libe57.FloatNode(i), None, [0.2, 0.3, 0.4], [0.2, 0.3, 0.4]),
        (lambda i: libe57.FloatNode(i), (0.0, 1.0), [0.2, 7.0, np.nan], [0.2, 1.0, np.nan]),
    ],
    ids=["limits stated", "bounds of an integer", "unbounded", "unbounded within 0 to 1", "one beyond its limits"],
)
def test_intensity_is_scaled_to_one_by_what_the_file_says(tmp_path, read_whole, kind, limits, stored, expected):
    extra = (
        {"intensityLimits": dict(zip(("intensityMinimum", "intensityMaximum"), limits, strict=True))} if limits else {}
    )
    write_raw(tmp_path / "i.e57", {**XYZ, "intensity": stored}, kinds={"intensity": kind}, extra=extra)
    (got,) = read_whole(tmp_path / "i.e57")
    np.testing.assert_allclose(got.cloud.intensity, expected, atol=1e-6)


def test_file_that_decodes_to_zeros_is_refused(tmp_path, read_whole):
    write_raw(tmp_path / "zeros.e57", {name: np.zeros(50) for name in XYZ})
    with pytest.raises(FormatError, match=r"zeros\.e57: none of its 50 points is a measurement \(at exactly 0 0 0: 50"):
        read_whole(tmp_path / "zeros.e57")


def test_file_that_decodes_to_one_place_is_refused(tmp_path, read_whole):
    write_raw(tmp_path / "one.e57", {name: np.full(50, 1.5) for name in XYZ})
    with pytest.raises(FormatError, match="all its 50 points lie at one place"):
        read_whole(tmp_path / "one.e57")


def test_one_point_at_the_origin_of_a_cloud_that_is_no_grid_is_kept(tmp_path, read_whole):
    write_raw(tmp_path / "corner.e57", {name: [0.0, 1.0, 2.0] for name in XYZ})
    (got,) = read_whole(tmp_path / "corner.e57")
    assert len(got.cloud) == 3
    assert got.dropped == {}


def test_pose_that_is_no_rotation_is_refused(tmp_path):
    write_raw(tmp_path / "p.e57", XYZ, pose=(0.0, 0.0, 0.0, 0.0))
    with pytest.raises(FormatError, match="quaternion of length 0"):
        list(read_scans(tmp_path / "p.e57"))


def test_scan_without_pose_has_none(tmp_path):
    write_raw(tmp_path / "n.e57", XYZ)
    (stream,) = read_scans(tmp_path / "n.e57")
    assert stream.pose is None
    assert not stream.is_origin_stated


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9, 0.999])
def test_file_that_is_cut_off_is_refused(tmp_path, stations, share):
    write_e57(tmp_path / "a.e57", stations)
    whole = (tmp_path / "a.e57").read_bytes()
    (tmp_path / "cut.e57").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(FormatError, match=r"cut\.e57: "):
        [list(stream.chunks()) for stream in read_scans(tmp_path / "cut.e57")]


def test_changed_byte_fails_the_checksum(tmp_path, stations):
    write_e57(tmp_path / "a.e57", stations)
    whole = bytearray((tmp_path / "a.e57").read_bytes())
    whole[3000] ^= 1
    (tmp_path / "b.e57").write_bytes(whole)
    with pytest.raises(FormatError, match="checksum"):
        [list(stream.chunks()) for stream in read_scans(tmp_path / "b.e57")]


def test_nothing_to_write_is_refused(tmp_path):
    with pytest.raises(FormatError, match="no scans"):
        write_e57(tmp_path / "a.e57", [])
    empty = Scan("S", PointCloud(np.empty((0, 3))), np.eye(4))
    with pytest.raises(FormatError, match="S holds no points"):
        write_e57(tmp_path / "a.e57", [empty])


@pytest.mark.parametrize("change", [{"pose": np.diag([-1.0, -1.0, 1.0, 1.0])}, {"origin": np.ones(3)}])
@pytest.mark.parametrize("write", [write_e57, write_ptx])
def test_blocks_of_one_scan_that_were_scanned_from_elsewhere_are_refused(tmp_path, stations, write, change):
    blocks = [dataclasses.replace(stations[0].take(stations[0].columns < 9), pose=np.eye(4))]
    blocks.append(dataclasses.replace(stations[0].take(stations[0].columns >= 9), **{"pose": np.eye(4), **change}))
    with pytest.raises(FormatError, match=f"a block of scan S0 has another {next(iter(change))} than its first one"):
        write(tmp_path / "a", [iter(blocks)])
    assert not (tmp_path / "a").exists()


def test_points_without_a_place_in_the_grid_cost_the_scan_its_grid_and_that_is_told(tmp_path, stations, read_whole):
    first, second = stations
    off = dataclasses.replace(first, rows=np.where(np.arange(500) == 3, -1, first.rows))
    assert write_e57(tmp_path / "a.e57", [off, second]) == ("S0",)
    bare, kept = read_whole(tmp_path / "a.e57")
    assert (len(bare.cloud), bare.rows) == (500, None)
    assert_same_scan(kept, second)
    blocks = [off.take(np.arange(500) >= 250), off.take(np.arange(500) < 250)]  # the second alone has one
    assert write_e57(tmp_path / "b.e57", [iter(blocks)]) == ("S0",)
    (again,) = read_whole(tmp_path / "b.e57")
    assert (len(again.cloud), again.rows) == (500, None)
    with pytest.raises(FormatError, match="S0 has points without a place in its grid"):
        write_e57(tmp_path / "c.e57", [off], fill_grid=True)
    none = dataclasses.replace(first, rows=np.full(500, -1), columns=np.full(500, -1))
    assert write_e57(tmp_path / "d.e57", [none]) == (), "what never was a grid is none that was lost"


def test_time_without_a_zone_is_refused(tmp_path, stations):
    with pytest.raises(ParameterError, match=r"acquired 2020-01-02T09:30:00 has no time zone"):
        write_e57(tmp_path / "a.e57", stations, acquired=datetime.datetime(2020, 1, 2, 9, 30))
    assert not (tmp_path / "a.e57").exists()
    write_e57(tmp_path / "a.e57", stations, acquired=datetime.datetime(2020, 1, 2, 9, 30, tzinfo=datetime.UTC))
