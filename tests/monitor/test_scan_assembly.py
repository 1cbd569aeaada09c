"""Scans that bring no poses and show no targets are placed by their shapes when an epoch is added."""

from pathlib import Path

import numpy as np
import pytest
from real_scans import read_range_image

from monitor.cli import run
from monitor.registration.anywhere.assembly import Assembly
from monitor.scan_assembly import into_project_frame
from projects import Project
from projects.transforms import apply, invert, perturb

NAMES = ("bun000.ply", "bun045.ply", "bun090.ply")


def add(project: Path, epoch: str, files: list[Path]) -> int:
    return run(["add-epoch", str(project), "bunny", epoch, "--date", "2026-05-01", "--unit", "m", *map(str, files)])


@pytest.fixture
def project(tmp_path: Path) -> Path:
    path = tmp_path / "project"
    assert run(["init", str(path)]) == 0
    assert run(["add-object", str(path), "bunny"]) == 0
    return path


def test_range_images_without_poses_stand_together_in_the_first_ones_frame(
    project: Path, real_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = real_data / "stanford_bunny" / "range"
    assert add(project, "bare", [folder / name for name in NAMES]) == 0
    assert "3 without a pose placed by shape alone" in capsys.readouterr().out
    truth = [read_range_image(folder, name, 8) for name in NAMES]
    T_first = truth[0][1]
    for header, (cloud, T) in zip(Project.open(project).scan_headers("bunny", "bare"), truth, strict=True):
        error = apply(header.pose, cloud.points) - apply(invert(T_first) @ T, cloud.points)
        assert np.sqrt((error**2).sum(axis=1).mean()) < 2e-3, header.name


def test_scans_of_different_things_are_refused_with_their_names(
    project: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / f"blank{k}.xyz" for k in range(2)]
    for file in files:
        np.savetxt(file, rng.uniform(1.0, 2.0, (500, 3)), fmt="%.5f")
    assert add(project, "blank", files) == 2
    told = capsys.readouterr().err
    assert "targets do not give it (0 found) nor do their shapes" in told
    assert "blank1.xyz" in told


def test_a_scan_of_three_points_without_a_pose_is_refused_with_its_name(
    project: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / f"few{k}.xyz" for k in range(2)]
    for file in files:
        np.savetxt(file, rng.uniform(1.0, 2.0, (3, 3)), fmt="%.5f")
    assert add(project, "few", files) == 2
    assert "few0.xyz: 3 points have no shape to place scans by; give --poses FILE" in capsys.readouterr().err


def test_poses_that_are_known_stay_and_give_the_frame(rng: np.random.Generator) -> None:
    T = [perturb(np.eye(4), np.zeros(3), rng.normal(size=6)) for _ in range(3)]
    found = Assembly(np.array([np.eye(4), T[0], T[1]]), np.array([True, True, True]), (), ())
    poses = into_project_frame(found, [None, T[2], None])
    assert poses[1] == pytest.approx(T[2])
    assert invert(poses[1]) @ poses[2] == pytest.approx(invert(T[0]) @ T[1])
    lost = Assembly(np.full((2, 4, 4), np.nan), np.array([False, False]), (), ())
    kept = into_project_frame(lost, [T[0], None])
    assert kept[0] == pytest.approx(T[0])
    assert np.isnan(kept[1]).all()
