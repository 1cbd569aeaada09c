"""Small nouns and scan streams for the tests of the store."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from projects.model import (
    REGION_COLUMNS,
    ComparedSurface,
    Comparison,
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


@dataclass
class StoredStream:
    """A scan stream as `projects.formats` gives it, from memory."""

    name: str
    path: Path
    cloud: PointCloud
    index: int = 0
    pose: np.ndarray | None = field(default_factory=lambda: np.eye(4))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scanner: str | None = "hds6000"
    is_grid: bool = True
    step: int = 7
    fails_after: int | None = None

    def chunks(self) -> Iterator[Scan]:
        for k, start in enumerate(range(0, len(self.cloud), self.step)):
            if k == self.fails_after:
                raise OSError("the scanner file ends here")
            which = np.arange(start, min(start + self.step, len(self.cloud)))
            yield Scan(self.name, self.cloud.take(which), np.eye(4), np.zeros(3), which // 4, which % 4,
                       self.scanner, {"zero range": 2})  # fmt: skip


def example_stream(folder: Path, rng: np.random.Generator, n: int = 20, name: str = "s1.ptx") -> StoredStream:
    """Return a stream of n points whose source file exists."""
    path = folder / name
    path.write_bytes(rng.bytes(100))
    cloud = PointCloud(
        rng.normal(size=(n, 3)), intensity=rng.random(n), colors=rng.integers(0, 256, (n, 3), dtype=np.uint8)
    )
    return StoredStream(name, path, cloud)


def example_surface(rng: np.random.Generator, n: int = 30) -> Surface:
    """Return a surface with NaN where something is unknown."""
    sigma = rng.random(n)
    sigma[::3] = np.nan
    return Surface(rng.normal(size=(n, 3)), rng.integers(0, n, (2 * n, 3)), sigma=sigma)


def full_surface(rng: np.random.Generator, n: int = 30) -> Surface:
    """Return a surface of which everything is known."""
    return Surface(
        rng.normal(size=(n, 3)), rng.integers(0, n, (2 * n, 3)), normals=rng.normal(size=(n, 3)), sigma=rng.random(n),
        sigma_shared=rng.random(n), n_support=rng.integers(0, 90, n), sample_distance=rng.random(n),
        stray_share=rng.random(n), roughness=rng.integers(0, 3, n), colors=rng.integers(0, 256, (n, 3)),
        intensity=rng.random(n),
        is_unresolved=rng.random(n) < 0.3, is_crest=rng.random(n) < 0.3, face_invented=rng.random(2 * n) < 0.3,
    )  # fmt: skip


def example_registration(rng: np.random.Generator, n: int = 30) -> Registration:
    """Return a registration with some fields unknown."""
    return Registration(np.eye(4), np.diag(rng.random(6)), rng.normal(size=3), True, n_inliers=5, rmse=1e-3,
                        is_stable=rng.random(n) < 0.5, weights=rng.random(n))  # fmt: skip


def example_comparison(rng: np.random.Generator, n_regions: int = 2) -> Comparison:
    """Return a comparison with a table of regions."""

    def side() -> ComparedSurface:
        distances = rng.normal(size=30)
        distances[:4] = np.nan
        return ComparedSurface(example_surface(rng), distances, rng.random(30), np.ones(30, np.uint8),
                               np.zeros(30, np.int32), np.zeros(30, np.uint8), rng.random(30), 0.5)  # fmt: skip

    rows = [[k + 1, "lost", *rng.normal(size=11)] for k in range(n_regions)]
    regions = pd.DataFrame(rows, columns=list(REGION_COLUMNS))
    statistics = {"bias_m": float("nan"), "n_vertices": 30, "automatic": {"search": [0.1, None, True]}}
    return Comparison(side(), side(), regions, example_registration(rng), "relative", statistics)


def example_project(folder: Path, rng: np.random.Generator) -> Project:
    """Return a project with the object `stove` and its epoch `E1` of one scan."""
    project = Project.create(folder / "project", name="Öfen")
    project.add_object(ObjectRecord("stove"))
    project.add_epoch(EpochRecord("stove", "E1", datetime.date(2024, 5, 1)), [example_stream(folder, rng)])
    return project


def example_step(product: str = "surface", **parameters: object) -> Step:
    """Return a step of the given product."""
    return Step(step_id(product, parameters, ["raw"]), product, parameters=parameters, inputs=("raw",))


def later_epoch(key: str = "E2") -> EpochRecord:
    """Return the record of another epoch of the object of `example_project`."""
    return EpochRecord("stove", key, datetime.date(2025, 1, 1))


def snapshot(folder: Path) -> dict[str, bytes]:
    """Return the bytes of every file of a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def findings(project: Project) -> list[tuple[str, str]]:
    """Return the severity and the words of all that a check of the project finds."""
    return [(f.severity, f.message) for f in project.verify().findings]


def assert_same(one: object, other: object) -> None:
    """Assert equality of nouns, with dtypes and with NaN equal to NaN."""
    assert type(one) is type(other)
    if dataclasses.is_dataclass(one):
        for f in dataclasses.fields(one):
            assert_same(getattr(one, f.name), getattr(other, f.name))
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, pd.DataFrame):
        pd.testing.assert_frame_equal(one, other)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    else:
        assert one == other or (one != one and other != other)
