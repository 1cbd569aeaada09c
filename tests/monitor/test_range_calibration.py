"""The calibration of a scan through the command line: from the whole scan, for what lies within the object's extent."""

import json
from pathlib import Path

import numpy as np
import pytest
from scanned_room import FARO, ROOM, STATION, scan_room

from monitor.cli import run
from monitor.range_calibration import calibration_of
from monitor.record import Place
from monitor.simulation.scanner import cyclic_error
from projects import Project

WALL = ROOM[1] - STATION[1]  # y of the wall that is monitored, in the scanner's frame
EXTENT = {"box": {"min": [-0.3, WALL - 0.1, -0.3], "max": [0.3, WALL + 0.1, 0.3]}}


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Add a scan of a room, of which a piece of wall is monitored, and process it with and without calibration."""
    folder = tmp_path_factory.mktemp("room")
    np.savetxt(folder / "room.xyz", scan_room(np.random.default_rng(5), n_points=200_000).cloud.points, fmt="%.6f")
    (folder / "extent.json").write_text(json.dumps(EXTENT))
    (folder / "off.toml").write_text("[filter.calibration]\nenabled = false\n")
    (folder / "poses").write_text("room.xyz 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 0 0 0\n")
    project = str(folder / "project")
    assert run(["init", project]) == 0
    assert run(["add-object", project, "wall", "--extent", str(folder / "extent.json")]) == 0
    for epoch, more in (("on", []), ("off", ["--settings", str(folder / "off.toml")])):
        added = ["add-epoch", project, "wall", epoch, "--date", "2026-05-01", "--scanner", "faro-ls880"]
        assert run([*added, "--poses", str(folder / "poses"), str(folder / "room.xyz")]) == 0
        assert run(["process", project, "wall", epoch, *more]) == 0
    return folder / "project"


def distances_to_wall(room: Path, epoch: str) -> np.ndarray:
    """Return how far [m] the filtered points lie behind the wall."""
    return Project.open(room).get("wall", epoch, "scan000").points[:, 1] - WALL


def test_the_whole_scan_corrects_what_lies_within_the_extent(room: Path) -> None:
    error = float(cyclic_error(FARO, np.array([WALL]))[0])
    assert abs(error) > 0.5e-3
    assert np.isclose(distances_to_wall(room, "off").mean(), error, atol=0.15e-3)
    assert abs(distances_to_wall(room, "on").mean()) < 0.05e-3


def test_the_calibration_is_kept_with_the_scan(room: Path) -> None:
    place = Place(Project.open(room), "wall", "on")
    step = place.project.latest("wall", "on", "calibration000")
    assert step is not None
    found = calibration_of(place, step)
    assert found is not None
    assert found.is_applied
    assert np.allclose(found.amplitudes, FARO.cyclic_amplitudes, atol=0.05e-3)
    assert found.covariance.shape == (8, 8)
    assert found.profile.shape[1] == 3
    assert step.step_id in place.project.latest("wall", "on", "scan000").inputs
    assert place.project.latest("wall", "off", "calibration000") is None
