"""Surfaces as files: each column is what the surface knows, under its name."""

import dataclasses
import json

import laspy
import numpy as np
import pandas as pd
import pytest
import trimesh
from report_examples import example_comparison
from small_comparison import make_comparison

from projects.errors import FormatError
from projects.formats import read_mesh, read_scans
from projects.model import Step, Surface
from reports.colours import choose_limit
from reports.exports import SUMMARY_KEYS, export_comparison, export_surface, summarize

KNOWN = {
    "sigma": np.array([1e-4, np.nan, 3e-4, 4e-4]), "sigma_shared": np.array([5e-5, 6e-5, 7e-5, np.nan]),
    "sample_distance": np.array([0.0, 1e-3, 2e-3, 3e-3]), "stray_share": np.array([0.0, 0.25, np.nan, 1.0]),
    "intensity": np.array([0.1, 0.2, 0.3, 0.4]),
    "n_support": np.array([9, 8, 7, 6]), "is_unresolved": np.array([True, False, False, False]),
    "is_crest": np.array([False, True, True, False]),
}  # fmt: skip


def tetrahedron(**known):
    """Return a tetrahedron of 1 m far from the origin."""
    corners = np.vstack([np.zeros(3), np.eye(3)]) + np.array([657_123.25, 5_400_321.5, 310.0])
    return Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), **known)


def test_all_that_a_surface_knows_is_exported_under_its_name(tmp_path):
    surface = tetrahedron(**KNOWN)
    table, ply = export_surface(tmp_path, "vase", "e1", surface, ("csv", "ply"))
    assert (table.name, ply.name) == ("vase_e1_surface.csv", "vase_e1_surface.ply")
    written = pd.read_csv(table)
    np.testing.assert_array_equal(written[["x", "y", "z"]], surface.vertices)
    columns = {"unresolved": "is_unresolved", "crest": "is_crest"}
    for name in ("sigma", "sigma_shared", "sample_distance", "stray_share", "intensity", "n_support", *columns):
        expected = KNOWN[columns.get(name, name)]
        np.testing.assert_allclose(written[name], np.asarray(expected, dtype=float), rtol=1e-6, err_msg=name)
    properties = trimesh.load(ply, process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert properties["crest"].tolist() == [0, 1, 1, 0]
    assert properties["unresolved"].tolist() == [1, 0, 0, 0]


def test_vertices_that_nobody_measured_are_no_points(tmp_path):
    """A hole's invented vertices were points like others in E57 and LAZ, where nothing could tell them."""
    surface = tetrahedron(**KNOWN, face_invented=[False, True, True, True])  # the fourth vertex is the invented top
    paths = export_surface(tmp_path, "vase", "e1", surface, ("csv", "e57", "laz", "ply"))
    assert len(pd.read_csv(paths[0])) == 3
    for path in paths[1:3]:
        (stream,) = read_scans(path)
        places = np.concatenate([chunk.cloud.points for chunk in stream.chunks()])
        np.testing.assert_allclose(places, surface.vertices[:3], atol=1e-4)
    assert len(read_mesh(paths[3]).vertices) == 4


def test_the_summary_says_where_the_colours_of_the_models_end():
    comparison = example_comparison(n_not_assessable=0, n_unchanged=0, n_changed=0)
    summary = summarize(comparison, Step("c" * 16, "comparison-e1"))
    assert summary["colours_end_m"] == choose_limit(comparison) == 0.015


def test_a_summary_by_itself_says_of_which_epochs_it_is_and_in_which_system(tmp_path):
    """Its transform is of no use to whoever does not know between what, and names of files get lost."""
    comparison = example_comparison(**dict.fromkeys(SUMMARY_KEYS, 0))
    step = Step("c" * 16, "comparison-e1")
    *_, path = export_comparison(tmp_path, ("vase", "e1", "e2"), comparison, step, (), crs="EPSG:31256")
    summary = json.loads(path.read_text(encoding="utf-8"))
    assert [summary[name] for name in ("object", "reference", "compared")] == ["vase", "e1", "e2"]
    assert summary["crs"] == "EPSG:31256"


def test_what_a_surface_does_not_know_has_no_column(tmp_path):
    (table,) = export_surface(tmp_path, "vase", "e1", tetrahedron(), ("csv",))
    assert list(pd.read_csv(table).columns) == ["x", "y", "z"]


def test_what_one_format_cannot_hold_is_said_before_others_are_written(tmp_path):
    surface = tetrahedron()
    odd = Surface(surface.vertices + 0.1, surface.faces)  # what it was shifted by before is whole in 32 bits
    with pytest.raises(FormatError, match="STL holds 32-bit numbers"):
        export_surface(tmp_path, "vase", "e1", odd, ("ply", "stl"))
    assert not list(tmp_path.iterdir())


def test_a_difference_model_says_why_a_place_was_not_assessed_and_what_its_numbers_are(tmp_path):
    comparison = make_comparison(n=30)
    told = np.full(len(comparison.on_compared.distances), 5e-4, np.float32)
    compared = dataclasses.replace(comparison.on_compared, told_from=told)
    figures = {**dict.fromkeys(SUMMARY_KEYS, 0.0), **comparison.statistics}
    comparison = dataclasses.replace(comparison, on_compared=compared, statistics=figures)
    step, ids = Step("c" * 16, "comparison-e1"), ("ball", "e1", "e2")
    paths = {p.name: p for p in export_comparison(tmp_path, ids, comparison, step, ("ply", "laz"))}
    ply = paths["ball_e1_e2_on-compared.ply"]
    properties = trimesh.load(ply, process=False).metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(properties["reason"].ravel(), comparison.on_compared.reasons)
    np.testing.assert_array_equal(properties["told_from"].ravel(), told)
    head = ply.read_bytes().split(b"end_header")[0].decode()
    assert "comment reason: 0 assessed, 1 no_face, 2 free_edge" in head
    las = laspy.read(paths["ball_e1_e2_on-compared.laz"])
    assert las.header.parse_crs() is None
    said = {d.name: d.description for d in las.point_format.extra_dimensions}
    assert said["distance"].rstrip("\0") == "m, positive = gained"
    assert said["assessment"].rstrip("\0") == "0 unknown 1 unchanged 2 changed"
    np.testing.assert_array_equal(las["reason"], comparison.on_compared.reasons)
    without = trimesh.load(paths["ball_e1_e2_on-reference.ply"], process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert "told_from" not in without.dtype.names


def test_files_name_the_reference_system_of_the_project(tmp_path):
    comparison, step = make_comparison(n=30), Step("c" * 16, "comparison-e1")
    figures = {**dict.fromkeys(SUMMARY_KEYS, 0.0), **comparison.statistics}
    comparison = dataclasses.replace(comparison, statistics=figures)
    ids, formats = ("ball", "e1", "e2"), ("ply", "obj", "laz", "e57")
    paths = {p.name: p for p in export_comparison(tmp_path, ids, comparison, step, formats, crs="EPSG:31256")}
    for suffix in ("ply", "obj"):
        head = paths[f"ball_e1_e2_on-compared.{suffix}"].read_bytes()[:2000]
        assert b"coordinates in EPSG:31256, x east, y north" in head
    for suffix in ("laz", "e57"):
        (stream,) = read_scans(paths[f"ball_e1_e2_on-compared.{suffix}"])
        assert (stream.system.name, stream.system.metres) == ("EPSG:31256", 1.0)
