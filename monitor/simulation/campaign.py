"""A campaign: scenes scanned epoch by epoch from stations, written as a real survey would leave them on disk.

Scenes, stations and an instrument go in; a folder with a file of scans for each epoch comes out, and the object's
extent, so that whatever follows enters by the front door.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monitor.simulation.instruments import Instrument
from monitor.simulation.scanner import Target, join_blocks, stream_scan, window_around
from monitor.simulation.scenes import Scene
from monitor.simulation.stations import Station
from monitor.simulation.true_change import TrueChange
from projects.errors import ParameterError
from projects.formats import write_e57, write_ptx
from projects.model import Floats, Scan


@dataclass(frozen=True)
class SurveyedEpoch:
    """What stood there at a date, in the project's frame, and from where it was scanned."""

    scene: Scene
    stations: Sequence[Station]
    date: datetime.date


@dataclass(frozen=True)
class Campaign:
    """The files of a campaign: one for each epoch, and the extent of the object (JSON)."""

    epochs: tuple[Path, ...]
    extent: Path


def stream_stations(
    scene: Scene, instrument: Instrument, stations: Sequence[Station], *, box: Floats, seed: int, n_subrays: int = 9
) -> Iterator[Iterator[Scan]]:
    """Yield the scans of one epoch block by block (`stream_scan`), one after the other; see `scan_stations`."""
    target = Target.of(scene, 2)
    for k, s in enumerate(stations):
        window = window_around(box, s.T_project_scanner, margin=0.01)
        yield stream_scan(
            target, instrument, s.T_project_scanner, window, step=s.step, seed=_seed_of(seed, k), n_subrays=n_subrays,
            registered=s.registered, name=s.name,
        )  # fmt: skip


def _seed_of(seed: int, station: int) -> int | tuple[int, int]:
    """Return the seed of an epoch's station that no station of another epoch has."""
    return seed * 100 + station if station < 100 else (seed, station)


def scan_stations(
    scene: Scene, instrument: Instrument, stations: Sequence[Station], *, box: Floats, seed: int, n_subrays: int = 9
) -> list[Scan]:
    """Return the scans of one epoch: from each station the smallest window that holds the box (2, 3) [m].

    The work is about a second and a half for 500 000 pulses of nine sub-rays on two cores.
    """
    streams = stream_stations(scene, instrument, stations, box=box, seed=seed, n_subrays=n_subrays)
    return [join_blocks(blocks) for blocks in streams]


def write_campaign(
    folder: Path | str, epochs: Sequence[SurveyedEpoch], instrument: Instrument, *, box: Floats, seed: int = 2026,
    format: str = "e57",
) -> Campaign:  # fmt: skip
    """Scan each epoch from its stations and write the scans, `epoch-1.e57` and so on, and the extent.

    Scans go to the file block by block, so that their size is bounded by the disk, not by memory.

    Parameters
    ----------
    folder : made where it is missing.
    epochs : in order of time; each scene with its changes, each station with the pose that it is registered with.
    instrument : of `monitor.simulation.instruments`.
    box : (2, 3) m, of the object in the project's frame: what is scanned, and written as its extent.
    seed : of all that is random; epoch k uses seed + k.
    format : e57 or ptx.
    """
    if format not in ("e57", "ptx"):
        raise ParameterError(f"format {format!r}: campaigns are written as e57 or ptx")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"epoch-{k}.{format}" for k in range(1, len(epochs) + 1))
    for k, (epoch, path) in enumerate(zip(epochs, paths, strict=True), start=1):
        scans = stream_stations(epoch.scene, instrument, epoch.stations, box=box, seed=seed + k)
        if format == "ptx":
            write_ptx(path, scans)
        else:
            acquired = datetime.datetime.combine(epoch.date, datetime.time(9, 30), tzinfo=datetime.UTC)
            write_e57(path, scans, acquired=acquired, description=f"{epoch.scene.name}, simulated survey")
    return Campaign(paths, write_extent(folder / "extent.json", box))


def write_extent(path: Path, box: Floats) -> Path:
    """Write a box (2, 3) [m] as the extent of an object; return the path."""
    low, high = np.asarray(box, dtype=float).tolist()
    path.write_text(json.dumps({"box": {"min": low, "max": high}}, indent=2) + "\n")
    return path


def describe_truth(T_second_first: Floats, changes: Sequence[TrueChange]) -> dict[str, Any]:
    """Return the truth of two epochs as plain numbers: motion of the whole, each change in the first one's frame."""
    told = [
        {
            "name": c.name, "kind": c.kind, "centre_m": c.centre.tolist(), "area_m2": c.area, "volume_m3": c.volume,
            "extreme_m": c.extreme, "threshold_m": c.threshold, "box_m": c.box.tolist(),
        }
        for c in changes
    ]  # fmt: skip
    return {"T_second_first": T_second_first.tolist(), "changes": told}
