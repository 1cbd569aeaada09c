"""One sheet behind another that look the same way, of which nothing joins the two: the floor of a crack, a background.

Walls between them were not seen. Each sheet is there up to its samples, and nothing hangs in the air before the other.
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


@pytest.mark.parametrize("cells", [5.0, 7.0, 9.0])
def test_a_background_and_what_stands_before_it_are_there_up_to_the_step(
    rng: np.random.Generator, cells: float
) -> None:
    """Strips of up to 11 mm on both sides of such a step, points 2 mm apart, had no surface."""
    spacing = 0.002
    depth = cells * 1.5 * spacing
    result = reconstruct_with_record(relief(rng, spacing, 0.12, lambda x, y: np.where(x > 0.0, -depth, 0.0)))
    assert result.counts["points_without_surface"] == 0
    vertices = inner(result, 0.05)
    assert vertices[vertices[:, 2] < -0.9 * depth, 0].min() < 1.5 * spacing
    assert vertices[vertices[:, 2] > -0.1 * depth, 0].max() > -1.5 * spacing


@pytest.mark.parametrize(("width", "depth"), [(0.008, 0.010), (0.012, 0.015), (0.012, 0.025)])
def test_the_floor_of_a_crack_is_there_and_its_mouth_is_open(rng, width: float, depth: float) -> None:
    """The mouth was closed, as a gap of the samples is, and the floor had no surface."""
    crack = relief(rng, 0.001, 0.08, lambda x, y: np.where((np.abs(x) < width / 2) & (np.abs(y) < 0.03), -depth, 0.0))
    result = reconstruct_with_record(crack)
    assert result.counts["points_without_surface"] < 0.15 * np.count_nonzero(crack.points[:, 2] < -depth / 2)
    vertices = inner(result, 0.025)
    over = vertices[np.abs(vertices[:, 0]) < width / 4, 2]
    assert np.mean(over < -0.9 * depth) > 0.9
    assert np.mean(over > -0.1 * depth) < 0.1


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
