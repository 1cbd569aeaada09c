"""A body seen from all around, then from one side: what happened beside the limb does not run over the far side."""

import numpy as np
import pytest
import trimesh

from monitor.comparison import compare
from projects.model import Registration, Surface

RADIUS, GAIN, STANDS_OFF, NOISE = 0.1, 1e-3, 1.5e-3, 2e-5  # m
PLACE = np.array([1.0, 0.0, 0.12]) / np.hypot(1.0, 0.12)  # of the gain, its middle a centimetre before the limb


def ball(rng: np.random.Generator, gain: float = 0.0) -> Surface:
    """Return a closed ball with noise and, about `PLACE`, a round layer of `gain` [m] that runs out at 3 cm."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    unit = np.asarray(mesh.vertices) / RADIUS
    away = RADIUS * np.arccos(np.clip(unit @ PLACE, -1.0, 1.0)) / 0.03
    height = gain * np.clip(1.5 * (1.0 - away**2), 0.0, 1.0) + rng.normal(0.0, NOISE, len(unit))
    return Surface(unit * (RADIUS + height[:, None]), np.asarray(mesh.faces), sigma=np.full(len(unit), NOISE))


def near_side(surface: Surface) -> Surface:
    """Return what is seen of a ball from above, its last two rows of vertices `STANDS_OFF` too high, as the ends of
    surfaces are where beams graze them."""
    unit = surface.vertices / np.linalg.norm(surface.vertices, axis=1)[:, None]
    row = 1.2 * RADIUS * np.sqrt(4.0 * np.pi / len(unit))
    lift = STANDS_OFF * (RADIUS * unit[:, 2] < 1.5 * row)
    kept = (unit[:, 2] > 0.0)[surface.faces].all(axis=1)
    used, corners = np.unique(surface.faces[kept], return_inverse=True)
    vertices = (surface.vertices + lift[:, None] * unit)[used]
    return Surface(vertices, corners.reshape(-1, 3), sigma=surface.sigma[used])


@pytest.mark.parametrize("swapped", [False, True])
def test_a_change_beside_the_limb_stays_there(rng: np.random.Generator, swapped: bool) -> None:
    """It ran along the end of the later surface and took all of the far side, 72 mm under the near one."""
    whole, part = ball(rng), near_side(ball(rng, GAIN))
    reference, compared = (part, whole) if swapped else (whole, part)
    still = Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, np.zeros(3), True,
                         is_stable=np.ones(len(compared.vertices), dtype=bool), stable_share=1.0)  # fmt: skip
    found = compare(reference, compared, still)
    assert len(found.regions) == 1
    region = found.regions.iloc[0]
    sign = -1.0 if swapped else 1.0
    assert region["extreme_m"] == pytest.approx(sign * GAIN, abs=0.1 * GAIN)  # part of it lies under the limb's rows
    for side in (found.on_reference, found.on_compared):
        taken = side.surface.vertices[side.region > 0]
        assert (np.linalg.norm(taken - RADIUS * PLACE, axis=1) < 0.035).all()
