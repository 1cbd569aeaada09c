"""The Rocaille stove of paper 002, fig. 3: three scans an epoch, implanted changes, through the whole chain.

Three courses of the front, six pieces among their neighbours, glazed; stations left, centre and right at 4 m, 0.7 mm
between points, each registered with 0.2 mm and 0.002 degrees. Between the epochs: worn and built-up patches, a lost
piece, a filling. Reduced for time: the extent holds about 0.6 x 0.8 m of the front. The Faro LS 880HE preset without
its cyclic error, as after the calibration in situ, which has its own experiment (this view holds no walls to calibrate
by).
"""

from __future__ import annotations

import dataclasses
import datetime
import tempfile
from collections.abc import Sequence
from pathlib import Path

import against_truth
import front_door
import numpy as np
import scan_to_scan
from rows import Row, Size

from monitor.simulation import (
    INSTRUMENTS,
    Edit,
    Model,
    Scene,
    Station,
    SurveyedEpoch,
    build_scene,
    coat,
    erode,
    fill,
    hollow_out,
    measure_changes,
    register_with_errors,
    stove_model,
    stove_stations,
    write_campaign,
)
from projects.model import Floats

TITLE = "Rocaille stove (paper 002, fig. 3): three scans an epoch"
INSTRUMENT = dataclasses.replace(INSTRUMENTS["faro-ls880"], cyclic_amplitudes=(), cyclic_phases=())
FOOTPRINT = 0.0035  # m, of its beam at 4 m
SPACINGS = {"small": 0.004, "full": 0.0007}
CELLS = {"small": 0.008, "full": 0.003}
PIECES = {"small": ((3,), (4, 5)), "full": ((3, 4, 5), (4, 5))}  # courses, and pieces of each
LIMIT = 3600.0


def inner_pieces(size: Size) -> list[str]:
    """Return the names of the pieces that the extent holds."""
    courses, pieces = PIECES[size]
    return [f"piece {c}.{k}" for c in courses for k in pieces]


def front(size: Size) -> Model:
    """Return these pieces and those around them as a model of their own, before the wall."""
    model = stove_model(cell=CELLS[size])
    courses, pieces = PIECES[size]
    around = [
        f"piece {c}.{k}" for c in range(courses[0] - 1, courses[-1] + 2) for k in range(pieces[0] - 1, pieces[-1] + 2)
    ]
    return dataclasses.replace(model, parts=tuple(model.part(name) for name in around))


def extent_of(model: Model, size: Size) -> Floats:
    """Return the box (2, 3) [m] that is scanned and monitored: the inner pieces, with room before and behind."""
    boxes = np.stack([model.part(name).bounds() for name in inner_pieces(size)])
    box = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    return box + np.array([[0.0, -0.02, 0.0], [0.0, 0.02, 0.0]])


def implant(model: Model, scene: Scene, size: Size) -> tuple[Edit, ...]:
    """Return the changes, each about the middle of a piece's front."""

    def at(name: str) -> tuple[Floats, Floats]:
        low, high = model.part(name).bounds()
        middle = 0.5 * (low + high)
        assert scene.truth is not None
        place = scene.truth.closest_point(np.array([[middle[0], low[1] - 0.02, middle[2]]]))
        return place[0], scene.truth.normal(place)[0]

    first = erode("worn patch", at("piece 3.4")[0], radius=0.035, depth=0.003, part="piece 3.4")
    if size == "small":
        return (first,)
    place, normal = at("piece 5.4")
    return (
        first,
        coat("crust", at("piece 3.5")[0], radius=0.025, height=0.002, part="piece 3.5"),
        hollow_out("lost piece", at("piece 4.4")[0], (0.022, 0.012, 0.018), part="piece 4.4"),
        fill("filling", place + 0.004 * normal, normal, radius=0.015, depth=0.02, part="piece 5.4"),
        erode("faint wear", at("piece 4.5")[0], radius=0.030, depth=0.001, part="piece 4.5"),
        erode("chip", at("piece 5.5")[0], radius=0.006, depth=0.0015, part="piece 5.5"),
    )


def run(size: Size) -> list[Row]:
    """Survey both epochs, process, compare and judge."""
    model = front(size)
    before = build_scene(model)
    edits = implant(model, before, size)
    after = build_scene(model, edits)
    box, stations = extent_of(model, size), stove_stations(spacing=SPACINGS[size])
    surveys = [
        SurveyedEpoch(scene, register_with_errors(stations, seed=k), datetime.date(2008 + k, 5, 1))
        for k, scene in enumerate((before, after))
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        campaign = write_campaign(folder, surveys, INSTRUMENT, box=box)
        told = [front_door.Epoch(f"e{k}", f"{2008 + k}-05-01", [path]) for k, path in enumerate(campaign.epochs)]
        project = front_door.process(folder, told, extent=campaign.extent)
        comparison = front_door.compare(project, "e0", "e1")
        agreement = agree(project, surveys[0], stations)
    changes = measure_changes(model, edits)
    return [*agreement, *against_truth.rows_of_changes(comparison, changes, (before, after), FOOTPRINT)]


def agree(project: Path, survey: SurveyedEpoch, stations: Sequence[Station]) -> list[Row]:
    """Return how the models of single scans agree, as registered and at their true poses."""
    motions, exact = scan_to_scan.network_motions(project, "e0"), scan_to_scan.true_motions(survey.stations)
    registered, true = (scan_to_scan.differ(project, "e0", T, stations, survey.scene) for T in (motions, exact))
    return scan_to_scan.rows_of(registered, true)


NOTES = (
    "Through the command line, E57, all settings automatic. Depth: the 95 % quantile of the distance over what truly "
    "changed. Scan to scan: models of the three scans, each against each, where `compare` assesses them. Reduced for "
    "time: six pieces of the front, among their neighbours; no cyclic error (it has its own row)."
)
