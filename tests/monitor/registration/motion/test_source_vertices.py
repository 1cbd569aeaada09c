"""What pairs of a registration say of the vertices of its source."""

import numpy as np
import pytest

from monitor.registration.motion.sides import prepare_side
from monitor.registration.motion.source_vertices import spread_to_vertices, spread_weights
from projects.model import PointCloud


def test_a_patch_shares_its_weight_out_among_its_points(rng: np.random.Generator) -> None:
    """Ten points, one of them not usable; of two patches one holds a single point, and a third pair lies in none."""
    points = rng.uniform(-0.1, 0.1, (11, 3))
    points[4] = np.nan
    side = prepare_side(PointCloud(points, normals=np.tile([0.0, 0.0, 1.0], (11, 1))), np.zeros(3))
    of_source = np.where(side.index == 7, 31, 12)
    numbers, weights = np.array([12, 31, 12, 99]), np.array([1.0, 3.0, 2.0, 50.0])
    shares = spread_weights(side, of_source, numbers, weights, 11)
    assert shares[4] == 0.0
    assert shares[7] == pytest.approx(0.5)
    assert np.delete(shares, [4, 7]) == pytest.approx(np.full(9, 0.5 / 9.0))
    is_stable = spread_to_vertices(side, of_source, np.array([31]), 11)
    assert np.flatnonzero(is_stable).tolist() == [7]
