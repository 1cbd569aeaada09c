"""Four epochs of a relief through the command line: change is followed, reported and exported."""

import dataclasses
import datetime
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import trimesh

from monitor.chain import compare_epochs
from monitor.cli import run, working
from monitor.record import METHOD, Place
from projects import Project, Surface
from projects.errors import ComparisonError
from projects.formats import write_ply_mesh
from projects.model import Assessment, EpochRecord, ObjectRecord, Step
from reports import pictures
from reports.course_charts import draw_courses
from reports.document import gather_facts
from reports.exports import export_series

YEARS = (2021, 2022, 2023, 2025)


def relief(depth: float, rng: np.random.Generator) -> Surface:
    """Return a wavy relief 0.3 m wide with noise, worn by `depth` [m] in a round place."""
    axis = np.linspace(-0.15, 0.15, 121)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    worn = depth * 0.5 * (1 + np.cos(np.pi * np.minimum(np.hypot(x - 0.05, y), 0.05) / 0.05))
    z = 0.02 * np.sin(21 * x) * np.cos(17 * y) - worn + rng.normal(0, 5e-5, len(x))
    index = np.arange(121 * 121).reshape(121, 121)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return Surface(np.column_stack([x, y, z]), np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("series")
    project, rng = str(folder / "project"), np.random.default_rng(3)
    assert run(["init", project]) == 0
    assert run(["add-object", project, "relief", "--name", "Relief with a worn place"]) == 0
    for year in YEARS:
        path = folder / f"e{year}.ply"
        write_ply_mesh(path, relief(6e-4 * (year - 2021), rng))
        assert run(["add-epoch", project, "relief", f"e{year}", "--date", f"{year}-05-01", "--mesh", str(path)]) == 0
    assert run(["process", project]) == 0
    assert run(["compare", project, "relief"]) == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "LARGEST", 200)  # pixels: six views of the usual size take a quarter of a minute
        patch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
        assert run(["report", project, "relief", "e2021", "e2025", "--out", str(folder)]) == 0
    assert run(["export", project, "relief", "e2021", "e2025", "--out", str(folder)]) == 0
    return folder


def test_the_worn_place_is_one_region_with_its_rate(made: Path) -> None:
    series = Project.open(made / "project").get("relief", "e2025", "series-e2021")
    assert series.epoch_ids == ("e2022", "e2023", "e2025")
    assert len(series.regions) == 1
    row = series.regions.iloc[0]
    assert row.model == "steady"
    assert np.hypot(row.x - 0.05, row.y) < 0.005
    deepest = np.nanmin(series.rate)
    assert deepest == pytest.approx(-6e-4, abs=8e-5)


def test_rates_are_significant_where_it_is_worn_and_nowhere_else(made: Path) -> None:
    """By themselves one vertex in twenty would be, all over the relief."""
    project = Project.open(made / "project")
    series = project.get("relief", "e2025", "series-e2021")
    comparison = project.get("relief", "e2025", "comparison-e2021")
    surface = comparison.on_reference.surface
    away = np.hypot(surface.vertices[:, 0] - 0.05, surface.vertices[:, 1])
    significant = series.rate_assessment == Assessment.CHANGED
    assert significant[away < 0.025].all()
    assert not significant[away > 0.06].any()
    assert (np.isnan(series.rate) <= (series.rate_assessment == Assessment.NOT_ASSESSABLE)).all()
    told = dataclasses.replace(series, rate_told_from=np.arange(len(series.rate), dtype=np.float32) / 1e6)
    path = export_series(made, "told", told, comparison, ["ply"])[0]
    exported = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(exported["rate_assessment"], series.rate_assessment)
    np.testing.assert_array_equal(exported["rate_told_from"], told.rate_told_from)


def test_motions_of_the_whole_are_adjusted_together_and_close(made: Path) -> None:
    project = Project.open(made / "project")
    series = project.get("relief", "e2025", "series-e2021")
    assert list(series.motions["epoch"]) == ["e2022", "e2023", "e2025"]
    assert len(series.closures) == 5  # three with the first epoch, two with the one before
    assert series.closures["misfit_sigma"].max() < 5.0
    assert (series.motions["shift_m"] < 5e-5).all()  # the relief stayed where it was
    assert series.motions["probability_unmoved"].isna().all()  # so far as anybody knows, without control
    assert "steady_motion" not in series.statistics
    assert project.latest("relief", "e2025", "series-e2021").automatic["closure_freedom"] == 12


