"""The smallest chips that are told: pits and chipped edges of a pedestal, scanned before and after from four stations.

The pedestal of the demo's figure, through files and the command line, all settings automatic. Its later epoch has pits
of six widths and three depths in one panel, and edges and corners that lost a piece; other stations. Truths are
integrated from the exact shapes. A chip is told where a region lies on it; a region anywhere else is false.
"""

from __future__ import annotations

import datetime
import functools
import itertools
import tempfile
from collections.abc import Sequence
from pathlib import Path

import front_door
import numpy as np
from region_places import PlacedEdit, places_of_regions, row_of_place
from rows import Row, Size

from monitor.simulation import INSTRUMENTS, Body, Scene, misregister, stand_at
from monitor.simulation.campaign import SurveyedEpoch, write_campaign
from monitor.simulation.changes import hollow_out
from monitor.simulation.model import only_near
from monitor.simulation.pedestal import DIE, DIE_HALF_WIDTH, HALF_WIDTH, PANEL_DEPTH, pedestal_part
from monitor.simulation.scenes import make_box
from monitor.simulation.solid import Field, Solid, contour
from monitor.simulation.stations import Station
from monitor.simulation.true_change import TrueChange, measure_change
from monitor.simulation.truth import truth_of
from projects.model import Comparison

TITLE = "The smallest chips told: pits and chipped edges of a pedestal"
LIMIT = 3000.0
DRAWS: dict[Size, int] = {"small": 1, "full": 3}
WIDTHS, DEPTHS = (0.008, 0.010, 0.012, 0.015, 0.020, 0.025), (0.001, 0.002, 0.004)  # m, of the pits
PITCH = (0.040, 0.048)  # m, from pit to pit, across and up
EDGES = (0.006, 0.008, 0.010)  # m, radii of the balls that edges lost
PLACES = {"edge": 0.052, "ledge seen from above": 0.376, "corner": 0.406}  # m, heights of the edges
SPACING, CELL = 0.0027, 0.0015  # m, between pulses at the pedestal, and of its triangles
BOX = np.array([[-0.24, -0.24, 0.008], [0.24, 0.24, 0.46]])
STATIONS = ((-45.0, 2.4, 1.3), (45.0, 2.6, 1.0), (135.0, 2.5, 1.5), (-135.0, 2.7, 1.2))  # degrees, m, m
NEAR = 0.012  # m: a region is that of a chip if its centre lies so near


@functools.cache
def chips() -> tuple[PlacedEdit, ...]:
    """Return the pits in the panel towards +y, wider ones to the right, deeper ones higher, and the chipped edges."""
    found, middle = [], 0.5 * (DIE[0] + DIE[1])
    for (i, width), (j, depth) in itertools.product(enumerate(WIDTHS), enumerate(DEPTHS)):
        place = np.array([(i - 2.5) * PITCH[0], DIE_HALF_WIDTH - PANEL_DEPTH, middle + (j - 1) * PITCH[1]])
        name = f"pit, {1e3 * width:.0f} mm wide, {1e3 * depth:.0f} mm deep"
        found.append(PlacedEdit(hollow_out(name, place, np.array([0.5 * width, depth, 0.5 * width])), place))
    for (k, radius), (what, height) in itertools.product(enumerate(EDGES), PLACES.items()):
        y = (-1.0) ** k * HALF_WIDTH if what == "corner" else 0.10 * (k - 1)
        place = np.array([-HALF_WIDTH if what == "corner" and k == 2 else HALF_WIDTH, y, height])
        name = f"{what}, a ball of {1e3 * radius:.0f} mm lost"
        found.append(PlacedEdit(hollow_out(name, place, np.full(3, radius)), place))
    return tuple(found)


def shape(epoch: int) -> Field:
    """Return the pedestal as it stands in epoch 0 or 1."""
    field: Field = Solid((pedestal_part(),))
    for chip in chips() if epoch else ():
        field = only_near(chip.edit, field)
    return field


