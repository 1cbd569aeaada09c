"""What a newer or another program added beside what is known is passed over (FORMAT.md, section 2)."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from store_examples import assert_same, example_comparison, example_project

from projects import index_file
from projects.elements import read_element, write_element
from projects.errors import StoreError
from projects.store import Project


def add_unknown(group: h5py.Group) -> None:
    """Add an attribute and items of kinds that this program does not know."""
    group.attrs["curator"] = "Ann"
    group.create_dataset("thumbnail", data=np.zeros((3, 3)))
    group.create_dataset("one", data=1.0)
    group["words"] = "text of variable length"
    group.create_group("notes").create_dataset("inside", data=np.arange(3))
    kind = group.create_group("index")
    kind.attrs.update({"encoding-type": "shape-index", "encoding-version": 9})


def change_index(project: Project, where: str, change: object) -> Path:
    """Change a group of the index, and seal it again."""
    path = project.path / index_file.INDEX_NAME
    with h5py.File(path, "r+") as file:
        change(file[where])
    index_file._seal(path)
    return project.path


@pytest.mark.parametrize(
    "where", ["/", "objects/stove", "objects/stove/epochs/E1", "objects/stove/epochs/E1/products/raw"]
)
def test_unknown_items_of_the_index_are_passed_over(tmp_path, rng, where):
    project = example_project(tmp_path, rng)
    known = project.index()
    again = Project.open(change_index(project, where, add_unknown))
    assert_same(again.index(), known)
    assert again.verify().findings == ()


def test_array_where_the_index_has_its_groups_is_refused(tmp_path, rng):
    def empty(group: h5py.Group) -> None:
        del group["objects"]
        group["objects"] = np.arange(3)

    with pytest.raises(StoreError, match="/objects is an array; a group was expected"):
        Project.open(change_index(example_project(tmp_path, rng), "/", empty))


def test_unknown_items_of_a_product_are_passed_over(tmp_path, rng):
    comparison = example_comparison(rng)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write_element(file, "content", comparison)
        for name in ("content", "content/registration", "content/on_compared/surface"):
            add_unknown(file[name])
        assert_same(read_element(file, "content"), comparison)


@pytest.mark.parametrize(
    ("unknown", "message"),
    [
        (h5py.SoftLink("/content/regions"), "is a link to another place"),
        (np.zeros(2, dtype=[("a", "f8")]), "neither numbers nor text"),
    ],
)
def test_unknown_items_that_no_file_may_hold_are_refused(tmp_path, rng, unknown, message):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write_element(file, "content", example_comparison(rng))
        file["content/extra"] = unknown
        with pytest.raises(StoreError, match=message):
            read_element(file, "content")
    with pytest.raises(StoreError, match=message):
        Project.open(change_index(example_project(tmp_path, rng), "objects/stove", lambda g: g.update({"x": unknown})))
