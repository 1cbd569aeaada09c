"""A piece of pipe before a wall: little area by itself, bent where all the rest is flat."""

import numpy as np


def pipe_before_wall(rng, noise=0.0015):
    """Points 10 mm apart on a wall of 1.5 m and on the front of a piece of pipe 0.4 m long and 100 mm across, 30 mm
    before it, with normals; which of them lie on the pipe. The wall behind the pipe is in its shade."""
    wall = np.c_[rng.uniform(-0.75, 0.75, (22_500, 2)), np.zeros(22_500)]
    wall = wall[(np.abs(wall[:, 0]) > 0.06) | (np.abs(wall[:, 1]) > 0.2)]
    angle, along = rng.uniform(-1.5, 1.5, 600), rng.uniform(-0.2, 0.2, 600)
    round_ = np.c_[np.sin(angle), 0.0 * angle, np.cos(angle)]
    pipe = np.c_[0.0 * along, along, 0.0 * along + 0.08] + 0.05 * round_
    normals = np.r_[np.tile([0.0, 0.0, 1.0], (len(wall), 1)), round_]
    points = np.r_[wall, pipe] + noise * rng.normal(size=(len(normals), 1)) * normals
    normals = normals + np.where(normals[:, 2:] == 1.0, 0.01, 0.1) * rng.normal(size=normals.shape)
    return points, normals / np.linalg.norm(normals, axis=1)[:, None], np.arange(len(points)) >= len(wall)
