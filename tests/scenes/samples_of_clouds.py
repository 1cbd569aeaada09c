"""Clouds as the surface's fits take them: how they sample a surface, and their points for fits of one radius."""

import numpy as np

from monitor.reconstruction.cell_size import Sampling, measure_and_sort, tree_of_points
from monitor.reconstruction.moments import level_of_points
from monitor.reconstruction.projection import Samples
from projects.model import Floats, PointCloud


def measure_sampling(cloud: PointCloud) -> Sampling:
    """Return spacing and noise of a cloud that has normals."""
    return measure_and_sort(cloud, tree_of_points(cloud.points))[0]


def samples_at(points: Floats, normals: Floats, radius: float, noise: float) -> Samples:
    """Return the points for fits within one radius (m), none summed up."""
    return Samples([level_of_points(points, normals, radius)], np.array([radius]), float(noise))
