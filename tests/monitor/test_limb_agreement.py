"""What a scan saw past a limb errs by what overlaps show of it, though the scan's own normals pass for flatter."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.quality import assess_scans
from projects.model import Floats, PointCloud, Surface

STEP = 0.02  # m between points
GRAZING, SURE = 2e-3, 2e-4  # m, what patches of the grazing scan and of the others err by
CUBE = 10.0 * STEP


def plate(x_from: float, x_to: float, step: float) -> Floats:
    """Return the points of a plate z = 0, 1.6 m wide."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(x_from, x_to, step), np.arange(0.0, 1.6, step), indexing="ij"))
    return np.column_stack([x, y, np.zeros(len(x))])


def surface() -> Surface:
    """Return the plate from -1 to 3 m, with its normals."""
    points = plate(-1.0, 3.0 + 1e-9, 0.1)
    i = np.arange(len(points)).reshape(-1, 16)
    a, b, c, d = (g.ravel() for g in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Surface(points, faces.astype(np.int32), normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)))


def scan(rng: np.random.Generator, x: tuple[float, float], degrees: float, seems: float, sigma: float) -> PointCloud:
    """Return a scan of the plate from so many degrees of incidence, whose own normals make it seem another angle; its
    patches err by `sigma` [m] each."""
    points = plate(*x, STEP) + 1e-3
    cell = np.floor((points - [-1.0, 0.0, 0.0]) / CUBE).astype(int)
    points[:, 2] = rng.normal(0.0, sigma, (40, 40))[cell[:, 0], cell[:, 1]]
    tilt = np.radians(degrees - seems)
    normals = np.tile([np.sin(tilt), 0.0, np.cos(tilt)], (len(points), 1))
    way = np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    origin = np.array([1.0, 0.8, 0.0]) + 500.0 * way  # so far that all beams are alike
    return PointCloud(points, normals=normals, origins=origin, spacing=np.full(len(points), STEP))


def test_a_grazing_scan_whose_normals_pass_for_flatter_is_as_unsure_where_it_is_alone(rng: np.random.Generator) -> None:
    past_limb = scan(rng, (0.0, 3.0), 87.0, 67.0, GRAZING)
    honest = [scan(rng, (-1.0, 2.0), 67.0, 67.0, SURE), scan(rng, (0.0, 2.0), 66.0, 66.0, SURE),
              scan(rng, (0.0, 2.0), 20.0, 20.0, SURE)]  # fmt: skip
    plane = surface()
    sigma = assess_scans(plane, [past_limb, *honest]).sigma
    x = plane.vertices[:, 0]
    inner = (plane.vertices[:, 1] > 0.3) & (plane.vertices[:, 1] < 1.3)
    alone, flat = inner & (x > 2.3) & (x < 2.8), inner & (x > -0.8) & (x < -0.3)
    assert np.sqrt(np.mean(sigma[alone] ** 2)) == pytest.approx(GRAZING, rel=0.3)  # by its own normals 1.0 mm
    assert np.sqrt(np.mean(sigma[flat] ** 2)) == pytest.approx(SURE, rel=0.5)  # the same 1.0 mm
