"""Scenes with silhouettes, scanned by the simulated instrument, and how far each point lies from any surface."""

import dataclasses

import numpy as np

from monitor.simulation import INSTRUMENTS, Body, Scene, simulate_scan, stand_at, window_around
from monitor.simulation.scenes import make_box, sphere_scene
from projects.open3d_library import load_open3d
from projects.transforms import apply


def arm_before_chest() -> Scene:
    """Return a bar 40 mm thick, 30 to 250 mm before a wall, and a ball beside it."""
    wall = make_box("chest", np.array([-0.6, 0.0, -0.5]), np.array([0.6, 0.2, 0.5]))
    arm = make_box("arm", np.array([-0.4, -0.02, -0.02]), np.array([0.4, 0.02, 0.02]))
    turn, c, s = np.eye(4), np.cos(0.28), np.sin(0.28)
    turn[:2, :2], turn[:3, 3] = [[c, -s], [s, c]], [0.0, -0.17, 0.2]
    ball = sphere_scene(radius=0.08, n_rings=120).bodies[0]
    aside = np.eye(4)
    aside[:3, 3] = [0.1, -0.25, -0.2]
    return Scene("arm", (wall, arm.moved(turn), ball.moved(aside)))


def scan_scene(scene: Scene, name: str = "phase-2020", step: float = 6e-4, seed: int = 3, **changes):
    """Return a scan of a scene from 3.5 m before it, and the distance [m] of each of its points to any surface."""
    instrument = dataclasses.replace(INSTRUMENTS[name], **changes)
    pose = stand_at(np.array([0.15, -3.5, 0.1]), facing=np.zeros(3))
    scan = simulate_scan(scene, instrument, pose, window_around(scene.bounds(), pose), step=step, seed=seed)
    return scan, distance_to_bodies(scene.bodies, apply(scan.pose, scan.cloud.points))


def distance_to_bodies(bodies: tuple[Body, ...], points: np.ndarray) -> np.ndarray:
    """Return the distance (n,) [m] of points to the nearest of the bodies' surfaces."""
    o3d = load_open3d()
    tree = o3d.t.geometry.RaycastingScene(nthreads=1)
    for body in bodies:
        faces = o3d.core.Tensor(body.faces.astype(np.uint32))
        tree.add_triangles(o3d.core.Tensor(body.vertices.astype(np.float32)), faces)
    return tree.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy().astype(float)
