"""The oyster reef of paper 001, section 4.2, seen from its rim at shallow angles: what is not seen must be said so.

A window of 4 x 3 m of the reef, two epochs from the same eight places at the rim (other headings and errors), points
about 20 mm apart across the beam; in the second epoch a hollow of 40 mm is gone. Judged on dense samples of the true
surface: seen are those with a measured point within the surface's trim distance, unseen those without.
"""

from __future__ import annotations

import datetime
import tempfile
from pathlib import Path
from typing import NamedTuple

import front_door
import numpy as np
from rows import Row, Size, in_percent, in_words, judge
from scipy.spatial import cKDTree

from monitor.simulation import (
    INSTRUMENTS,
    Scene,
    Station,
    SurveyedEpoch,
    erode,
    register_with_errors,
    visible_change,
    write_campaign,
)
from monitor.simulation.reef import STATIONS, reef_scene
from monitor.simulation.scanner import stand_at
from projects.formats import read_scans
from projects.model import Assessment, Bools, Comparison, Floats, NotAssessed
from projects.transforms import apply

TITLE = "Oyster reef (paper 001, 4.2): what is not seen or too sparse"
INSTRUMENT = INSTRUMENTS["leica-hds6000"]
WINDOWS = {"small": (2.0, 1.6), "full": (4.0, 3.0)}
SPACINGS = {"small": 0.03, "full": 0.02}  # m across the beam, at 10 m
DEPTH, RADIUS = 0.04, 0.15
TRIM_CELLS = 2.5
LIMIT = 2400.0


class Survey(NamedTuple):
    """What was measured: all points of each epoch (n, 3) m, and the true scenes."""

    points: tuple[Floats, Floats]
    scenes: tuple[Scene, Scene]
    box: Floats


def stations(spacing: float, seed: int) -> tuple[Station, ...]:
    """Return the eight stations along the rim, registered with errors."""
    rng = np.random.default_rng([seed, 5])
    places = [
        Station(f"station {k}", stand_at(at + rng.normal(scale=0.05, size=3), facing=np.zeros(3)), spacing / 10.0)
        for k, at in enumerate(STATIONS, start=1)
    ]
    return register_with_errors(places, seed=seed, sigma_position=0.0005, sigma_angle=3e-5)


def survey(size: Size, folder: Path) -> tuple[Survey, Comparison]:
    """Scan both epochs, write them as PTX, and let `monitor` compare them."""
    half_x, half_y = (0.5 * length for length in WINDOWS[size])
    box = np.array([[-half_x, -half_y, -1.5], [half_x, half_y, 1.5]])
    hollow = erode("hollow", place_of_hollow(), radius=RADIUS, depth=DEPTH)
    scenes = reef_scene(), reef_scene(changes=[hollow])
    epochs = [
        SurveyedEpoch(scene, stations(SPACINGS[size], k), datetime.date(2010 + k, 6, 1))
        for k, scene in enumerate(scenes)
    ]
    campaign = write_campaign(folder, epochs, INSTRUMENT, box=box, format="ptx")
    told = [front_door.Epoch(f"e{k}", f"201{k}-06-01", [path]) for k, path in enumerate(campaign.epochs)]
    project = front_door.process(folder, told, extent=campaign.extent)
    comparison = front_door.compare(project, "e0", "e1")
    points = tuple(measured_points(path, box) for path in campaign.epochs)
    return Survey((points[0], points[1]), scenes, box), comparison


def place_of_hollow() -> Floats:
    """Return a place on the reef, in the middle of the window."""
    guess = np.array([[0.35, 0.2, 0.5]])
    return np.asarray(reef_scene().truth.closest_point(guess)[0])


def measured_points(path: Path, box: Floats) -> Floats:
    """Return all points of a file within the box, in the project's frame."""
    found = [apply(chunk.pose, chunk.cloud.points) for stream in read_scans(path) for chunk in stream.chunks()]
    points = np.concatenate(found)
    return points[((points >= box[0]) & (points <= box[1])).all(axis=1)]


def sample_truth(scene: Scene, box: Floats, spacing: float) -> Floats:
    """Return points spread over the true surface inside the box, drawn by area from its triangles."""
    rng = np.random.default_rng(5)
    body = scene.bodies[0]
    corners = body.vertices[body.faces]
    inside = ((corners >= box[0]) & (corners <= box[1])).all(axis=(1, 2))
    corners = corners[inside]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    chosen = rng.choice(len(corners), size=int(area.sum() / spacing**2), p=area / area.sum())
    u = np.sqrt(rng.uniform(size=len(chosen)))
    v = rng.uniform(size=len(chosen))
    a, b, c = (corners[chosen, k] for k in range(3))
    return (1.0 - u)[:, None] * a + (u * (1.0 - v))[:, None] * b + (u * v)[:, None] * c


