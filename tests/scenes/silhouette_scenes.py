"""Scenes with silhouettes, scanned by the simulated instrument, and which of the points no surface has."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.simulation import INSTRUMENTS, Body, Scene, simulate_scan, stand_at, window_around, without_errors
from monitor.simulation.scenes import make_box, sphere_scene
from projects.model import Scan
from projects.open3d_library import load_open3d
from projects.transforms import apply

INSTRUMENT = INSTRUMENTS["phase-2020"]
NEAR = 4.0  # beams: as far as a footprint reaches
STEEPEST = np.tan(np.radians(80.0))


class SilhouetteScan(NamedTuple):
    """A scan with the truth of each point.

    `away` (n,) beams to the nearest jump of range; `off` (n,) m, how far what the beam would give without noise lies
    from any surface; `on` (n,) index of the body nearest to that.
    """

    scan: Scan
    away: np.ndarray
    off: np.ndarray
    on: np.ndarray

    def mixed(self, sigma: float) -> np.ndarray:
        """Return the points (n,) beside a jump that even without noise lie farther than 3 sigma [m] off any surface.

        Beside nothing the spot may reach over a rim as well; such a point lies beyond it, but in its plane.
        """
        return (self.away <= NEAR) & (self.off > 3.0 * sigma)


def arm_before_chest() -> Scene:
    """Return a wall, a bar 40 mm thick, 30 to 250 mm before it, and a ball beside it."""
    wall = make_box("chest", np.array([-0.6, 0.0, -0.5]), np.array([0.6, 0.2, 0.5]))
    arm = make_box("arm", np.array([-0.4, -0.02, -0.02]), np.array([0.4, 0.02, 0.02]))
    turn, c, s = np.eye(4), np.cos(0.28), np.sin(0.28)
    turn[:2, :2], turn[:3, 3] = [[c, -s], [s, c]], [0.0, -0.17, 0.2]
    ball = sphere_scene(radius=0.08, n_rings=120).bodies[0]
    aside = np.eye(4)
    aside[:3, 3] = [0.1, -0.25, -0.2]
    return Scene("arm", (wall, arm.moved(turn), ball.moved(aside)))


def scan_scene(scene: Scene, step: float, seed: int = 3) -> SilhouetteScan:
    """Return a scan of a scene from 3.5 m before it, steps of `step` [rad], and its truth."""
    pose = stand_at(np.array([0.15, -3.5, 0.1]), facing=np.zeros(3))
    window = window_around(scene.bounds(), pose)
    scan = simulate_scan(scene, INSTRUMENT, pose, window, step=step, seed=seed)
    free = simulate_scan(scene, without_errors(INSTRUMENT), pose, window, step=step, seed=seed)
    place, free_place = (1_000_000 * s.rows.astype(np.int64) + s.columns for s in (scan, free))
    _, here, there = np.intersect1d(place, free_place, return_indices=True)
    scan, points = scan.take(here), free.cloud.points[there]
    off = np.array([distance_to(body, apply(scan.pose, points)) for body in scene.bodies])
    ranges = np.linalg.norm(points, axis=1)
    tree = cKDTree(points / ranges[:, None])
    jumps = np.ptp(ranges[tree.query(tree.data, 9)[1]], axis=1) > 3.0 * step * ranges * STEEPEST
    away = cKDTree(tree.data[jumps]).query(tree.data)[0] / step
    return SilhouetteScan(scan, away, off.min(axis=0), off.argmin(axis=0))


def distance_to(body: Body, points: np.ndarray) -> np.ndarray:
    """Return the distance (n,) [m] of points to a body's surface."""
    o3d = load_open3d()
    tree = o3d.t.geometry.RaycastingScene(nthreads=1)
    faces = o3d.core.Tensor(body.faces.astype(np.uint32))
    tree.add_triangles(o3d.core.Tensor(body.vertices.astype(np.float32)), faces)
    return tree.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy().astype(float)
