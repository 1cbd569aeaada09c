"""A project of an epoch of two scans and one of a finished mesh, compared, of nouns that were made up, not computed."""

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np
from report_examples import example_comparison, example_object

from projects import PointCloud, Project, Scan
from projects.formats import read_scans, write_e57
from projects.model import ControlPoint, EpochRecord, Step
from projects.transforms import perturb

TURN = perturb(np.eye(4), np.zeros(3), np.array([0.1, -0.2, 0.3, 1.0, 2.0, 0.5]))
MOTION = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.0, 1e-3, 2e-3, 0.0, -1e-3]))


def silent(text: str) -> None:
    """Take what is told."""


def measured(k: int) -> PointCloud:
    """Return 400 points of a scan, in its frame."""
    rng = np.random.default_rng([5, k])
    return PointCloud(rng.uniform(-1, 1, (400, 3)), intensity=rng.random(400).astype(np.float32))


def step(product: str, digit: str, **more: object) -> Step:
    """Return a step as the chain would have left it."""
    return Step(
        digit * 16, product, versions={"heritage-monitor": "0.1.0"}, created="2026-05-19T08:00:00+00:00", **more
    )


def fill(folder: Path) -> Project:
    """Make a project of an epoch of two scans and one of a finished mesh, compared; nothing is computed."""
    project = Project.create(folder / "project", name="Tor", crs="EPSG:31256")
    project.add_object(example_object(name="Säule am Tor"))
    scans = [Scan(f"station {k}", measured(k), TURN if k else np.eye(4)) for k in range(2)]
    write_e57(folder / "a.e57", scans)
    control = (ControlPoint("K1", np.array([1.0, 2.0, 3.0]), 0.001),)
    record = EpochRecord("column", "e1", datetime.date(2025, 5, 12), operator="A. Müller", control=control)
    project.add_epoch(record, read_scans(folder / "a.e57"))
    comparison = example_comparison(n_not_assessable=0, n_unchanged=1, n_changed=1)
    mesh = comparison.on_compared.surface
    given = {"file": "column.ply", "sha256": "ab" * 32}
    project.add_epoch(EpochRecord("column", "e2", datetime.date(2026, 5, 18), sources=(given,)), mesh=mesh)
    moved = {"T_project_given": np.stack([np.eye(4), MOTION])}
    project.put("column", "e1", step("network", "1", automatic={"applied": True, "misfit_after_m": 0.0004}), moved)
    cloud = replace(measured(0), sigma=np.full(400, 1e-4), n_merged=np.full(400, 3),
                    scan_index=np.repeat([0, 1], 200))  # fmt: skip
    project.put("column", "e1", step("filtered", "2", counts={"in": 800, "outlier": 5, "out": 400}), cloud)
    surface = replace(
        comparison.on_reference.surface, sigma=np.full(len(comparison.on_reference.surface.vertices), 2e-5)
    )
    found = {"method": "localized", "cell_size_m": 0.004}
    project.put("column", "e1", step("surface", "3", automatic=found, inputs=("2" * 16, "1" * 16)), surface)
    project.put("column", "e2", step("surface", "4"), mesh)
    project.put("column", "e2", step("comparison-e1", "5", inputs=("3" * 16, "4" * 16)), comparison)
    return project
