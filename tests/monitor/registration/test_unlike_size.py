"""Epochs of which one is in another unit, or has no scale: refused with how much larger it is."""

import numpy as np
import pytest
import trimesh

from monitor.registration.epochs import register_epochs
from projects.model import Surface


def body(scale: float, rng: np.random.Generator) -> Surface:
    """Return an uneven ball of half a metre, its coordinates times a scale, with 0.1 mm of noise."""
    ball = trimesh.creation.icosphere(4, 0.5)
    vertices = np.array(ball.vertices) * (1.0 + 0.05 * np.sin(9.0 * ball.vertices[:, :1]))
    return Surface(scale * (vertices + rng.normal(0.0, 1e-4, vertices.shape)) + 3.0, np.array(ball.faces))


@pytest.mark.parametrize(("scale", "told"), [(1.0 / 0.3048, "3.28 times as large"), (0.1, "0.1 times as large")])
def test_another_scale_is_told_with_the_refusal(rng, scale, told):
    found, _ = register_epochs(body(scale, rng), body(1.0, rng))
    assert not found.converged
    assert f"the compared epoch is {told} as the reference: is it in another unit or scale?" in found.reason


def test_epochs_of_one_size_are_not_asked_for_their_unit(rng):
    sheet = Surface(np.c_[rng.uniform(-0.7, 0.7, (300, 2)), np.zeros(300)], np.arange(300).reshape(-1, 3))
    found, _ = register_epochs(sheet, body(1.0, rng))
    assert not found.converged
    assert "times as large" not in found.reason
