"""Scans of one set-up: told by their pose, joined as one body, with their targets once each."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from monitor.adjusted import adjusted_clouds, adjusted_doubtful
from monitor.cli import run
from monitor.filtered_scans import FilteredScans
from monitor.range_calibration import largest_of_setups
from monitor.record import Place
from monitor.registration.network.adjustment import Adjustment
from monitor.registration.network.snooping import TieFit
from monitor.scan_network import _as_arrays, _figures, _why_nothing_is_left, tell_control
from monitor.setups import join_setups, join_targets, number_setups, setups_of
from monitor.simulation import stand_at
from projects import Project
from projects.model import PointCloud, Step, SurveyTarget

HERE = stand_at(np.array([1.0, 2.0, 1.7]), facing=np.zeros(3))
THERE = stand_at(np.array([-1.0, 2.0, 1.7]), facing=np.zeros(3))


def test_scans_of_one_pose_are_one_set_up_but_not_those_in_the_frame_of_the_project() -> None:
    near = HERE.copy()
    near[0, 3] += 1e-7  # two registrations of neighbouring tripods, never a copy
    poses = [HERE, THERE, HERE.copy(), np.eye(4), np.eye(4), near, np.full((4, 4), np.nan)]
    assert number_setups(poses).tolist() == [0, 1, 0, 2, 3, 4, 5]


def test_scans_of_one_common_frame_stand_where_their_scanners_did_and_not_at_one_place() -> None:
    """Exported moved by one shift, each with its scanner's place, they were one body: seen from the first one's place,
    never fitted onto each other, and calibrated with the largest."""
    nowhere = np.full(3, np.nan)
    origins = [np.zeros(3), np.array([4.0, 0.0, 0.0]), np.array([0.0, 1e-5, 0.0]), nowhere, nowhere]
    assert number_setups([HERE] * 5, origins).tolist() == [0, 1, 0, 2, 3]


def test_a_poses_file_with_one_shift_and_the_scanners_places_gives_two_set_ups(tmp_path: Path) -> None:
    across = np.linspace(-0.5, 0.5, 20)
    y, z = (a.ravel() for a in np.meshgrid(across, across))
    wall, project = np.c_[np.full(y.size, 3.0), y, z], str(tmp_path / "project")
    lines = []
    for name, place in (("a.xyz", "0 0 0"), ("b.xyz", "0 4 0")):
        np.savetxt(tmp_path / name, wall + (name == "b.xyz") * 0.004, fmt="%.4f")
        lines.append(f"{name} 1 0 0 1000 0 1 0 2000 0 0 1 0 0 0 0 1 {place}\n")
    (tmp_path / "poses").write_text("".join(lines))
    files = [str(tmp_path / name) for name in ("a.xyz", "b.xyz")]
    assert run(["init", project]) == run(["add-object", project, "wall"]) == 0
    words = ["add-epoch", project, "wall", "e", "--date", "2024-05-01", "--poses", str(tmp_path / "poses"), *files]
    assert run(words) == 0
    assert setups_of(Place(Project.open(Path(project)), "wall", "e")).tolist() == [0, 1]


def cloud(n: int, origin: np.ndarray, rng: np.random.Generator) -> PointCloud:
    return PointCloud(rng.normal(size=(n, 3)), origins=origin, sigma=np.full(n, 0.001))


def test_joined_clouds_keep_their_points_and_the_place_they_were_seen_from(rng: np.random.Generator) -> None:
    a, b, c, none = (cloud(n, np.array([n, 0.0, 0.0]), rng) for n in (4, 5, 6, 0))
    c = dataclasses.replace(c, origins=a.origins)
    joined = join_setups([a, b, c, none], np.array([0, 1, 0, 2]))
    assert len(joined) == 2
    assert np.array_equal(joined[0].points, np.concatenate([a.points, c.points]))
    assert np.array_equal(joined[0].origins, a.origins)  # one place, so beams can be told
    assert joined[1] is b


def target(x: float, sigma: float) -> SurveyTarget:
    return SurveyTarget("sphere", np.array([x, 0.0, 0.0]), np.eye(3) * sigma**2, 0.07, 0.001, 100, 0.9)


def test_target_seen_twice_from_one_set_up_counts_once_as_it_is_known_best() -> None:
    found = join_targets([[target(1.002, 0.002), target(3.0, 0.002)], [target(1.0, 0.0002)]])
    assert [t.centre[0] for t in found] == [1.0, 3.0]


def test_all_scans_of_a_set_up_get_its_motion_and_one_that_saw_nothing_alone_stays() -> None:
    T = np.eye(4)
    T[0, 3] = 0.01
    found = Adjustment((np.eye(4), T), (), True, "", 0.0, 0.0, 1, covariances=np.stack([np.eye(6), 4.0 * np.eye(6)]),
                       centres=np.array([[0.0, 0, 0], [1.0, 0, 0]]))  # fmt: skip
    arrays = _as_arrays(found, [0, 1], np.array([0, 1, 1, 2]))
    assert arrays["T_project_given"][:, 0, 3] == pytest.approx([0.0, 0.01, 0.01, 0.0])
    assert arrays["covariances"][2, 0, 0] == 4.0
    assert np.isnan(arrays["centres"][3]).all()


def test_a_control_point_that_was_left_out_holds_no_network() -> None:
    seen = [(-1, False), (-1, True), (-1, False), (0, False)]
    ties = tuple(TieFit(f"P{k}", scan, np.zeros(3), 1.0, 0.5, is_blunder, True)
                 for k, (scan, is_blunder) in enumerate(seen))  # fmt: skip
    found = Adjustment((np.eye(4),), (), True, "", 0.0, 0.0, 1, covariance=np.eye(6), ties=ties)
    figures = _figures(found, [0])
    assert figures["n_control"] == 2
    assert figures["n_targets"] == 1


def test_control_that_holds_not_the_whole_or_was_left_out_is_told() -> None:
    held = {"n_control": 5, "sigma_position_m": 2e-4, "blunders": []}
    assert tell_control(held, 5) == tell_control({}, 5) == ""  # {}: switched off, or made before it was recorded
    assert tell_control({"n_control": 0}, 0) == ""
    assert "none of its 5 control points" in tell_control({"n_control": 0}, 5)
    assert tell_control({"n_control": 0, "no_control_reason": "why"}, 5).endswith("so control holds nothing (why)")
    for unknown in (np.nan, None):
        told = tell_control(held | {"n_control": 2, "sigma_position_m": unknown}, 5)
        assert told.startswith("2 of its 5 control points hold targets, and a turn of the whole stays free")
    wrong = held | {"blunders": ["control point S3", "target 4 in scan 2"]}
    assert tell_control(wrong, 5).endswith("against the others: control point S3, target 4 in scan 2")


def test_windows_are_calibrated_with_the_largest_scan_of_their_set_up() -> None:
    assert largest_of_setups(np.array([0, 0, 1, 1, 2]), [10, 900, 70, 70, 3]).tolist() == [1, 1, 2, 2, 4]


def test_an_epoch_of_which_nothing_is_left_tells_what_became_of_its_points() -> None:
    """Scans of a few points within the extent: that "no scan has a point within the extent" would be wrong."""
    counts = ({"read": 900, "outside_extent": 897, "in": 3, "too_few": 3, "out": 0}, {"read": 4, "in": 4, "too_few": 4})
    steps = [Step("s", "scan000", counts=c) for c in counts]
    told = _why_nothing_is_left(steps)
    assert told.startswith("no point is left of 904 in 2 scans (outside extent 897, too few 7); check")


def test_doubtful_points_go_with_the_cloud_of_their_set_up_where_the_adjustment_put_it() -> None:
    """Scans 0 and 2 stand at one place; scan 1 saw nothing; of scan 3 nothing is doubtful."""
    counts, n_doubtful = (5, 0, 4, 6), (2, 0, 3, 0)
    scans = [Step(f"s{k}", f"scan{k:03d}", counts={"out": n} if n else {}) for k, n in enumerate(counts)]
    doubtful = [Step(f"d{k}", f"doubtful{k:03d}") for k in range(4)]
    motions = np.tile(np.eye(4), (4, 1, 1))
    motions[:, 0, 3] = [10.0, 20.0, 10.0, 40.0]
    held = {"n": {"T_project_given": motions, "setups": np.array([0, 1, 0, 2])}}
    held |= {s.step_id: cloud_at(n, k) for k, (s, n) in enumerate(zip(scans, counts, strict=True))}
    held |= {s.step_id: cloud_at(n, k) for k, (s, n) in enumerate(zip(doubtful, n_doubtful, strict=True))}
    place, network = SimpleNamespace(get=lambda step: held[step.step_id]), Step("n", "network")
    clouds = adjusted_clouds(place, scans, network)
    beside = adjusted_doubtful(place, FilteredScans(scans, doubtful), network)
    assert [len(c) for c in clouds] == [9, 6]
    assert [len(c) for c in beside] == [5, 0]
    assert beside[0].points[:, 0].tolist() == [10.0, 10.0, 12.0, 12.0, 12.0]
    assert [len(c) for c in adjusted_doubtful(place, FilteredScans(scans, []), network)] == [0, 0]


def cloud_at(n: int, k: int) -> PointCloud:
    """Return n points at x = k m, seen from there."""
    points = np.tile([float(k), 0.0, 0.0], (n, 1))
    return PointCloud(points, origins=np.zeros(3), scan_index=np.full(n, k, dtype=np.int32))
