"""Meshes whose faces do not hang together, or look the other way: refused with the reason."""

import numpy as np
import pytest
import trimesh

from monitor.registration import register
from monitor.registration.epochs import register_epochs
from projects.errors import RegistrationError
from projects.model import Surface


def test_faces_that_do_not_hang_together_are_refused_with_the_reason(rng):
    """All corners lay on free edges, none was left to compare, and the search by shape ended in an error of ours."""
    ball = trimesh.creation.icosphere(6, 0.5)
    whole = Surface(np.array(ball.vertices), np.array(ball.faces))
    corners = whole.vertices[whole.faces].reshape(-1, 3)
    loose = Surface(corners + rng.normal(0.0, 5e-4, corners.shape), np.arange(len(corners)).reshape(-1, 3))
    with pytest.raises(RegistrationError, match=r"^0 and 40962 usable points .* its faces do not hang together"):
        register_epochs(loose, whole)


def test_a_surface_inside_out_is_refused_with_the_reason(rng):
    """It was told only that little of it found a surface that looks the same way."""
    ball = trimesh.creation.icosphere(5, 0.5)
    vertices = np.array(ball.vertices) * (1.0 + 0.05 * np.sin(9.0 * ball.vertices[:, :1]))
    whole = Surface(vertices, np.array(ball.faces))
    moved = Surface(vertices + rng.normal(0.0, 1e-4, vertices.shape), whole.faces[:, ::-1])
    said = register(moved, whole)
    assert not said.converged
    assert "one that looks the opposite way: one of the two is inside out, or a back side" in said.reason
    apart = register(Surface(vertices + np.array([5.0, 0.0, 0.0]), whole.faces), whole)
    assert "opposite" not in apart.reason
