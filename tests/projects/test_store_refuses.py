"""What a hostile or clumsy user gives is refused in one line, and the project stays as it was."""

from __future__ import annotations

import dataclasses
import datetime
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from store_examples import (
    example_project,
    example_step,
    example_stream,
    example_surface,
    findings,
    later_epoch,
    snapshot,
)

from projects import hdf5, index_file
from projects.elements import read_element, write_element
from projects.errors import MonitorError, ParameterError, StoreError
from projects.identifiers import PRODUCT_FILE_PATTERN, product_file, require_id, split_product, suggest_id
from projects.model import ObjectRecord, PointCloud
from projects.store import Project

NAMES = {
    "../../etc": "etc",
    "..": "object-1",
    ".": "object-1",
    "": "object-1",
    "/etc/passwd": "etc-passwd",
    "a/b": "a-b",
    "a\\b": "a-b",
    "Heilige Barbara": "Heilige-Barbara",
    "Tür über Größe": "Tuer-ueber-Groesse",
    "u\u0308ber": "ueber",
    "Café": "Cafe",
    "ſtove": "stove",
    "stаtue": "st-tue",  # the third letter is Cyrillic
    "stove\n": "stove",
    "stove\0": "stove",
    "-rf": "rf",
    ".hidden": "hidden",
    "a_b": "a-b",
    "石": "object-1",
    "x" * 65: "x" * 64,
    "\udcff": "object-1",
}


@pytest.fixture
def project(tmp_path, rng):
    return example_project(tmp_path, rng)


@pytest.mark.parametrize("name", NAMES)
def test_name_that_is_no_id_is_refused_with_a_suggestion_and_nothing_changes(project, tmp_path, rng, name):
    stream = example_stream(tmp_path, rng)
    before = snapshot(tmp_path)
    with pytest.raises(ParameterError) as caught:
        project.add_object(ObjectRecord(name))
    message = str(caught.value)
    assert f"for example {NAMES[name]!r}" in message
    assert "--name" in message
    assert message.isprintable()
    assert len(message) < 400
    with pytest.raises(ParameterError, match=r"(?s)epoch id .* belongs in --label"):
        project.add_epoch(later_epoch(name), [stream])
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("name", ["series", "Series"])
def test_an_epoch_may_not_be_called_as_exports_of_all_epochs_are(project, tmp_path, rng, name):
    stream = example_stream(tmp_path, rng)
    before = snapshot(tmp_path)
    with pytest.raises(ParameterError, match=f"epoch id '{name}' stands for change .* such as '{name}-1'"):
        project.add_epoch(later_epoch(name), [stream])
    assert snapshot(tmp_path) == before
    project.add_object(ObjectRecord("series"))  # names of files begin with the object
    project.add_epoch(later_epoch("series-1"), [stream])


def test_suggestions_are_ids_themselves(rng):
    alphabet = [*"aZ9.-_/ äß\u0301\0\n\u202e石", "\udc80"]
    for length in rng.integers(0, 90, 500):
        assert require_id(suggest_id("".join(rng.choice(alphabet, length)), "object"), "object")


def test_look_alike_letter_is_named(project):
    with pytest.raises(ParameterError, match="cyrillic small letter a"):
        project.add_object(ObjectRecord("stаtue"))


def test_ids_that_differ_only_in_case_are_refused(project, tmp_path, rng):
    with pytest.raises(StoreError, match="differs only in upper and lower case from the existing 'stove'"):
        project.add_object(ObjectRecord("Stove"))
    with pytest.raises(StoreError, match="existing 'E1'"):
        project.add_epoch(later_epoch("e1"), [example_stream(tmp_path, rng)])
    with pytest.raises(StoreError, match="exists already"):
        project.add_object(ObjectRecord("stove"))


@pytest.mark.parametrize("object_id", ["a", "con", "COM1.x", "a..b", "trailing.", "a-b.c", "x" * 64])
def test_every_id_gives_its_own_file_inside_the_project(object_id):
    file = product_file(object_id, "E.1", "comparison-E-0.1", "0123456789abcdef")
    assert len(file.parts) == 4
    assert file.parts[0] == "objects"
    assert not file.is_absolute()
    assert ".." not in file.parts
    assert PRODUCT_FILE_PATTERN.fullmatch(file.name)
    assert not file.parts[1].endswith(".")
    assert file.parts[1].split(".")[0].lower() not in ("con", "com1")


