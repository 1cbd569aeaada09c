"""The main job on real scans, through the command line alone: bunny scans in two epochs, with a dent of known depth.

Scans: Stanford Computer Graphics Laboratory, `../shared/data/stanford_bunny`. Every other scan, in the order of
bun.conf, is epoch 1; the others are epoch 2, with a cosine bowl pressed into their points. Everything else is a
no-change pair with real noise and real registration error. `pytest -s` prints the figures.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from real_scans import read_configuration
from scipy.spatial import cKDTree

from monitor.cli import run
from projects import Project
from projects.formats import read_scans

DEPTH, RADIUS = 0.001, 0.012
VIEW = np.array([0.0, 0.0, -1.0])  # the sensor looks along -z of the scan's frame
STATION = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class RangeScan:
    name: str
    pose: np.ndarray
    points: np.ndarray

    def posed(self) -> np.ndarray:
        return self.points @ self.pose[:3, :3].T + self.pose[:3, 3]

    def view(self) -> np.ndarray:
        return self.pose[:3, :3] @ VIEW


@dataclass(frozen=True)
class Dent:
    centre: np.ndarray
    direction: np.ndarray

    def depth_at(self, points: np.ndarray) -> np.ndarray:
        """Return the depth (n,) [m] of the bowl at points, across the viewing direction."""
        offset = points - self.centre
        along = offset @ self.direction
        across = np.linalg.norm(offset - along[:, None] * self.direction, axis=1)
        bowl = DEPTH * 0.5 * (1.0 + np.cos(np.pi * np.minimum(across, RADIUS) / RADIUS))
        return np.where(np.abs(along) < RADIUS, bowl, 0.0)


@dataclass(frozen=True)
class Outcome:
    folder: Path
    dent: Dent
    before: np.ndarray
    after: np.ndarray
    summary: dict

    def comparison(self):
        return Project.open(self.folder / "project").get("bunny", "second", "comparison-first")


def place_dent(before: np.ndarray, scan: RangeScan) -> Dent:
    """Choose the point of the scan that is seen best by both epochs: head on, and whole within the bowl's radius."""
    tree, posed, view = cKDTree(before), scan.posed(), scan.view()
    own = cKDTree(posed)
    best, centre = -1.0, posed[0]
    for candidate in posed[:: max(1, len(posed) // 400)]:
        near = posed[own.query_ball_point(candidate, RADIUS)]
        covered = float(np.mean(tree.query(near)[0] < 0.0007)) if len(near) > 500 else 0.0
        normal = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2][2]
        score = covered * abs(float(normal @ view)) * min(1.0, len(near) / 1500)
        if score > best:
            best, centre = score, candidate
    return Dent(centre, view)


def write_scan(path: Path, points: np.ndarray) -> None:
    """Write points as a PLY file, double precision, as an instrument's program would."""
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(header.encode("ascii") + points.astype("<f8").tobytes())


def add_epoch(folder: Path, epoch: str, date: str, scans: list[RangeScan]) -> None:
    """Write the scans and the poses file and add them as an epoch."""
    lines, files = ["# bun.conf, with the station 1 m in front of each scan"], []
    for scan in scans:
        path = folder / f"{epoch}-{scan.name}"
        write_scan(path, scan.points)
        files.append(str(path))
        lines.append(" ".join([path.name, *map(repr, map(float, scan.pose.ravel())), *map(repr, map(float, STATION))]))
    poses = folder / f"{epoch}.poses"
    poses.write_text("\n".join(lines) + "\n")
    options = ["--date", date, "--poses", str(poses), "--unit", "m"]
    assert run(["add-epoch", str(folder / "project"), "bunny", epoch, *options, *files]) == 0


@pytest.fixture(scope="module")
def outcome(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Run the main job once and keep what it made."""
    folder = tmp_path_factory.mktemp("bunny")
    source = real_data / "stanford_bunny" / "range"
    scans = []
    for name, pose in read_configuration(source / "bun.conf"):
        chunks = [c.cloud.points for stream in read_scans(source / name) for c in stream.chunks()]
        scans.append(RangeScan(name, pose, np.concatenate(chunks)))
    first, second = scans[0::2], scans[1::2]
    before = np.concatenate([s.posed() for s in first])
    dent = place_dent(before, second[0])
    dented = []
    for scan in second:
        posed = scan.posed()
        moved = posed + dent.depth_at(posed)[:, None] * dent.direction
        dented.append(RangeScan(scan.name, scan.pose, (moved - scan.pose[:3, 3]) @ scan.pose[:3, :3]))
    project = str(folder / "project")
    assert run(["init", project]) == 0
    assert run(["add-object", project, "bunny"]) == 0
    add_epoch(folder, "first", "1993-08-01", first)
    add_epoch(folder, "second", "1994-08-01", dented)
    assert run(["process", project]) == 0
    assert run(["compare", project, "bunny", "first", "second"]) == 0
    assert run(["export", project, "bunny", "first", "second", "--out", str(folder / "out")]) == 0
    summary = json.loads((folder / "out" / "bunny_first_second_summary.json").read_text())
    return Outcome(folder, dent, before, np.concatenate([s.posed() for s in dented]), summary)


def sides(outcome: Outcome):
    """Yield both sides of the comparison with, for each vertex, its distance to the dent's axis and the coverage."""
    comparison = outcome.comparison()
    undo = np.linalg.inv(comparison.registration.T_target_source)
    before, after = cKDTree(outcome.before), cKDTree(outcome.after)
    for side in (comparison.on_compared, comparison.on_reference):
        vertices = side.surface.vertices
        in_second = vertices @ undo[:3, :3].T + undo[:3, 3]
        in_both = (before.query(vertices)[0] < 0.002) & (after.query(in_second)[0] < 0.002)
        in_dent = outcome.dent.depth_at(in_second) > 0
        yield side, in_dent, in_both, in_second


def test_unchanged_surface_is_at_zero_and_mostly_assessed(outcome: Outcome) -> None:
    for side, in_dent, in_both, _ in sides(outcome):
        known = side.assessment > 0
        outside = known & ~in_dent
        assert abs(np.median(side.distances[outside])) <= 0.00005
        called = float(np.mean(side.assessment[outside] == 2))
        assessed = float(np.mean(known[in_both]))
        lod = float(np.median(side.lod95[known]))
        print(f"\nmedian {1e3 * np.median(side.distances[outside]):.4f} mm, called changed {called:.3%}, "
              f"assessed {assessed:.1%}, median lod95 {1e3 * lod:.3f} mm")  # fmt: skip
        assert called <= 0.10
        assert assessed >= 0.80
        assert lod <= 0.0006


def test_dent_is_found_as_one_negative_region_of_the_right_depth(outcome: Outcome) -> None:
    regions = outcome.comparison().regions
    offset = np.linalg.norm(regions[["x", "y", "z"]].to_numpy() - outcome.dent.centre, axis=1)
    print(f"\n{regions.to_string()}")
    near = regions[offset < RADIUS]
    assert len(near) == 1
    assert near.iloc[0]["mean_m"] < 0
    assert near.iloc[0]["extreme_m"] < 0
    assert near.iloc[0]["area_m2"] == regions["area_m2"].max()
    for side, _, _, in_second in sides(outcome):
        offset = in_second - outcome.dent.centre
        across = np.linalg.norm(offset - np.outer(offset @ outcome.dent.direction, outcome.dent.direction), axis=1)
        centre = (across < 0.002) & (np.abs(offset @ outcome.dent.direction) < 0.006)
        normals = side.surface.normals[centre]
        truth = -DEPTH * float(np.median(np.abs(normals @ outcome.dent.direction)))
        print(f"dent: {1e3 * np.nanmedian(side.distances[centre]):.3f} mm, truth {1e3 * truth:.3f} mm")
        assert np.nanmedian(side.distances[centre]) == pytest.approx(truth, abs=0.00025)


def test_summary_names_what_other_programs_rely_on(outcome: Outcome) -> None:
    keys = {"T_reference_compared", "covariance", "centre", "mode", "motion_significance", "stable_share", "bias_m"}
    keys |= {"nmad_m", "rmse_m", "lod95_median_m", "n_vertices", "n_not_assessable", "n_unchanged", "n_changed"}
    keys |= {"share_above_lod95", "settings", "versions", "inputs"}
    assert keys - set(outcome.summary) == set()
    counts = [outcome.summary[k] for k in ("n_not_assessable", "n_unchanged", "n_changed")]
    assert sum(counts) == outcome.summary["n_vertices"]
    assert outcome.summary["mode"] == "relative"
