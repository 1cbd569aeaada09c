"""The command `plan`: from where, at which resolution, is a change seen?"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import typer
from rich.console import Console
from rich.table import Table

from monitor.cli.results import make_folder, require_place
from monitor.cli.units import metres_from_millimetres
from monitor.simulation.instruments import INSTRUMENTS, Instrument
from monitor.simulation.planning import Visibility
from monitor.simulation.resolution import (
    Plan,
    Task,
    choose_plan,
    plan_resolutions,
    see_vertices,
    stand_around_body,
)
from monitor.simulation.scenes import Body
from projects.errors import ParameterError
from projects.formats import metres_per_unit, question_unit, read_mesh, sniff_format, write_csv, write_ply_mesh
from projects.model import Floats, Surface

SHOWN, NOT_SHOWN, UNSEEN = (70, 150, 90), (214, 96, 60), (150, 150, 150)  # colours of the written surface
SMALLEST_TURN = 1.0  # degrees: 360 places a ring are more than anybody tries


@dataclass(frozen=True)
class PlanRequest:
    """What `monitor plan` was asked, as given: lengths in millimetres but distances and heights, those in metres."""

    mesh: Path
    out: Path
    scanner: str
    change: float
    width: float
    registration: float
    distances: str
    heights: str
    every: float
    reflectance: float
    beside: tuple[Path, ...]
    unit: str | None


def plan_for_mesh(request: PlanRequest, as_json: bool) -> None:
    """Plan, write stations and surface, and say where to stand, at which resolution, and what is not seen."""
    if request.scanner not in INSTRUMENTS:
        raise ParameterError(f"--scanner {request.scanner}: known presets are {', '.join(sorted(INSTRUMENTS))}")
    require_place(request.out, "--out")
    instrument = INSTRUMENTS[request.scanner]
    distances, heights = _numbers(request.distances, "--distances"), _numbers(request.heights, "--heights")
    if not SMALLEST_TURN <= request.every <= 360.0:  # NaN too
        raise ParameterError(f"--every {request.every:g}: degrees from {SMALLEST_TURN:g} to 360 are needed")
    if not 0.0 <= request.registration < np.inf:
        raise ParameterError(f"--registration {request.registration:g}: millimetres are needed, 0 or more")
    if not 0.0 < request.reflectance <= 1.0:
        raise ParameterError(f"--reflectance {request.reflectance:g}: a share of the light is needed, above 0, up to 1")
    task = Task(
        change=metres_from_millimetres(request.change, "--change"),
        extent=metres_from_millimetres(request.width, "--width"),
        reflectance=request.reflectance,
        sigma_registration=request.registration / 1000.0,
    )
    surface = _read(request.mesh, request.unit)
    _require_smaller(request, surface)
    shift = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))  # rays are float32
    body = _body(request.mesh, surface, shift)
    beside = [_body(path, _read(path, request.unit), shift) for path in request.beside]
    candidates = stand_around_body(body, distances=distances, heights=heights, every=np.radians(request.every))
    plans = plan_resolutions(body, beside, instrument, candidates, task)
    best = choose_plan(plans)
    if not best.taken:
        raise ParameterError(
            f"a change of {request.change:g} mm, {request.width:g} mm wide, shows nowhere from {len(candidates)} "
            f"places with {instrument.name}: come nearer (--distances), or ask for a larger --change or --width"
        )
    stations = [candidates[k] for k in best.taken]
    seen = see_vertices(body, beside, instrument, stations, best.step, task)
    make_folder(request.out)
    table = _stations(stations, body, shift)
    write_csv(request.out / "stations.csv", table)
    write_ply_mesh(request.out / "surface.ply", surface, _properties(seen, task), _comments(request, instrument, best))
    if as_json:
        typer.echo(json.dumps(_as_mapping(request, instrument, plans, best, table), indent=2))
    else:
        _say(request, instrument, plans, best, table)


def _read(path: Path, unit: str | None) -> Surface:
    """Return a mesh in metres; raise `UnitError` where nobody named the unit and its size is improbable."""
    surface = read_mesh(path, unit=metres_per_unit(unit or "m"))
    bounds = np.array([surface.vertices.min(axis=0), surface.vertices.max(axis=0)])
    question_unit(bounds, unit is not None, sniff_format(path), path.name)
    return surface


def _require_smaller(request: PlanRequest, surface: Surface) -> None:
    """Raise `ParameterError` where the change asked for is larger than all that is planned for."""
    across = 1000.0 * float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))
    for option, value in (("--change", request.change), ("--width", request.width)):
        if value > across:
            raise ParameterError(
                f"{option} {value:g}: {request.mesh.name} is {across:.4g} mm across; millimetres up to that are needed"
            )


def _body(path: Path, surface: Surface, shift: Floats) -> Body:
    """Return a mesh as a body of the scene, in coordinates about `shift` (3,) [m]."""
    return Body(path.stem, surface.vertices - shift, surface.faces)


def _numbers(text: str, option: str) -> list[float]:
    """Return numbers above 0 out of a list with commas."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(np.isfinite(v) and v > 0.0 for v in values):
        raise ParameterError(f"{option} {text}: metres above 0 are needed, several with commas between, such as 1.5,3")
    return values


