"""The ornate room of paper 000, scanned from inside: surfaces that look inwards, metres from the middle.

Three stations an epoch within the room, 7.5 x 7 x 5 m, whole panoramas, registered with 1 mm and 0.1 mrad. Between the
epochs: a panel worn by 5 mm, the boss of a cartouche lost, the ceiling sunk by 8 mm over 1.6 m, a chest that stands
elsewhere.
"""

from __future__ import annotations

import dataclasses
import datetime
import tempfile
from pathlib import Path

import against_truth
import front_door
import numpy as np
from rows import Row, Size, in_words, judge

from monitor.simulation import (
    INSTRUMENTS,
    Edit,
    Model,
    Scene,
    Window,
    build_scene,
    coat,
    erode,
    hollow_out,
    measure_changes,
    misregister,
    room_model,
    simulate_scan,
    stand_at,
)
from monitor.simulation.changes import move_part
from monitor.simulation.model import box_part
from monitor.simulation.room import HEIGHT, LENGTH, STATIONS, WIDTH
from projects.formats import write_e57
from projects.model import Comparison, Surface

TITLE = "Ornate room (paper 000), scanned from inside"
INSTRUMENT = INSTRUMENTS["leica-hds6000"]
STEPS = {"small": 0.012, "full": 0.006}  # rad
CELLS = {"small": 0.03, "full": 0.012}  # m, of the simulated ornament
ROUND = Window(-np.pi, np.pi, -1.1, 1.5)
FROM, TO = np.array([1.0, 2.2, 0.4]), np.array([-1.0, 2.2, 0.4])  # m, middle of the chest before and after
HALF = np.array([0.3, 0.2, 0.4])  # m
LIMIT = 3600.0
SMALL_BARS = (
    "area of the surface over that of the plain room",
    "chest lost where it stood",
    "chest added where it stands",
)


def furnished(size: Size) -> Model:
    """Return the room with a chest in it."""
    room = room_model(cell=CELLS[size], plain_cell=0.05)
    chest = box_part("chest", FROM - HALF, FROM + HALF, cell=0.01, reflectance=0.4)
    return dataclasses.replace(room, parts=(*room.parts, chest))


def implant() -> tuple[Edit, ...]:
    """Return what changes between the epochs."""
    aside = np.eye(4)
    aside[:3, 3] = TO - FROM
    return (
        erode("worn panel", [-2.4, 0.5 * WIDTH + 0.008, 1.3], radius=0.3, depth=0.005, part="north wall"),
        hollow_out("lost boss", [0.0, 0.5 * WIDTH - 0.02, 3.15], (0.10, 0.05, 0.10), part="north wall"),
        coat("sunk ceiling", [1.5, 1.0, HEIGHT], radius=0.8, height=0.008, part="ceiling"),
        move_part("chest", "chest", aside),
    )


def survey(scene: Scene, step: float, folder: Path, epoch: int, draw: int = 0) -> Path:
    """Scan at so many rad from pulse to pulse from the stations, near where they stood before, and write the file."""
    rng = np.random.default_rng([7 + draw, epoch])
    scans = []
    for k, place in enumerate(STATIONS):
        pose = stand_at(place + rng.normal(scale=[0.15, 0.15, 0.05]), facing=np.zeros(3))
        given = misregister(pose, rng, sigma_position=0.001, sigma_angle=1e-4)
        scans.append(
            simulate_scan(
                scene,
                INSTRUMENT,
                pose,
                ROUND,
                step=step,
                seed=1000 * draw + 100 * epoch + k,
                registered=given,
                name=f"station {k}",
            )
        )
    path = folder / f"epoch-{epoch}.e57"
    acquired = datetime.datetime(2010 + epoch, 6, 1, tzinfo=datetime.UTC)
    write_e57(path, scans, acquired=acquired, description="ornate room, simulated survey")
    return path


def run(size: Size) -> list[Row]:
    """Survey the room twice, compare, and judge what is covered, found and called changed."""
    model = furnished(size)
    edits = implant()
    scenes = build_scene(model), build_scene(model, edits)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [survey(scene, STEPS[size], folder, k) for k, scene in enumerate(scenes)]
        told = [front_door.Epoch(f"e{k}", f"201{k}-06-01", [path]) for k, path in enumerate(paths)]
        project = front_door.process(folder, told)
        comparison = front_door.compare(project, "e0", "e1")
        covered = row_of_cover(front_door.surface(project, "e0"))
    changes = measure_changes(model, edits)
    found = against_truth.rows_of_changes(comparison, changes, scenes, 3.0 * STEPS[size])
    return [covered, *found, *rows_of_chest(comparison)]


def row_of_cover(surface: Surface) -> Row:
    """Return how much of the four walls, the floor and the ceiling has a surface, by area of their plain rooms."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    plain = 2.0 * (LENGTH * WIDTH + (LENGTH + WIDTH) * HEIGHT)
    return Row("area of the surface over that of the plain room", in_words(area / plain, 3), judge(area > 0.95 * plain),
               "", "0.95", value=area / plain)  # fmt: skip


def rows_of_chest(comparison: Comparison) -> list[Row]:
    """Return whether the chest is told lost where it stood and added where it stands."""
    places, change = comparison.regions[["x", "y", "z"]].to_numpy(), comparison.regions["mean_m"].to_numpy()
    rows = []
    for what, place, sign in (("lost where it stood", FROM, -1.0), ("added where it stands", TO, 1.0)):
        is_near = (np.abs(places - place) < HALF + 0.1).all(axis=1)
        found = bool((is_near & (np.sign(change) == sign)).any())
        rows.append(Row(f"chest {what}", "found" if found else "missed", judge(found), "", "found"))
    return rows


NOTES = (
    "Through the command line, E57, all settings automatic. Reduced: panoramas of 6 mrad, 1.4 million points an epoch. "
    "Depth: the 95 % quantile of the distance over what truly changed."
)
