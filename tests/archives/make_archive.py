"""Make the archived project of the present format version: python tests/archives/make_archive.py FOLDER

Run once for every format version, by the program that wrote it, and never again: what lies in tests/archives/ must go
on opening with every later program. The values are formulas, so that a test can say what it must find there.
"""

from __future__ import annotations

import datetime
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from projects.model import (
    REGION_COLUMNS,
    ComparedSurface,
    Comparison,
    ControlPoint,
    EpochRecord,
    ObjectRecord,
    PointCloud,
    Registration,
    Scan,
    Step,
    Surface,
)
from projects.provenance import step_id
from projects.store import Project

EXTENT = {"polygon": [[0.0, 0.0], [2.0, 0.0], [1.0, 2.0]], "bottom": -1.0, "top": 3.5}
POSE = np.array([[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]])
SOURCE = b"not a scan, but it has a hash\n"


def raw_cloud(n: int = 60) -> PointCloud:
    """Return the points of the archived scan."""
    k = np.arange(n)
    points = np.column_stack([np.sin(k), np.cos(k), k / 7.0])
    return PointCloud(points, intensity=k / n, colors=np.column_stack([k, 2 * k, 255 - k]))


def cloud() -> PointCloud:
    """Return the archived cloud, with every field."""
    n, k = 40, np.arange(40)
    normals = np.column_stack([np.zeros(n), np.where(k % 5, 0.6, np.nan), np.where(k % 5, 0.8, np.nan)])
    return PointCloud(
        points=np.column_stack([k, k**2, np.sqrt(k)]) / 3.0, normals=normals, origins=np.array([1.0, 2.0, 3.0]),
        sigma=k * 1e-5, intensity=k / n, colors=np.column_stack([k, k, k]), scan_index=k % 3, n_merged=k + 1,
        spread=k * 1e-6, surface_variation=k / 1000.0, roughness=k % 3, spacing=np.full(n, 0.002),
    )  # fmt: skip


def surface(shift: float = 0.0) -> Surface:
    """Return the archived surface, with every field."""
    k = np.arange(12)
    vertices = np.column_stack([k % 4, k // 4, np.cos(k) + shift]).astype(float)
    faces = np.array([[i, i + 1, i + 4] for i in (0, 1, 2, 4, 5, 6)])
    sigma = np.where(k % 3, 1e-4 * k, np.nan)
    return Surface(
        vertices, faces, normals=np.tile([0.0, 0.0, 1.0], (12, 1)), sigma=sigma, n_support=k, sample_distance=k / 1e4,
        roughness=k % 3, colors=np.column_stack([k, k + 1, k + 2]), intensity=k / 12, face_invented=np.arange(6) == 3,
    )  # fmt: skip


def registration() -> Registration:
    """Return the archived registration."""
    return Registration(
        POSE, np.diag(np.arange(1.0, 7.0)) * 1e-8, np.array([0.5, 1.5, 2.5]), True, "", 10, 12, 4, 1e-4, 2e-4, 0.9,
        0.75, np.arange(12) % 4 > 0,
    )  # fmt: skip


def comparison() -> Comparison:
    """Return the archived comparison."""
    k = np.arange(12)
    assessed = k % 4
    distances = np.where(assessed, -0.001 * k, np.nan)
    side = ComparedSurface(surface(), distances, np.where(assessed, 5e-4, np.nan), np.minimum(assessed, 2),
                           (k > 8).astype(np.int32), np.where(assessed, 0, 3))  # fmt: skip
    regions = pd.DataFrame([[1, "lost", *(np.arange(11) / 8.0)], [2, "added", *(-np.arange(11) / 8.0)]],
                           columns=list(REGION_COLUMNS))  # fmt: skip
    statistics = {"bias_m": -1.5e-5, "n_vertices": 12, "nothing": float("nan"), "automatic": {"search": [0.1, None]}}
    return Comparison(side, side, regions, registration(), "relative", statistics)


@dataclass
class ArchivedStream:
    """The archived scan as a stream of two chunks."""

    path: Path
    name: str = "station-1.ptx"
    index: int = 0
    scanner: str | None = "hds6000"
    is_grid: bool = True

    @property
    def pose(self) -> np.ndarray:
        return POSE

    @property
    def origin(self) -> np.ndarray:
        return np.zeros(3)

    def chunks(self) -> Iterator[Scan]:
        whole = raw_cloud()
        for which in (np.arange(35), np.arange(35, 60)):
            yield Scan(self.name, whole.take(which), POSE, np.zeros(3), which // 10, which % 10, self.scanner,
                       {"zero range": 4, "nan": 1})  # fmt: skip


def step(product: str) -> Step:
    """Return the archived step of a product; its time is stated, so that the test can, too."""
    parameters = {"spacing": None, "n": 48, "share": 0.25, "mode": "relative"}
    return Step(
        step_id(product, parameters, ["00112233aabbccdd"]), product, parameters, ("00112233aabbccdd",),
        {"spacing": 0.002}, {"n_in": 60, "dropped": {"silhouette": 3}}, {"numpy": "2.4.6"}, "2026-11-21T12:00:00+00:00",
        1.25,
    )  # fmt: skip


def make(folder: Path) -> None:
    """Write the archived project, of one object with two epochs, into a new folder."""
    source = folder.parent / "station-1.ptx"
    source.write_bytes(SOURCE)
    project = Project.create(folder, name="Öfen und Treppen", crs="EPSG:25832", description="zwei\nZeilen")
    project.add_object(ObjectRecord("stove.1", "Kachelofen", "I-17", "Köln", "Ton", "grün glasiert", EXTENT, 0.01))
    control = (ControlPoint("P1", np.array([1.0, 2.0, 3.0])), ControlPoint("P2", np.zeros(3), 0.002))
    for epoch_id, year in (("E1", 2024), ("E-2.b", 2025)):
        record = EpochRecord(
            "stove.1", epoch_id, datetime.date(year, 5, 1), "vor", "hds6000", True, False, "Ada", (), control
        )
        project.add_epoch(record, [ArchivedStream(source)])
    project.add_epoch(EpochRecord("stove.1", "cad", datetime.date(2020, 1, 1)), mesh=surface(1.0))
    for epoch_id, product, noun in (
        ("E1", "cloud", cloud()),
        ("E1", "surface", surface()),
        ("E1", "quality", {"distances": np.array([0.1, np.nan]), "scans": {"a": np.arange(3), "note": "Fuß"}}),
        ("E-2.b", "registration-E1", registration()),
        ("E-2.b", "comparison-E1", comparison()),
        ("E1", "comparison-E-2.b", {"facts": [1, 2.5, None, float("inf")], "a/b": True}),
    ):
        project.put("stove.1", epoch_id, step(product), noun)
    source.unlink()


if __name__ == "__main__":
    make(Path(sys.argv[1]))
