"""The demo's campaign: the carved figure scanned in two epochs from stations around it, with the truth beside it.

A folder goes in; two E57 files, the object's extent and the truth come out, as a survey would leave them on disk.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monitor.simulation.campaign import SurveyedEpoch, describe_truth, write_campaign
from monitor.simulation.figure import CarvedFigure, carved_figure, motion, true_changes
from monitor.simulation.instruments import INSTRUMENTS
from monitor.simulation.scanner import misregister, stand_at
from monitor.simulation.scenes import Scene, make_box
from monitor.simulation.stations import Station
from monitor.simulation.true_change import TrueChange
from projects.model import Floats

SPACING = 0.0027  # m, between neighbouring pulses at the figure
SIGMA_POSITION, SIGMA_ANGLE = 0.0002, 3e-5  # m, rad: what is left of each station's registration
# Stations: angle about the figure [degrees, -90 is in front], distance and height [m].
STATIONS = ((-90, 2.6, 1.45), (-30, 2.8, 1.35), (28, 2.9, 1.70), (90, 2.7, 1.40), (150, 2.8, 0.75), (-152, 2.5, 2.15))
EXTENT = np.array([[-0.32, -0.32, 0.008], [0.32, 0.32, 1.75]])


@dataclass(frozen=True)
class DemoCampaign:
    """The files of the demo and what is true of them.

    Attributes
    ----------
    epochs : path of each epoch's E57 file, first and second.
    extent : path of the extent's JSON file.
    dates, labels : of the epochs.
    texts : name, inventory, place, material, description and operator of the object block, and the instrument.
    scanner : preset of the instrument.
    T_second_first : (4, 4), how the figure as a whole was moved.
    changes : what else changed, in the first epoch's coordinates.
    """

    epochs: tuple[Path, Path]
    extent: Path
    dates: tuple[datetime.date, datetime.date]
    labels: tuple[str, str]
    texts: Mapping[str, str]
    scanner: str
    T_second_first: Floats
    changes: tuple[TrueChange, ...]


def demo_scene(figure: CarvedFigure, *, T_project_figure: Floats | None = None) -> Scene:
    """Return the figure in its place: on a stone floor, before a wall."""
    pose = np.eye(4) if T_project_figure is None else T_project_figure
    floor = make_box("floor", np.array([-4.0, -4.0, -0.1]), np.array([4.0, 4.0, 0.0]), reflectance=0.35)
    wall = make_box("wall", np.array([-4.0, 3.6, 0.0]), np.array([4.0, 3.8, 3.0]), reflectance=0.8)
    return Scene("carved figure", (figure.body.moved(pose), floor, wall), figure.truth.moved(pose))


def demo_stations(*, seed: int, spacing: float = SPACING, heading: float = 0.0) -> tuple[Station, ...]:
    """Return the stations of one epoch, not quite where planned and `heading` [rad] further round than in `STATIONS`;
    each is registered with errors."""
    rng = np.random.default_rng([seed, 1])
    stations = []
    for k, (angle, distance, height) in enumerate(STATIONS):
        turn = np.radians(angle) + heading + rng.normal(scale=0.02)
        place = np.array([distance * np.cos(turn), distance * np.sin(turn), height]) + rng.normal(scale=0.03, size=3)
        pose = stand_at(place, facing=np.zeros(3), heading=rng.uniform(-0.3, 0.3))
        registered = misregister(pose, rng, sigma_position=SIGMA_POSITION, sigma_angle=SIGMA_ANGLE)
        stations.append(Station(f"station {k + 1}", pose, spacing / (distance - 0.15), registered))
    return tuple(stations)


def write_demo_campaign(
    folder: Path | str, *, seed: int = 2026, cell: float = 0.0025, spacing: float = SPACING
) -> DemoCampaign:
    """Scan the carved figure in two epochs and write what a survey would leave: `epoch-1.e57`, `epoch-2.e57`, the
    extent and, as no survey could, `truth.json`.

    Parameters
    ----------
    folder : made where it is missing.
    seed : of all that is random.
    cell : m, edge length of the figure's triangles.
    spacing : m, between neighbouring pulses at the figure.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    (Path(folder) / "truth.json").touch()  # at once: it names the folder as ours, and what it holds takes seconds
    preset, dates = "phase-2020", (datetime.date(2025, 5, 12), datetime.date(2026, 5, 18))
    epochs = []
    for epoch, date in enumerate(dates, start=1):
        scene = demo_scene(carved_figure(epoch, cell=cell), T_project_figure=np.eye(4) if epoch == 1 else motion())
        stations = demo_stations(seed=seed + epoch, spacing=spacing, heading=0.15 * (epoch - 1))
        epochs.append(SurveyedEpoch(scene, stations, date))
    changes = true_changes()
    truth = describe_truth(motion(), changes)
    (Path(folder) / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")
    written = write_campaign(folder, epochs, INSTRUMENTS[preset], box=EXTENT, seed=seed)
    return DemoCampaign(
        (written.epochs[0], written.epochs[1]), written.extent, dates, ("before the winter", "after the restoration"),
        _texts(INSTRUMENTS[preset].name), preset, motion(), changes,
    )  # fmt: skip


def _texts(instrument: str) -> dict[str, str]:
    """Return what the archive knows of the object, by field."""
    return {
        "name": "Allegory with mural crown, torch and shield",
        "inventory": "DEMO-2026-001",
        "place": "nowhere: made by code, scanned by simulation",
        "material": "limestone (assumed reflectance 0.55)",
        "description": "Standing figure on a moulded pedestal inscribed HERITAGE ANNO MMXXVI, 1.7 m high.",
        "operator": "monitor demo",
        "instrument": f"{instrument} (simulated), six stations, 2.7 mm spacing at the figure",
    }
