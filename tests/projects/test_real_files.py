"""Every scan file made by others gives its points or one clear error; the same cloud is the same from every reader.

The counts are those of the files' own headers or lines, taken with other programs (pye57, laspy, wc), not with ours.
"""

import importlib

import numpy as np
import pytest
import pyvista

from projects.errors import FormatError
from projects.formats import question_unit, read_mesh, read_poses, read_scans, sniff_format
from projects.formats.measured import keep_measurements
from projects.open3d_library import load_open3d

COUNTS = {
    "e57/A4.e57": [4],
    "e57/A_B.e57": [2, 4],
    "e57/A_B_different_dims.e57": [1, 1],
    "e57/ColouredCubeFloat.e57": [7680],
    "e57/bunnyDouble.e57": [30571],
    "e57/bunnyFloat.e57": [30571],
    "e57/bunnyInt19.e57": [30571],
    "e57/bunnyInt32.e57": [30571],
    "e57/pumpAVisualReferenceImage.e57": [155201],
    "e57/testWithNormals.e57": [2],
    "e57/tinyCartesianFloatRgb.e57": [2090],
    "e57/tiny_pc_and_images.e57": [2],
    "e57/translationWithoutRotation.e57": [4],
    "gseg_parity/E57/XYZ_Intensity.e57": [54202],
    "gseg_parity/E57/XYZ_Only.e57": [54202],
    "gseg_parity/E57/XYZ_RGB.e57": [54202],
    "gseg_parity/LAS/XYZ_Intensity.las": [54202],
    "gseg_parity/LAS/XYZ_RGB.las": [54202],
    "gseg_parity/LAZ/XYZ_Intensity.laz": [54202],
    "gseg_parity/PLY_ASCII/XYZ_Only.ply": [54202],
    "gseg_parity/PLY_Binary/XYZ_Intensity.ply": [54202],
    "gseg_parity/TXT/XYZ_Intensity.txt": [54202],
    "gseg_parity/TXT/XYZ_Only.txt": [54202],
    "las/1.2-with-color.las": [1065],
    "las/1_4_w_evlr.laz": [1000],
    "las/autzen_trim.laz": [110000],
    "las/bad-geotiff-keys.las": [10],
    "las/bad_vlr_count.las": [10],
    "las/extrabytes.las": [1065],
    "las/gps-time-nan.las": [1],
    "las/hextest.las": [8],
    "las/mvk-thin.las": [6280],
    "las/noise-clean.las": [1065],
    "las/noise-dirty.las": [1065],
    "las/permutations/1.0_0.las": [1],
    "las/permutations/1.0_1.las": [1],
    "las/permutations/1.1_0.las": [1],
    "las/permutations/1.1_1.las": [1],
    "las/permutations/1.2_0.las": [1],
    "las/permutations/1.2_1.las": [1],
    "las/permutations/1.2_2.las": [1],
    "las/permutations/1.2_3.las": [1],
    "las/plane.laz": [28185],
    "las/simple.copc.laz": [1065],
    "las/simple.laz": [1065],
    "las/simple1_3.las": [999],
    "las/test_0.02_seconde.las": [10310],
    "las/unregistered_extra_bytes.las": [4],
    "las/vegetation_1_3.las": [10683],
    "m3c2_autzen_bmx/autzen-bmx-2010.las": [829],
    "m3c2_autzen_bmx/autzen-bmx-2023.las": [687],
    "m3c2_autzen_bmx/autzen-bmx-cores.txt": [3],
    "nikolov_statues/Angel_decimated.ply": [18412],
    "nikolov_statues/owl_decimated.ply": [12442],
    "piecewise_icp_synth/no_T/Epoch_001.pcd": [174474],
    "piecewise_icp_synth/no_T/Epoch_002.pcd": [172216],
    "piecewise_icp_synth/with_T/Epoch_001.pcd": [174474],
    "piecewise_icp_synth/with_T/Epoch_002.pcd": [172216],
    "piecewise_icp_synth/with_T/Epoch_003.pcd": [174752],
    "piecewise_icp_synth/with_T/Epoch_004.pcd": [172487],
    "piecewise_icp_synth/with_T/Epoch_005.pcd": [170218],
    "piecewise_icp_synth/with_T/Epoch_006.pcd": [163560],
    "ply_edge/metadata.ply": [4],
    "ply_edge/obj_points.obj": [8],
    "ply_edge/obj_wireframe.obj": [8],
    "ply_edge/ply_points_ascii.ply": [8],
    "ply_edge/ply_points_bin.ply": [8],
    "ply_edge/points_agisoft.xyz": [100],
    "ply_edge/points_ascii.ply": [5],
    "ply_edge/points_ascii_with_lists.ply": [5],
    "ply_edge/points_bin.ply": [5],
    "ply_edge/points_cloudcompare.xyz": [101],
    "ply_edge/points_emptyascii.ply": [12],
    "ply_edge/points_emptyface.ply": [1024],
    "ptx_pts/1.2-with-color.ptx": [1065],
    "ptx_pts/autzen.pts": [10],
    "ptx_pts/crlf_test.txt": [10],
    "ptx_pts/crlf_test2.txt": [10],
    "ptx_pts/largescan.txt": [6],
    "ptx_pts/missingheader.txt": [5],
    "ptx_pts/no-color.ptx": [15],
    "ptx_pts/quoted.txt": [9],
    "ptx_pts/test.pts": [19],
    "ptx_pts/utm17_1.txt": [10],
    "stanford_bunny/range/bun000.ply": [40256],
    "stanford_bunny/range/bun045.ply": [40097],
    "stanford_bunny/range/bun090.ply": [30379],
    "stanford_bunny/range/bun180.ply": [40251],
    "stanford_bunny/range/bun270.ply": [31701],
    "stanford_bunny/range/bun315.ply": [35336],
    "stanford_bunny/range/chin.ply": [37738],
    "stanford_bunny/range/ear_back.ply": [32193],
    "stanford_bunny/range/top2.ply": [38298],
    "stanford_bunny/range/top3.ply": [36023],
    "stanford_bunny/reconstruction/bun_zipper.ply": [35947],
    "stanford_bunny/reconstruction/bun_zipper_res2.ply": [8171],
    "stanford_bunny/reconstruction/bun_zipper_res3.ply": [1889],
    "stanford_bunny/reconstruction/bun_zipper_res4.ply": [453],
    "vapc_rockwall/small_mask.laz": [3065],
    "vapc_rockwall/vapc_in.laz": [547662],
}
DROPPED = {"ply_edge/points_emptyascii.ply": [{"after the number promised": 1}]}  # 12 promised, 13 lines
ERRORS = {
    "e57/PinholeImageWithDistortionParameters.e57": "holds no scans",
    "e57/ZeroPoints.e57": "holds no points",
    "e57/bad-crc.e57": "checksum mismatch",
    "e57/empty.e57": "holds no scans",
    "las/no-points.las": "holds no points",
    "nikolov_statues/Angel_decimated.vtp": "no known format",
    "ply_edge/empty.obj": "holds no points",
    "ply_edge/empty.ply": "holds no points",
    "ply_edge/obj_empty.obj": "holds no points",
    "ply_edge/ply_empty_ascii.ply": "holds no points",
    "ply_edge/ply_empty_bin.ply": "holds no points",
    "ply_edge/ply_empty_header.ply": "holds no points",
    "ptx_pts/multiple-and-transform.ptx": r"ptx#1: the transform scales by 1 to 2",
}
NO_SCANS = {".md", ".conf", ".csv", ""}
FOLDERS = ("e57", "las", "ptx_pts", "ply_edge", "gseg_parity", "piecewise_icp_synth", "m3c2_autzen_bmx",
           "stanford_bunny", "vapc_rockwall", "nikolov_statues")  # fmt: skip
