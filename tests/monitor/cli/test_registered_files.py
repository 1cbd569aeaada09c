"""Files that stand in the project's frame already: poses that are the identity do not say where a scanner stood."""

from pathlib import Path

import numpy as np
import pytest

from monitor.cli import run
from monitor.scans import open_scans
from monitor.unit_check import UnitCheck
from monitor.vantage import could_be_measured_from
from projects import PointCloud, Project, Scan
from projects.formats import read_poses, write_e57

IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
SHIFTED = "1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1"


def vase(rng: np.random.Generator, n_points: int = 6000) -> np.ndarray:
    """Return points of a vase 0.3 m high about the origin, as all stations together measured it."""
    z, turn = rng.uniform(-0.15, 0.15, n_points), rng.uniform(0.0, 2.0 * np.pi, n_points)
    r = 0.08 + 0.02 * np.sin(25.0 * z) + rng.normal(0.0, 1e-4, n_points)
    return np.c_[r * np.cos(turn), r * np.sin(turn), z]


def places(folder: Path, lines: dict[str, str], repeated: bool = False) -> list[np.ndarray]:
    """Return where the scanner of each file stood, for the poses (and places) given of them."""
    for name in lines:
        np.savetxt(folder / name, vase(np.random.default_rng(len(name)), 50), fmt="%.6f")
    (folder / "poses").write_text("".join(f"{name} {numbers}\n" for name, numbers in lines.items()))
    poses = read_poses(folder / "poses")
    return [s.origin for s in open_scans([folder / n for n in lines], poses, UnitCheck(), repeated)]


@pytest.mark.parametrize(
    ("lines", "known"),
    [
        ({"a.xyz": IDENTITY}, False),
        ({"a.xyz": IDENTITY, "bb.xyz": IDENTITY}, False),
        ({"a.xyz": IDENTITY, "bb.xyz": SHIFTED}, True),  # the project's frame is that of the first scan
        ({"a.xyz": SHIFTED}, True),
        ({"a.xyz": f"{IDENTITY} 0 0 0"}, True),
    ],
)
def test_poses_that_are_all_the_identity_do_not_say_where_a_scanner_stood(tmp_path, lines, known):
    for origin in places(tmp_path, lines):
        np.testing.assert_array_equal(origin, np.zeros(3) if known else np.full(3, np.nan))


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (30.0, -20.0, 1.0), (4e5, 5e6, 200.0)])
def test_points_all_around_a_body_were_not_measured_from_one_place_and_those_before_it_were(rng, place):
    body = 5.0 * vase(rng, 40_000) + (0.0, 3.0, 0.0)  # 0.8 m across
    normal = body[:, :2] - (0.0, 3.0)
    front = (normal * -body[:, :2]).sum(axis=1) > 0.0  # what looks to 0 0 0
    assert not could_be_measured_from(body, np.array(place))
    assert could_be_measured_from(body[front], np.zeros(3))


def test_a_wall_behind_a_body_is_no_second_sheet_but_at_the_silhouette(rng):
    body = 5.0 * vase(rng, 40_000) + (0.0, 3.0, 0.0)
    front = body[((body[:, :2] - (0.0, 3.0)) * -body[:, :2]).sum(axis=1) > 0.0]
    wall = np.c_[rng.uniform(-2.0, 2.0, 60_000), np.full(60_000, 5.0), rng.uniform(-1.5, 1.5, 60_000)]
    hidden = np.abs(wall[:, 0] / wall[:, 1]) < 0.5 / 3.0
    assert could_be_measured_from(np.r_[front, wall[~hidden]], np.zeros(3))


def test_one_scan_whose_frame_is_the_project_s_stood_at_its_origin(tmp_path, rng):
    x, y = rng.uniform(-0.3, 0.3, (2, 4000))
    np.savetxt(tmp_path / "a.xyz", np.c_[x, y, -4.0 + 0.03 * np.sin(11.0 * x)], fmt="%.6f")
    (tmp_path / "poses").write_text(f"a.xyz {IDENTITY}\n")
    (stream,) = open_scans([tmp_path / "a.xyz"], read_poses(tmp_path / "poses"), UnitCheck())
    np.testing.assert_array_equal(stream.origin, np.zeros(3))


def test_a_merged_e57_without_a_grid_does_not_say_where_a_scanner_stood_even_where_its_points_would_allow_it(
    tmp_path, rng
):
    x, y = rng.uniform(-0.3, 0.3, (2, 4000))
    scan = Scan("merged", PointCloud(np.c_[x, y, -4.0 + 0.03 * np.sin(11.0 * x)]), np.eye(4))
    write_e57(tmp_path / "a.e57", [scan])
    (stream,) = open_scans([tmp_path / "a.e57"], {}, UnitCheck())
    assert np.isnan(stream.origin).all()


@pytest.mark.parametrize("is_merged", [False, True])
def test_an_e57_without_a_grid_that_brings_a_pose_says_where_a_scanner_stood_if_its_points_bear_it_out(
    tmp_path, rng, is_merged
):
    x, y = rng.uniform(-0.3, 0.3, (2, 4000))
    points = 5.0 * vase(rng, 40_000) + (0.0, 3.0, 0.0) if is_merged else np.c_[x, y, -4.0 + 0.03 * np.sin(11.0 * x)]
    pose = np.eye(4)
    pose[:3, 3] = 3.0, -2.0, 1.0
    write_e57(tmp_path / "a.e57", [Scan("a", PointCloud(points), pose)])
    (stream,) = open_scans([tmp_path / "a.e57"], {}, UnitCheck())
    np.testing.assert_array_equal(stream.pose, pose)
    np.testing.assert_array_equal(stream.origin, np.full(3, np.nan) if is_merged else np.zeros(3))


def test_repeated_scans_were_measured_from_one_place_and_are_taken_at_their_word(tmp_path):
    for origin in places(tmp_path, {"a.xyz": IDENTITY, "bb.xyz": IDENTITY}, repeated=True):
        np.testing.assert_array_equal(origin, np.zeros(3))


def test_a_registered_file_about_the_origin_looks_outward_and_says_what_is_unknown(tmp_path, capsys):
    """Seen from 0 0 0 it was inside out, and what was lost from it was told as added."""
    file, poses, project = tmp_path / "vase.xyz", tmp_path / "poses", tmp_path / "project"
    np.savetxt(file, vase(np.random.default_rng(1)), fmt="%.6f")
    poses.write_text(f"vase.xyz {IDENTITY}\n")
    assert run(["init", str(project)]) == run(["add-object", str(project), "vase"]) == 0
    given = ["add-epoch", str(project), "vase", "e1", "--date", "2026-05-01", "--poses", str(poses), str(file)]
    assert run(given) == 0
    (said,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mind: ")]
    assert (
        "nobody says where the scanner stood: it is not known whether what is missing is gone or was not seen" in said
    )
    assert run(["process", str(project)]) == 0
    surface = Project.open(project).get("vase", "e1", "surface")
    outward = (surface.normals[:, :2] * surface.vertices[:, :2]).sum(axis=1)
    assert (outward > 0.0).mean() > 0.99
