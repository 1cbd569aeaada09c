"""Every experiment runs in small, says what it should, and its bars that passed still pass."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from rows import Row, as_mapping, in_words, judge
from shared_data import data_folder
from validate import EXPERIMENTS, HERE, RESULTS, ROOT, SMALL_LIMIT, load, names_of_experiments, run_in_child
from validation_page import section, summary, table, versions, write_page


@pytest.mark.slow
@pytest.mark.validation
@pytest.mark.parametrize("name", names_of_experiments())
def test_experiment_in_small_gives_rows_and_keeps_its_bars(name: str) -> None:
    if "from peers import" in (EXPERIMENTS / f"{name}.py").read_text():
        pytest.importorskip("pymeshlab", reason="the peers come with pip install .[validation]")
    if getattr(load(name), "READS_REAL_DATA", False) and not data_folder().is_dir():
        pytest.skip(f"real scans are not beside this checkout ({data_folder()})")
    result = run_in_child(name, "small", SMALL_LIMIT)
    assert "error" not in result, result.get("trace", result["error"])
    assert result["rows"]
    bars = set(getattr(load(name), "SMALL_BARS", ()))
    for row in result["rows"]:
        assert row["what"]
        assert row["ours"]
        assert row["verdict"] in ("pass", "not yet", "stated")
        if row["what"] in bars:
            assert row["verdict"] == "pass", f"{row['what']}: {row['ours']}, asked {row['asked']}"
    assert bars <= {row["what"] for row in result["rows"]}


def test_every_experiment_finds_what_it_is_made_of_where_the_command_runs() -> None:
    code = "import validate; print(sum(bool(validate.load(name).TITLE) for name in validate.names_of_experiments()))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(HERE)])}
    said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert int(said.stdout) == len(names_of_experiments())


def test_page_gives_every_experiment_a_place_and_keeps_the_prose(tmp_path: Path) -> None:
    experiments = {name: load(name) for name in names_of_experiments()}
    write_page(tmp_path / "page.md", HERE / "template.md", RESULTS, experiments)
    page = (tmp_path / "page.md").read_text()
    assert "[[" not in page
    assert all(f"### {experiment.TITLE}" in page for experiment in experiments.values())
    assert "## The main job on real scans" in page


def test_page_on_disk_holds_the_results_kept() -> None:
    page = (HERE.parents[1] / "VALIDATION.md").read_text()
    for path in RESULTS.glob("*.json"):
        for line in table(json.loads(path.read_text()).get("rows", [])):
            assert line in page, f"{path.name}: run `python tests/validation/validate.py --write`"


def test_table_leaves_empty_columns_out_and_keeps_peers_apart() -> None:
    rows = [Row("a", "1", judge(True), others={"peer": "2"}), Row("b", "3", judge(False), asked="2", cause="too slow")]
    lines = table([as_mapping(row) for row in rows])
    assert lines == [
        "| what | asked | ours | peer |  |", "|---|---|---|---|---|", "| a |  | 1 | 2 | pass |",
        "| b | 2 | 3 |  | **not yet** |",
    ]  # fmt: skip


class Experiment:
    TITLE = "An experiment"


def test_failed_experiment_is_told_with_its_reason_and_stops_nothing() -> None:
    failed = {"command": "c", "date": "d", "commit": "x", "error": "ValueError: too few"}
    assert "**failed: ValueError: too few**" in section("one", failed, Experiment)
    assert "| failed |" in summary({"one": failed}, {"one": Experiment})


def test_versions_are_told_once_and_by_name_where_they_differ() -> None:
    usual, other = {"python": "3.11.7", "numpy": "2.4.6"}, {"python": "3.12.1"}
    kept = {"a": {"versions": usual}, "b": {"versions": other}, "c": {"versions": usual}}
    assert versions(kept) == ["Versions: python 3.11.7, numpy 2.4.6.", "Versions of `b`: python 3.12.1."]
    assert "Versions of `b`: python 3.12.1." in summary(kept, {"a": Experiment, "b": Experiment, "c": Experiment})


def test_what_is_not_known_passes_no_bar_and_is_null() -> None:
    assert judge(abs(float("nan")) < 1.0) == "not yet"
    assert in_words(float("nan")) == "-"
    assert in_words(-0.0004, 3, signed=True) == "0.000"
    assert in_words(-0.0126, 3, "mm", signed=True) == "−0.013 mm"
    assert json.loads(json.dumps(as_mapping(Row("a", "1"))))["value"] is None
