"""The command line on a small project: the whole way, and bad input that leaves the project as it was."""

import dataclasses
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pdf_oxide import PdfDocument

from monitor.chain import process_epoch
from monitor.cli import results, run, working
from projects import Project
from projects.model import Step
from reports import pictures
from reports.quantities import percent

STATION = "0 0 4"


def relief(n: int, rng: np.random.Generator, dent: float) -> np.ndarray:
    """Return points (n, 3) [m] of a wavy relief 0.6 m wide, seen from above, with a round dent of depth `dent`."""
    x, y = rng.uniform(-0.3, 0.3, (2, n))
    z = 0.03 * np.sin(11 * x) * np.cos(9 * y) + 0.01 * np.sin(23 * y + 7 * x)
    radius = np.hypot(x - 0.1, y + 0.05)
    z = z - dent * 0.5 * (1 + np.cos(np.pi * np.minimum(radius, 0.06) / 0.06))
    return np.column_stack([x, y, z + rng.normal(0, 0.0003, n)])


def write_epoch(folder: Path, name: str, dent: float, rng: np.random.Generator) -> tuple[list[str], str]:
    """Write two scans as text and their poses file; return the files and the poses file."""
    files, lines = [], []
    for k in range(2):
        path = folder / f"{name}-{k}.xyz"
        np.savetxt(path, relief(9000, rng, dent), fmt="%.6f")
        files.append(str(path))
        lines.append(f"{path.name} 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 {STATION}")
    poses = folder / f"{name}.poses"
    poses.write_text("\n".join(lines) + "\n")
    return files, str(poses)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a project with two epochs, processed and compared, through the command line alone."""
    folder = tmp_path_factory.mktemp("relief")
    project, rng = str(folder / "project"), np.random.default_rng(7)
    assert run(["init", project, "--name", "Reliefs"]) == 0
    assert run(["add-object", project, "relief", "--material", "limestone", "--tolerance", "2"]) == 0
    for name, date, dent in (("e1", "2025-05-01", 0.0), ("e2", "2026-05-01", 0.006)):
        files, poses = write_epoch(folder, name, dent, rng)
        assert run(["add-epoch", project, "relief", name, "--date", date, "--poses", poses, *files]) == 0
    assert run(["process", project]) == 0
    assert run(["compare", project, "relief"]) == 0
    return folder


@pytest.fixture
def project(made: Path, tmp_path: Path) -> Path:
    """Return a copy of the project, to be changed."""
    return Path(shutil.copytree(made / "project", tmp_path / "copy"))


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a report draw its views small: six of the usual size take a quarter of a minute."""
    monkeypatch.setattr(pictures, "LARGEST", 200)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)


def digest(folder: Path) -> dict[str, str]:
    """Return the hash of every file of a project."""
    files = (p for p in folder.rglob("*") if p.is_file() and p.name != "project.lock")
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_the_dent_is_found_and_told_as_lost(made: Path) -> None:
    comparison = Project.open(made / "project").get("relief", "e2", "comparison-e1")
    largest = comparison.regions.iloc[0]
    assert largest["kind"] == "lost"
    assert np.hypot(largest["x"] - 0.1, largest["y"] + 0.05) < 0.01
    assert largest["extreme_m"] == pytest.approx(-0.006, abs=0.001)
    volume = -0.006 * np.pi * 0.06**2 * (0.5 - 2 / np.pi**2)  # of the cosine bowl
    assert largest["volume_m3"] == pytest.approx(volume, rel=0.12)


def test_compare_tells_what_could_not_be_assessed_of_both_surfaces_and_no_share_as_none(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["compare", str(made / "project"), "relief", "e1", "e2"]) == 0
    statistics = Project.open(made / "project").get("relief", "e2", "comparison-e1").statistics
    shares = [1.0 - statistics[name] for name in ("assessed_area_share_reference", "assessed_area_share")]
    assert min(shares) > 0.0
    before, after = (percent(share).replace("\u00a0", " ") for share in shares)
    told = capsys.readouterr().out
    assert f"; {before} of e1 and {after} of e2 not assessable" in told or f"; {after} not assessable" in told
    assert "; 0 %" not in told


