"""The examples of docs/simulation.md, run as they stand."""

import re
from pathlib import Path

import numpy as np
import trimesh

GUIDE = Path(__file__).parents[3] / "docs" / "simulation.md"


def test_the_examples_of_the_guide_plan_and_rehearse_a_campaign(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    figure = trimesh.creation.capsule(height=1.5, radius=0.3).apply_translation([0.0, 0.0, 1.0])
    figure.export("minerva.ply")
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL):
        exec(compile(block, str(GUIDE), "exec"), names)
    assert 3 <= len(names["taken"]) <= 8  # a convex body has to be seen from all sides
    assert len(names["campaign"].epochs) == 2
    assert all(path.stat().st_size > 1000 for path in names["campaign"].epochs)
    assert np.isclose(names["truth"].extreme, -0.003, atol=0.0003)  # as deep as it was worn
    assert "shows a change of 2 mm" in capsys.readouterr().out
