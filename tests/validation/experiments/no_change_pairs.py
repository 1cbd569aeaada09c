"""Unchanged objects scanned twice, the whole method from scans to regions: what is called significant, and where.

Small bodies, each pair with its own instrument, spacing, stations and registration error of the stations. The store,
the chain and the comparison are those of the command line; only the reading of files is left out. An epoch's errors
are common to a pair, so the interval of each share is a bootstrap over pairs.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from held_out import beyond_held_out
from rows import Row, Size, judge
from scipy.stats import beta

from monitor.chain import compare_epochs, process_epoch
from monitor.comparison.regions.evidence import Sights
from monitor.engine import open_engine
from monitor.record import Place
from monitor.settings import Settings
from monitor.sights import gather_sights
from monitor.simulation import INSTRUMENTS, Body, Scene, misregister, simulate_scan, stand_at, window_around
from projects import Project
from projects.errors import RegistrationError
from projects.formats import ScanStream
from projects.model import Comparison, EpochRecord, Floats, ObjectRecord, Roughness, Scan

TITLE = "Unchanged pairs: what the level of detection and the regions promise"
LIMIT = 4 * 3600.0
N_PAIRS = {"small": 1, "full": 200}
INSTRUMENT_NAMES = ("phase-2020", "leica-hds6000")
N_STATIONS = 4
HALF_WIDTH_ASKED = 0.015
ACROSS = np.array([0.0, 1.0, 0.0])  # the cut into halves that teach each other: each holds smooth and rough surface
NOTES = (
    "Bodies 0.3 m wide, one half rough, four stations at 2 m, 3 to 4.5 mm spacing, each station registered with 0.1 to "
    "0.3 mm; the second epoch from other stations. Shares are of assessable vertices of the compared surface beyond "
    "their lod95; intervals by bootstrap over pairs. A level is learned from its own pair's calm vertices, so that "
    "nearly 5 % lie beyond it by construction; that of the other half was learned on one half of each surface (cut "
    "across its rough and its smooth part) and counts on the other."
)


class PairCounts(NamedTuple):
    """What one pair shows, [all, 3 roughness classes, 3 thirds of the lever arm]: vertices, those beyond their lod95,
    and those beyond the one that the other half of the surface teaches."""

    n: Floats
    n_beyond: Floats
    n_held_out: Floats
    n_regions: int
    assessed_share: float


def run(size: Size) -> list[Row]:
    """Return the shares beyond lod95 and the pairs with a region; each core takes every so many-th pair."""
    if size == "small":
        return rows_of(map(attempt_pair, range(N_PAIRS[size])))
    n_parts = os.cpu_count() or 1
    one_core = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    with tempfile.TemporaryDirectory() as folder:
        parts = [Path(folder) / f"part-{k}.pickle" for k in range(n_parts)]
        children = [
            subprocess.Popen(
                [sys.executable, __file__, "--seeds", str(k), str(N_PAIRS[size]), str(n_parts), "--keep", str(part)],
                env={**os.environ, **one_core},
            )
            for k, part in enumerate(parts)
        ]
        ended = [child.wait() for child in children]
        if any(ended):
            raise RuntimeError("a part of the pairs failed; what it said stands above")
        return rows_of(itertools.chain.from_iterable(map(read_part, parts)))


def keep_part(path: Path, pairs: Sequence[PairCounts | None]) -> None:
    """Write the pairs measured so far."""
    path.write_bytes(pickle.dumps([None if counts is None else tuple(counts) for counts in pairs]))


def read_part(path: Path) -> list[PairCounts | None]:
    """Return the pairs of a part."""
    return [None if counts is None else PairCounts(*counts) for counts in pickle.loads(path.read_bytes())]


def attempt_pair(seed: int) -> PairCounts | None:
    """Return the counts of a pair, None where the chain refuses to compare it."""
    try:
        return measure_pair(seed)
    except RegistrationError:
        return None


def rows_of(pairs: Iterable[PairCounts | None]) -> list[Row]:
    """Return the rows of some pairs; one that the chain refuses to compare is counted as such."""
    pairs = list(pairs)
    counts = [c for c in pairs if c is not None]
    refused = len(pairs) - len(counts)
    told = Row("pairs refused: the scans of an epoch did not settle", str(refused), value=float(refused))
    return [*share_rows(counts), region_row(counts), told]


def make_body(seed: int) -> Scene:
    """Return a closed bumpy body about 0.3 m wide whose half on +x is rough: 0.5 mm over 8 mm."""
    rng = np.random.default_rng([seed, 7])
    mesh = trimesh.creation.icosphere(subdivisions=6)
    d = mesh.vertices
    waves, phases = rng.normal(size=(12, 3)) * 3.0, rng.uniform(0.0, 2.0 * np.pi, 12)
    radius = 0.13 * np.linalg.norm(d * rng.uniform(0.8, 1.2, 3), axis=1) + 0.004 * np.cos(d @ waves.T + phases).sum(1)
    fine, shift = rng.normal(size=(40, 3)) * 110.0, rng.uniform(0.0, 2.0 * np.pi, 40)
    rough = np.cos(d @ fine.T + shift).sum(1) * np.sqrt(2.0 / 40.0) * 0.0005
    radius += rough * np.clip(4.0 * d[:, 0] + 0.5, 0.0, 1.0)
    return Scene("bumpy body", (Body("body", d * radius[:, None], mesh.faces.astype(np.int32), 0.6),))


def scan_epoch(scene: Scene, seed: int, rng: np.random.Generator, instrument: str, spacing: float) -> list[Scan]:
    """Return the scans of one epoch from stations of its own."""
    scans = []
    for k, (pose, registered) in enumerate(spread_stations(rng)):
        window = window_around(scene.bounds(), pose, margin=0.01)
        scans.append(simulate_scan(scene, INSTRUMENTS[instrument], pose, window, step=spacing / 1.9,
                                   seed=1000 * seed + k, registered=registered, name=f"station {k + 1}"))  # fmt: skip
    return scans


def spread_stations(rng: np.random.Generator, n_stations: int = N_STATIONS) -> list[tuple[Floats, Floats]]:
    """Return the true pose of each station around the body and the one that it is registered with."""
    start, sigma = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(1e-4, 3e-4)
    stations = []
    for k in range(n_stations):
        turn = start + 2.0 * np.pi * k / n_stations + rng.normal(scale=0.15)
        place = np.array([2.0 * np.cos(turn), 2.0 * np.sin(turn), rng.uniform(-0.6, 0.9)])
        pose = stand_at(place, facing=np.zeros(3), heading=rng.uniform(-0.3, 0.3))
        stations.append((pose, misregister(pose, rng, sigma_position=sigma, sigma_angle=3e-5)))
    return stations


def stream(scan: Scan, index: int, path: Path) -> ScanStream:
    """Return a simulated scan as a reader would hand it over."""

    def chunks() -> Iterator[Scan]:
        yield scan

    return ScanStream(scan.name, index, path, scan.pose, scan.origin, True, len(scan.cloud), scan.scanner,
                      scan.rows is not None, scan.name, "simulated", chunks)  # fmt: skip


def compare_pair(epochs: Sequence[Sequence[Scan]], folder: Path) -> tuple[Comparison, Sights]:
    """Return the comparison of two epochs of scans by the whole method, in a project of its own, and what their
    stations saw."""
    project = Project.create(folder / "project")
    project.add_object(ObjectRecord("body"))
    path = folder / "simulated"
    path.write_bytes(b"simulated in memory")
    settings = Settings()
    places = []
    for k, scans in enumerate(epochs):
        record = EpochRecord("body", f"e{k}", datetime.date(2025 + k, 5, 1))
        project.add_epoch(record, [stream(scan, i, path) for i, scan in enumerate(scans)])
        places.append(Place(project, "body", record.epoch_id))
    with open_engine() as engine:
        for place in places:
            process_epoch(place, settings, engine, lambda _: None)
        step = compare_epochs(places[1], "e0", settings, lambda _: None)
    return places[1].get(step), (gather_sights(places[0]), gather_sights(places[1]))


def measure_pair(seed: int) -> PairCounts:
    """Simulate, process and compare one unchanged pair, and count."""
    rng = np.random.default_rng([seed, 1])
    scene = make_body(seed)
    instrument, spacing = INSTRUMENT_NAMES[seed % len(INSTRUMENT_NAMES)], rng.uniform(0.003, 0.0045)
    epochs = [scan_epoch(scene, 2 * seed + k, rng, instrument, spacing) for k in range(2)]
    with tempfile.TemporaryDirectory() as folder:
        return count_pair(*compare_pair(epochs, Path(folder)))


def count_pair(comparison: Comparison, sights: Sights) -> PairCounts:
    """Return the counts of one comparison of epochs whose stations saw the `sights`."""
    side = comparison.on_compared
    known = np.isfinite(side.distances)
    beyond = np.abs(side.distances[known]) > side.lod95[known]
    held_out = beyond_held_out(comparison, ACROSS, sights)[known]
    roughness = np.zeros(len(known), dtype=int) if side.surface.roughness is None else side.surface.roughness
    arm = np.linalg.norm(side.surface.vertices - comparison.registration.centre, axis=1)[known]
    third = np.digitize(arm, np.quantile(arm, [1.0 / 3.0, 2.0 / 3.0]))
    groups = [np.ones(len(beyond), dtype=bool), *(roughness[known] == r for r in Roughness),
              *(third == t for t in range(3))]  # fmt: skip
    return PairCounts(
        np.array([g.sum() for g in groups], dtype=float),
        np.array([(g & beyond).sum() for g in groups], dtype=float),
        np.array([(g & held_out).sum() for g in groups], dtype=float),
        len(comparison.regions), float(known.mean()),
    )  # fmt: skip


def share_rows(counts: Sequence[PairCounts]) -> list[Row]:
    """Return the rows of the shares beyond lod95 and beyond the level of the other half, and the share assessed."""
    own = rows_of_shares(counts, np.array([c.n_beyond for c in counts]), "beyond lod95")
    other = rows_of_shares(counts, np.array([c.n_held_out for c in counts]), "beyond the lod95 of the other half")
    assessed = float(np.mean([c.assessed_share for c in counts]))
    return [*own, *other, Row("assessable", f"{100 * assessed:.0f} %", value=assessed)]


def rows_of_shares(counts: Sequence[PairCounts], beyond: Floats, what: str) -> list[Row]:
    """Return a row for all vertices, for each class of roughness and for each third of the lever arm; `beyond` (k, 7)
    of k pairs."""
    names = ("all", "smooth", "medium", "rough", "nearest third of the lever arm", "middle third", "farthest third")
    n = np.array([c.n for c in counts])
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(counts), (2000, len(counts)))
    rows = []
    for k, name in enumerate(names):
        if n[:, k].sum() < 1000 * len(counts) / 200:
            continue
        share = beyond[:, k].sum() / n[:, k].sum()
        low, high = np.quantile(beyond[draws, k].sum(axis=1) / n[draws, k].sum(axis=1), [0.025, 0.975])
        holds = low <= 0.05 <= high and 0.5 * (high - low) <= HALF_WIDTH_ASKED
        rows.append(Row(f"{what}: {name}", f"{100 * share:.1f} % ({100 * low:.1f} to {100 * high:.1f})",
                        judge(holds), asked="contains 5 %, half-width at most 1.5 %", value=share))  # fmt: skip
    return rows


def region_row(counts: Sequence[PairCounts]) -> Row:
    """Return the share of pairs with a false region, with its binomial interval (Clopper and Pearson)."""
    n, k = len(counts), sum(c.n_regions > 0 for c in counts)
    high = float(beta.ppf(0.95, k + 1, n - k)) if k < n else 1.0
    return Row("pairs that report a region", f"{k} of {n} (one-sided 95 % bound {100 * high:.1f} %)",
               judge(k <= 0.05 * n), asked="at most 5 %", value=k / n)  # fmt: skip


def main() -> None:
    """Measure a part of the pairs, which take some twenty seconds each, or tell what parts have shown."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seeds", nargs=3, type=int, metavar=("FIRST", "END", "STEP"), default=(0, 0, 1))
    parser.add_argument("--keep", type=Path, metavar="FILE", help="write the pairs there, one after another")
    parser.add_argument("parts", nargs="*", type=Path, help="files that --keep has written: tell of these too")
    asked = parser.parse_args()
    found = [pair for part in asked.parts for pair in read_part(part)]
    for seed in range(*asked.seeds):
        found.append(attempt_pair(seed))
        if asked.keep:
            keep_part(asked.keep, found)
    if not asked.keep:
        for row in rows_of(found):
            print(f"{row.what}: {row.ours}")


if __name__ == "__main__":
    main()
