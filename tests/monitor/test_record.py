"""What a step made is entered only while what it was made of is still there."""

import datetime
from pathlib import Path

import pytest

from monitor.record import Asked, Made, Place, once_step
from projects import Project
from projects.errors import StoreError
from projects.model import EpochRecord, ObjectRecord, Surface

DATE = datetime.date(2026, 5, 1)


def flat(height: float) -> Surface:
    return Surface([[0, 0, height], [1, 0, height], [0, 1, height]], [[0, 1, 2]])


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """Return an epoch of a finished mesh."""
    project = Project.create(tmp_path / "p")
    project.add_object(ObjectRecord("stove"))
    project.add_epoch(EpochRecord("stove", "e1", DATE), mesh=flat(0.0))
    return Place(project, "stove", "e1")


def test_what_was_made_of_an_epoch_that_was_replaced_meanwhile_is_not_entered(place: Place) -> None:
    raw = place.project.latest("stove", "e1", "mesh")
    assert raw is not None
    asked = Asked("surface", "mesh", {}, (raw,))

    def make() -> Made:
        other = Project.open(place.project.path)
        other.remove_epoch("stove", "e1")
        other.add_epoch(EpochRecord("stove", "e1", DATE), mesh=flat(1.0))
        return Made(flat(0.0))

    with pytest.raises(StoreError, match=r"epoch e1: mesh, of which surface was made, was taken out or replaced"):
        once_step(place, asked, make)
    assert [step.product for step in place.project.steps("stove", "e1")] == ["mesh"]
    assert [f for f in place.project.verify().findings if f.severity != "note"] == []


def test_what_was_made_of_what_is_there_is_entered_once(place: Place) -> None:
    raw = place.project.latest("stove", "e1", "mesh")
    assert raw is not None
    asked, calls = Asked("surface", "mesh", {}, (raw,)), []

    def make() -> Made:
        calls.append(1)
        return Made(flat(0.0))

    assert once_step(place, asked, make).step_id == once_step(place, asked, make).step_id == asked.step_id
    assert calls == [1]
