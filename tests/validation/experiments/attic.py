"""The attic sculpture of paper 001, fig. 2: eight scans from two heights, the surface against its own points.

The paper's Poisson surface lay beside its points all over ("predominantly shades of blue"). Photon 120 preset with its
residual cyclic error, each station registered with 0.2 mm and 0.002 degrees; the network, the merge and the surface are
those of the command line. The points compared with are the thinned points of each scan where the network put them.
"""

from __future__ import annotations

import dataclasses
import datetime
import tempfile
from pathlib import Path

import front_door
import numpy as np
from rows import Row, Size, in_percent, in_words, judge

from monitor.simulation import (
    INSTRUMENTS,
    SurveyedEpoch,
    attic_scene,
    attic_stations,
    register_with_errors,
    write_campaign,
)
from projects.model import Bools, Floats
from projects.transforms import apply

TITLE = "Attic sculpture (paper 001, fig. 2): the surface against its own points"
INSTRUMENT = INSTRUMENTS["faro-photon120"]
SPACINGS = {"small": 0.012, "full": 0.002}
CELLS = {"small": 0.012, "full": 0.005}
LIMIT = 3600.0
NOISE = "noise of these points"
STEEP = np.radians(60.0)
LIMB = 0.05  # m: where the true surface bends more sharply than this, most of a spot's power may miss its tangent plane


def run(size: Size) -> list[Row]:
    """Survey once, process, and judge the surface by its points and by the truth."""
    scene = attic_scene(cell=CELLS[size])
    bodies = np.concatenate([body.vertices for body in scene.bodies if body.name != "floor"])
    box = np.stack([bodies.min(axis=0) - 0.02, bodies.max(axis=0) + 0.02])
    box[0, 2] = 0.01  # not the floor
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stations = register_with_errors(attic_stations(spacing=SPACINGS[size]), seed=4)
        epochs = [SurveyedEpoch(scene, stations, datetime.date(2010, 9, 1))]
        campaign = write_campaign(folder, epochs, INSTRUMENT, box=box)
        told = [front_door.Epoch("e0", "2010-09-01", list(campaign.epochs))]
        project = front_door.process(folder, told, extent=campaign.extent)
        quality = front_door.product(project, "e0", "quality")
        surface = front_door.surface(project, "e0")
        clouds = [front_door.product(project, "e0", f"scan{k:03d}") for k in range(len(stations))]
        motions = front_door.product(project, "e0", "network")["T_project_given"]
    off = 1e3 * np.concatenate(list(quality.values()))
    sigma = 1e3 * np.concatenate([cloud.sigma for cloud in clouds])
    assert scene.truth is not None
    feet = scene.truth.closest_point(
        np.concatenate([apply(T, cloud.points) for T, cloud in zip(motions, clouds, strict=True)])
    )
    eyes = np.repeat(
        [s.T_project_scanner[:3, 3] for s in stations], [len(cloud) for cloud in clouds], axis=0
    )  # fmt: skip
    towards = eyes - feet
    cosine = (towards * scene.truth.normal(feet)).sum(axis=1) / np.linalg.norm(towards, axis=1)
    is_steep = cosine < np.cos(STEEP)
    is_bent = np.nanmax(np.abs(scene.truth.curvature(feet)), axis=1) > 1.0 / LIMB
    error = 1e3 * scene.truth.signed_distance(surface.vertices)
    return with_cause([*rows_of(off, sigma, error), *rows_of_places(off, sigma, is_steep, is_bent)])


def with_cause(rows: list[Row]) -> list[Row]:
    """Return the rows, that of the rms with where it exceeds the noise; the last rows tell of places."""
    above = [row for row in rows if row.what.startswith("rms of points") and row.value > float(row.others[NOISE])]
    told = "; ".join(f"{row.what.removesuffix(', mm')}: {row.ours}, stated {row.others[NOISE]}" for row in above)
    cause = f"only these lie farther off than they state: {told}" if above else ""
    return [
        dataclasses.replace(row, cause=cause) if row.what == "rms, mm" and row.verdict == "not yet" else row
        for row in rows
    ]


def rows_of_places(off: Floats, sigma: Floats, is_steep: Bools, is_bent: Bools) -> list[Row]:
    """Return where the squares of the rms come from: the share of the points, and what they say their noise is."""
    known = np.isfinite(off)
    total = float(np.sum(off[known] ** 2))
    places = {
        "seen within 60 degrees, curved less than 1 / 50 mm": ~is_steep & ~is_bent,
        "seen within 60 degrees, curved more": ~is_steep & is_bent,
        "seen beyond 60 degrees": is_steep,
    }
    rows = []
    for what, where in places.items():
        here = known & where
        rms, noise = (float(np.sqrt(np.nanmean(v[here] ** 2))) for v in (off, sigma))
        share, of_squares = float(here.sum() / known.sum()), float(np.sum(off[here] ** 2)) / total
        rows.append(
            Row(f"rms of points {what}, mm", in_words(rms, 3), "stated", "", "", {
                NOISE: in_words(noise, 3), "of the points": in_percent(share),
                "of the squares": in_percent(of_squares)}, rms)
        )  # fmt: skip
    return rows


def rows_of(off: Floats, sigma: Floats, error: Floats) -> list[Row]:
    """Return bias and rms against the points, and the error against the truth."""
    known = off[np.isfinite(off)]
    mean, rms = float(known.mean()), float(np.sqrt(np.mean(known**2)))
    noise = float(np.sqrt(np.nanmean(sigma**2)))
    near = error[np.abs(error) < 10.0]
    return [
        Row("signed mean, points over surface, mm", in_words(mean, 4, signed=True), judge(abs(mean) <= 0.02),
            "beside it all over", "0.02", value=mean),
        Row("rms, mm", in_words(rms, 3), judge(rms <= noise), "within 0.5 (Geomagic)", "the points' noise",
            {NOISE: in_words(noise, 3)}, rms),
        Row("points farther than 0.5 mm", in_percent(float(np.mean(np.abs(known) > 0.5)), 2)),
        Row("points over no surface", in_percent(float(np.mean(~np.isfinite(off))), 2)),
        Row("surface against the truth: median, mm", in_words(float(np.median(near)), 3, signed=True),
            value=float(np.median(near))),
        Row("surface against the truth: 95 % within, mm", in_words(float(np.quantile(np.abs(near), 0.95)), 2)),
        Row("surface farther than 10 mm from the truth", in_percent(1.0 - len(near) / len(error), 2)),
    ]  # fmt: skip


NOTES = "Through the command line, E57, all settings automatic."
