"""Difference models, surfaces and tables as files, under the names and with the properties that other programs rely on.

In: a comparison or a surface and the ids that name it. Out: the paths of the files written.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from projects.errors import ParameterError
from projects.formats import (
    require_stl_holds,
    write_csv,
    write_e57,
    write_glb,
    write_las,
    write_obj,
    write_ply_mesh,
    write_stl,
)
from projects.formats.complete_file import complete_file
from projects.model import ComparedSurface, Comparison, NotAssessed, PointCloud, Scan, Series, Step, Surface
from projects.triangles import rest_on_nothing
from reports.colours import choose_limit, vertex_colours
from reports.followed import find_footprints
from reports.motions import steady_motion_table
from reports.quantities import NBSP

SUMMARY_KEYS = ("stable_share", "bias_m", "nmad_m", "rmse_m", "lod95_median_m", "n_vertices", "n_not_assessable",
                "n_unchanged", "n_changed", "share_above_lod95", "motion_significance")  # fmt: skip
UNIT_NOTE = "metres; positive distance = material gained; assessment 0 not assessable, 1 unchanged, 2 changed"
TOLD_NOTE = "told_from: from how large a mean change around on one is told, in 19 of 20 cases"
REASON_NOTE = "reason: " + ", ".join(f"{reason.value} {reason.name.lower()}" for reason in NotAssessed)
RATE_NOTE = "metres, rates in metres a year; positive = material gained"

UNITS = {"distance": "m, positive = gained", "lod95": "m", "told_from": "m", "sigma": "m", "sigma_shared": "m",
         "sample_distance": "m", "rate": "m/year, positive = gained", "sigma_rate": "m/year",
         "rate_told_from": "m/year", "acceleration": "m/year2", "sigma_acceleration": "m/year2",
         "assessment": "0 unknown 1 unchanged 2 changed"}  # fmt: skip

Properties = Mapping[str, NDArray[Any]]
Writer = Callable[[Path, Surface, Properties, str], None]


def export_comparison(
    out: Path, ids: tuple[str, str, str], comparison: Comparison, step: Step, formats: Sequence[str], *, crs: str = ""
) -> list[Path]:
    """Write both difference models, the table of regions and the summary; return the paths.

    Parameters
    ----------
    out : an existing folder.
    ids : object, reference epoch, compared epoch.
    comparison : in the reference epoch's coordinates, m.
    step : the comparison's record: its parameters, versions and inputs stand in the summary, as `ids` and `crs` do.
    formats : of `FORMATS`; the table and the summary are always written.
    crs : reference system of the project, EPSG:n, which PLY, OBJ, LAZ and E57 name.
    """
    stem = "_".join(ids)
    limit = choose_limit(comparison)
    written: list[Path] = []
    for name in ("on-compared", "on-reference"):
        side = comparison.on_compared if name == "on-compared" else comparison.on_reference
        colours = vertex_colours(side, limit)
        surface = dataclasses.replace(side.surface, colors=colours)
        written += _write_formats(out / f"{stem}_{name}", surface, side_properties(side, colours), formats, crs)
    table, summary = out / f"{stem}_regions.csv", out / f"{stem}_summary.json"
    write_csv(table, comparison.regions)
    about = dict(zip(("object", "reference", "compared"), ids, strict=True))
    write_json(summary, {**summarize(comparison, step), **about, "crs": crs or None})
    return [*written, table, summary]


def export_surface(
    out: Path, object_id: str, epoch_id: str, surface: Surface, formats: Sequence[str], *, crs: str = ""
) -> list[Path]:
    """Write an epoch's surface, in the epoch's own project coordinates; return the paths."""
    return _write_formats(out / f"{object_id}_{epoch_id}_surface", surface, surface_columns(surface), formats, crs)


def export_series(
    out: Path, object_id: str, series: Series, comparison: Comparison, formats: Sequence[str], *,
    bearing: float | None = None, crs: str = "",
) -> list[Path]:  # fmt: skip
    """Write the rates on the reference surface, where they are significant (`rate_assessment`: 0 not assessable, 1 not
    significant, 2 significant), from how large a rate on one is told, the followed regions and their history; return
    the paths.

    Parameters
    ----------
    series : rates in m/year, positive = gained.
    comparison : of the reference epoch with the last of the series.
    bearing : rad, of the object's front, by which words of place go; None where nobody said.
    crs : reference system of the project, EPSG:n.
    """
    surface = comparison.on_reference.surface
    stem = f"{object_id}_{series.reference_id}_series"
    properties = {
        **surface_columns(dataclasses.replace(surface, colors=None, intensity=None, sigma=None, sigma_shared=None,
                                              sample_distance=None, n_support=None)),
        "rate": series.rate.astype(np.float32), "sigma_rate": series.sigma_rate.astype(np.float32),
        "identity": series.identity.astype(np.int32),
    }  # fmt: skip
    if series.rate_assessment is not None:
        properties["rate_assessment"] = series.rate_assessment.astype(np.uint8)
    if series.rate_told_from is not None:
        properties["rate_told_from"] = series.rate_told_from
    written = _write_formats(out / stem, surface, properties, formats, crs)
    tables = {name: getattr(series, name) for name in ("regions", "history", "forecast", "motions", "closures")}
    tables["regions"] = _place_regions(series, comparison, bearing)
    steady = steady_motion_table(series)
    if steady is not None:
        tables["steady_motion"] = steady
    for name in tables:
        path = out / f"{stem}_{name}.csv"
        write_csv(path, tables[name])
        written.append(path)
    return written


def _place_regions(series: Series, comparison: Comparison, bearing: float | None) -> pd.DataFrame:
    """Return the followed regions with where they lie, and which regions of the last comparison they are."""
    placed = find_footprints(series, comparison, bearing)
    at = [placed[int(k)] for k in series.regions["identity"]]
    words = [a.where.replace(NBSP, " ") for a in at]
    return series.regions.assign(place=words, last_region=[a.region for a in at])


def side_properties(side: ComparedSurface, colours: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
    """Return the properties of a difference model's vertices after x y z, in their order and with their types."""
    normals = np.full((len(side.distances), 3), np.nan) if side.surface.normals is None else side.surface.normals
    known = side.assessment > 0
    return {
        **{f"n{axis}": normals[:, k].astype(np.float32) for k, axis in enumerate("xyz")},
        **{name: colours[:, k] for k, name in enumerate(("red", "green", "blue"))},
        "distance": np.where(known, side.distances, np.nan).astype(np.float32),
        "lod95": np.where(known, side.lod95, np.nan).astype(np.float32),
        "assessment": side.assessment.astype(np.uint8),
        "region": side.region.astype(np.int32),
        **({} if side.told_from is None else {"told_from": side.told_from.astype(np.float32)}),
        "reason": side.reasons.astype(np.uint8),
    }