@pytest.mark.parametrize("product", ["../x", "Surface", "a b", "comparison-", "comparison-../E1", "", "a/b", "x-\0"])
def test_product_names_that_are_none_are_refused(project, product):
    with pytest.raises(ParameterError, match="not a product name"):
        project.put("stove", "E1", example_step(product), {"x": 1})


def test_reference_is_kept_apart_from_the_kind(project, rng, tmp_path):
    assert split_product("comparison-E-0.1") == ("comparison", "E-0.1")
    with pytest.raises(StoreError, match="no epoch 'E9'"):
        project.put("stove", "E1", example_step("comparison-E9"), {"x": 1})


def test_step_ids_that_are_none_are_refused(project):
    for step_id in ("", "../../../../etc", "ABCDEF0123456789", "12"):
        step = example_step()
        object.__setattr__(step, "step_id", step_id)
        with pytest.raises(ParameterError, match="step id"):
            project.put("stove", "E1", step, {"x": 1})


# folders that are no project


def test_what_is_no_project_is_said_to_be_none(tmp_path, rng):
    with pytest.raises(StoreError, match="does not exist; make a project"):
        Project.open(tmp_path / "nothing")
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match="is a file"):
        Project.open(tmp_path / "file")
    with pytest.raises(StoreError, match="is a file"):
        Project.create(tmp_path / "file")
    with pytest.raises(StoreError, match="is not a project"):
        Project.open(tmp_path)
    with pytest.raises(StoreError, match=r"is not empty \(it holds 'file'\)"):
        Project.create(tmp_path)
    with pytest.raises(StoreError, match="cannot be reached"):
        Project.create(tmp_path / "file" / "below")
    for name in ("x" * 5000, "nul\0"):
        with pytest.raises(StoreError, match="cannot be reached"):
            Project.open(tmp_path / name)
        with pytest.raises(StoreError, match="cannot be reached"):
            Project.create(tmp_path / name)
    Project.create(tmp_path / "p")
    with pytest.raises(StoreError, match="is a project already"):
        Project.create(tmp_path / "p")