def test_a_steady_motion_of_the_whole_is_a_file_of_its_own(made: Path) -> None:
    project = Project.open(made / "project")
    series = project.get("relief", "e2025", "series-e2021")
    comparison = project.get("relief", "e2025", "comparison-e2021")
    steady = {"centre": np.zeros(3), "epochs": 4, "rate": np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1e-3]),
              "covariance": 1e-10 * np.eye(6), "p_rate": 0.0, "p_turn": 1.0, "p_shift": 0.0, "p_fit": 0.5}  # fmt: skip
    told = dataclasses.replace(series, statistics={**series.statistics, "steady_motion": steady})
    written = export_series(made, "settles", told, comparison, ["ply"])
    (path,) = [p for p in written if p.name.endswith("_steady_motion.csv")]
    assert pd.read_csv(path).loc[0, ["z_m_per_year", "sigma_z_m_per_year"]].tolist() == [-1e-3, 1e-5]
    assert not any("steady" in p.name for p in export_series(made, "rests", series, comparison, ["ply"]))


def test_report_and_files_say_how_it_goes_on(made: Path) -> None:
    page = (made / "relief_e2021_e2025_report.html").read_text()
    assert 'id="series"' in page
    assert "goes on steadily" in page
    assert "Of motions that are not assessable, how well the coordinates of both epochs agree is not known" in page
    assert ">not significant<" not in page
    summary = json.loads((made / "relief_e2021_e2025_summary.json").read_text())
    assert summary["motion_significance"] is None
    assert summary["statistics"]["motion_is_significant"] is None
    table = pd.read_csv(made / "relief_e2021_series_regions.csv")
    assert table["rate_m_per_year"].iloc[0] < -1e-4
    assert (made / "relief_e2021_series.ply").stat().st_size > 100_000