NOT_SCANS = {"piecewise_icp_synth/defined_transformations.txt"}


def test_no_file_is_left_out(real_data):
    there = {
        str(path.relative_to(real_data))
        for folder in FOLDERS
        for path in (real_data / folder).rglob("*")
        if path.is_file() and path.suffix not in NO_SCANS
    }
    assert there - NOT_SCANS == set(COUNTS) | set(ERRORS)


def read_here(path):
    """Return the points and the counts of every scan of a file, without the child process (which takes longer)."""
    reader = importlib.import_module(f"projects.formats.{sniff_format(path)}")
    for header in reader.list_scans(str(path)):
        blocks = list(keep_measurements(reader.read_scan(str(path), header), header.is_centred))
        yield np.concatenate([columns["points"] for columns, _ in blocks]), [dropped for _, dropped in blocks]


@pytest.mark.parametrize("name", COUNTS)
def test_file_gives_all_its_points(real_data, name):
    scans = list(read_here(real_data / name))
    assert [len(points) for points, _ in scans] == COUNTS[name]
    for points, dropped in scans:
        assert np.isfinite(points).all()
        assert [counts for counts in dropped if counts] == DROPPED.get(name, [])


ONE_OF_EACH = ("e57/A_B.e57", "las/simple.laz", "ptx_pts/no-color.ptx", "ptx_pts/test.pts", "ply_edge/metadata.ply",
               "ply_edge/obj_points.obj", "piecewise_icp_synth/no_T/Epoch_001.pcd", "ptx_pts/quoted.txt")  # fmt: skip


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_child_process_gives_the_same_points(real_data, read_whole, name):
    scans = read_whole(real_data / name)
    for scan, (points, _) in zip(scans, read_here(real_data / name), strict=True):
        np.testing.assert_array_equal(scan.cloud.points, points)