def test_export_names_and_properties_are_those_of_the_contract(made: Path, tmp_path: Path) -> None:
    out = str(tmp_path)
    formats = "ply,glb,obj,stl,laz,e57,csv"
    assert run(["export", str(made / "project"), "relief", "e1", "e2", "--out", out, "--format", formats]) == 0
    stem = "relief_e1_e2"
    names = {f"{stem}_on-{side}.{f}" for side in ("compared", "reference") for f in formats.split(",")}
    assert {p.name for p in tmp_path.iterdir()} == names | {f"{stem}_regions.csv", f"{stem}_summary.json"}
    header = (tmp_path / f"{stem}_on-compared.ply").read_bytes().split(b"end_header")[0].decode()
    properties = [line.removeprefix("property ") for line in header.splitlines() if line.startswith("property ")]
    assert properties[:13] == [
        "double x", "double y", "double z", "float nx", "float ny", "float nz", "uchar red", "uchar green",
        "uchar blue", "float distance", "float lod95", "uchar assessment", "int region",
    ]  # fmt: skip
    summary = json.loads((tmp_path / f"{stem}_summary.json").read_text())
    assert summary["n_vertices"] == summary["n_not_assessable"] + summary["n_unchanged"] + summary["n_changed"]
    assert np.shape(summary["covariance"]) == (6, 6)
    assert summary["mode"] == "relative"


def test_export_of_one_epoch_is_its_surface(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "SCREEN_FACES", 2000)  # charts of all 35 000 faces take a quarter of a minute
    given = ["export", str(made / "project"), "relief", "e1", "--out"]
    assert run([*given, str(tmp_path / "plain")]) == 0
    assert [p.name for p in (tmp_path / "plain").iterdir()] == ["relief_e1_surface.ply"]
    assert run([*given, str(tmp_path / "light"), "--format", "screen"]) == 0
    assert [p.name for p in (tmp_path / "light").iterdir()] == ["relief_e1_screen.glb"]


