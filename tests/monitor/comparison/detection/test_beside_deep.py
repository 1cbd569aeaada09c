"""A faint change beside deep ones on a small object: patches that reach into what is deep do not hide it.

Balls whose noise is known, two pieces of which are gone or added, 20 mm deep, and a third place is worn by 0.3 mm.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from monitor.comparison import compare
from projects.model import Comparison, Floats, Registration, Surface

RADIUS, NOISE, WORN, EDGE = 0.15, 1e-4, 3e-4, 0.01  # m
WEAR = ((0.0, 0.0, 1.0), -WORN, 0.05)  # place, depth [m] and width [m]
DEEP = (((1.0, 0.0, 0.0), -0.02, 0.06), ((-1.0, 0.0, 0.3), 0.02, 0.06))


def shape(directions: Floats, changes: tuple) -> Floats:
    """Return the distances (n,) [m] of a ball's surface from its middle with some changes."""
    radii = np.full(len(directions), RADIUS)
    for place, depth, width in changes:
        along = RADIUS * np.arccos(np.clip(directions @ np.array(place) / np.linalg.norm(place), -1.0, 1.0))
        radii += depth * np.clip((0.5 * width + EDGE - along) / EDGE, 0.0, 1.0)
    return radii


def compared(seed: int, *changes: tuple, states_noise: bool = True) -> Comparison:
    """Compare a ball with itself after some changes; the registration is known."""
    rng, mesh = np.random.default_rng(seed), trimesh.creation.icosphere(subdivisions=5)
    d, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    sigma = np.full(len(d), NOISE) if states_noise else None
    known = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(len(d), dtype=bool))  # fmt: skip
    both = (Surface(d * (shape(d, those) + rng.normal(0.0, NOISE, len(d)))[:, None], faces, sigma=sigma)
            for those in ((), changes))  # fmt: skip
    return compare(*both, known)


def told_from(found: Comparison) -> float:
    """Return from how large a change [m] on one is told."""
    return float(found.statistics["told_by_width_m"][0][1])


@pytest.mark.parametrize("seed", range(2))
def test_what_is_told_beside_deep_changes_is_what_is_told_without(seed: int) -> None:
    assert told_from(compared(seed, *DEEP, WEAR)) == pytest.approx(told_from(compared(seed)), rel=0.25)


@pytest.mark.parametrize("states_noise", [True, False])
def test_a_faint_change_is_told_beside_deep_ones(states_noise: bool) -> None:
    found = compared(1, *DEEP, WEAR, states_noise=states_noise)
    assert len(found.regions) == 3
    worn = found.regions[found.regions["z"] > 0.9 * RADIUS].iloc[0]
    assert worn["mean_m"] == pytest.approx(-WORN, rel=0.25)
    assert worn["sigma_mean_m"] < 0.1 * WORN


def test_deep_changes_alone_have_no_other_beside_them() -> None:
    assert [len(compared(seed, *DEEP).regions) for seed in range(4)] == [2] * 4
