"""Through the command line: scans with targets and control points, absolute mode, and scans that bring no poses."""

import datetime
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from survey_targets import SCANNER, sphere

from monitor import scan_network
from monitor.cli import run
from monitor.simulation import Body, Scene, simulate_scan, stand_at, window_around
from projects import Project
from projects.formats import write_e57
from projects.transforms import apply, invert, perturb

pytestmark = pytest.mark.slow  # 80 s: a whole campaign through the command line

PLACES = {
    "S1": np.array([0.55, 0.1, 0.35]), "S2": np.array([-0.5, 0.3, -0.3]), "S3": np.array([0.1, -0.6, 0.4]),
    "S4": np.array([-0.2, 0.62, 0.25]), "S5": np.array([-0.6, -0.35, 0.3]),
}  # fmt: skip
STATIONS = [stand_at(np.array([2.4 * np.cos(a), 2.4 * np.sin(a), 0.3]), facing=np.zeros(3)) for a in (0.0, 2.1, 4.2)]
BOX = np.array([[-0.8, -0.8, -0.6], [0.8, 0.8, 0.6]])


def bumpy_ball(shift: np.ndarray) -> Body:
    """Return a bumpy body of about 0.6 m as a mesh, moved by `shift` [m]."""
    ball = sphere(np.zeros(3), 1.0)
    directions = ball.vertices[:]
    waves = np.array([[9.0, 2, 1], [-3, 8, 2], [1, -4, 10], [6, 6, -5]])
    radius = 0.25 + 0.012 * np.sin(directions @ waves.T).sum(axis=1)
    return Body("ball", directions * radius[:, None] + shift, ball.faces, 0.6)


def write_epoch(path: Path, shift: np.ndarray, seed: int, *, bare: bool = False) -> list[Path]:
    """Write three scans of the ball among five spheres, with poses that are off by 20 mm together and 3 mm each, or
    bare, as text files without any."""
    rng = np.random.default_rng(seed)
    scene = Scene("ball", (bumpy_ball(shift), *(sphere(p, 0.05) for p in PLACES.values())))
    scans = []
    for k, T in enumerate(STATIONS):
        error = np.concatenate([rng.normal(0, 0.001, 3), rng.normal(0, 0.003, 3) + np.array([0.02, 0.0, 0.0])])
        window = window_around(BOX, T)
        scans.append(simulate_scan(scene, SCANNER, T, window, step=0.0016, seed=10 * seed + k, n_subrays=1,
                                   registered=perturb(T, T[:3, 3], error), name=f"station {k}"))  # fmt: skip
    if not bare:
        write_e57(path, scans, acquired=datetime.datetime(2024, 5, 1, tzinfo=datetime.UTC))
        return [path]
    files = [path.with_name(f"{path.stem}-{k}.xyz") for k in range(len(scans))]
    for file, scan in zip(files, scans, strict=True):
        np.savetxt(file, scan.cloud.points, fmt="%.6f")
    return files


