"""Finished meshes as epochs: nobody states their noise, the comparison finds it."""

from pathlib import Path

import numpy as np
import pytest

from monitor.cli import run
from projects import Comparison, Project, Surface
from projects.formats import write_ply_mesh
from projects.model import NotAssessed
from reports.certainty import detection_table

NOISE = 5e-5  # m
N = 121


def coarse_mesh(rng: np.random.Generator) -> Surface:
    """Return a sheet 0.3 m wide with noise: calm on one half, on the other relief as fine as the vertices."""
    axis = np.linspace(-0.15, 0.15, N)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    fine = 1.5e-3 * np.sin(600.0 * x) * np.cos(500.0 * y) * np.clip(x / 0.02, 0.0, 1.0)
    z = 0.03 * np.sin(15.0 * x) * np.cos(12.0 * y) + fine
    index = np.arange(N * N).reshape(N, N)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    vertices = np.column_stack([x, y, z]) + rng.normal(0.0, NOISE, (N * N, 3))
    return Surface(vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


@pytest.fixture(scope="module")
def unchanged(tmp_path_factory: pytest.TempPathFactory) -> list[Comparison]:
    """Return the comparisons of three unchanged meshes with the first."""
    folder: Path = tmp_path_factory.mktemp("meshes")
    project, rng = str(folder / "project"), np.random.default_rng(4)
    assert run(["init", project]) == 0
    assert run(["add-object", project, "panel"]) == 0
    years = (2021, 2022, 2023, 2024)
    for year in years:
        path = folder / f"e{year}.ply"
        write_ply_mesh(path, coarse_mesh(rng))
        assert run(["add-epoch", project, "panel", f"e{year}", "--date", f"{year}-05-01", "--mesh", str(path)]) == 0
    assert run(["process", project]) == 0
    for year in years[1:]:
        assert run(["compare", project, "panel", "e2021", f"e{year}"]) == 0
    return [Project.open(project).get("panel", f"e{year}", "comparison-e2021") for year in years[1:]]


def test_relief_as_fine_as_the_vertices_is_not_taken_for_their_noise(unchanged: list[Comparison]) -> None:
    for comparison in unchanged:
        assert len(comparison.regions) == 0
        assert comparison.statistics["share_above_lod95"] == pytest.approx(0.05, abs=0.01)
        # of two vertices and what an interpolated foot leaves of them: between one and the root of two noises
        assert 1.96 * NOISE < comparison.statistics["lod95_median_m"] < 1.96 * 1.7 * NOISE


def test_noise_that_is_not_stated_is_no_contradiction_between_the_sides(unchanged: list[Comparison]) -> None:
    for comparison in unchanged:
        contradicted = comparison.on_compared.reasons == NotAssessed.SHEET_BETWEEN
        assert contradicted.mean() < 0.005


def test_no_share_of_stated_errors_is_told_where_none_are_stated(unchanged: list[Comparison]) -> None:
    for comparison in unchanged:
        assert np.isnan(comparison.statistics["error_scale"])
        told = [row[0] for row in detection_table(comparison, 0.05).rows]
        assert not [row for row in told if "that both surfaces state" in row]
        assert [row for row in told if "errors of neighbours agree over" in row]