@functools.cache
def scene_of(epoch: int) -> Scene:
    """Return the pedestal on a floor."""
    field = shape(epoch)
    vertices, faces = contour(field, Solid((pedestal_part(),)).bounds(), cell=CELL)
    body = Body("pedestal", vertices, faces, 0.55)
    floor = make_box("floor", np.array([-3.0, -3.0, -0.1]), np.array([3.0, 3.0, 0.0]), reflectance=0.35)
    return Scene("pedestal", (body, floor), truth_of(field, body.surface()))


@functools.cache
def truths() -> tuple[TrueChange, ...]:
    """Return how large each chip truly is, where it is deeper than a fifth of a millimetre."""
    before, after = shape(0), shape(1)
    return tuple(measure_change(c.edit.name, before, after, c.edit.box, threshold=2e-4) for c in chips())


def stations_of(seed: int) -> tuple[Station, ...]:
    """Return the stations of one epoch, each not quite where planned and registered with errors."""
    rng, out = np.random.default_rng([seed, 5]), []
    for k, (angle, distance, height) in enumerate(STATIONS):
        turn = np.radians(angle + rng.normal(scale=3.0))
        place = np.array([distance * np.cos(turn), distance * np.sin(turn), height]) + rng.normal(scale=0.03, size=3)
        pose = stand_at(place, facing=np.array([0.0, 0.0, 0.25]), heading=rng.uniform(-0.3, 0.3))
        given = misregister(pose, rng, sigma_position=2e-4, sigma_angle=3e-5)
        out.append(Station(f"station {k + 1}", pose, SPACING / (distance - 0.2), given))
    return tuple(out)


def compare_draw(seed: int) -> tuple[Comparison, Comparison]:
    """Return the comparisons of one draw: of the pedestal with itself, and with its later state."""
    states, dates = (0, 0, 1), [datetime.date(2020 + k, 5, 1) for k in range(3)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        epochs = [SurveyedEpoch(scene_of(state), stations_of(10 * seed + k), date)
                  for k, (state, date) in enumerate(zip(states, dates, strict=True))]  # fmt: skip
        written = write_campaign(folder / "scans", epochs, INSTRUMENTS["phase-2020"], box=BOX, seed=100 * seed)
        told = [front_door.Epoch(f"e{k}", str(date), [path])
                for k, (date, path) in enumerate(zip(dates, written.epochs, strict=True))]  # fmt: skip
        project = front_door.process(folder, told, extent=written.extent)
        return front_door.compare(project, "e0", "e1"), front_door.compare(project, "e1", "e2")


def run(size: Size) -> list[Row]:
    """Compare so many draws, and say of each chip how often it was told and how well."""
    pairs = [compare_draw(seed) for seed in range(1, DRAWS[size] + 1)]
    found = [later for _, later in pairs]
    rows = [row_of(k, chip, truth, found) for k, (chip, truth) in enumerate(zip(chips(), truths(), strict=True))]
    level = float(np.median([c.statistics["lod95_median_m"] for c in found]))
    false = sum(len(same.regions) for same, _ in pairs)
    return [
        Row("level of detection, median, mm", f"{1e3 * level:.2f}", value=level),
        *rows,
        Row("regions where nothing changed: of the unchanged pairs", str(false), value=float(false)),
        Row("regions where nothing changed: beside the chips", str(sum(nearest_chip(c).count(-1) for c in found))),
    ]


def nearest_chip(comparison: Comparison) -> list[int]:
    """Return the chip that each region lies on, -1 where on none."""
    return places_of_regions(comparison, [c.place for c in chips()], NEAR)


def row_of(number: int, chip: PlacedEdit, truth: TrueChange, found: Sequence[Comparison]) -> Row:
    """Return how often a chip is told, and its figures where it is, against the truth."""
    told = [c.regions.iloc[nearest_chip(c).index(number)] for c in found if number in nearest_chip(c)]
    return row_of_place(chip, truth, told, found)


NOTES = (
    "Through the command line, E57, 2.7 mm between pulses, four stations an epoch, registered to 0.2 mm. The depth and "
    "volume are those of the exact shapes; no bar is asked for. A chip told twice counts once. A volume is "
    "not known where too much beside the chip was not seen, nor the margin of a depth beside free edges and where the "
    "surface turns sharply."
)
SMALL_BARS = ()
