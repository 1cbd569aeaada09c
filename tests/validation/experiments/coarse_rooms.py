"""The ornate room of paper 000, scanned so coarsely that its ornament lies between the points: unchanged, and worn.

Points lie up to 60 mm apart on frames 22 mm high and 60 mm wide, which a scanner's columns cross at the same heights
of their profile all along, in each epoch at others. Each draw is three epochs: the room twice unchanged, then with
frames worn, a panel worn, the boss of a cartouche lost. A region of the unchanged pair is false, and so is one of the
other that lies on none of these places.
"""

from __future__ import annotations

import functools
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import front_door
import numpy as np
from region_places import CM3, PlacedEdit, places_of_regions, row_of_place
from room import furnished, survey
from rows import Row, Size, in_percent, in_words, judge

from monitor.simulation import build_scene, clean, erode, hollow_out, measure_changes
from monitor.simulation.room import LENGTH, WIDTH
from projects.model import Comparison, Floats

TITLE = "An ornate room scanned coarsely: unchanged, and worn"
LIMIT = 3600.0
DRAWS: dict[Size, int] = {"small": 1, "full": 4}
STEP = 0.012  # rad
FRAME = (0.05, 0.2)  # m, half of what is worn of a frame: across it and its wall, and along it
NEAR = 0.25  # m: a region is that of a place if its centre lies so near


@dataclass(frozen=True)
class Loss(PlacedEdit):
    """What is lost of the room, and whether it is asked to be told."""

    is_asked: bool = True


def worn_frame(part: str, place: Floats, depth: float, is_asked: bool = True) -> Loss:
    """Return the wear of an upright frame over 0.4 m, by so much along its normal."""
    half = np.array([FRAME[0], FRAME[0], FRAME[1]])
    name = f"frame worn by {1e3 * depth:.0f} mm, 0.4 m long"
    return Loss(clean(name, depth=depth, box=np.array([place - half, place + half]), part=part), place, is_asked)


@functools.cache
def losses() -> tuple[Loss, ...]:
    """Return all that is lost."""
    beside, above = (WIDTH - 0.5) / 6.0 - 0.12, (LENGTH - 0.5) / 6.0 - 0.12  # of middle panels: where their frames are
    panel, boss = np.array([-2.4, 0.5 * WIDTH + 0.008, 1.3]), np.array([0.0, 0.5 * WIDTH - 0.02, 3.15])
    return (
        worn_frame("north wall", np.array([above, 0.5 * WIDTH - 0.01, 1.3]), 0.005, is_asked=False),
        worn_frame("east wall", np.array([0.5 * LENGTH - 0.01, beside, 1.3]), 0.010, is_asked=False),
        worn_frame("west wall", np.array([-0.5 * LENGTH + 0.01, -beside, 1.3]), 0.020),
        Loss(erode("panel worn by 5 mm", panel, radius=0.3, depth=0.005, part="north wall"), panel),
        Loss(hollow_out("lost boss", boss, (0.10, 0.05, 0.10), part="north wall"), boss),
    )


def compare_draw(draw: int) -> tuple[Comparison, Comparison]:
    """Return the comparisons of one draw: of the room with itself, and with its later state."""
    model = furnished("full")
    scenes = (build_scene(model), build_scene(model), build_scene(model, tuple(loss.edit for loss in losses())))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [survey(scene, STEP, folder, k, draw) for k, scene in enumerate(scenes)]
        told = [front_door.Epoch(f"e{k}", f"201{k}-06-01", [path]) for k, path in enumerate(paths)]
        project = front_door.process(folder, told)
        return front_door.compare(project, "e0", "e1"), front_door.compare(project, "e1", "e2")


def run(size: Size) -> list[Row]:
    """Compare so many draws; say how often nothing was told of nothing, and each loss of a loss."""
    pairs = [compare_draw(draw) for draw in range(1, DRAWS[size] + 1)]
    places = [loss.place for loss in losses()]
    truths = measure_changes(furnished("full"), tuple(loss.edit for loss in losses()))
    on = [places_of_regions(worn, places, NEAR) for _, worn in pairs]
    rows = []
    for k, (loss, truth) in enumerate(zip(losses(), truths, strict=True)):
        told = [worn.regions.iloc[o.index(k)] for (_, worn), o in zip(pairs, on, strict=True) if k in o]
        row = row_of_place(loss, truth, told, [worn for _, worn in pairs], CM3)
        rows.append(replace(row, asked="all", verdict=judge(len(told) == len(pairs))) if loss.is_asked else row)
    false, beside = sum(len(same.regions) > 0 for same, _ in pairs), sum(o.count(-1) for o in on)
    share, level = (float(np.mean([same.statistics[name] for same, _ in pairs]))
                    for name in ("share_above_lod95", "lod95_median_m"))  # fmt: skip
    return [
        Row("unchanged pairs with a region", f"{false} of {len(pairs)}", judge(false == 0), "", "none"),
        Row("beyond lod95 where nothing changed", in_percent(share, 1), value=share),
        Row("level of detection, median, mm", in_words(1e3 * level, 2), value=level),
        *rows,
        Row("regions beside what was lost", str(beside), judge(beside == 0), "", "none"),
    ]


NOTES = (
    "Through the command line, E57, three panoramas of 12 mrad an epoch, registered to 1 mm and 0.1 mrad, all settings "
    "automatic. Depths and volumes are those of the exact shapes; a frame worn by less than what lies between the "
    "points can say is not asked for."
)
SMALL_BARS = ("unchanged pairs with a region",)
