"""Rigid transforms: a motion about a point, there and back."""

import numpy as np
import pytest

from projects.transforms import apply, invert, motion_about, perturb

FAR = np.array([6e5, 5e6, 100.0])


def test_the_motion_of_a_transform_is_the_one_that_makes_it(rng: np.random.Generator) -> None:
    for size in (1e-6, 1e-2, 2.0):
        delta = np.concatenate([size * rng.normal(size=3), rng.normal(size=3)])
        delta[:3] *= min(1.0, 3.0 / np.linalg.norm(delta[:3]))
        assert motion_about(perturb(np.eye(4), FAR, delta), FAR) == pytest.approx(delta, abs=1e-8)


def test_a_turn_about_one_point_shifts_another() -> None:
    quarter = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]))
    assert motion_about(quarter, np.array([1.0, 0.0, 0.0])) == pytest.approx([0, 0, np.pi / 2, -1, 1, 0])
    assert apply(invert(quarter), apply(quarter, FAR)) == pytest.approx(FAR)
