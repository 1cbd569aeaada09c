"""The reference instrument of paper 003: a light-section sensor that sees a few square decimetres from near by.

A laser plane is thrown from beside the camera and swept over the object; where the camera sees it, the triangle of
camera, laser and point gives the point. What only one of the two sees stays unknown (shadowing, section 1.2.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.bearings import directions_of
from monitor.declare import check_settings, setting
from monitor.simulation.scanner import Target, Window, cast, lay_grid
from monitor.simulation.scenes import Scene
from projects.errors import ParameterError
from projects.model import Floats, PointCloud, Scan
from projects.transforms import apply, rotate


@dataclass(frozen=True, kw_only=True)
class TriangulationSensor:
    """A laser light-section sensor. The range noise grows with the square of the range, as a triangle's height does.

    Defaults are those of the Konica-Minolta VI-910 as far as paper 003 states them: noise of "some ten micrometers"
    for light sections (section 1.2.1) at a point quality of "some tenth millimetres" (section 4.1), which includes
    what registering its views costs; ranges to "only 2 m"; resolution of the class, "0.12 mm for a 0.2 m field of
    view" (section 1.2.1, said of a Breuckmann optoTOP-HE). Not stated there, assumed: shortest range and base line,
    and that the noise holds at 1 m. The maker's data sheet was not at hand.
    """

    name: str = setting("Konica-Minolta VI910", unit="", meaning="name, written into the scans")
    noise_1m: float = setting(30e-6, unit="m", low=0.0, meaning="range noise at 1 m, one sigma")
    calibration_error: float = setting(0.0, unit="m", meaning="constant error of the range")
    base_line: float = setting(0.25, unit="m", low=1e-3, high=5.0, meaning="laser to camera, along the scanner's y")
    resolution: float = setting(0.12e-3, unit="m", low=1e-6, meaning="spacing of the points at the middle of the view")
    range_min: float = setting(0.5, unit="m", low=0.0, meaning="shortest range")
    range_max: float = setting(2.0, unit="m", low=0.0, meaning="longest range")
    incidence_max: float = setting(np.radians(80.0), unit="rad", low=0.0, high=1.5707, meaning="steepest view or light")

    def __post_init__(self) -> None:
        check_settings(self)


def scan_by_triangulation(
    scene: Scene, sensor: TriangulationSensor, T_project_scanner: Floats, window: Window, *, distance: float,
    seed: int = 0, name: str = "reference", n_threads: int = 2,
) -> Scan:  # fmt: skip
    """Return what a light-section sensor measures of a scene from one station, without a footprint.

    Parameters
    ----------
    T_project_scanner : (4, 4), of the camera, which looks along its x axis; the laser stands `base_line` along y.
    window : the view, in the camera's frame, at most 1 rad wide.
    distance : m, to the middle of the view, where the points lie `resolution` apart.

    Returns
    -------
    Scan, points (n, 3) [m] in the camera's frame, on a grid as `simulate_scan` gives it; `dropped` counts what met
    nothing or lay out of range ("no return") and what the laser did not reach or touched too steeply ("shadow").
    """
    if max(window.azimuth_max - window.azimuth_min, window.elevation_max - window.elevation_min) > 1.0:
        raise ParameterError(f"{window}: a light-section sensor sees 1 rad at most; give a narrower window")
    angles, row, column = lay_grid(window, sensor.resolution / distance)
    target, rng = Target.of(scene, n_threads), np.random.default_rng(seed)
    local = directions_of(angles[:, 0], angles[:, 1])
    directions, eye = rotate(T_project_scanner, local), T_project_scanner[:3, 3]
    hits = cast(target, _rays(np.broadcast_to(eye, directions.shape), directions), n_threads)
    ranges = hits.t[:, 0].astype(float)
    met = (ranges >= sensor.range_min) & (ranges <= sensor.range_max)
    laser = apply(T_project_scanner, np.array([[0.0, sensor.base_line, 0.0]]))[0]
    far = np.where(met, ranges, 1.0)
    points = eye + far[:, None] * directions
    towards = points - laser
    reach = np.linalg.norm(towards, axis=1)
    towards = towards / reach[:, None]
    lit = cast(target, _rays(np.broadcast_to(laser, towards.shape), towards), n_threads).t[:, 0]
    normals, steepest = hits.normals[:, 0], np.cos(sensor.incidence_max)
    seen = met & (lit > reach - 1e-4)
    for ray in (directions, towards):
        seen &= np.abs((ray * normals).sum(axis=1)) > steepest
    measured = far + sensor.calibration_error + sensor.noise_1m * far**2 * rng.normal(size=len(far))
    cloud = PointCloud(measured[seen, None] * local[seen], origins=np.zeros(3))
    dropped = {"no return": int((~met).sum()), "shadow": int((met & ~seen).sum())}
    return Scan(
        name, cloud, T_project_scanner, rows=row[seen], columns=column[seen], scanner=sensor.name, dropped=dropped
    )  # fmt: skip


def _rays(starts: Floats, directions: Floats) -> Floats:
    """Return rays (n, 1, 6) float32."""
    return np.concatenate([starts, directions], axis=1).astype(np.float32)[:, None]
