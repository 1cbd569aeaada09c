"""What is put into a project comes back equal, in this process and in the next."""

from __future__ import annotations

import dataclasses
import datetime

import numpy as np
import pytest
from store_examples import (
    assert_same,
    example_comparison,
    example_project,
    example_registration,
    example_step,
    example_stream,
    example_surface,
    full_surface,
)

from projects import raw
from projects.errors import ParameterError, StoreError
from projects.model import ControlPoint, EpochRecord, ObjectRecord, PointCloud
from projects.store import Project


def test_scan_comes_back_point_for_point(tmp_path, rng):
    stream = example_stream(tmp_path, rng, n=20)
    stream.pose = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    project = Project.create(tmp_path / "p")
    project.add_object(ObjectRecord("stove"))
    project.add_epoch(EpochRecord("stove", "E1", datetime.date(2024, 5, 1)), [stream])
    chunks = list(Project.open(tmp_path / "p").iterate_scan("stove", "E1", 0, chunk=9))
    assert [len(c.cloud) for c in chunks] == [9, 9, 2]
    for name in ("points", "intensity", "colors"):
        assert_same(np.concatenate([getattr(c.cloud, name) for c in chunks]), getattr(stream.cloud, name))
    assert np.concatenate([c.rows for c in chunks]).tolist() == [k // 4 for k in range(20)]
    np.testing.assert_array_equal(chunks[0].pose, stream.pose)
    header = project.scan_headers("stove", "E1")[0]
    assert (header.name, header.n_points, header.dropped, header.scanner) == (
        "s1.ptx",
        20,
        {"zero range": 6},
        "hds6000",
    )
    np.testing.assert_array_equal(header.bounds, [stream.cloud.points.min(axis=0), stream.cloud.points.max(axis=0)])


def test_nouns_come_back_equal(tmp_path, rng):
    project = example_project(tmp_path, rng)
    project.add_epoch(EpochRecord("stove", "E2", datetime.date(2025, 5, 1)), [example_stream(tmp_path, rng, name="t")])
    n = 50
    cloud = PointCloud(rng.normal(size=(n, 3)), normals=rng.normal(size=(n, 3)), origins=np.arange(3.0),
                       n_merged=np.arange(n), roughness=np.zeros(n))  # fmt: skip
    nouns = {
        "cloud": cloud,
        "surface": example_surface(rng),
        "registration": example_registration(rng),
        "comparison-E1": example_comparison(rng),
        "comparison-E2": example_comparison(rng, n_regions=0),
        "quality": {"distances": np.array([0.1, np.nan]), "mask": np.array([True, False]), "empty": np.zeros((0, 3)),
                    "f4": np.float32([1.5]), "scans": {"a": np.arange(3), "b": {"n": 5, "x": None}}, "name": "Fuß",
                    "surface": example_surface(rng)},
        "facts": {"a/b": [1, 2.5, None, float("inf")], "nested": {"x": True}},
    }  # fmt: skip
    for product, noun in nouns.items():
        step = project.put("stove", "E2", example_step(product), noun)
        again = Project.open(project.path)
        assert_same(again.get("stove", "E2", product), noun)
        assert_same(again.latest("stove", "E2", product), step)
        assert_same(again.find("stove", "E2", product, step.step_id), step)
        assert again.find("stove", "E2", product, "0" * 16) is None


def test_everything_known_of_a_surface_comes_back(tmp_path, rng):
    surface = full_surface(rng)
    unset = [f.name for f in dataclasses.fields(surface) if getattr(surface, f.name) is None]
    assert unset == []  # a new field belongs into the example, the store and FORMAT.md
    project = example_project(tmp_path, rng)
    project.put("stove", "E1", example_step(), surface)
    assert_same(Project.open(project.path).get("stove", "E1", "surface"), surface)


def test_records_come_back_equal(tmp_path, rng):
    project = Project.create(tmp_path / "p", name="Dom zu Köln", crs="EPSG:25832", description="zwei\nZeilen")
    extent = {"box": {"min": [0, 0, 0], "max": [1, 1, 2.5]}}
    record = ObjectRecord("statue.1", "Hl. Barbara", extent=extent, tolerance=0.01, front=0.75 * np.pi)
    project.add_object(record)
    control = (ControlPoint("P1", np.array([1.0, 2.0, 3.0])), ControlPoint("P2", np.zeros(3), 0.002))
    epoch = EpochRecord("statue.1", "2024-05", datetime.date(2024, 5, 1), "before", "hds6000", True, control=control)
    project.add_epoch(epoch, [example_stream(tmp_path, rng)])
    again = Project.open(tmp_path / "p")
    assert (again.name, again.crs, again.description) == ("Dom zu Köln", "EPSG:25832", "zwei\nZeilen")
    assert again.objects() == [record]
    found = again.epoch("statue.1", "2024-05")
    assert_same(dataclasses.replace(found, control=(), sources=()), dataclasses.replace(epoch, control=()))
    assert_same(found.control[0], control[0])
    assert_same(found.control[1], control[1])
    assert found.sources[0]["file"] == "s1.ptx"


def test_front_is_given_later_and_changes_nothing_else(tmp_path, rng):
    project = example_project(tmp_path, rng)
    project.put("stove", "E1", example_step(), full_surface(rng))
    (before,), steps = project.objects(), repr(project.steps("stove", "E1"))
    assert before.front is None
    Project.open(project.path).set_front("stove", 0.0)
    again = Project.open(project.path)
    assert again.objects() == [dataclasses.replace(before, front=0.0)]
    assert repr(again.steps("stove", "E1")) == steps
    assert again.verify().findings == ()


@pytest.mark.parametrize("front", [-0.1, 2 * np.pi, float("nan"), float("inf"), "south", True])
def test_front_that_is_no_bearing_is_refused_and_nothing_is_entered(tmp_path, rng, front):
    project = example_project(tmp_path, rng)
    kept = (project.path / "project.h5").read_bytes()
    for enter in (lambda: project.add_object(ObjectRecord("vase", front=front)),
                  lambda: project.set_front("stove", front)):  # fmt: skip
        with pytest.raises(ParameterError, match="a bearing from 0 to below 2 pi rad is needed"):
            enter()
    assert (project.path / "project.h5").read_bytes() == kept


def test_epochs_come_by_date(tmp_path, rng):
    project = example_project(tmp_path, rng)
    for key, year in (("a", 2025), ("b", 2019)):
        record = EpochRecord("stove", key, datetime.date(year, 1, 1))
        project.add_epoch(record, [example_stream(tmp_path, rng)])
    assert [e.epoch_id for e in project.epochs("stove")] == ["b", "E1", "a"]


def test_finished_mesh_is_an_epoch_by_itself(tmp_path, rng):
    project = example_project(tmp_path, rng)
    mesh = example_surface(rng)
    project.add_epoch(EpochRecord("stove", "cad", datetime.date(2020, 1, 1)), mesh=mesh)
    assert Project.open(project.path).epoch("stove", "cad").is_mesh
    assert_same(project.get("stove", "cad", "mesh"), mesh)


def test_reader_sees_what_a_writer_entered_after_it_opened(tmp_path, rng):
    project = example_project(tmp_path, rng)
    reader = Project.open(project.path)
    project.put("stove", "E1", example_step(), example_surface(rng))
    assert reader.latest("stove", "E1", "surface") is not None


def test_unknown_names_are_answered_with_what_exists(tmp_path, rng):
    project = example_project(tmp_path, rng)
    with pytest.raises(StoreError, match=r"no object 'Stove'; it has stove; did you mean 'stove'\?"):
        project.object("Stove")
    with pytest.raises(StoreError, match=r"no epoch 'E9'; it has E1"):
        project.epoch("stove", "E9")
    with pytest.raises(StoreError, match=r"no 'surface'; it has raw"):
        project.get("stove", "E1", "surface")


def test_scans_beyond_four_digits_come_in_their_order(monkeypatch):
    monkeypatch.setattr(raw, "read_mark", lambda _group: ("scans", 1))
    monkeypatch.setattr(raw.hdf5, "child", lambda parent, name: parent[name])
    content = {name: name for name in ("10000", "0002", "9999", "1001")}
    assert raw.scan_groups({"content": content}) == ["0002", "1001", "9999", "10000"]
