"""Sigma of vertices where the points around state none, or only some do."""

from types import SimpleNamespace

import numpy as np

from monitor.reconstruction.surface import vertex_sigma
from projects.model import PointCloud

NAN = float("nan")


def test_points_that_state_nothing_say_nothing_and_not_that_there_is_no_noise() -> None:
    cloud = PointCloud(np.zeros((4, 3)), sigma=np.array([2e-3, NAN, NAN, NAN]))
    index = np.array([[0, 1, 2, 3], [1, 2, 3, 1]])  # one of four states something, none does
    fits = SimpleNamespace(sigma=np.array([1e-4, 1e-4]), scatter=np.array([1e-3, 1e-3]), n_support=np.array([50, 50]))
    np.testing.assert_allclose(vertex_sigma(fits, cloud, index), [2e-4, 1e-4], rtol=1e-12)
