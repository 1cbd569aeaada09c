"""Pairs of epochs compared side by side by worker processes: the same results as one after the other."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from monitor.cli import run
from projects import Project
from projects.formats import write_ply_mesh
from projects.model import Surface


@pytest.fixture(scope="module")
def processed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a project of three epochs of a bumpy ball as finished meshes, of which the last is dented."""
    folder, rng = tmp_path_factory.mktemp("workers"), np.random.default_rng(4)
    ball, path = trimesh.creation.icosphere(subdivisions=5), str(folder / "p")
    radius = 0.15 + 0.01 * np.sin(9.0 * ball.vertices[:, 0]) * np.cos(7.0 * ball.vertices[:, 1] + ball.vertices[:, 2])
    dent = 4e-3 * np.exp(-(np.linalg.norm(ball.vertices - [0.0, 0.0, 1.0], axis=1) ** 2) / 0.02)
    assert run(["init", path]) == 0
    assert run(["add-object", path, "ball"]) == 0
    for k in range(3):
        noisy = radius + rng.normal(0.0, 5e-5, len(radius)) - dent * (k == 2)
        file = folder / f"e{k}.ply"
        write_ply_mesh(file, Surface(ball.vertices * noisy[:, None], ball.faces.astype(np.int32)))
        assert run(["add-epoch", path, "ball", f"e{k}", "--date", f"202{k}-05-01", "--mesh", str(file)]) == 0
    assert run(["process", path]) == 0
    return folder / "p"


def test_pairs_are_compared_side_by_side_with_the_same_results(
    processed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(processed, tmp_path / "one")
    shutil.copytree(processed, tmp_path / "two")
    assert run(["compare", str(tmp_path / "one"), "ball", "--json"]) == 0
    one = json.loads(capsys.readouterr().out)
    assert run(["compare", str(tmp_path / "two"), "ball", "--workers", "2", "--json"]) == 0
    told = capsys.readouterr()
    assert "comparing 3 pairs of epochs on the workers" in told.err
    assert "WARNING" not in told.err
    assert json.loads(told.out) == one
    assert [f["n_regions"] for f in one] == [0, 1, 1]
    both = [Project.open(tmp_path / name) for name in ("one", "two")]
    for reference, compared in (("e0", "e1"), ("e0", "e2"), ("e1", "e2")):
        steps = [p.latest("ball", compared, f"comparison-{reference}") for p in both]
        assert steps[0] is not None
        assert steps[1] is not None
        first, second = (
            p.get("ball", compared, s.product, s.step_id) for p, s in zip(both, steps, strict=True) if s is not None
        )
        np.testing.assert_array_equal(first.on_compared.distances, second.on_compared.distances)
        np.testing.assert_array_equal(first.on_compared.region, second.on_compared.region)


def test_a_single_pair_is_compared_here_and_what_makes_no_sense_is_refused_all_the_same(
    processed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(processed, tmp_path / "p")
    capsys.readouterr()
    assert run(["compare", str(tmp_path / "p"), "ball", "e0", "e1", "--workers", "0"]) == 2
    assert "--workers 0: at least 1 worker is needed" in capsys.readouterr().err
    assert run(["compare", str(tmp_path / "p"), "ball", "e0", "e1", "--workers", "2"]) == 0
    assert "on the workers" not in capsys.readouterr().err
