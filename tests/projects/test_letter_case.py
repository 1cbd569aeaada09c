"""Epochs whose ids differ only in upper and lower case, where the disk takes these for one."""

from __future__ import annotations

import pytest
from store_examples import example_project, example_stream, findings, later_epoch

from projects.errors import StoreError
from projects.model import ObjectRecord
from projects.store import Project


@pytest.fixture
def project(tmp_path, rng):
    return example_project(tmp_path, rng)


def as_one_folder(project: Project, listed: str, other: str) -> None:
    """Lay the folder of an epoch down as such a disk does: listed under one name, reached under both."""
    above = project.path / "objects/stove"
    (above / other).rename(above / listed)
    (above / other).symlink_to(listed)


def test_purging_a_removed_epoch_leaves_a_living_one_whose_id_differs_in_case(project, tmp_path, rng):
    project.remove_epoch("stove", "E1", purge=True)
    project.add_epoch(later_epoch("e1"), [example_stream(tmp_path, rng)])
    as_one_folder(project, "E1", "e1")
    (project.path / "objects/stove/E1/raw-0123456789abcdef.h5").write_bytes(b"left of the epoch E1 that was removed")
    assert [s for s, _ in findings(project)].count("note") == 1, "what is left is told, what lives is not"
    project.remove_epoch("stove", "E1", purge=True)
    assert [p.name[:4] for p in project.path.glob("objects/stove/E1/*.h5")] == ["raw-"]
    assert sum(len(s.cloud) for s in project.iterate_scan("stove", "e1", 0)) == 20
    assert project.purge() == []
    assert [s for s, _ in findings(project)] == ["warning"], "the link, which stands for the disk"


def test_what_is_left_in_a_folder_of_another_case_is_purged_where_the_disk_tells_them_apart(project):
    living = next(project.path.glob("objects/stove/E1/*.h5"))
    left = project.path / "objects/stove/e1" / living.name
    left.parent.mkdir()
    left.write_bytes(b"of the same name but for its case")
    assert project.purge() == [left]
    assert living.exists()


def test_id_whose_folder_is_left_in_another_case_is_refused(project, tmp_path, rng):
    project.remove_epoch("stove", "E1")
    with pytest.raises(StoreError, match=r"epoch 'e1': the folder .*stove/E1 is left of one that was removed"):
        project.add_epoch(later_epoch("e1"), [example_stream(tmp_path, rng)])
    (project.path / "objects/Vase").mkdir()
    with pytest.raises(StoreError, match=r"object 'vase': the folder .*objects/Vase"):
        project.add_object(ObjectRecord("vase"))
    project.remove_epoch("stove", "E1", purge=True)
    project.add_epoch(later_epoch("e1"), [example_stream(tmp_path, rng)])
