"""What is lost or out of date is never left out of what is handed out without a word."""

import datetime
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from example_project import fill, step
from report_examples import example_comparison, example_object
from series_examples import followed

from monitor.cli import results, run
from projects import Project
from projects.errors import StoreError
from projects.model import EpochRecord
from reports import deposit_comparison
from reports.archive import write_archive
from reports.document import gather_facts


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Project:
    """Return a project of four epochs, the later three compared with e1, and followed to e2, to e3 and to e4; its
    reports are not drawn."""
    monkeypatch.setattr(deposit_comparison, "write_report", lambda stem, facts: [])
    monkeypatch.setattr(results, "write_report", lambda stem, facts: [])
    filled = fill(tmp_path)
    compared = example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1)
    for k, digit in ((3, "6"), (4, "7")):
        record = EpochRecord("column", f"e{k}", datetime.date(2024 + k, 5, 18))
        filled.add_epoch(record, mesh=compared.on_compared.surface)
        filled.put("column", f"e{k}", step("surface", "4"), compared.on_compared.surface)
        filled.put("column", f"e{k}", step("comparison-e1", digit, inputs=("3" * 16, "4" * 16)), compared)
    for k, inputs in ((2, "5"), (3, "56"), (4, "567")):
        made = step("series-e1", f"{k + 6:x}", inputs=tuple(16 * c for c in inputs))
        series = followed({5: 2})
        filled.put("column", f"e{k}", made, replace(series, reference_id="e1", rate=np.full(len(series.rate), k / 1e3)))
    return filled


def lose(project: Project, epoch_id: str, product: str) -> None:
    """Delete the file of a product."""
    (path,) = project.path.glob(f"objects/column/{epoch_id}/{product}-*.h5")
    path.unlink()


def compare_anew(project: Project, epoch_id: str) -> None:
    """Put another comparison of an epoch with e1 than change was followed over."""
    compared = example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1)
    project.put("column", epoch_id, step("comparison-e1", "c", inputs=("3" * 16, "4" * 16)), compared)


def rates_in(folder: Path) -> list[float]:
    """Return the rates [m/year] that an exported table of vertices holds, each once."""
    return sorted(pd.read_csv(folder / "column_e1_series.csv")["rate"].round(6).unique())


def test_a_report_of_one_epoch_asks_for_the_next_and_for_no_comparison_that_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    single = Project.create(tmp_path / "p")
    single.add_object(example_object())
    asked = ["report", str(single.path), "column", "--out", str(tmp_path / "out")]
    for has in ("no epoch yet", "one epoch, e1"):
        assert run(asked) == 2
        said = capsys.readouterr().err
        assert f"object column has {has}, and a report tells what changed between two; add the next survey" in said
        assert "monitor compare" not in said
        if has == "no epoch yet":
            record = EpochRecord("column", "e1", datetime.date(2025, 5, 12))
            single.add_epoch(record, mesh=example_comparison().on_compared.surface)
    assert not (tmp_path / "out").exists()


def test_epochs_named_the_other_way_round_are_said_to_be(project: Project) -> None:
    """A comparison backwards in time is hardly what was wanted, and takes minutes."""
    with pytest.raises(StoreError, match="e1 is the reference and e2 is compared with it: name e1 first; to tell it "):
        gather_facts(project, "column", "e2", "e1")
    with pytest.raises(StoreError, match="e3 and e2 of object column are not compared yet; run: monitor compare"):
        gather_facts(project, "column", "e3", "e2")


def test_status_says_which_comparisons_are_of_before_and_names_them_in_the_order_of_time(
    project: Project, capsys: pytest.CaptureFixture[str]
) -> None:
    surface = example_comparison().on_compared.surface
    first = EpochRecord("column", "z0", datetime.date(2020, 5, 18))
    project.add_epoch(first, mesh=surface)
    project.put("column", "z0", step("surface", "8"), surface)
    compared = example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1)
    project.put("column", "e4", step("comparison-z0", "d", inputs=("8" * 16, "4" * 16)), compared)

    def status() -> tuple[dict[str, Any], str]:
        """Return what is told of e4, to programs and to people."""
        capsys.readouterr()
        assert run(["status", str(project.path), "--json"]) == 0
        (told,) = [e for e in json.loads(capsys.readouterr().out)["objects"][0]["epochs"] if e["epoch"] == "e4"]
        assert run(["status", str(project.path)]) == 0
        (row,) = [line for line in capsys.readouterr().out.splitlines() if "2028-05-18" in line]
        return told, row

    told, row = status()
    assert told["compared_with"] == ["z0", "e1"]  # of 2020 and of 2025
    assert told["outdated"] == []
    assert "z0, e1 " in row
    project.put("column", "e1", step("surface", "e"), surface)
    told, row = status()
    assert told["outdated"] == ["e1"]
    assert "z0, e1 (out of date) " in row


