"""The mouth of a crack is open where its floor was seen through it; a gap before what is solid is closed.

The walls of the crack were not seen.
"""

from __future__ import annotations

import numpy as np
import pytest

from monitor.reconstruction import reconstruct_with_record
from monitor.reconstruction.surface import ReconstructionResult
from projects.model import Floats, PointCloud

NOISE = 2e-4  # m
UP = np.array([0.0, 0.0, 1.0])


def relief(rng: np.random.Generator, spacing: float, extent: float, heights) -> PointCloud:
    """Return points at random over a square about the origin, as high [m] as `heights` of x and y says; all look up."""
    x, y = rng.uniform(-extent / 2, extent / 2, (2, round((extent / spacing) ** 2)))
    z = heights(x, y) + rng.normal(0.0, NOISE, len(x))
    return PointCloud(np.column_stack([x, y, z]), normals=np.tile(UP, (len(x), 1)))


def inner(result: ReconstructionResult, half: float) -> Floats:
    """Return the vertices (n, 3) m within `half` [m] of the middle along y."""
    vertices = result.surface.vertices
    return vertices[np.abs(vertices[:, 1]) < half]


@pytest.mark.parametrize(("width", "depth"), [(0.007, 0.025), (0.009, 0.025)])
def test_the_mouth_of_a_crack_is_open_where_its_floor_was_seen(rng, width: float, depth: float) -> None:
    """It was closed, as a gap of the samples is."""
    crack = relief(rng, 0.001, 0.08, lambda x, y: np.where((np.abs(x) < width / 2) & (np.abs(y) < 0.03), -depth, 0.0))
    result = reconstruct_with_record(crack)
    vertices = inner(result, 0.025)
    over = vertices[np.abs(vertices[:, 0]) < 0.001, 2]
    assert np.count_nonzero(over > -0.1 * depth) < 0.1 * np.count_nonzero(over < -0.9 * depth)
    assert result.counts["faces_over_openings"] > 0


@pytest.mark.parametrize("behind", ["nothing", "the back of the plate"])
def test_a_gap_of_the_samples_before_what_is_solid_is_closed(rng: np.random.Generator, behind: str) -> None:
    front = relief(rng, 0.001, 0.05, lambda x, y: 0.0 * x)
    front = front.take(np.flatnonzero(np.hypot(*front.points[:, :2].T) > 0.003))
    if behind != "nothing":
        back = relief(rng, 0.001, 0.05, lambda x, y: 0.0 * x - 0.012)
        front = PointCloud(np.vstack([front.points, back.points]), normals=np.vstack([front.normals, -back.normals]))
    result = reconstruct_with_record(front)
    assert result.counts["faces_over_openings"] == 0
    vertices = result.surface.vertices
    assert (np.hypot(*vertices[vertices[:, 2] > -0.006, :2].T) < 0.0015).any()