@pytest.mark.parametrize("name", ERRORS)
def test_file_without_usable_points_is_one_clear_error(real_data, name):
    with pytest.raises(FormatError, match=ERRORS[name]) as caught:
        [list(stream.chunks()) for stream in read_scans(real_data / name)]
    assert name.split("/")[-1] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_same_cloud_comes_from_every_reader(real_data, read_whole):
    def points(name):
        return read_whole(real_data / "gseg_parity" / name)[0].cloud

    reference = points("TXT/XYZ_Intensity.txt")
    # what the formats keep: single floats of a value printed with eight decimals, six decimals, one millimetre
    tolerances = {"E57/XYZ_Intensity.e57": 6e-9, "E57/XYZ_Only.e57": 6e-9, "PLY_ASCII/XYZ_Only.ply": 6e-7,
                  "LAS/XYZ_Intensity.las": 0.51e-3, "LAZ/XYZ_Intensity.laz": 0.51e-3, "LAS/XYZ_RGB.las": 0.51e-3,
                  "TXT/XYZ_Only.txt": 0.0, "PLY_Binary/XYZ_Intensity.ply": 6e-9, "E57/XYZ_RGB.e57": 6e-9}  # fmt: skip
    for name, tolerance in tolerances.items():
        cloud = points(name)
        np.testing.assert_allclose(cloud.points, reference.points, rtol=0, atol=tolerance, err_msg=name)
        if "Intensity" in name:
            np.testing.assert_allclose(cloud.intensity, reference.intensity, atol=1.01 / 65535, err_msg=name)
        if "RGB" in name:
            assert (cloud.colors == [85, 0, 255]).all()


def test_the_same_bunny_comes_from_every_way_to_store_numbers(real_data, read_whole):
    exact, *others = (
        read_whole(real_data / "e57" / f"bunny{kind}.e57")[0].cloud.points
        for kind in ("Double", "Float", "Int19", "Int32")
    )
    for points, tolerance in zip(others, (7.6e-9, 0.51e-6, 0.51e-6), strict=True):
        np.testing.assert_allclose(points, exact, rtol=0, atol=tolerance)


def test_pcd_equals_what_open3d_reads(real_data, read_whole):
    path = real_data / "piecewise_icp_synth/with_T/Epoch_003.pcd"
    theirs = np.asarray(load_open3d().io.read_point_cloud(str(path)).points)
    np.testing.assert_array_equal(read_whole(path)[0].cloud.points, theirs)


def test_mesh_equals_the_same_statue_in_another_format(real_data):
    ours = read_mesh(real_data / "nikolov_statues/Angel_decimated.ply", unit=0.001)
    theirs = pyvista.read(real_data / "nikolov_statues/Angel_decimated.vtp")
    np.testing.assert_allclose(ours.vertices, 0.001 * theirs.points, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(ours.faces, theirs.regular_faces)


def test_statue_in_millimetres_is_questioned_and_scans_of_a_wall_are_not(real_data):
    def bounds(name):
        points = np.concatenate([c.cloud.points for s in read_scans(real_data / name) for c in s.chunks()])
        return np.array([points.min(axis=0), points.max(axis=0)])

    with pytest.raises(FormatError, match=r"322 m across .* \(0\.322 m if in mm"):
        question_unit(bounds("nikolov_statues/Angel_decimated.ply"), unit_stated=False)
    question_unit(bounds("vapc_rockwall/small_mask.laz"), unit_stated=False)
    question_unit(bounds("stanford_bunny/range/bun000.ply"), unit_stated=False)


def test_scaled_transform_does_not_spoil_a_scan_that_has_a_line_in_the_poses_file(real_data, tmp_path, read_whole):
    identity = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
    (tmp_path / "poses.txt").write_text(f"multiple-and-transform.ptx#1 {identity}\n")
    path = real_data / "ptx_pts/multiple-and-transform.ptx"
    first, second = read_whole(path, pose_lines=read_poses(tmp_path / "poses.txt"))
    np.testing.assert_array_equal(first.cloud.points[0], [37012.24, 49028.31, 15.83])
    np.testing.assert_array_equal(second.cloud.points[0], [637012.24, 849028.31, 431.66])