@pytest.mark.parametrize("product", ["comparison", "series"])
def test_nothing_whose_file_is_lost_is_left_out_of_an_archive(project: Project, tmp_path: Path, product: str) -> None:
    lose(project, "e3", f"{product}-e1")
    told = f"the {product} of column from e1 to e3 was made, but its file is missing or cut off; monitor verify"
    with pytest.raises(StoreError, match=told):
        write_archive(tmp_path / "out", project, ["column"], lambda text: None)
    assert not (tmp_path / "out").exists()


def test_a_comparison_asked_for_whose_file_is_lost_is_not_called_never_made(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lose(project, "e3", "comparison-e1")
    for command in ("export", "report"):
        assert run([command, str(project.path), "column", "e1", "e3", "--out", str(tmp_path / "out")]) == 2
        told = capsys.readouterr().err
        assert "the comparison of column from e1 to e3 was made, but its file is missing or cut off" in told
        assert told.rstrip().endswith(f"make it anew with: monitor compare {project.path} column e1 e3")
        assert "not compared yet" not in told
    with pytest.raises(StoreError, match="e2 and e3 of object column are not compared yet; run: monitor compare"):
        gather_facts(project, "column", "e2", "e3")


def test_exports_and_reports_of_everything_name_the_comparison_whose_file_is_lost(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lose(project, "e3", "comparison-e1")
    for command in ("export", "report"):
        assert run([command, str(project.path), "column", "--out", str(tmp_path / "out")]) == 0
        told = capsys.readouterr().err
        assert "mind: the comparison of column from e1 to e3 is left out: its file is missing or cut off" in told
        assert "the comparison of column from e1 to e2" not in told
    assert not list((tmp_path / "out").glob("column_e1_e3*"))


def test_a_series_over_an_epoch_compared_anew_is_shown_no_more(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The series to e4 rests on e3's comparison of before; the one to e2 does not."""
    assert gather_facts(project, "column", "e1", "e4").series is not None
    compare_anew(project, "e3")
    assert gather_facts(project, "column", "e1", "e4").series is None
    assert gather_facts(project, "column", "e1", "e2").series is not None
    told = "epochs of column were compared anew since change was followed from e1 to e4, so the series is left out"
    for command in ("export", "report"):
        assert run([command, str(project.path), "column", "e1", "e4", "--out", str(tmp_path / command)]) == 0
        assert f"mind: {told}; bring it up to date: monitor compare" in capsys.readouterr().err
    assert not list((tmp_path / "export").glob("*series*"))
    facts = write_archive(tmp_path / "out", project, ["column"], lambda text: None)
    assert told in facts.minds
    assert told.replace("e4", "e3") in facts.minds
    assert not any(told.replace("e4", "e2") in mind for mind in facts.minds)
    assert told in " ".join((tmp_path / "out" / "data" / "README.txt").read_text(encoding="utf-8").split())
    assert [p.parent.name for p in (tmp_path / "out").rglob("*_series.ply")] == ["e1_e2"]


def test_a_shorter_series_does_not_replace_the_files_of_a_longer_one(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both have the same names."""
    export = ["export", str(project.path), "column", "--format", "csv", "--out", str(tmp_path)]
    assert run(export) == 0
    assert rates_in(tmp_path) == [0.004]
    said = capsys.readouterr()
    assert said.out.count("column_e1_series.csv") == 1
    assert "left out" not in said.err  # what it holds is in the longer one
    assert run([*export, "e1", "e2"]) == 0
    assert "the series from e1 to e2 is left out, since change is followed to e4" in capsys.readouterr().err
    assert rates_in(tmp_path) == [0.004]
    project.remove_epoch("column", "e4")
    assert run([*export, "e1", "e3"]) == 0
    assert rates_in(tmp_path) == [0.003]
