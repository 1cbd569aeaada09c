"""A slow bulge through the command line: no comparison shows a region, and the series reports one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from simulated_series import SIGMA, draw_noise, plane, square

from monitor.cli import run
from projects import Project, Surface
from projects.formats import write_ply_mesh
from projects.model import Assessment
from reports import pictures

YEARS = range(2010, 2021)


def epoch(rng: np.random.Generator, years: int) -> Surface:
    """Return a relief of which 50 x 50 mm have bulged by 0.1 mm a year, with noise of 0.36 mm."""
    base, sigma = plane(), SIGMA * np.sqrt(0.5)
    x, y = base.vertices[:, 0], base.vertices[:, 1]
    z = 0.01 * np.sin(40.0 * x) * np.cos(30.0 * y) + 1e-4 * years * square(0.025) + draw_noise(rng, sigma)
    return Surface(np.column_stack([x, y, z]), base.faces)


@pytest.mark.slow
def test_a_bulge_that_no_comparison_shows_is_on_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    project, rng = str(tmp_path / "project"), np.random.default_rng(2)
    assert run(["init", project]) == 0
    assert run(["add-object", project, "wall", "--name", "Wall that bulges"]) == 0
    for year in YEARS:
        path = tmp_path / f"e{year}.ply"
        write_ply_mesh(path, epoch(rng, year - 2010))
        assert run(["add-epoch", project, "wall", f"e{year}", "--date", f"{year}-05-01", "--mesh", str(path)]) == 0
    assert run(["process", project]) == 0
    capsys.readouterr()
    assert run(["compare", project, "wall"]) == 0
    assert "of them found by the trend alone" in capsys.readouterr().out
    monkeypatch.setattr(pictures, "LARGEST", 200)  # pixels
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 200)
    assert run(["report", project, "wall", "e2010", "e2020", "--out", str(tmp_path)]) == 0
    assert run(["export", project, "wall", "e2010", "e2020", "--out", str(tmp_path)]) == 0
    store = Project.open(tmp_path / "project")
    direct = [store.get("wall", f"e{y}", "comparison-e2010") for y in YEARS[1:]]
    assert sum(len(c.regions) for c in direct) == 0
    table = pd.read_csv(tmp_path / "wall_e2010_series_regions.csv")
    assert set(table["found_by"]) == {"trend"}
    largest = table.sort_values("area_m2").iloc[-1]  # the registration takes a part of a bulge that it cannot know
    assert 5e-5 < largest["rate_m_per_year"] < 1e-4 + 2.58 * largest["sigma_rate_m_per_year"]
    series = store.get("wall", "e2020", "series-e2010")
    assert square(0.025)[series.rate_assessment == Assessment.CHANGED].mean() > 0.9
    page = (tmp_path / "wall_e2010_e2020_report.html").read_text()
    assert "No single epoch shows" in page
    assert "by its trend alone" in page