def test_a_light_model_of_a_comparison_is_refused_and_not_left_out_without_a_word(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["export", str(made / "project"), "relief", "e1", "e2", "--out", str(tmp_path / "out"), "--format"]
    assert run([*given, "ply,screen"]) == 2
    assert "screen is the light model of one epoch; of a comparison take ply, glb, obj" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_holes_that_stay_open_are_told_on_the_screen_and_as_json(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def leave_open(*given: Any) -> list[Step]:
        asked = {"parameters": {"surface": {"watertight": True}}, "counts": {"holes_left_open": 2}}
        return [dataclasses.replace(s, **asked) if s.product == "surface" else s for s in process_epoch(*given)]

    monkeypatch.setattr(working, "process_epoch", leave_open)
    assert run(["process", str(made / "project"), "relief", "e1", "--json"]) == 0
    said = capsys.readouterr()
    told = "not watertight: 2 holes stay open, since faces over them would meet others"
    assert f"mind: relief e1: {told}\n" in said.err
    assert json.loads(said.out)[0]["open_holes"] == told


def test_a_surface_that_most_points_have_not_got_is_told(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lose(*given: Any) -> list[Step]:
        lost = {"automatic": {"uncovered_share": 0.984}}
        return [dataclasses.replace(s, **lost) if s.product == "surface" else s for s in process_epoch(*given)]

    assert run(["process", str(made / "project"), "relief", "e1"]) == 0
    assert "has no surface" not in capsys.readouterr().err
    monkeypatch.setattr(working, "process_epoch", lose)
    assert run(["process", str(made / "project"), "relief", "e1", "--json"]) == 0
    said = capsys.readouterr()
    assert "mind: relief e1: 98.4 % of the area between its points has no surface: perhaps they lie too far" in said.err
    assert json.loads(said.out)[0]["uncovered"].startswith("98.4 % of the area")


def test_a_second_process_makes_nothing_new(made: Path) -> None:
    before = digest(made / "project")
    assert run(["process", str(made / "project")]) == 0
    assert run(["compare", str(made / "project"), "relief", "e1", "e2"]) == 0
    assert digest(made / "project") == before


@pytest.mark.usefixtures("small_pictures")
def test_report_is_a_page_and_a_document_with_their_fixed_names(made: Path, tmp_path: Path) -> None:
    assert run(["report", str(made / "project"), "relief", "e1", "e2", "--out", str(tmp_path)]) == 0
    document, page = sorted(tmp_path.iterdir(), reverse=True)
    assert (document.name, page.name) == ("relief_e1_e2_report.pdf", "relief_e1_e2_report.html")
    told = PdfDocument(str(document)).extract_text(0)
    assert "One region changed." in told
    text = page.read_text(encoding="utf-8")
    assert "limestone" in text
    assert "http://" not in text.replace("http://www.w3.org", "")


def test_status_as_json_names_what_was_done(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["status", str(made / "project"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    epochs = facts["objects"][0]["epochs"]
    assert [e["n_scans"] for e in epochs] == [2, 2]
    assert [e["n_points"] for e in epochs] == [18000, 18000]
    assert epochs[1]["compared_with"] == ["e1"]


def test_areas_that_the_user_calls_stable_are_the_only_ones(project: Path, tmp_path: Path) -> None:
    stable = tmp_path / "stable.json"
    stable.write_text('{"polygon": [[-1, -1], [0, -1], [0, 1], [-1, 1]]}')  # the half on -x, without the dent
    assert run(["compare", str(project), "relief", "e1", "e2", "--stable", str(stable)]) == 0
    comparison = Project.open(project).get("relief", "e2", "comparison-e1")
    is_stable = comparison.registration.is_stable
    x = comparison.on_compared.surface.vertices[:, 0]
    assert is_stable[x < -0.02].mean() > 0.8
    assert not is_stable[x > 0.02].any()
    assert comparison.regions.iloc[0]["extreme_m"] == pytest.approx(-0.006, abs=0.001)


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (5400000.125, 5400001.0, "holds nothing of the earlier epoch; that lies within x -"),
        (-100.0, 100.0, "holds all of both epochs; that lies within x -"),
    ],
)
def test_a_stable_area_that_misses_the_object_or_holds_all_of_it_is_refused(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], low: float, high: float, said: str
) -> None:
    stable = tmp_path / "stable.json"
    stable.write_text(json.dumps({"box": {"min": [low] * 3, "max": [high] * 3}}))
    assert run(["compare", str(project), "relief", "e1", "e2", "--stable", str(stable)]) == 2
    error = capsys.readouterr().err
    area = ", ".join(f"{axis} {low:.3f} to {high:.3f}" for axis in "xyz")
    assert f"the stable area, within {area} m, {said}" in error
    assert "give the part where nothing moved, in metres" in error


def test_verify_finds_a_changed_byte(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["verify", str(project)]) == 0
    victim = next((project / "objects").rglob("surface-*.h5"))
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    assert run(["verify", str(project)]) == 2
    assert "surface" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["status", "{tmp}/nowhere"], "nowhere"),
        (["status", "{tmp}"], "not a project"),
        (["verify", "{tmp}/nowhere"], "nowhere: there is nothing there; give the folder of a project or of an archive"),
        (["verify", "{tmp}"], "holds no project.h5 of a project and is no archive; give the folder of"),
        (["verify", "{scan0}"], "is a file, and no folder of a project or of an archive"),
        (["add-object", "{project}", "../../etc"], "for example 'etc'"),
        (["add-object", "{project}", "Große Vase"], "Grosse-Vase"),
        (["add-object", "{project}", "a/b"], "a-b"),
        (["add-object", "{project}", "relief"], "relief"),
        (["add-object", "{project}", "vase", "--tolerance", "-3"], "--tolerance"),
        (["add-object", "{project}", "vase", "--front", "up"], "--front up: north, east, south, west are allowed"),
        (["add-object", "{project}", "vase", "--front", "360.5"], "or degrees clockwise from north, 0 to 360"),
        (["add-object", "{project}", "vase", "--front", "-90"], "--front -90: north"),
        (["add-object", "{project}", "vase", "--front", "nan"], "--front nan: north"),
        (["set-front", "{project}", "relief", "up"], "DIRECTION up: north, east, south, west are allowed"),
        (["set-front", "{project}", "vase", "south"], "vase"),
        (["add-object", "{project}", "vase", "--extent", "{tmp}/none.json"], "none.json"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-05-01"], "FILE"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-05-01", "{tmp}/none.ply"], "no such file"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "May 2026", "{scan0}"], "--date"),
        (["add-epoch", "{project}", "relief", "e1", "--date", "2026-05-01", "{scan0}"], "has an epoch e1 already"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-05-01", "{scan0}", "{scan1}"], "--poses"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-05-01", "{scan0}", "{scan0}"], "given twice"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-05-01", "--unit", "km", "{scan0}"], "km"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-05-01", "--scanner", "eye", "{scan0}"], "eye"),
        (["add-epoch", "{project}", "nothing", "e3", "--date", "2026-05-01", "{scan0}"], "nothing"),
        (["process", "{project}", "nothing"], "nothing"),
        (["compare", "{project}", "relief", "e1"], "two"),
        (["compare", "{project}", "relief", "e1", "e1"], "twice"),
        (["compare", "{project}", "relief", "e1", "e9"], "e9"),
        (["compare", "{project}", "relief", "e1", "e2", "--mode", "sideways"], "relative, absolute"),
        (["compare", "{project}", "relief", "e1", "e2", "--stable", "{tmp}/none.json"], "none.json"),
        (["export", "{project}", "relief", "--out", "{tmp}/o", "--format", "dwg"], "dwg"),
        (["report", "{project}", "relief", "e2", "e1", "--out", "{tmp}/o"], "monitor compare"),
        (["process", "{project}", "--settings", "{tmp}/none.toml"], "none.toml"),
        (["process", "{project}", "--workers", "0"], "at least 1"),
        (["paint", "{project}"], "No such command"),
        (["init", "{tmp}/new", "--crs", "nonsense"], "like EPSG:31256"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "2026-5-1", "{scan0}"], "2026-05-31"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "\uff12026-05-01", "{scan0}"], "2026-05-31"),
        (["add-epoch", "{project}", "relief", "e3", "--date", "0001-01-01", "{scan0}"], "2026-05-31"),
        (["demo", "--out", "{scan0}/below"], "cannot be made a folder"),
    ],
)
def test_bad_input_is_one_clear_line_and_changes_nothing(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    names = {"tmp": tmp_path, "project": made / "project", "scan0": made / "e1-0.xyz", "scan1": made / "e1-1.xyz"}
    before = digest(made / "project")
    capsys.readouterr()
    assert run([a.format(**names) for a in arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    said = [line for line in lines if line.startswith("monitor: ")]
    assert len(said) == 1
    assert message in said[0]
    assert digest(made / "project") == before


def add_far_epoch(project: Path, folder: Path, points: np.ndarray) -> None:
    """Add and process a third epoch, "far", of one scan."""
    file = folder / "far.xyz"
    np.savetxt(file, points, fmt="%.6f")
    poses = folder / "far.poses"
    poses.write_text(f"far.xyz 1 0 0 40 0 1 0 0 0 0 1 0 0 0 0 1 {STATION}\n")
    added = ["add-epoch", str(project), "relief", "far", "--date", "2026-06-01", "--poses", str(poses), str(file)]
    assert run(added) == 0
    assert run(["process", str(project), "relief", "far"]) == 0


def test_epochs_of_other_things_elsewhere_are_refused(
    project: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    x, y = rng.uniform(-0.3, 0.3, (2, 9000))
    other = np.column_stack([x, y, 0.25 * np.cos(4 * x) * np.cos(5 * y) + rng.normal(0, 3e-4, 9000)])
    add_far_epoch(project, tmp_path, other)
    before = digest(project)
    capsys.readouterr()
    assert run(["compare", str(project), "relief", "e1", "far"]) == 2
    said = capsys.readouterr().err
    assert "overlap" in said
    assert "by shape alone" in said
    assert digest(project) == before


@pytest.mark.usefixtures("small_pictures")
def test_object_carried_elsewhere_is_found_by_its_shape_and_the_report_says_so(
    project: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    add_far_epoch(project, tmp_path, relief(18000, rng, 0.0))
    assert run(["compare", str(project), "relief", "e1", "far"]) == 0
    assert "they were brought together by their shapes alone" in capsys.readouterr().out
    comparison = Project.open(project).get("relief", "far", "comparison-e1")
    assert comparison.registration.T_target_source[0, 3] == pytest.approx(-40.0, abs=5e-4)
    assert run(["report", str(project), "relief", "e1", "far", "--out", str(tmp_path)]) == 0
    assert "by their shapes alone" in (tmp_path / "relief_e1_far_report.html").read_text()


def test_millimetres_taken_for_metres_are_questioned_with_the_size(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = tmp_path / "millimetres.xyz"
    np.savetxt(scan, 1000 * relief(3000, np.random.default_rng(3), 0.0), fmt="%.3f")
    before = digest(made / "project")
    command = ["add-epoch", str(made / "project"), "relief", "mm", "--date", "2026-06-01", str(scan)]
    assert run(command) == 2
    assert "0.6 m if in mm" in capsys.readouterr().err
    assert digest(made / "project") == before


def test_an_epoch_that_fails_does_not_keep_the_others_from_being_made(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "few.xyz", relief(12, np.random.default_rng(3), 0.0), fmt="%.6f")
    doubts = {"2024-05-01": "", "2099-05-01": "has not come yet",
              "1020-05-01": "lies before anything was measured point by point"}  # fmt: skip
    for name, date in zip(("e0", "e9", "e8"), doubts, strict=True):
        given = ["add-epoch", str(project), "relief", name, "--date", date, str(tmp_path / "few.xyz")]
        assert run(given) == 0
        said = capsys.readouterr().err
        assert (f"mind: {date} " in said) == bool(doubts[date])
        assert f"mind: {date} {doubts[date]}; was epoch {name} surveyed then?" in said or not doubts[date]
    assert run(["remove-epoch", str(project), "relief", "e8"]) == 0
    capsys.readouterr()
    assert run(["process", str(project), "--json"]) == 2
    said = capsys.readouterr()
    assert [f["epoch"] for f in json.loads(said.out)] == ["e1", "e2"]
    assert "monitor: object relief, epoch e0: " in said.err
    assert said.err.endswith(
        "monitor: 2 of 4 epochs could not be processed, for what is said above; the others are done\n"
    )
    assert run(["compare", str(project), "relief", "--json"]) == 2
    said = capsys.readouterr()
    assert [(f["reference"], f["compared"]) for f in json.loads(said.out)] == [("e1", "e2")]
    assert said.err.endswith(
        f"monitor: epochs e0 and e9 of object relief have no surface yet; run: monitor process {project} relief\n"
        "monitor: 4 of 5 pairs of epochs could not be compared, and no change was followed over the epochs, "
        "for what is said above; the others are done\n"
    )


def test_a_removed_epoch_is_gone_and_its_comparison_with_it(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run(["remove-epoch", str(project), "relief", "e1"]) == 0
    said = capsys.readouterr().out
    assert "with it went the comparison e1 to e2; monitor compare makes anew what can be made" in said
    kept = Project.open(project)
    assert [e.epoch_id for e in kept.epochs("relief")] == ["e2"]
    assert kept.latest("relief", "e2", "comparison-e1") is None


def test_what_can_no_longer_be_read_is_not_left_out_of_an_export(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (surface,) = (project / "objects" / "relief" / "e1").glob("surface-*.h5")
    surface.unlink()
    assert run(["export", str(project), "relief", "--out", str(tmp_path / "out")]) == 2
    assert "epoch e1 of object relief has no surface" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run(["status", str(project), "--json"]) == 0
    epochs = json.loads(capsys.readouterr().out)["objects"][0]["epochs"]
    assert [e["processed"] for e in epochs] == [False, True]


def test_a_comparison_of_before_an_epoch_was_processed_again_is_told_so(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = tmp_path / "s.toml"
    assert run(["export", str(project), "relief", "e1", "e2", "--out", str(tmp_path / "out")]) == 0
    assert "mind:" not in capsys.readouterr().err
    settings.write_text("\ufeff[surface]\ncrumb_cells = 4.0\n", encoding="utf-8")  # as some editors begin a file
    assert run(["process", str(project), "relief", "e1", "--settings", str(settings)]) == 0
    assert run(["export", str(project), "relief", "e1", "e2", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert "mind: e1 was processed again after e1 and e2 were compared" in said
    assert "mind: e2" not in said


def test_epochs_are_purged_one_by_one_and_afterwards_too(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = project / "objects" / "relief"
    assert run(["remove-epoch", str(project), "relief", "e1"]) == 0
    kept = sorted(p.name for p in (folder / "e1").iterdir())
    assert run(["remove-epoch", str(project), "relief", "e2", "--purge"]) == 0
    assert not (folder / "e2").exists()
    assert sorted(p.name for p in (folder / "e1").iterdir()) == kept  # it was not named
    assert run(["remove-epoch", str(project), "relief", "e1", "--purge"]) == 0
    assert not list(folder.iterdir())
    capsys.readouterr()
    assert run(["remove-epoch", str(project), "relief", "e1", "--purge"]) == 2
    assert "no epoch" in capsys.readouterr().err


def test_names_that_the_screen_has_no_letters_for_are_told_with_their_numbers(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-c",
        "from monitor.cli import main; main()",
        "init",
        str(tmp_path / "p"),
        "--name",
        "Säule 柱",
    ]
    told = subprocess.run(command, capture_output=True, check=False, env={**os.environ, "PYTHONIOENCODING": "latin-1"})
    assert (told.returncode, told.stderr) == (0, b"")
    assert told.stdout.startswith(b"project S\xe4ule \\u67f1 started in ")


@pytest.mark.parametrize("command", ["export", "report"])
def test_nothing_is_written_into_the_project_but_what_it_keeps(
    made: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    project = made / "project"
    assert run([command, str(project), "relief", "e1", "e2", "--out", str(project / "out")]) == 2
    assert f"--out {project}/out: lies within the project; give a folder outside of" in capsys.readouterr().err
    assert not (project / "out").exists()


def test_an_interrupted_command_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(path: Path, as_json: bool) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("monitor.cli.keeping.show_status", interrupt)
    assert run(["status", "anywhere"]) == 130
    assert "interrupted; what was finished is kept" in capsys.readouterr().err
