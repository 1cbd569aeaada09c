"""Parts that moved against material that came or went; the size and direction of a region."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from monitor.comparison import compare
from monitor.comparison.regions.moved import Sample, is_explained
from monitor.comparison.regions.shapes import principal_axes
from monitor.simulation.solid import contour
from projects.model import Comparison, Registration, Surface
from projects.transforms import rotation_from_vector

NOISE = 2e-5  # m


def plate_with_block(rng: np.random.Generator, shift: float, growth: float = 0.0) -> Surface:
    """Return a plate of 0.1 m with a block of 30 x 30 x 16 mm on it, moved by `shift`, longer by `growth` [m]."""

    def rounded(p: np.ndarray, half: list[float], edge: float) -> np.ndarray:
        q = np.abs(p) - np.array(half)[:, None] + edge
        return np.linalg.norm(np.maximum(q, 0.0), axis=0) + np.minimum(q.max(axis=0), 0.0) - edge

    def field(p: np.ndarray) -> np.ndarray:
        block = rounded(p - np.array([shift + 0.5 * growth, 0.0, 0.01])[:, None], [0.015 + 0.5 * growth, 0.015, 0.016],
                        0.003)  # fmt: skip
        return np.minimum(rounded(p, [0.05, 0.05, 0.01], 0.004), block)

    vertices, faces = contour(field, np.array([[-0.06, -0.06, -0.02], [0.06, 0.06, 0.04]]), cell=0.0015)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    noisy = vertices + normals * rng.normal(0, NOISE, (len(vertices), 1))
    return Surface(noisy, faces, sigma=np.full(len(vertices), NOISE))


def result_of(reference: Surface, compared: Surface) -> Comparison:
    n = len(compared.vertices)
    known = Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(n, dtype=bool))  # fmt: skip
    return compare(reference, compared, known)


def test_a_block_that_was_pushed_is_moved_and_one_that_grew_is_added(rng: np.random.Generator) -> None:
    before = plate_with_block(rng, 0.0)
    pushed = result_of(before, plate_with_block(rng, 0.002)).regions
    assert list(pushed.kind[:2]) == ["moved", "moved"]
    assert pushed.mean_m[0] * pushed.mean_m[1] < 0
    grown = result_of(before, plate_with_block(rng, 0.0, 0.002)).regions
    assert grown.kind[0] == "added"
    assert "moved" not in set(grown.kind)


def test_a_rigid_motion_is_told_from_another_change(rng: np.random.Generator) -> None:
    points = rng.normal(size=(300, 3)) * 0.01 + 5.0
    normals = rng.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    motion = (points - 5.0) @ (rotation_from_vector(np.array([0.02, 0.05, -0.03])) - np.eye(3)).T + [1e-3, 0.0, 2e-4]
    change = np.einsum("ij,ij->i", normals, motion)

    def both(change: np.ndarray) -> tuple[Sample, Sample]:
        lost = np.einsum("ij,ij->i", normals, motion) < 0.0
        a, b = (Sample(points[k], normals[k], change[k]) for k in (lost, ~lost))
        return a, b

    nothing = Sample(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    moved = both(change + rng.normal(0, 1e-5, 300))
    assert is_explained(moved, nothing)
    assert not is_explained(both(np.abs(change)), nothing)
    assert not is_explained(tuple(Sample(*(v[:3] for v in part)) for part in moved), nothing)  # type: ignore[arg-type]
    between = Sample(points, normals, change)
    assert is_explained(moved, between)
    assert not is_explained(moved, between._replace(change=np.zeros(300)))  # all of it stood still


def layers(rng: np.random.Generator, *patches: tuple[float, float, float]) -> Surface:
    """Return a sheet of 0.12 m with discs on it: where along x, their radius and their thickness [m]."""
    x, y = (g.ravel() for g in np.meshgrid(*2 * [np.arange(-50, 51) * 1.2e-3], indexing="ij"))
    z = rng.normal(0, NOISE, x.size)
    for centre, radius, thickness in patches:
        z[np.hypot(x - centre, y) < radius] += thickness
    i = np.arange(100 * 101).reshape(100, 101)[:, :-1].ravel()
    return Surface(np.column_stack([x, y, z]), np.vstack([np.c_[i, i + 101, i + 102], np.c_[i, i + 102, i + 1]]),
                   sigma=np.full(x.size, NOISE))  # fmt: skip


@pytest.mark.parametrize(
    ("patches", "kinds"),
    [
        (((-0.022, 0.011, 3e-4), (0.022, 0.011, -3e-4)), ["cleaned", "coated"]),
        (((-0.012, 0.010, -2e-3), (0.010, 0.008, 2e-4)), ["coated", "lost"]),
    ],
)
def test_layers_that_came_and_went_side_by_side_are_no_part_that_moved(
    rng: np.random.Generator, patches: tuple[tuple[float, float, float], ...], kinds: list[str]
) -> None:
    """A tilt explains two layers but for what lies between them, and a deep loss all but for what lies beside it."""
    assert sorted(result_of(layers(rng), layers(rng, *patches)).regions.kind) == kinds


def test_principal_directions_of_a_strip_are_its_own() -> None:
    turn = rotation_from_vector(np.array([0.3, -0.4, 0.5]))
    x, y = np.meshgrid(np.linspace(0, 0.08, 41), np.linspace(0, 0.03, 16))
    axes, extents = principal_axes(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]) @ turn.T, np.ones(x.size))
    np.testing.assert_allclose(extents, [0.08, 0.03, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(axes @ turn), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("depth", [0.002])
def test_the_summary_names_each_region_with_its_size(rng: np.random.Generator, depth: float) -> None:
    result = result_of(plate_with_block(rng, 0.0), plate_with_block(rng, 0.0, depth))
    shape = result.statistics["region_shapes"][0]
    assert shape["region"] == 1
    assert shape["name"].startswith("added, ")
    assert shape["length_m"] == pytest.approx(0.030, abs=0.003)  # the block's end: 30 mm, and 16 mm above the plate
    assert shape["width_m"] == pytest.approx(0.016, abs=0.003)
    assert abs(shape["along"][1]) > 0.95