def write_control(path: Path, rng: np.random.Generator) -> Path:
    lines = [f"{n},{','.join(f'{v:.6f}' for v in p + rng.normal(0, 0.0003, 3))},0.0003" for n, p in PLACES.items()]
    path.write_text("\n".join(["name,x,y,z,sigma", *lines]) + "\n")
    return path


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a project with two epochs under control; in the second the object stands 6 mm aside."""
    folder = tmp_path_factory.mktemp("control")
    rng = np.random.default_rng(4)
    project = str(folder / "project")
    (folder / "extent.json").write_text(json.dumps({"box": {"min": [-0.35] * 3, "max": [0.35] * 3}}))
    assert run(["init", project]) == 0
    assert run(["add-object", project, "ball", "--extent", str(folder / "extent.json")]) == 0
    for k, (epoch, shift) in enumerate((("first", np.zeros(3)), ("second", np.array([0.006, 0.0, 0.0])))):
        (file,) = write_epoch(folder / f"{epoch}.e57", shift, 7 + k)
        control = write_control(folder / f"{epoch}.csv", rng)
        options = ["--date", f"202{4 + k}-05-01", "--control", str(control)]
        assert run(["add-epoch", project, "ball", epoch, *options, str(file)]) == 0
    assert run(["process", project]) == 0
    assert run(["compare", project, "ball", "first", "second"]) == 0
    return folder


def test_scans_stand_where_control_says(campaign: Path) -> None:
    project = Project.open(campaign / "project")
    for epoch in ("first", "second"):
        network = project.get("ball", epoch, "network")
        headers = project.scan_headers("ball", epoch)
        for header, motion, truth in zip(headers, network["T_project_given"], STATIONS, strict=True):
            on_object = apply(invert(truth), 0.25 * np.vstack([np.eye(3), -np.eye(3)]))
            apart = np.linalg.norm(apply(motion @ header.pose, on_object) - apply(truth, on_object), axis=1)
            assert apart.max() < 0.0008  # control has 0.3 mm; as given 20 mm and more
        step = project.latest("ball", epoch, "network")
        assert step.automatic["control_rms_m"] < 0.001
        assert step.automatic["n_control"] == 5
        assert step.automatic["blunders"] == []
        assert np.isfinite(network["covariance"]).all()


def test_comparison_is_absolute_and_holds_the_uncertainty_of_both_frames(campaign: Path) -> None:
    project = Project.open(campaign / "project")
    comparison = project.get("ball", "second", "comparison-first")
    assert comparison.mode == "absolute"
    moved = -comparison.registration.T_target_source[:3, 3]
    assert moved == pytest.approx([0.006, 0.0, 0.0], abs=0.001)
    frames = [project.get("ball", e, "network")["covariance"] for e in ("first", "second")]
    floor = np.diag(frames[0] + frames[1])[3:]
    assert (np.diag(comparison.registration.covariance)[3:] > 0.5 * floor).all()
    assert np.sqrt(floor).max() > 0.00005
    assert comparison.statistics["motion_significance"] > 0.999
    assert comparison.statistics["motion_is_significant"]
    side = comparison.on_compared
    front = side.surface.vertices[:, 0] > 0.2
    assert np.nanmedian(side.distances[front]) == pytest.approx(0.005, abs=0.001)  # 6 mm along x, seen along normals


def test_nothing_is_built_on_scans_that_do_not_settle(
    campaign: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    project = campaign / "project"
    before = [Project.open(project).latest("ball", "first", kind).step_id for kind in ("network", "surface")]
    (campaign / "short.toml").write_text("[adjust]\nmax_iterations = 29\n")  # so that it is adjusted anew
    adjust = scan_network.adjust_scans
    monkeypatch.setattr(
        scan_network, "adjust_scans", lambda *asked: replace(adjust(*asked), converged=False, reason="still moving")
    )
    assert run(["process", str(project), "ball", "first", "--settings", str(campaign / "short.toml")]) == 2
    assert "the scans could not be fitted onto each other: still moving" in capsys.readouterr().err
    assert [Project.open(project).latest("ball", "first", kind).step_id for kind in ("network", "surface")] == before


def test_scans_without_poses_are_placed_by_targets_and_control(campaign: Path) -> None:
    project = str(campaign / "project")
    files = write_epoch(campaign / "bare.e57", np.zeros(3), 11, bare=True)
    options = ["--date", "2026-05-01", "--control", str(campaign / "first.csv"), "--unit", "m"]
    assert run(["add-epoch", project, "ball", "bare", *options, *map(str, files)]) == 0
    for header, truth in zip(Project.open(campaign / "project").scan_headers("ball", "bare"), STATIONS, strict=True):
        assert np.linalg.norm(header.pose[:3, 3] - truth[:3, 3]) < 0.004  # before the adjustment


def test_scans_without_poses_and_targets_are_refused(campaign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(2)
    for k in range(2):
        np.savetxt(campaign / f"blank{k}.xyz", rng.uniform(1.0, 2.0, (500, 3)), fmt="%.5f")
    files = [str(campaign / f"blank{k}.xyz") for k in range(2)]
    options = ["--date", "2026-06-01", "--unit", "m"]
    assert run(["add-epoch", str(campaign / "project"), "ball", "blank", *options, *files]) == 2
    assert "targets do not give it" in capsys.readouterr().err
