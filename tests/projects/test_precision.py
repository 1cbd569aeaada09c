"""Files in single precision far from 0: refused where the numbers are too coarse for what was measured."""

import laspy
import numpy as np
import pytest

from projects.errors import FormatError
from projects.formats import read_mesh, read_scans

FACADE = np.array([10_000.0, 50_000.0, 200.0])  # where surveys of a town lie in its system, m


def write_ply(path, points, kind, faces=()):
    """Write points (n, 3) as a binary PLY of `kind`, float or double, with faces where given."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property {kind} {axis}\n" for axis in "xyz")
    if len(faces):
        head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    rows = np.zeros(len(faces), [("n", "u1"), ("corners", "<i4", 3)])
    rows["n"] = 3
    if len(faces):
        rows["corners"] = faces
    body = points.astype("<f4" if kind == "float" else "<f8").tobytes() + rows.tobytes()
    path.write_bytes(head.encode() + b"end_header\n" + body)
    return path


def read(path, unit=1.0):
    return np.concatenate([chunk.cloud.points for scan in read_scans(path, unit=unit) for chunk in scan.chunks()])


@pytest.mark.parametrize(("unit", "scale"), [(1.0, 1.0), (0.001, 1000.0)])
def test_single_precision_fifty_kilometres_away_is_refused_with_its_step_and_double_is_read(tmp_path, rng, unit, scale):
    """Read as it was, a face 2 mm aside stated a sigma of 6 micrometres: all its points had one coordinate."""
    points = FACADE + rng.random((500, 3)) * [1.0, 0.002, 1.0]
    with pytest.raises(
        FormatError, match=r"single precision, as far as 50000 m from 0, where they are rounded to (3.9|4) mm"
    ):
        read(write_ply(tmp_path / "far.ply", points * scale, "float"), unit)
    np.testing.assert_allclose(
        read(write_ply(tmp_path / "far.ply", points * scale, "double"), unit), points, rtol=1e-15
    )


@pytest.mark.parametrize("digits", [3, 6])
def test_single_precision_written_as_text_is_told_from_coordinates_rounded_to_millimetres(tmp_path, rng, digits):
    points, path = FACADE + rng.random((500, 3)), tmp_path / "far.xyz"
    np.savetxt(path, points, fmt=f"%.{digits}f")
    assert len(read(path)) == 500
    np.savetxt(path, points.astype(np.float32), fmt="%.6f")
    with pytest.raises(FormatError, match="single precision"):
        read(path)


@pytest.mark.parametrize("shift", [0.0, 4000.0, 8000.0])
def test_single_precision_is_read_where_it_is_finer_than_noise(tmp_path, rng, shift):
    points = shift + rng.random((500, 3))
    assert np.abs(read(write_ply(tmp_path / "near.ply", points, "float")) - points).max() <= 0.25e-3


def test_a_mesh_in_single_precision_far_away_is_refused_too(tmp_path, rng):
    points, faces = FACADE + rng.random((300, 3)), np.arange(300).reshape(-1, 3)
    with pytest.raises(FormatError, match="single precision"):
        read_mesh(write_ply(tmp_path / "far.ply", points, "float", faces))
    assert len(read_mesh(write_ply(tmp_path / "far.ply", points, "double", faces)).vertices) == 300


@pytest.mark.parametrize("digits", [5, 6, 7])
def test_text_of_few_significant_digits_is_refused_where_it_is_coarser_than_noise(tmp_path, rng, digits):
    """Of 123.456 and 1.23456 the step of the finer was taken for both: a wall 0.5 mm aside stated less than 0.1 um."""
    points, path = np.array([12.0, 123.0, 1.0]) + rng.random((300, 3)), tmp_path / "few.xyz"
    np.savetxt(path, points, fmt=f"%.{digits}g")
    if digits == 7:
        assert len(read(path)) == 300  # 0.1 mm
        return
    with pytest.raises(FormatError, match=f"some of its coordinates are rounded to {10 ** (6 - digits)} mm and others"):
        read(path)


@pytest.mark.parametrize("scales", [[0.01, 0.01, 0.001], [0.001, 0.001, 0.0001], [0.001] * 3, [1e-4, 1e-4, 1e-5]])
def test_scales_of_las_that_differ_are_refused_where_one_is_coarser_than_noise(tmp_path, rng, scales):
    """The finest was taken for all: a wall 4 mm aside stated 0.42 mm, with steps of 10, 10 and 1 mm."""
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales, header.offsets = scales, [0.0, 0.0, 0.0]
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = rng.random((3, 200))
    cloud.write(tmp_path / "a.las")
    if max(scales) == min(scales) or max(scales) < 5e-4:
        assert len(read(tmp_path / "a.las")) == 200
        return
    with pytest.raises(FormatError, match=f"rounded to {1e3 * max(scales):g} mm and others finer .*LAS that differ"):
        read(tmp_path / "a.las")


@pytest.mark.parametrize("fmt", ["%.3f", "%.6f", "%.10g", ["%d", "%d", "%.3f"]])
def test_as_many_decimals_in_each_coordinate_and_a_raster_are_read(tmp_path, rng, fmt):
    points, path = rng.random((300, 3)) * 90.0 + [0.0, 120.0, 1.0], tmp_path / "many.xyz"
    np.savetxt(path, points, fmt=fmt)
    assert len(read(path, unit=0.001 if isinstance(fmt, list) else 1.0)) == 300


@pytest.mark.parametrize(
    ("fmt", "unit", "step"),
    [("%.3f %.3f %.4f", 1.0, 1), ("%.4f %.2f %.3f", 1.0, 10), ("%.4f %.4f %.5f", 1.0, 0), ("%.3f %.3f %.4f", 1e-3, 0)],
)
def test_text_of_unequal_decimals_is_refused_where_some_are_coarser_than_noise(tmp_path, rng, fmt, unit, step):
    """The step of the finest was taken for all: walls aside along x, at millimetres, stated the noise of 0.1 mm."""
    points, path = rng.random((300, 3)) * 2.0 + 8.0, tmp_path / "unequal.xyz"
    np.savetxt(path, points, fmt=fmt)
    if not step:
        assert len(read(path, unit)) == 300
        return
    with pytest.raises(FormatError, match=f"some of its coordinates are rounded to {step} mm and others finer"):
        read(path, unit)


def test_a_raster_whose_heights_are_finer_than_its_places_and_a_plane_at_one_coordinate_are_read(tmp_path, rng):
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.5, 10.5, 0.5), np.arange(0.5, 10.5, 0.5)))
    np.savetxt(tmp_path / "raster.xyz", np.column_stack([x, y, rng.random(400)]), fmt="%.1f %.1f %.4f")
    np.savetxt(tmp_path / "plane.xyz", np.column_stack([np.ones(400), rng.random((400, 2))]), fmt="%.1f %.4f %.4f")
    assert [len(read(tmp_path / name)) for name in ("raster.xyz", "plane.xyz")] == [400, 400]
