"""Scans that overlap no other one of their epoch, or lie beside the extent: what is said of their poses."""

import json
from pathlib import Path

import numpy as np
import pytest

from monitor.chain import is_held_by_control
from monitor.cli import run
from projects import Project

POSE = "1 0 0 {x} 0 1 0 0 0 0 1 0 0 0 0 1 0 0 1.5"


def said_of(folder: Path, places: list[float], capsys: pytest.CaptureFixture[str]) -> tuple[list[str], list[int]]:
    """Return what `process` minds, and which scans stand alone, of scans of a relief put at places along x [m]."""
    rng, project = np.random.default_rng(3), folder / "project"
    lines = []
    for k, x in enumerate(places):
        flat = rng.uniform(-0.12, 0.12, (3000, 2))
        z = 0.02 * np.sin(40.0 * flat[:, 0]) * np.cos(30.0 * flat[:, 1]) + rng.normal(0.0, 2e-4, 3000)
        np.savetxt(folder / f"{k}.xyz", np.c_[flat, z], fmt="%.6f")
        lines.append(f"{k}.xyz {POSE.format(x=x)}\n")
    (folder / "poses").write_text("".join(lines))
    files = [str(folder / f"{k}.xyz") for k in range(len(places))]
    assert run(["init", str(project)]) == run(["add-object", str(project), "relief"]) == 0
    given = ["add-epoch", str(project), "relief", "e1", "--date", "2026-05-01", "--poses", str(folder / "poses")]
    assert run([*given, *files]) == 0
    assert run(["process", str(project)]) == 0
    minded = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mind: ")]
    return minded, Project.open(project).latest("relief", "e1", "network").automatic["alone"]


@pytest.mark.parametrize(
    ("places", "alone", "words"),
    [
        (
            [0.0, 0.0, 3.0],
            [2],
            "no surface of scan 3 was found again in another scan: nothing shows whether its pose is right",
        ),
        (
            [0.0, 3.0],
            [0, 1],
            "no surface of scans 1 and 2 was found again in another scan: nothing shows whether their poses are right",
        ),
        ([0.0, 0.0], [], ""),
        ([0.0], [], ""),
    ],
)
def test_scans_that_overlap_no_other_are_said(tmp_path, capsys, places, alone, words):
    minded, found = said_of(tmp_path, places, capsys)
    assert found == alone
    assert minded == ([f"mind: relief e1: {words}"] if words else [])


def test_control_of_which_no_scan_holds_a_target_is_said_and_holds_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flat = np.random.default_rng(3).uniform(-0.12, 0.12, (3000, 2))
    np.savetxt(
        tmp_path / "a.xyz", np.c_[flat, 0.02 * np.sin(40.0 * flat[:, 0]) * np.cos(30.0 * flat[:, 1])], fmt="%.6f"
    )
    (tmp_path / "control.csv").write_text("P1,1,0,0\nP2,0,1,0\nP3,0,0,1\n")
    project = str(tmp_path / "project")
    assert run(["init", project]) == run(["add-object", project, "relief"]) == 0
    given = ["--date", "2026-05-01", "--control", str(tmp_path / "control.csv")]
    assert run(["add-epoch", project, "relief", "e1", *given, str(tmp_path / "a.xyz")]) == 0
    assert run(["process", project]) == 0
    told = "mind: relief e1: none of its 3 control points holds a target of its scans, so control holds nothing"
    assert told in capsys.readouterr().err.splitlines()
    assert not is_held_by_control(Project.open(project), "relief", "e1")  # it was, and absolute mode the default


def test_scans_beside_the_extent_are_told_where_they_lie(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(0.0, 1.0, 40))
    np.savetxt(tmp_path / "wall.xyz", np.column_stack([x.ravel(), np.full(x.size, 2.0), z.ravel()]), fmt="%.4f")
    extent = {"box": {"min": [2600000.0, 1200001.0, -1.0], "max": [2600002.0, 1200003.0, 3.0]}}
    (tmp_path / "extent.json").write_text(json.dumps(extent))
    project = str(tmp_path / "project")
    assert run(["init", project]) == 0
    assert run(["add-object", project, "wall", "--extent", str(tmp_path / "extent.json")]) == 0
    assert run(["add-epoch", project, "wall", "first", "--date", "2024-05-01", str(tmp_path / "wall.xyz")]) == 0
    apart = "as their poses say, the scans lie about x 0.0 m, y 2.0 m, the extent about x 2600001.0 m, y 1200002.0 m"
    assert f"mind: first: {apart}: nothing of them is within" in capsys.readouterr().err
    assert run(["process", project]) == 2
    told = capsys.readouterr().err
    assert "no point is left of 1600 in 1 scan" in told
    assert apart in told
