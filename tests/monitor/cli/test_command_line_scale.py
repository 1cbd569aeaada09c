"""What the command line says of an epoch that is of another scale: not that nothing changed."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from monitor.cli import run
from projects.formats import write_ply_mesh
from projects.model import Surface


def bumpy(ratio: float, rng: np.random.Generator) -> Surface:
    """Return a bumpy ball of 0.3 m, `ratio` times as large, with noise on its vertices."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    radius = 0.15 + 0.01 * np.sin(9.0 * ball.vertices[:, 0]) * np.cos(7.0 * ball.vertices[:, 1] + ball.vertices[:, 2])
    noise = rng.normal(0.0, 5e-5, len(radius))
    return Surface(ball.vertices * (ratio * radius + noise)[:, None], ball.faces.astype(np.int32))


@pytest.mark.parametrize(("ratio", "said"), [(1.0, "no change found"), (1.02, "no part changed against the rest")])
def test_another_scale_is_not_no_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rng: np.random.Generator, ratio: float, said: str
) -> None:
    project = str(tmp_path / "p")
    assert run(["init", project]) == 0
    assert run(["add-object", project, "ball"]) == 0
    for k, of_epoch in enumerate((1.0, ratio)):
        path = tmp_path / f"e{k}.ply"
        write_ply_mesh(path, bumpy(of_epoch, rng))
        assert run(["add-epoch", project, "ball", f"e{k}", "--date", f"202{k}-05-01", "--mesh", str(path)]) == 0
    assert run(["process", project]) == 0
    capsys.readouterr()
    assert run(["compare", project, "ball", "e0", "e1"]) == 0
    out = capsys.readouterr().out
    assert f"-> e1: {said};" in out
    assert ("times as large as the reference" in out) == (ratio != 1.0)
