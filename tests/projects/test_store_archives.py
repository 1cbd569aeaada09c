"""Every archived project of an earlier format version opens, and says what it said then."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from projects import migrations
from projects.extent import inside
from projects.store import Project

ARCHIVES = Path(__file__).parents[1] / "archives"
sys.path.insert(0, str(ARCHIVES))

import make_archive  # noqa: E402
from store_examples import assert_same  # noqa: E402


@pytest.fixture
def archived(tmp_path):
    shutil.copytree(ARCHIVES / "version-1", tmp_path / "version-1")
    return Project.open(tmp_path / "version-1")


def test_there_is_an_archive_of_every_project_version():
    assert sorted(p.name for p in ARCHIVES.glob("version-*")) == [
        f"version-{v}" for v in range(1, migrations.CURRENT["project"] + 1)
    ]


def test_archived_version_1_holds_its_records(archived):
    assert (archived.name, archived.crs, archived.description) == ("Öfen und Treppen", "EPSG:25832", "zwei\nZeilen")
    (stove,) = archived.objects()
    assert (stove.name, stove.inventory, stove.place, stove.material) == ("Kachelofen", "I-17", "Köln", "Ton")
    assert stove.tolerance == 0.01
    assert inside(stove.extent, np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 3.6]])).tolist() == [True, False]
    assert [e.epoch_id for e in archived.epochs("stove.1")] == ["cad", "E1", "E-2.b"]
    first = archived.epoch("stove.1", "E1")
    assert (first.date.isoformat(), first.label, first.operator, first.repeated) == ("2024-05-01", "vor", "Ada", True)
    assert [(c.name, c.position.tolist()) for c in first.control] == [("P1", [1, 2, 3]), ("P2", [0, 0, 0])]
    assert np.isnan(first.control[0].sigma)
    assert first.sources[0]["sha256"] == hashlib.sha256(make_archive.SOURCE).hexdigest()


def test_archived_version_1_holds_its_scan(archived):
    chunks = list(archived.iterate_scan("stove.1", "E1", 0, chunk=50))
    for name in ("points", "intensity", "colors"):
        found = np.concatenate([getattr(c.cloud, name) for c in chunks])
        assert_same(found, getattr(make_archive.raw_cloud(), name))
    np.testing.assert_array_equal(np.concatenate([c.columns for c in chunks]), np.arange(60) % 10)
    np.testing.assert_array_equal(chunks[0].pose, make_archive.POSE)
    header = archived.scan_headers("stove.1", "E1")[0]
    assert (header.name, header.n_points, header.is_grid) == ("station-1.ptx", 60, True)
    assert header.dropped == {"zero range": 8, "nan": 2}


def test_archived_version_1_holds_its_products(archived):
    assert_same(archived.get("stove.1", "E1", "cloud"), make_archive.cloud())
    assert_same(archived.get("stove.1", "E1", "surface"), make_archive.surface())
    assert_same(archived.get("stove.1", "cad", "mesh"), make_archive.surface(1.0))
    assert_same(archived.get("stove.1", "E-2.b", "registration-E1"), make_archive.registration())
    assert_same(archived.get("stove.1", "E-2.b", "comparison-E1"), make_archive.comparison())
    quality = archived.get("stove.1", "E1", "quality")
    np.testing.assert_array_equal(quality["distances"], [0.1, np.nan])
    assert quality["scans"]["note"] == "Fuß"
    facts = archived.get("stove.1", "E1", "comparison-E-2.b")
    assert facts == {"facts": [1, 2.5, None, float("inf")], "a/b": True}
    assert_same(archived.latest("stove.1", "E1", "surface"), make_archive.step("surface"))


def test_archived_version_1_is_whole_and_can_be_continued(archived):
    assert archived.verify().findings == ()
    archived.remove_epoch("stove.1", "E-2.b", purge=True)
    assert archived.verify().ok
    assert archived.latest("stove.1", "E1", "comparison-E-2.b") is None


def test_format_document_is_enough_to_read_the_archive_without_this_program():
    """Follows FORMAT.md with h5py and json alone."""
    folder = ARCHIVES / "version-1"
    octets = (folder / "project.h5").read_bytes()
    line = octets[:512].split(b"\n")[0].decode("ascii")
    assert line == f"heritage-monitor project, version 1, sha256 {hashlib.sha256(octets[512:]).hexdigest()}"
    with h5py.File(folder / "project.h5") as file:
        epoch = file["objects/stove.1/epochs/E-2.b"]
        assert epoch.attrs["date"] == "2025-05-01"
        assert json.loads(epoch.attrs["control"])[0] == {
            "name": "P1", "position": [1.0, 2.0, 3.0], "sigma": {"$float": "nan"}}  # fmt: skip
        product = epoch["products/comparison-E1"]
        assert (product.attrs["kind"], product.attrs["reference"]) == ("comparison", "E1")
        link = product.get("file", getlink=True)
        content = (folder / link.filename).read_bytes()
        assert (len(content), hashlib.sha256(content).hexdigest()) == (product.attrs["bytes"], product.attrs["sha256"])
        # an HDF5 browser follows the link by itself
        side = product["file/content/on_compared"]
        np.testing.assert_array_equal(side["distances"], make_archive.comparison().on_compared.distances)
        assert [t.decode() for t in product["file/content/regions/001"][:]] == ["lost", "added"]
        assert json.loads(product["file/step"][0])["parameters"]["n"] == 48
        scan = epoch["products/raw/file/content/0000"]
        np.testing.assert_array_equal(scan["points"], make_archive.raw_cloud().points)
        assert scan.attrs["name"].decode() == "station-1.ptx"


def test_older_element_is_brought_up_to_date_step_by_step(archived, monkeypatch):
    """A future version 3 of the surface: version 1's `sigma` was halved in 2 and renamed back in 3, say."""

    def to_2(parts):
        return {**parts, "sigma": parts["sigma"] / 2}

    def to_3(parts):
        return {**parts, "n_support": parts["n_support"] + 1}

    monkeypatch.setattr(migrations, "CURRENT", {**migrations.CURRENT, "surface": 3})
    monkeypatch.setattr(migrations, "UPGRADES", {("surface", 1): to_2, ("surface", 2): to_3})
    found, then = archived.get("stove.1", "E1", "surface"), make_archive.surface()
    np.testing.assert_array_equal(found.sigma, then.sigma / 2)
    np.testing.assert_array_equal(found.n_support, then.n_support + 1)