def run(size: Size) -> list[Row]:
    """Compare the two epochs and ask what is said of the unseen."""
    with tempfile.TemporaryDirectory() as folder:
        measured, comparison = survey(size, Path(folder))
    looked_at = row_of_sight(measured.scenes[1], SPACINGS[size])
    side = comparison.on_reference
    cell = float(np.median(edge_lengths(side.surface.vertices, side.surface.faces)))
    reach = TRIM_CELLS * cell
    samples = sample_truth(measured.scenes[0], measured.box, 0.5 * cell)
    gap = cKDTree(measured.points[0]).query(samples, workers=2)[0]
    vertices = cKDTree(side.surface.vertices)
    near, index = vertices.query(samples, workers=2)
    is_assessed = (side.assessment[index] != Assessment.NOT_ASSESSABLE) & (near < reach)
    return [*rows_of(measured, comparison, gap, near, is_assessed, cell), looked_at]


def row_of_sight(after: Scene, spacing: float) -> Row:
    """Return how much of the hollow's floor the stations of the second epoch truly see, and how densely."""
    body, centre = after.bodies[0], place_of_hollow()
    corners = body.vertices[body.faces]
    middle = corners.mean(axis=1)
    floor = np.linalg.norm((middle - centre)[:, :2], axis=1) < 0.5 * RADIUS
    normals = np.cross(corners[floor, 1] - corners[floor, 0], corners[floor, 2] - corners[floor, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    poses = [s.T_project_scanner for s in stations(spacing, 1)]
    seen = visible_change(
        after, INSTRUMENT, poses, middle[floor], normals, step=spacing / 10.0, extent=2.0 * RADIUS, reflectance=0.4
    )  # fmt: skip
    share, between = float(np.mean(seen.n_stations > 0)), 1e3 * float(np.nanmedian(seen.spacing))
    told = f"{in_percent(share)}, by {np.median(seen.n_stations):.0f} stations, {between:.0f} mm between pulses"
    return Row("the hollow's floor that stations truly see", told, value=share)


def edge_lengths(vertices: Floats, faces: Floats) -> Floats:
    """Return the length of one edge of each face."""
    return np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)


def rows_of(
    measured: Survey, comparison: Comparison, gap: Floats, near: Floats, is_assessed: Bools, cell: float
) -> list[Row]:
    """Return what is covered, invented, assessed, and called changed."""
    reach, side = TRIM_CELLS * cell, comparison.on_reference
    seen, unseen = gap <= cell, gap > 2.0 * reach
    invented = cKDTree(measured.points[0]).query(side.surface.vertices, workers=2)[0] > reach
    covered = float(np.mean(near[seen] < reach))
    told = float(np.mean(is_assessed[unseen])) if unseen.any() else 0.0
    lost = -measured.scenes[1].truth.signed_distance(side.surface.vertices)
    gone = measured.scenes[0].truth.signed_distance(side.surface.vertices)
    still = np.abs(lost + gone) < 1e-4
    known = side.assessment != Assessment.NOT_ASSESSABLE
    called = float(np.mean(side.assessment[still & known] == Assessment.CHANGED))
    at = comparison.regions[["x", "y", "z"]].to_numpy()
    hits = np.linalg.norm(at - place_of_hollow(), axis=1) < RADIUS
    return [
        Row("true surface that no point came near (2 trims)", in_percent(float(unseen.mean()), 1)),
        Row("of that, said to be assessed", in_percent(told, 2), judge(told <= 0.01), "edges lost", "at most 1 %"),
        Row("surface farther than 2.5 cells from a point", in_percent(float(invented.mean()), 2),
            judge(float(invented.mean()) == 0.0), "", "none"),
        Row("seen surface that is covered", in_percent(covered, 1)),
        Row("seen surface that is assessed", in_percent(float(np.mean(is_assessed[seen])), 1)),
        Row("unchanged, assessed surface called changed", in_percent(called, 2), judge(called <= 0.01), "", "1 %"),
        row_of_hollow(comparison, lost, bool(hits.any())),
        Row("other regions", str(int((~hits).sum())), judge(not (~hits).any()), "", "none"),
    ]  # fmt: skip


def row_of_hollow(comparison: Comparison, depth: Floats, is_found: bool) -> Row:
    """Return whether the hollow is found; where not, what the vertices inside it say.

    `depth` (n,) m: how deep the vertices of the reference lie above the true surface afterwards, with sign.
    """
    side = comparison.on_reference
    inside = (np.linalg.norm(side.surface.vertices - place_of_hollow(), axis=1) < RADIUS) & (depth < -0.5 * DEPTH)
    reasons = side.reasons[inside]
    counted = {NotAssessed(r).name.lower().replace("_", " "): float(np.mean(reasons == r)) for r in np.unique(reasons)}
    told = ", ".join(f"{name} {in_percent(share)}" for name, share in sorted(counted.items(), key=lambda i: -i[1]))
    known = inside & (side.assessment != Assessment.NOT_ASSESSABLE)
    figures = "none assessed"
    if known.any():
        median, lod = (1e3 * float(np.nanmedian(v[known])) for v in (side.distances, side.lod95))
        figures = f"of those assessed median distance {in_words(median, 1)} mm, lod95 {in_words(lod, 1)} mm"
    cause = f"of its {int(inside.sum())} vertices deeper than 20 mm: {told}; {figures}"
    return Row("hollow of 40 mm, 0.3 m wide", "found" if is_found else "missed", judge(is_found), "", "found",
               cause="" if is_found else cause)  # fmt: skip


NOTES = (
    "Through the command line, PTX files, all settings automatic. Reduced: a window of 4 x 3 m at 20 mm instead of the "
    "whole reef."
)
