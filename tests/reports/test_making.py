"""A report that is there is known to be what would be drawn anew, and one that is not is known not to be."""

import dataclasses
from pathlib import Path

import pytest
from report_examples import DENT, example_comparison, example_epochs, example_object, facts_of
from shown_examples import pictures_of

from reports import making
from reports.document import make_facts
from reports.html import write_page
from reports.making import mark_of
from reports.pdf import write_document
from reports.report import is_current


@pytest.fixture
def stem(tmp_path: Path) -> Path:
    """Return the path of a report that is there, without its endings."""
    stem = tmp_path / "report"
    write_page(stem.with_suffix(".html"), facts_of(), pictures_of(facts_of()))
    write_document(stem.with_suffix(".pdf"), facts_of(), pictures_of(facts_of()))
    return stem


def test_a_report_of_the_same_facts_is_current_and_one_of_others_is_not(stem: Path) -> None:
    assert is_current(stem, facts_of())
    assert not is_current(stem, facts_of(name="Säule am Hof"))
    turned = make_facts(example_comparison(), dataclasses.replace(example_object(), front=3.0), *example_epochs())
    assert not is_current(stem, turned)
    other = make_facts(example_comparison(rows=(DENT,)), example_object(), *example_epochs())
    assert not is_current(stem, other)
    assert not is_current(stem.with_name("other"), facts_of())


def test_a_change_that_no_text_tells_makes_it_another_report(stem: Path) -> None:
    facts = facts_of()
    side = facts.comparison.on_compared
    moved = side.distances.copy()
    moved[100] += 1e-9
    comparison = dataclasses.replace(facts.comparison, on_compared=dataclasses.replace(side, distances=moved))
    assert not is_current(stem, dataclasses.replace(facts, comparison=comparison))


def test_a_report_of_which_one_file_is_gone_or_of_another_program_is_not_current(
    stem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    marked = mark_of(facts_of())
    monkeypatch.setattr(making, "_program", lambda: "another program")
    assert mark_of(facts_of()) != marked
    assert not is_current(stem, facts_of())
    monkeypatch.undo()
    assert is_current(stem, facts_of())
    stem.with_suffix(".pdf").unlink()
    assert not is_current(stem, facts_of())