def surface_columns(surface: Surface) -> dict[str, NDArray[Any]]:
    """Return what is known of a surface's vertices, in a fixed order."""
    columns: dict[str, NDArray[Any]] = {}
    if surface.normals is not None:
        columns |= {f"n{axis}": surface.normals[:, k].astype(np.float32) for k, axis in enumerate("xyz")}
    if surface.colors is not None:
        columns |= {name: surface.colors[:, k] for k, name in enumerate(("red", "green", "blue"))}
    for name in ("intensity", "sigma", "sigma_shared", "sample_distance", "stray_share"):
        values = getattr(surface, name)
        if values is not None:
            columns[name] = np.asarray(values, dtype=np.float32)
    if surface.n_support is not None:
        columns["n_support"] = surface.n_support
    if surface.is_unresolved is not None:
        columns["unresolved"] = surface.is_unresolved.astype(np.uint8)
    if surface.is_crest is not None:
        columns["crest"] = surface.is_crest.astype(np.uint8)
    return columns


def summarize(comparison: Comparison, step: Step) -> dict[str, Any]:
    """Return the summary that other programs read: `SUMMARY_KEYS` first, then where the difference models' colours end,
    and every further statistic."""
    motion = comparison.registration
    statistics = dict(comparison.statistics)
    named = {key: statistics.pop(key) for key in SUMMARY_KEYS}
    return {
        "T_reference_compared": motion.T_target_source,
        "covariance": motion.covariance,
        "centre": motion.centre,
        "mode": comparison.mode,
        **named,
        "colours_end_m": choose_limit(comparison),
        "settings": step.parameters,
        "versions": step.versions,
        "inputs": step.inputs,
        "statistics": statistics,
    }


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write plain values as strict JSON; what is unknown (NaN) is null."""
    text = json.dumps(_plain(content), indent=2, allow_nan=False, ensure_ascii=False)
    with complete_file(path) as unfinished:
        unfinished.write_text(text + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """Return nested values as JSON knows them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _write_formats(
    stem: Path, surface: Surface, properties: Properties, formats: Sequence[str], crs: str
) -> list[Path]:
    """Write one surface in each format; return the paths."""
    written = []
    for name in formats:
        if name not in _WRITERS:
            raise ParameterError(f"format {name!r}: allowed are {', '.join(FORMATS)}")
        if name == "stl":  # before others are written
            require_stl_holds(stem.parent / f"{stem.name}.stl", surface)
    points = _measured_vertices(surface, properties) if surface.face_invented is not None else (surface, properties)
    for name in formats:
        path = stem.parent / f"{stem.name}.{name}"
        _WRITERS[name](path, *(points if name in OF_POINTS else (surface, properties)), crs)
        written.append(path)
    return written