def test_index_that_is_cut_off_or_of_another_program_is_refused(project):
    path = project.path / index_file.INDEX_NAME
    whole = path.read_bytes()
    for octets, message in (
        (b"hello", "is not the index"),
        (b"", "is not the index"),
        (whole[:512], "seal does not fit"),
        (whole[: len(whole) // 2], "seal does not fit"),
        (whole + b"x", "seal does not fit"),
    ):
        path.write_bytes(octets)
        with pytest.raises(StoreError, match=message):
            Project.open(project.path)
    path.unlink()
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "something else"
    with pytest.raises(StoreError, match="is not the index of a heritage-monitor project"):
        Project.open(project.path)


def test_any_changed_byte_of_the_index_is_refused(project, rng):
    path = project.path / index_file.INDEX_NAME
    whole = path.read_bytes()
    used = np.flatnonzero(np.frombuffer(whole[:512], np.uint8))
    for position in [*used.tolist(), *rng.integers(512, len(whole), 200).tolist()]:
        octets = bytearray(whole)
        octets[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(octets)
        with pytest.raises(StoreError):
            index_file.read_index(path)


def test_newer_versions_are_refused_in_one_line(project, rng, monkeypatch):
    project.put("stove", "E1", example_step(), example_surface(rng))
    entry = project.index().objects["stove"].epochs["E1"].products["surface"]
    with h5py.File(project.path / entry.file, "r+") as file:
        file["content"].attrs["encoding-version"] = 2
    with (
        h5py.File(project.path / entry.file) as file,
        pytest.raises(StoreError, match=r"surface version 2 is newer than this program reads \(1\); update"),
    ):
        read_element(file, "content")
    monkeypatch.setattr(index_file, "CURRENT", {**index_file.CURRENT, "project": 7})
    index_file.write_index(project.path / index_file.INDEX_NAME, project.index())
    with pytest.raises(StoreError, match="project version 7 is newer"):
        Project.open(project.path)


def test_json_values_have_a_version_and_are_read_without_as_older_programs_wrote_them(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write_element(file, "facts", {"n": [1, None]})
        assert dict(file["facts"].attrs) == {"encoding-type": "json", "encoding-version": 1}
        del file["facts"].attrs["encoding-version"]
        assert read_element(file, "facts") == {"n": [1, None]}
        file["facts"].attrs["encoding-version"] = 2
        with pytest.raises(StoreError, match=r"json version 2 is newer than this program reads \(1\)"):
            read_element(file, "facts")


# products that are not what they were


def surface_file(project: Project, rng: np.random.Generator) -> Path:
    project.put("stove", "E1", example_step(), example_surface(rng))
    return project.path / project.index().objects["stove"].epochs["E1"].products["surface"].file


def test_cut_off_changed_or_missing_products_are_found_and_can_be_made_anew(project, rng):
    path = surface_file(project, rng)
    whole = path.read_bytes()
    step = project.latest("stove", "E1", "surface")
    path.write_bytes(whole[:-100])
    with pytest.raises(StoreError, match="cut off or changed"):
        project.get("stove", "E1", "surface")
    assert project.find("stove", "E1", "surface", step.step_id) is None
    assert not project.verify().ok
    for position in rng.integers(0, len(whole), 40):
        octets = bytearray(whole)
        octets[position] ^= 16
        path.write_bytes(octets)
        with pytest.raises(StoreError, match="were changed"):
            Project.open(project.path).get("stove", "E1", "surface")
        assert not project.verify().ok
    path.unlink()
    with pytest.raises(StoreError, match="is missing"):
        project.get("stove", "E1", "surface")
    assert findings(project)[0][0] == "error"
    project.put("stove", "E1", step, example_surface(rng))
    assert project.find("stove", "E1", "surface", step.step_id) is not None
    assert findings(project) == []


def test_changed_raw_points_are_never_read(project, rng):
    path = next(project.path.glob("objects/stove/E1/raw-*.h5"))
    whole = path.read_bytes()
    for position in rng.integers(0, len(whole), 60):
        octets = bytearray(whole)
        octets[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(octets)
        for reader in (project, Project.open(project.path)):
            with pytest.raises(StoreError, match="were changed"):
                list(reader.iterate_scan("stove", "E1", 0))
            assert reader.scan_headers("stove", "E1")[0].n_points == 20
    path.write_bytes(whole)
    assert project.verify().ok


def test_checksums_of_the_chunks_themselves_are_right_and_read(project):
    path = next(project.path.glob("objects/stove/E1/raw-*.h5"))
    with h5py.File(path) as file:
        points = file["content/0000/points"]
        assert points.fletcher32
        assert points.shuffle
        assert points.compression == "gzip"
        good = points[:]
        chunk = points.id.get_chunk_info(0)
    octets = bytearray(path.read_bytes())
    octets[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(octets)
    with h5py.File(path) as file, pytest.raises(OSError, match=r"checksum|filter"):
        assert (file["content/0000/points"][:] == good).all()


def test_product_put_in_the_place_of_another_is_found(project, rng):
    path = surface_file(project, rng)
    other = example_step(other=True)
    project.put("stove", "E1", other, example_surface(rng))
    shutil.copy(project.path / f"objects/stove/E1/surface-{other.step_id}.h5", path.with_suffix(".new"))
    current = project.path / f"objects/stove/E1/surface-{other.step_id}.h5"
    os.replace(path, current)  # of the same size or not, it is not the one that the index names
    with pytest.raises(StoreError, match="changed"):
        project.get("stove", "E1", "surface")
    assert not project.verify().ok


def test_link_that_climbs_out_of_the_project_is_refused(project, tmp_path):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["x"] = 1
    links = ["../secret.h5", str(secret), "objects/stove/../../../secret.h5", "objects/stove/E1/..", "C:\\secret.h5"]
    index = project.index()
    for link in links:
        object.__setattr__(index.objects["stove"].epochs["E1"].products["raw"], "file", link)
        index_file.write_index(project.path / index_file.INDEX_NAME, index)
        with pytest.raises(StoreError, match="does not lie in the project; it is refused"):
            Project.open(project.path)


def test_link_inside_a_product_is_never_followed(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(3)
    with h5py.File(tmp_path / "product.h5", "w") as file:
        file["external"] = h5py.ExternalLink("other.h5", "/secret")
        file["soft"] = h5py.SoftLink("/external")
        file.create_dataset("outside", (3,), "i8", external=[(str(tmp_path / "raw.bin"), 0, h5py.h5f.UNLIMITED)])
        layout = h5py.VirtualLayout((3,), "i8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "secret", (3,))
        file.create_virtual_dataset("virtual", layout)
    with hdf5.open_file(tmp_path / "product.h5", "product") as file:
        for name in ("external", "soft"):
            with pytest.raises(StoreError, match="a link to another place"):
                hdf5.child(file, name)
        for name in ("outside", "virtual"):
            with pytest.raises(StoreError, match="in another file"):
                hdf5.read_array(hdf5.child(file, name))


def test_symbolic_links_do_not_lead_out_of_the_project(project, tmp_path, rng):
    elsewhere = tmp_path / "elsewhere"
    (project.path / "objects/stove/E1").rename(elsewhere)
    (project.path / "objects/stove/E1").symlink_to(elsewhere)
    with pytest.raises(StoreError, match="leads out of the project"):
        list(project.iterate_scan("stove", "E1", 0))
    before = snapshot(elsewhere)
    with pytest.raises(StoreError, match="leads out of the project"):
        project.put("stove", "E1", example_step(), example_surface(rng))
    project.remove_epoch("stove", "E1", purge=True)
    assert snapshot(elsewhere) == before


def test_files_of_others_are_named_and_left_alone(project, rng):
    for name in ("notes.txt", "objects/stove/E1/photo.jpg", "objects/stove/E1/mine.h5"):
        (project.path / name).write_text("mine")
    surface_file(project, rng)
    project.remove_epoch("stove", "E1", purge=True)
    assert {f.path for f in project.verify().findings} == {
        "notes.txt",
        "objects/stove/E1/photo.jpg",
        "objects/stove/E1/mine.h5",
    }
    assert not list(project.path.rglob("raw-*.h5"))


# epochs that cannot be added


def test_failing_reader_leaves_the_project_as_it_was(project, tmp_path, rng):
    good, bad = example_stream(tmp_path, rng, n=60, name="a"), example_stream(tmp_path, rng, n=60, name="b")
    bad.fails_after = 3
    before = snapshot(project.path)
    with pytest.raises(StoreError, match="the scanner file ends here"):
        project.add_epoch(later_epoch(), [good, bad])
    assert snapshot(project.path) == before


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: setattr(s, "pose", None), "has no pose; state it"),
        (lambda s: setattr(s, "pose", 2 * np.eye(4)), "rigid|not a 4 x 4"),
        (lambda s: setattr(s, "cloud", PointCloud(np.zeros((0, 3)))), "holds no points"),
        (lambda s: s.cloud.points.__setitem__((5, 1), np.nan), "not finite"),
        (lambda s: s.cloud.points.__setitem__((5, 1), -np.inf), "not finite"),
        (lambda s: s.path.unlink(), "cannot be read"),
    ],
)
def test_scans_that_cannot_be_kept_are_refused(project, tmp_path, rng, spoil, message):
    stream = example_stream(tmp_path, rng)
    spoil(stream)
    before = snapshot(project.path)
    with pytest.raises(MonitorError, match=message):
        project.add_epoch(later_epoch(), [stream])
    with pytest.raises(StoreError, match="has no scans"):
        project.add_epoch(later_epoch(), [])
    assert snapshot(project.path) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"date": datetime.datetime(2024, 5, 1, 12)}, "date"),
        ({"date": "1. Mai"}, "date"),
        ({"label": "a\0b"}, r"holds U\+0000"),
        ({"operator": "\udc80"}, "no text"),
        ({"control": ({"name": "P1"},)}, "control|whole index"),
    ],
)
def test_records_that_could_not_be_read_again_are_never_entered(project, tmp_path, rng, change, message):
    stream = example_stream(tmp_path, rng)
    before = repr(project.index())
    with pytest.raises(MonitorError, match=message):
        project.add_epoch(dataclasses.replace(later_epoch(), **change), [stream])
    with pytest.raises(MonitorError, match="polygon has at least three corners"):
        project.add_object(ObjectRecord("later", extent={"polygon": [[0, 0]]}))
    assert repr(Project.open(project.path).index()) == before
    assert project.verify().ok


def test_nouns_that_cannot_be_kept_are_refused(project):
    before = snapshot(project.path)
    for noun, message in (
        ({"a/b": np.zeros(3)}, "cannot name an item"),
        ({"x": object()}, "a object cannot be kept"),
        ({1: 2}, "text is needed"),
        (np.zeros(3, dtype=complex), "complex128 cannot be stored"),
        (pd.DataFrame([[1, 2]], columns=["a", "a"]), "a table has two columns 'a'"),
    ):
        with pytest.raises(StoreError, match=message):
            project.put("stove", "E1", example_step(), noun)
    assert snapshot(project.path) == before


# removal


def test_removed_epoch_takes_the_comparisons_made_from_it_along(project, tmp_path, rng):
    for key in ("E2", "E3"):
        project.add_epoch(later_epoch(key), [example_stream(tmp_path, rng, name=key)])
    for compared, reference in (("E2", "E1"), ("E3", "E1"), ("E3", "E2")):
        project.put("stove", compared, example_step(f"comparison-{reference}"), {"x": np.arange(3)})
    surface = project.put("stove", "E1", example_step(), example_surface(rng))
    made = example_step("made")
    object.__setattr__(made, "inputs", (surface.step_id,))
    project.put("stove", "E2", made, {"x": 1})
    project.remove_epoch("stove", "E1")
    assert [s.product for s in project.steps("stove", "E2")] == ["raw"]
    assert sorted(s.product for s in project.steps("stove", "E3")) == ["comparison-E2", "raw"]
    assert list(project.path.glob("objects/stove/E1/raw-*.h5")), "it stays on disk until purged"
    assert {severity for severity, _ in findings(project)} == {"note"}
    assert len(project.purge()) == 5
    assert findings(project) == []


def test_epoch_of_the_same_scans_keeps_what_was_made_from_them(project, tmp_path, rng):
    stream = example_stream(tmp_path, rng)
    for key in ("twin1", "twin2"):
        project.add_epoch(later_epoch(key), [stream])
    made = example_step("cloud")
    object.__setattr__(made, "inputs", (project.latest("stove", "twin1", "raw").step_id,))
    project.put("stove", "twin2", made, {"x": np.arange(3)})
    project.remove_epoch("stove", "twin1", purge=True)
    assert project.get("stove", "twin2", "cloud")["x"].tolist() == [0, 1, 2]
    assert project.verify().findings == ()


def test_purge_takes_what_was_made_from_the_epoch_and_nothing_else(project, tmp_path, rng):
    for key in ("E2", "E3"):
        project.add_epoch(later_epoch(key), [example_stream(tmp_path, rng, name=key)])
    for compared, reference in (("E2", "E1"), ("E3", "E1"), ("E3", "E2")):
        project.put("stove", compared, example_step(f"comparison-{reference}"), {"x": np.arange(3)})
    project.remove_epoch("stove", "E2")
    project.remove_epoch("stove", "E1", purge=True)
    left = sorted(str(p.relative_to(project.path / "objects/stove")) for p in project.path.glob("objects/stove/*/*.h5"))
    assert [name.rpartition("-")[0] for name in left] == ["E2/raw", "E3/comparison-E2", "E3/raw"]
    project.remove_epoch("stove", "E2", purge=True)
    assert [p.parent.name for p in project.path.glob("objects/stove/*/*.h5")] == ["E3"]
    assert findings(project) == []
    with pytest.raises(StoreError, match="has no epoch 'E2'"):
        project.remove_epoch("stove", "E2", purge=True)
