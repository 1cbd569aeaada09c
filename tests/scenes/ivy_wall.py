"""A bent wall with ivy before a part of it, scanned twice, through the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monitor.cli import run as run_monitor
from projects import Project
from projects.model import Floats

IVY = (0.039, -0.008)  # m, before a crest of the wall


def wall_with_ivy(rng: np.random.Generator, *, is_level: bool = False) -> Floats:
    """Return points of a bent wall of 0.2 m, 3 mm apart, seven of ten before it where ivy grows.

    The ivy stands 2 to 12 mm before the wall, or `is_level`, before its crest, at heights of 11.5 to 13 mm, where no
    wall is.
    """
    x, y = (g.ravel() + rng.uniform(-1e-3, 1e-3, g.size) for g in np.meshgrid(*[np.arange(-0.1, 0.1, 0.003)] * 2))
    z = 0.01 * np.sin(40.0 * x) * np.cos(50.0 * y + 0.4) + 3e-4 * rng.normal(size=len(x))
    leaf = (np.hypot(x - IVY[0], y - IVY[1]) < (0.015 if is_level else 0.03)) & (rng.random(len(x)) < 0.7)
    z[leaf] = rng.uniform(1.15e-2, 1.3e-2, leaf.sum()) if is_level else z[leaf] + rng.uniform(2e-3, 1.2e-2, leaf.sum())
    return np.c_[x, y, z]


def processed(folder: Path, *options: str, extent: Path | None = None) -> Project:
    """Return the project in which two scans of the wall were processed, with level ivy where there is an extent."""
    project, files = folder / "project", [folder / "a.xyz", folder / "b.xyz"]
    for k, file in enumerate(files):
        np.savetxt(file, wall_with_ivy(np.random.default_rng([k, 3]), is_level=extent is not None), fmt="%.6f")
    pose = " ".join(f"{v:g}" for v in np.eye(4).ravel())
    (folder / "poses").write_text("".join(f"{file.name} {pose} 0 0 2\n" for file in files))
    assert run_monitor(["init", str(project)]) == 0
    given = [] if extent is None else ["--extent", str(extent)]
    assert run_monitor(["add-object", str(project), "wall", *given]) == 0
    files_given = ["--poses", str(folder / "poses"), *map(str, files)]
    assert run_monitor(["add-epoch", str(project), "wall", "e1", "--date", "2026-01-01", *options, *files_given]) == 0
    assert run_monitor(["process", str(project)]) == 0
    return Project.open(project)