def _measured_vertices(surface: Surface, properties: Properties) -> tuple[Surface, Properties]:
    """Return the vertices that rest on measured faces, for formats that hold no faces and could not tell the others."""
    kept = np.flatnonzero(~rest_on_nothing(surface))
    known = {name: values[kept] for name in ("intensity", "colors") if (values := getattr(surface, name)) is not None}
    points = Surface(surface.vertices[kept], np.empty((0, 3), dtype=np.int32), **known)
    return points, {name: values[kept] for name, values in properties.items()}


def _write_ply(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write the surface with all properties."""
    write_ply_mesh(path, surface, properties, comments=_notes_on(properties, crs))


def _notes_on(properties: Properties, crs: str) -> tuple[str, ...]:
    """Return what a file says of its units, signs and numbers: of the properties that it has."""
    unit = UNIT_NOTE if "assessment" in properties else RATE_NOTE if "rate" in properties else "metres"
    more = {"told_from": TOLD_NOTE, "reason": REASON_NOTE}
    return unit, *system_note(crs), *(note for name, note in more.items() if name in properties)


def system_note(crs: str) -> tuple[str, ...]:
    """Return in which reference system coordinates are, where the project says so."""
    return (f"coordinates in {crs}, x east, y north",) if crs else ()


def _write_obj(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write the surface; OBJ holds no properties."""
    write_obj(path, surface, comments=("metres", *system_note(crs)))


def _write_stl(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write the triangles alone."""
    write_stl(path, surface)


def _write_glb(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write the surface in its colours."""
    write_glb(path, surface)


def _write_laz(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write the vertices as points, with what LAS does not hold by itself as extra dimensions."""
    plain = {name: values for name, values in properties.items() if name not in ("red", "green", "blue", "intensity")}
    write_las(path, _vertex_cloud(surface), plain, {name: UNITS[name] for name in plain if name in UNITS}, crs)


def _write_csv(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write a row for each vertex that was measured."""
    places = {axis: surface.vertices[:, k] for k, axis in enumerate("xyz")}
    write_csv(path, pd.DataFrame({**places, **properties}))


def _write_e57(path: Path, surface: Surface, properties: Properties, crs: str) -> None:
    """Write the vertices as one scan."""
    vertices = Scan(path.stem, _vertex_cloud(surface), np.eye(4))
    write_e57(path, [vertices], description="vertices of a surface", crs=crs)


def _vertex_cloud(surface: Surface) -> PointCloud:
    """Return the vertices as points."""
    return PointCloud(surface.vertices, intensity=surface.intensity, colors=surface.colors)


_WRITERS: dict[str, Writer] = {
    "ply": _write_ply,
    "glb": _write_glb,
    "obj": _write_obj,
    "stl": _write_stl,
    "laz": _write_laz,
    "e57": _write_e57,
    "csv": _write_csv,
}
FORMATS = tuple(_WRITERS)
OF_POINTS = ("laz", "e57", "csv")
