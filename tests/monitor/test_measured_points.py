"""What the scans of an epoch measured: all of it, where the adjustment put it, and not more at a time than fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ivy_wall import processed, wall_with_ivy

from monitor import measured
from monitor.measured import join_evenly, measured_points, raw_scans
from monitor.record import Place
from monitor.simulation.campaign import write_extent
from projects.model import PointCloud, Scan
from projects.transforms import apply


def test_scans_may_lie_off_by_their_noise_and_by_what_they_disagree_by() -> None:
    steps = [SimpleNamespace(automatic=known) for known in ({"noise_before": 3e-4}, {}, {"noise_before": None},
                                                            {"noise_before": float("nan")})]  # fmt: skip
    for disagreement, sigma in ((4e-4, 5e-4), (np.nan, 3e-4)):
        found = raw_scans(None, steps, [np.eye(4)] * 4, [None] * 4, disagreement)
        assert [scan.sigma for scan in found] == pytest.approx([sigma])


def test_points_are_corrected_in_range_then_posed_then_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    pose, motion = np.eye(4), np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1.0, 2.0, 3.0]
    motion[:3, :3], motion[:3, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0.1, 0.0, 0.0]
    scan = Scan("a", PointCloud(np.array([[1.0, 0.0, 0.0]])), pose)
    twice = lambda scan, _: replace(scan, cloud=replace(scan.cloud, points=2.0 * scan.cloud.points))  # noqa: E731
    monkeypatch.setattr(measured, "iterate_within", lambda *_: [(1, scan)])
    monkeypatch.setattr(measured, "correct_range", twice)
    place = SimpleNamespace(project=None, object_id="", epoch_id="")
    step = SimpleNamespace(automatic={"noise_before": 3e-4})
    for calibration, x in ((None, 1.0), ("some", 2.0)):
        (found,) = raw_scans(place, [step], [motion], [calibration], np.nan)
        # posed (1, 2 + x, 3); moved: y and z are turned
        np.testing.assert_allclose(np.vstack(list(found.pieces)), [[1.1, -3.0, 2.0 + x]])


def test_what_was_measured_is_every_point_of_every_scan_where_it_was_adjusted(tmp_path: Path) -> None:
    project = processed(tmp_path)
    place = Place(project, "wall", "e1")
    network = project.latest("wall", "e1", "network")
    assert network is not None
    motions = place.get(network)["T_project_given"]
    scans = [wall_with_ivy(np.random.default_rng([k, 3])) for k in range(2)]
    expected = np.vstack([apply(T, scan) for T, scan in zip(motions, scans, strict=True)])
    found = measured_points(place)
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=1e-6)  # the files' rounding


def test_what_lies_outside_of_the_extent_was_not_measured_of_the_object(tmp_path: Path) -> None:
    box = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.011]])
    project = processed(tmp_path, extent=write_extent(tmp_path / "box.json", box))
    found = measured_points(Place(project, "wall", "e1"))
    scans = np.vstack([wall_with_ivy(np.random.default_rng([k, 3]), is_level=True) for k in range(2)])
    assert found is not None
    assert len(found) == pytest.approx(np.count_nonzero(((scans >= box[0]) & (scans <= box[1])).all(axis=1)), abs=2)


def test_of_repeated_scans_the_points_of_their_mean_are_asked(tmp_path: Path) -> None:
    project = processed(tmp_path, "--repeated")
    found = measured_points(Place(project, "wall", "e1"))
    assert found is not None
    np.testing.assert_array_equal(found, project.get("wall", "e1", "filtered").points)


def test_of_a_finished_mesh_nothing_was_measured() -> None:
    project = SimpleNamespace(latest=lambda *_: None, scan_headers=lambda *_: [])
    assert measured_points(Place(project, "wall", "e1")) is None  # type: ignore[arg-type]


def test_of_more_points_than_fit_every_second_or_fourth_is_kept_of_each_piece() -> None:
    pieces = [np.full((n, 3), float(k)) for k, n in enumerate((16, 16, 32))]
    assert len(join_evenly(pieces, 64)) == 64
    assert np.bincount(join_evenly(pieces, 63)[:, 0].astype(int)).tolist() == [8, 8, 16]
    assert np.bincount(join_evenly(pieces, 20)[:, 0].astype(int)).tolist() == [4, 4, 8]
    assert join_evenly([], 10).shape == join_evenly([np.empty((0, 3))], 10).shape == (0, 3)
    lone = join_evenly([np.full((1, 3), float(k)) for k in range(10)], 4)
    assert lone[:, 0].tolist() == [0.0, 3.0, 6.0, 9.0]
