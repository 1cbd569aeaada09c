"""Meshes whose faces do not hang together: refused with the reason."""

import numpy as np
import pytest
import trimesh

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