def test_series_of_an_older_comparison_is_not_exported_beside_the_new_one(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its rates and regions rest on other numbers; the report leaves it out too."""
    project, settings = tmp_path / "copy", tmp_path / "other.toml"
    shutil.copytree(made / "project", project)
    settings.write_text("[compare]\nfalse_discovery_rate = 0.01\n")
    assert run(["compare", str(project), "relief", "e2021", "e2025", "--settings", str(settings)]) == 0
    capsys.readouterr()
    assert run(["export", str(project), "relief", "e2021", "e2025", "--out", str(tmp_path / "out")]) == 0
    assert "the series is left out; bring it up to date: monitor compare" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*series*"))


def test_nothing_is_followed_where_a_pair_failed_though_an_older_comparison_of_it_is_kept(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A series of comparisons of which one was made otherwise is none."""

    def fail_at_one(place: Place, *rest: Any) -> Step:
        if place.epoch_id == "e2025":
            raise ComparisonError("as it happens")
        return compare_epochs(place, *rest)

    monkeypatch.setattr("monitor.cli.working.compare_epochs", fail_at_one)
    capsys.readouterr()
    assert run(["compare", str(made / "project"), "relief", "--json"]) == 2
    said = capsys.readouterr()
    assert all("series" not in facts for facts in json.loads(said.out))
    assert "and no change was followed over the epochs" in said.err


@pytest.mark.parametrize("as_json", [False, True])
def test_what_was_compared_is_told_where_following_it_fails(
    as_json: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    project = Project.create(tmp_path / "project")
    project.add_object(ObjectRecord("relief"))
    flat = Surface(np.eye(3), [[0, 1, 2]])
    for year in (2021, 2022, 2023):
        project.add_epoch(EpochRecord("relief", f"e{year}", datetime.date(year, 5, 1), is_mesh=True), mesh=flat)

    def compared(work: working._PairWork, here: Any) -> dict[str, str]:
        return {"object": "relief", "reference": work.pair[0], "compared": work.pair[1], "answer": "no change found"}

    def fail(*_: Any) -> None:
        raise ComparisonError("the first surface has no faces")

    monkeypatch.setattr(working, "_without_bare", lambda project, object_id, pairs: (pairs, []))
    monkeypatch.setattr(working, "_compare_pair", compared)
    monkeypatch.setattr(working, "follow_epochs", fail)
    assert run(["compare", str(project.path), "relief", *(["--json"] if as_json else [])]) == 2
    said = capsys.readouterr()
    pairs = [("e2021", "e2022"), ("e2021", "e2023"), ("e2022", "e2023")]
    if as_json:
        assert [(f["reference"], f["compared"]) for f in json.loads(said.out)] == pairs
    else:
        assert said.out.splitlines() == [f"relief {a} -> {b}: no change found" for a, b in pairs]
    assert said.err.strip().endswith("the first surface has no faces")


def test_program_reads_the_series_from_the_answer(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run(["compare", str(made / "project"), "relief", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts[-1]["series"] == {"n_epochs": 4, "n_regions": 1, "n_regions_by_trend": 0}


def test_in_absolute_mode_the_answer_says_what_the_differences_are_of(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    asked = ["compare", str(made / "project"), "relief", "e2022", "e2025", "--mode", "absolute", "--json"]
    assert run(asked) == 0
    answer = json.loads(capsys.readouterr().out)[0]["answer"]
    assert answer.endswith("; the differences are of coordinates, and how well both epochs' agree is not known")
    found = Project.open(made / "project").get("relief", "e2025", "comparison-e2022")
    lower = dataclasses.replace(found, statistics={**found.statistics, "offset_m": -4e-4})
    assert working._lies_off(lower).endswith("lies 0.40 mm further in on average, a motion of the whole included")
    relative = dataclasses.replace(lower, mode="relative")
    assert working._lies_off(relative).endswith("lies 0.40 mm further in on average")


def test_epochs_of_one_date_leave_no_order_and_that_is_said(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    project = str(tmp_path / "project")
    assert run(["init", project]) == 0
    assert run(["add-object", project, "relief"]) == 0
    for name, date in (("late", "2023-05-01"), ("b", "2022-05-01"), ("a", "2022-05-01")):
        write_ply_mesh(tmp_path / f"{name}.ply", relief(0.0, rng))
        given = ["add-epoch", project, "relief", name, "--date", date, "--mesh", str(tmp_path / f"{name}.ply")]
        assert run(given) == 0
    assert run(["process", project]) == 0
    capsys.readouterr()
    assert run(["compare", project, "relief"]) == 0
    said = capsys.readouterr().out
    assert said.strip().endswith("no series: a and b are of one date, and leave no order")
    remarks = " ".join(gather_facts(Project.open(tmp_path / "project"), "relief", "a", "late").remarks)
    assert "over the 3 epochs of this object is not told: epochs a and b are of one date, which leaves" in remarks
    assert run(["compare", project, "relief", "late", "a"]) == 0
    assert "told backwards in time, the reference is the later epoch" in capsys.readouterr().out


def test_comparisons_of_both_modes_make_no_series_and_that_is_said(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One is absolute by default where control holds both epochs, others are not: they were followed as one course."""
    path = made / "mixed"
    shutil.copytree(made / "project", path)
    monkeypatch.setattr("monitor.chain.default_mode", lambda *ids: "absolute" if ids[-1] == "e2023" else "relative")
    capsys.readouterr()
    assert run(["compare", str(path), "relief"]) == 0
    told = "compared with the first are e2022 and e2025 in relative mode and e2023 in absolute mode"
    assert capsys.readouterr().out.strip().endswith(f"no series: {told}; --mode relative compares all alike")
    facts = gather_facts(Project.open(path), "relief", "e2021", "e2025")
    assert facts.series is None
    assert told in " ".join(facts.remarks)


def test_a_series_says_which_of_its_comparisons_are_in_doubt(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the doubt of the pair in the report stood there, though all that is followed rests on the others, too."""
    path, doubt = made / "doubted", "a step further fits as well"
    shutil.copytree(made / "project", path)

    def with_doubt(place: Place, step: Step) -> Any:
        found = get(place, step)
        is_one = (place.epoch_id, step.product) == ("e2023", "comparison-e2021")
        doubted = dataclasses.replace(found.registration, doubt=doubt) if is_one else None
        return found if doubted is None else dataclasses.replace(found, registration=doubted)

    get = Place.get
    monkeypatch.setitem(METHOD, "series", METHOD["series"] + 1)
    monkeypatch.setattr(Place, "get", with_doubt)
    assert run(["compare", str(path), "relief"]) == 0
    lead = gather_facts(Project.open(path), "relief", "e2021", "e2025").series.lead
    assert lead.endswith(f" In doubt is how epoch e2023 lies on epoch e2021: {doubt}.")
    assert "In doubt" not in gather_facts(Project.open(made / "project"), "relief", "e2021", "e2025").series.lead


def test_the_drawing_is_the_same_every_time(made: Path) -> None:
    series = Project.open(made / "project").get("relief", "e2025", "series-e2021")
    drawing = draw_courses(series)
    assert drawing == draw_courses(series)
    assert b"region 1: goes on steadily" in drawing  # matplotlib names its texts in comments