def _stations(stations: list[Floats], body: Body, shift: Floats) -> pd.DataFrame:
    """Return a line for each station: place in the mesh's coordinates, turn about the object, height above its foot."""
    at = np.array([pose[:3, 3] for pose in stations])
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    off = at - 0.5 * (low + high)
    return pd.DataFrame(
        {
            "station": np.arange(1, len(at) + 1),
            "x_m": np.round(at[:, 0] + shift[0], 3), "y_m": np.round(at[:, 1] + shift[1], 3),
            "z_m": np.round(at[:, 2] + shift[2], 3),
            "angle_deg": np.round(np.degrees(np.arctan2(off[:, 1], off[:, 0])), 1),
            "from_middle_m": np.round(np.hypot(off[:, 0], off[:, 1]), 2),
            "above_foot_m": np.round(at[:, 2] - low[2], 2),
        }
    )  # fmt: skip


def _properties(seen: Visibility, task: Task) -> dict[str, Any]:
    """Return colours, the smallest change [m], spacing and footprint [m] and the number of stations of each vertex."""
    colors = np.full((len(seen.sigma), 3), NOT_SHOWN, dtype=np.uint8)
    colors[seen.smallest_change <= task.change] = SHOWN
    colors[~seen.in_sight] = UNSEEN
    lengths = {
        name: getattr(seen, name).astype(np.float32) for name in ("smallest_change", "spacing", "footprint", "sigma")
    }
    channels = {name: np.ascontiguousarray(colors[:, k]) for k, name in enumerate(("red", "green", "blue"))}
    return {**channels, **lengths, "n_stations": seen.n_stations.astype(np.int32)}


def _comments(request: PlanRequest, instrument: Instrument, best: Plan) -> list[str]:
    """Return what the written surface says of itself: what was asked, and what its colours mean."""
    return [
        f"change of {request.change:g} mm, {request.width:g} mm wide, seen by {instrument.name} from "
        f"{len(best.taken)} stations, step {np.degrees(best.step):.4f} degrees; green: it shows, red: it does not, "
        "gray: no station has it in sight; lengths in metres"
    ]


def _figures(plan: Plan) -> dict[str, Any]:
    """Return what a plan comes to, lengths in millimetres."""
    return {
        "resolution": f"1/{plan.fraction}",
        "step_deg": round(float(np.degrees(plan.step)), 5),
        "n_stations": len(plan.taken),
        "n_pulses": plan.n_pulses,
        "spacing_mm": _median_mm(plan.seen.spacing),
        "footprint_mm": _median_mm(plan.seen.footprint),
        "smallest_change_mm": _median_mm(plan.seen.smallest_change),
        "shown": round(plan.shown, 3),
        "too_few_pulses": round(plan.too_few, 3),
        "unseen": round(plan.unseen, 3),
    }


def _median_mm(lengths: Floats) -> float | None:
    """Return the median [mm] of lengths [m] that are known; None without any."""
    known = lengths[np.isfinite(lengths)]
    return round(1e3 * float(np.median(known)), 2) if len(known) else None


def _as_mapping(
    request: PlanRequest, instrument: Instrument, plans: tuple[Plan, ...], best: Plan, table: pd.DataFrame
) -> dict[str, Any]:
    """Return the plans and the advice as the values of `--json`."""
    return {
        "instrument": instrument.name, "change_mm": request.change, "width_mm": request.width,
        "registration_mm": request.registration, "resolutions": [_figures(plan) for plan in plans],
        "advice": {**_figures(best), "stations": table.to_dict(orient="records")},
    }  # fmt: skip


def _say(
    request: PlanRequest, instrument: Instrument, plans: tuple[Plan, ...], best: Plan, table: pd.DataFrame
) -> None:
    """Print the plans, the advice and the stations."""
    console = Console(width=None if Console().is_terminal else 120)
    headings = ("resolution", "step", "stations", "pulses", "between\npulses", "beam", "smallest\nchange", "shows it",
                "too few\npulses", "not seen")  # fmt: skip
    shown = Table(*headings, title=f"{request.change:g} mm over {request.width:g} mm, {instrument.name}")
    for plan in plans:
        f = _figures(plan)
        lengths = ["-" if f[k] is None else f"{f[k]} mm" for k in ("spacing_mm", "footprint_mm", "smallest_change_mm")]
        mark = " *" if plan is best else ""
        shown.add_row(
            f["resolution"] + mark, f"{f['step_deg']}°", str(f["n_stations"]), f"{plan.n_pulses / 1e6:.1f} M", *lengths,
            f"{plan.shown:.0%}", f"{plan.too_few:.0%}", f"{plan.unseen:.0%}",
        )  # fmt: skip
    console.print(shown)
    advice = _figures(best)
    typer.echo(
        f"advice (*): {advice['resolution']} of the finest resolution ({advice['step_deg']} degrees) from "
        f"{len(best.taken)} stations; {best.shown:.0%} of the surface then shows the change, "
        f"{best.unseen:.0%} is not seen"
    )
    typer.echo(
        "too few pulses: in sight, but fewer than three pulses of any station fall on a place as wide as was asked; "
        "not seen: in sight of none of the stations taken, or too far, too near or too dark for them"
    )
    typer.echo(
        "smallest change: what one place differs from zero by at 95 %; a comparison, sure that nothing on all of the "
        "surface is told by mistake, tells larger ones: of simulated objects two to four times as large"
    )
    typer.echo(table.to_string(index=False))
    typer.echo(f"{request.out / 'stations.csv'}\n{request.out / 'surface.ply'}")
