"""The documentation archive: whole by the check of others, true to what was measured, and never half there."""

import datetime
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bagit
import numpy as np
import pandas as pd
import pytest
from example_project import MOTION, TURN, fill, measured, silent, step
from report_examples import example_comparison, example_object
from series_examples import followed, series_of

from monitor.cli import run
from projects import Project
from projects.bags import verify_bag
from projects.errors import ParameterError, StoreError
from projects.formats import read_mesh, read_scans
from projects.formats.complete_file import complete_folder
from projects.model import (
    CLOSURE_COLUMNS,
    FORECAST_COLUMNS,
    HISTORY_COLUMNS,
    MOTION_COLUMNS,
    SERIES_COLUMNS,
    EpochRecord,
    NotAssessed,
)
from projects.provenance import hash_file
from projects.transforms import apply
from reports import archive, deposit_comparison, pictures
from reports.archive import write_archive


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a project and its archive."""
    folder = tmp_path_factory.mktemp("archived")
    with pytest.MonkeyPatch.context() as small:
        small.setattr(pictures, "LARGEST", 200)
        small.setattr(pictures, "CLOSE_UP_PIXELS", 200)
        write_archive(folder / "archive", fill(folder), ["column"], silent)
    return folder


def test_the_library_of_congress_finds_the_bag_whole(made: Path) -> None:
    bag = bagit.Bag(str(made / "archive"))
    bag.validate()
    assert bag.version_info == (1, 0)
    assert bag.info["External-Description"] == "Documentation archive of Tor: Säule am Tor"
    assert (verify_bag(made / "archive").findings, verify_bag(made / "archive").n_files) == ((), len(bag.entries))


def test_the_crate_names_every_file_with_its_hash_and_what_it_came_of(made: Path) -> None:
    data = made / "archive" / "data"
    graph = {e["@id"]: e for e in json.loads((data / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]}
    there = {p.relative_to(data).as_posix() for p in data.rglob("*") if p.is_file()} - {"ro-crate-metadata.json"}
    described = {name: e for name, e in graph.items() if e["@type"] == "File"}
    assert set(described) == there == {part["@id"] for part in graph["./"]["hasPart"]}
    for name, entity in described.items():
        assert entity["sha256"] == hash_file(data / name)
        assert len(entity["description"]) > 10
    processing = next(e for e in graph.values() if e.get("name", "").startswith("Processing of epoch e1"))
    assert {o["@id"] for o in processing["object"]} == {
        f"column/e1/column_e1_{n}" for n in ("scans.e57", "control.csv")
    }
    assert "column/e1/column_e1_surface.ply" in {r["@id"] for r in processing["result"]}
    comparing = next(e for e in graph.values() if e.get("name", "").startswith("Comparison"))
    assert {o["@id"] for o in comparing["object"]} == {f"column/{e}/column_{e}_surface.ply" for e in ("e1", "e2")}
    assert graph[comparing["instrument"]["@id"]]["softwareVersion"] == "0.1.0"
    assert graph["./"]["license"].startswith("No licence was recorded")  # RO-Crate 1.2: MUST be there
    (about,) = graph["./"]["about"]
    subject = graph[about["@id"]]
    assert (subject["name"], subject["identifier"], subject["material"]) == ("Säule am Tor", "K 12/3", "limestone")


def test_the_readme_says_what_every_column_of_every_file_is(made: Path) -> None:
    data = made / "archive" / "data"
    words = set(re.findall(r"[A-Za-z0-9_]+", (data / "README.txt").read_text(encoding="utf-8")))
    names = {c for p in data.rglob("*") if p.suffix == ".csv" or "_GRE" in p.name for c in pd.read_csv(p).columns}
    for path in data.rglob("*.ply"):
        head = path.read_bytes().split(b"end_header")[0].decode("ascii")
        names |= {line.split()[-1] for line in head.splitlines() if line.startswith("property")}
    names |= set(json.loads(next(data.rglob("*_summary.json")).read_text(encoding="utf-8")))
    names |= {c for columns in (SERIES_COLUMNS, HISTORY_COLUMNS, FORECAST_COLUMNS, MOTION_COLUMNS, CLOSURE_COLUMNS)
              for c in columns}  # fmt: skip
    told_once = {name for name in names if name.removeprefix("sigma_") in words or name in words}
    assert names - told_once == set()
    readme = (data / "README.txt").read_text(encoding="utf-8")
    reasons = readme.partition("  reason  ")[2].partition("  red green blue")[0]
    assert {int(number) for number in re.findall(r"\d+", reasons)} == {int(reason) for reason in NotAssessed}
    assert {"unresolved", "crest", "invented", "stray_share", "rate_assessment", "rate_told_from"} <= words


def test_the_readme_calls_poses_registered_only_where_they_are(made: Path, tmp_path: Path) -> None:
    told = (made / "archive" / "data" / "README.txt").read_text(encoding="utf-8")
    assert "points, stations as registered\n" in told
    assert "where the scanner stood, as registered\n" in told
    assert "as given" not in told.partition("Names\n")[2].partition("Formats:")[0].replace("as it was given", "")
    raw = Project.create(tmp_path / "raw")
    raw.add_object(replace(example_object(), object_id="door"))
    raw.add_epoch(EpochRecord("door", "e1", datetime.date(2027, 5, 1)), read_scans(made / "a.e57"))
    write_archive(tmp_path / "archive", raw, ["door"], silent)
    told = (tmp_path / "archive" / "data" / "README.txt").read_text(encoding="utf-8")
    assert "as registered" not in told
    for line in ("points, stations as given, not registered\n", "pose of scan N, as given, not registered: 4 x 4",
                 "where the scanner stood, as given, not registered\n"):  # fmt: skip
        assert line in told


def test_the_front_of_the_object_stands_in_the_archive_and_its_report_goes_by_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 120)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 120)
    project = fill(tmp_path)
    project.put("column", "e2", step("series-e1", "9", inputs=("5" * 16,)), followed({5: 2, 7: 1}))
    project.set_front("column", np.radians(15.0))
    write_archive(tmp_path / "archive", project, ["column"], silent)
    data = tmp_path / "archive" / "data" / "column"
    rows = {r.field: r.value for r in pd.read_csv(data / "e1" / "column_e1_metadata.csv").itertuples()}
    assert rows["Front faces, clockwise from +y [degrees]"] == "15.0"
    (report,) = data.rglob("*_report.html")
    told = report.read_text(encoding="utf-8")
    assert "it faces north (15 degrees clockwise from +y)" in told
    assert ["left side, 30" in told, "right side, 30" in told] == [True, False]  # of the region, and as it is followed
    assert run(["export", str(project.path), "column", "e1", "e2", "--out", str(tmp_path)]) == 0
    for table in (tmp_path / "column_a_series_regions.csv", *data.rglob("column_a_series_regions.csv")):
        places = pd.read_csv(table).set_index("identity")["place"]
        assert {k: v.partition(",")[0] for k, v in places.items()} == {5: "left side", 7: "back"}
    assert len(list(data.rglob("*_series_regions.csv"))) == 1


def test_points_of_the_cloud_name_their_scan_as_the_other_files_do(made: Path) -> None:
    folder = made / "archive" / "data" / "column" / "e1"
    cloud, scans = pd.read_csv(folder / "column_e1_GRE.txt"), pd.read_csv(folder / "column_e1_scans.csv")
    assert cloud["scan"].tolist() == [1] * 200 + [2] * 200
    assert set(cloud["scan"]) == set(scans["scan"])
    assert all((folder / f"column_e1_GRmatrices_scan{n}.txt").is_file() for n in set(cloud["scan"]))


def test_scans_come_back_as_measured_and_their_matrices_place_them_as_registered(made: Path) -> None:
    folder = made / "archive" / "data" / "column" / "e1"
    scans = list(read_scans(folder / "column_e1_scans.e57"))
    for k, (scan, motion) in enumerate(zip(scans, (np.eye(4), MOTION), strict=True)):
        given = TURN if k else np.eye(4)
        points = np.concatenate([block.cloud.points for block in scan.chunks()])
        np.testing.assert_allclose(points, measured(k).points, atol=0.6e-6)
        np.testing.assert_allclose(scan.pose, given, atol=1e-12)
        matrix = np.loadtxt(folder / f"column_e1_GRmatrices_scan{k + 1}.txt")
        np.testing.assert_allclose(apply(matrix, points), apply(motion, apply(given, measured(k).points)), atol=2e-6)
    table = pd.read_csv(folder / "column_e1_scans.csv")
    assert table["source_sha256"].tolist() == [hash_file(made / "a.e57")] * 2
    station = apply(MOTION, TURN[:3, 3])
    np.testing.assert_allclose(
        table[["station_x", "station_y", "station_z"]].iloc[1].to_numpy(float), station, atol=1e-12
    )


def test_cloud_mesh_and_metadata_say_what_the_project_holds(made: Path) -> None:
    folder = made / "archive" / "data" / "column" / "e1"
    cloud = pd.read_csv(folder / "column_e1_GRE.txt")
    np.testing.assert_array_equal(cloud[["x", "y", "z"]].to_numpy(), measured(0).points)
    assert cloud["n_merged"].tolist() == [3] * 400
    given = read_mesh(made / "archive" / "data" / "column" / "e2" / "column_e2_origmesh.obj")
    np.testing.assert_allclose(given.vertices, example_comparison().on_compared.surface.vertices, atol=1e-6)
    rows = {(r.part, r.field): r.value for r in pd.read_csv(folder / "column_e1_metadata.csv").itertuples()}
    assert rows["survey", "Coordinate reference system"] == "EPSG:31256"
    assert rows["survey", "Company or operator"] == "A. Müller"
    assert rows["survey", "Scanner serial number"] == "not recorded"
    assert rows["survey", "Number of measured points"] == "800"
    assert rows["registration", "Given poses were corrected"] == "yes"
    assert rows["points", "dropped as outliers of the merged cloud"] == "5"
    assert float(rows["mesh", "Sigma of a vertex, median [m]"]) == 2e-5
    assert rows["survey", "Extent of the object [m]"] == "none was given"
    assert rows["survey", "Front faces, clockwise from +y [degrees]"] == "none was given"
    mesh = made / "archive" / "data" / "column" / "e2" / "column_e2_metadata.csv"
    of_mesh = {(r.part, r.field): r.value for r in pd.read_csv(mesh).itertuples()}
    assert of_mesh["survey", "Original file"] == f"column.ply (SHA-256 {'ab' * 32})"
    assert pd.read_csv(folder / "column_e1_control.csv").iloc[0].tolist() == ["K1", 1.0, 2.0, 3.0, 0.001]


def test_verify_names_every_file_that_is_changed_missing_or_new(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:

    copy = Path(shutil.copytree(made / "archive", tmp_path / "archive"))
    assert run(["verify", str(copy)]) == 0
    epoch = copy / "data" / "column" / "e1"
    damaged = epoch / "column_e1_GRE.txt"
    damaged.write_bytes(damaged.read_bytes().replace(b"1", b"2", 1))  # of the same length
    (epoch / "column_e1_control.csv").unlink()
    (epoch / "notes.txt").write_text("by hand")
    (copy / "bag-info.txt").write_text("Source-Organization: somebody else\n")
    capsys.readouterr()
    assert run(["verify", str(copy), "--json"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert {f["path"]: f["message"].split(" ", 1)[1][:22] for f in told["findings"]} == {
        "data/column/e1/column_e1_GRE.txt": "has changed since it w",
        "data/column/e1/column_e1_control.csv": "is missing",
        "data/column/e1/notes.txt": "was not there when it ",
        "bag-info.txt": "has changed since it w",
    }
    (copy / "manifest-sha256.txt").unlink()
    assert run(["verify", str(copy)]) == 2


def test_a_bag_without_the_seal_of_its_manifest_is_said_to_have_none(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = Path(shutil.copytree(made / "archive", tmp_path / "archive"))
    (copy / "tagmanifest-sha256.txt").unlink()
    (copy / "bag-info.txt").write_text("Source-Organization: somebody else\n")
    assert run(["verify", str(copy)]) == 0  # a bag that others made need not have one
    assert "warning: tagmanifest-sha256.txt: tagmanifest-sha256.txt is missing, so nobody" in capsys.readouterr().out
    (copy / "manifest-sha256.txt").write_text("")
    assert run(["verify", str(copy)]) == 2
    n_files = sum(p.is_file() for p in (copy / "data").rglob("*"))
    assert f"{n_files} things are not as recorded" in capsys.readouterr().err  # of the 0 that are in the manifest


def test_a_path_that_leads_out_of_the_bag_is_not_followed(made: Path, tmp_path: Path) -> None:

    copy = Path(shutil.copytree(made / "archive", tmp_path / "archive"))
    (tmp_path / "secret").write_text("outside")
    with (copy / "manifest-sha256.txt").open("a") as manifest:
        manifest.write(f"{hash_file(tmp_path / 'secret')}  data/../../secret\n")
    (finding, *_) = verify_bag(copy).findings
    assert finding.severity == "error"


def test_an_archive_that_was_cut_short_leaves_nothing(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*given: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(deposit_comparison, "write_report", fail)
    project = Project.open(made / "project")
    with pytest.raises(ParameterError, match=r"cannot be written \(No space left on device\); make room"):
        write_archive(tmp_path / "archive", project, ["column"], silent)
    assert list(tmp_path.iterdir()) == []
    left, mine = tmp_path / ".archive-0123abcd.unfinished", tmp_path / "archive.unfinished"
    for folder in (left, mine):  # the first by a process that was killed
        folder.mkdir()
        (folder / "old").write_text("old")
    os.utime(left, (0.0, 0.0))
    with complete_folder(tmp_path / "archive") as folder:
        (folder / "new").write_text("new")
    assert [p.name for p in (tmp_path / "archive").iterdir()] == ["new"]
    assert [p.name for p in tmp_path.iterdir() if p.name != "archive"] == [mine.name]


def test_what_another_process_is_still_writing_is_left_alone_and_what_one_left_that_ended_is_removed(
    tmp_path: Path,
) -> None:
    begin = (
        "import sys, time; from pathlib import Path; from projects.formats.complete_file import complete_folder\n"
        "with complete_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'half').write_text('half'); print('begun', flush=True); time.sleep(600)"
    )
    other = subprocess.Popen([sys.executable, "-c", begin, str(tmp_path / "archive")], stdout=subprocess.PIPE)
    assert other.stdout is not None
    assert other.stdout.readline() == b"begun\n"
    refused = pytest.raises(ParameterError, match=rf"archive: is being written by process {other.pid} on ")
    with refused, complete_folder(tmp_path / "archive"):
        pass
    (room,) = tmp_path.iterdir()
    assert (room / "archive" / "half").read_text() == "half"
    other.kill()
    other.wait()
    with complete_folder(tmp_path / "archive") as folder:
        (folder / "new").write_text("new")
    assert [p.name for p in tmp_path.iterdir()] == ["archive"]
    assert [p.name for p in (tmp_path / "archive").iterdir()] == ["new"]


def test_a_folder_in_use_one_within_the_project_and_an_empty_object_are_refused(made: Path, tmp_path: Path) -> None:
    project = Project.open(made / "project")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ParameterError, match="is there already; give a folder that is new or empty"):
        write_archive(tmp_path, project, ["column"], silent)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    with pytest.raises(ParameterError, match="lies within the project"):
        write_archive(made / "project" / "archive", project, ["column"], silent)
    empty = Project.create(tmp_path / "empty")
    empty.add_object(replace(example_object(), object_id="bare"))
    with pytest.raises(StoreError, match="has no epoch yet, so there is nothing to archive"):
        write_archive(tmp_path / "out", empty, ["bare"], silent)
    assert run(["archive", str(made / "project"), "nobody", "--out", str(tmp_path / "out")]) == 2


def test_what_is_not_processed_or_out_of_date_is_said_in_the_archive(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:

    monkeypatch.setattr(pictures, "LARGEST", 200)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
    copy = Project.open(shutil.copytree(made / "project", tmp_path / "project"))
    copy.add_epoch(EpochRecord("column", "e3", datetime.date(2027, 5, 1)), read_scans(made / "a.e57"))
    copy.put("column", "e2", step("surface", "6"), example_comparison().on_compared.surface)
    assert run(["archive", str(copy.path), "--out", str(tmp_path / "archive")]) == 0
    told = capsys.readouterr().err
    readme = (tmp_path / "archive" / "data" / "README.txt").read_text(encoding="utf-8")
    as_given = "the archive holds no surface of it, and its scans stand as given, not registered"
    for text in (
        f"epoch e3 of column is not processed: {as_given}",
        "epoch e2 of column was processed again after it was compared",
    ):
        assert text in told
        assert text in readme
    assert archive._today() in readme
    assert "points, stations as registered or as given (below)" in readme
    assert "Poses of the scans of column e3 are\nas they were given, not registered." in readme
    data = tmp_path / "archive" / "data"
    graph = {e["@id"]: e for e in json.loads((data / "ro-crate-metadata.json").read_text(encoding="utf-8"))["@graph"]}
    for epoch, known in (("e1", "as registered"), ("e3", "as given, not registered")):
        told = [
            graph[f"column/{epoch}/column_{epoch}_{name}"]["description"]
            for name in ("scans.csv", "GRmatrices_scan1.txt")
        ]
        assert all(known in text for text in told)
        rows = {
            r.field: r.value for r in pd.read_csv(data / "column" / epoch / f"column_{epoch}_metadata.csv").itertuples()
        }
        assert rows["Registration method"].startswith("one adjustment") == (epoch == "e1")
        assert rows["Registration method"].endswith("the poses are as given, not registered") == (epoch == "e3")


def test_the_crate_claims_no_origin_that_a_file_does_not_have(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 200)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
    project = Project.open(shutil.copytree(made / "project", tmp_path / "project"))
    project.put("column", "e1", step("filtered", "7"), measured(0))  # processed anew, and ended before the surface
    newer = replace(step("surface", "6"), versions={"heritage-monitor": "0.1.0", "numpy": "9.9"})
    project.put("column", "e2", newer, example_comparison().on_compared.surface)
    facts = write_archive(tmp_path / "archive", project, ["column"], silent)
    told = "epoch e1 of column was being processed anew, and that was not finished: its mesh and comparisons rest on an"
    assert any(mind.startswith(f"{told} earlier cloud") for mind in facts.minds)
    text = (tmp_path / "archive" / "data" / "ro-crate-metadata.json").read_text(encoding="utf-8")
    graph = {e["@id"]: e for e in json.loads(text)["@graph"]}
    actions = {e["name"]: e for e in graph.values() if e["@type"] == "CreateAction"}
    processing = {r["@id"] for r in actions["Processing of epoch e1 of column"]["result"]}
    assert "column/e1/column_e1_surface.ply" in processing
    assert "column/e1/column_e1_GRE.txt" not in processing
    compared = actions["Comparison of epochs e1 and e2 of column"]
    assert [o["@id"] for o in compared["object"]] == ["column/e1/column_e1_surface.ply"]  # not the newer one of e2
    programs = [graph[a["instrument"]["@id"]]["softwareRequirements"] for a in actions.values()]
    assert programs == ["", "numpy 9.9", ""]


def test_a_series_is_said_to_come_of_all_comparisons_that_it_rests_on(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures, "LARGEST", 100)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 100)
    project = Project.open(shutil.copytree(made / "project", tmp_path / "project"))
    n = len(example_comparison().on_reference.surface.vertices)
    known = {name: np.zeros(n) for name in ("rate", "sigma_rate", "acceleration", "sigma_acceleration")}
    series = replace(series_of("steady", (-1e-4, -4e-4)), identity=np.zeros(n, np.int32), **known)
    again = step(
        "comparison-e2", "a", inputs=("3" * 16, "4" * 16)
    )  # entered after the one that the series is kept with
    project.put("column", "e1", again, example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1))
    project.put("column", "e2", step("series-e1", "9", inputs=("5" * 16, "a" * 16)), series)
    write_archive(tmp_path / "archive", project, ["column"], silent)
    text = (tmp_path / "archive" / "data" / "ro-crate-metadata.json").read_text(encoding="utf-8")
    actions = {e["name"]: e for e in json.loads(text)["@graph"] if e["@type"] == "CreateAction"}
    followed = actions["Change of column followed from epoch e1 to e2"]
    inputs, results = ({f["@id"] for f in followed[part]} for part in ("object", "result"))
    assert {"column/e1_e2/column_e1_e2_regions.csv", "column/e2_e1/column_e2_e1_regions.csv"} <= inputs
    assert {Path(name).name.split("_")[2].split(".")[0] for name in results} == {"series"}
    compared = {f["@id"] for f in actions["Comparison of epochs e1 and e2 of column"]["result"]}
    assert not any("series" in name for name in compared)
