"""Rigid transforms: a motion about a point, there and back."""

import numpy as np
import pytest

from projects.transforms import apply, invert, motion_about, perturb, rows_of_inverse, undone_motion

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


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4, 0.3, np.pi / 2, 3.0])
def test_what_a_transform_errs_by_is_carried_over_to_its_inverse(rng: np.random.Generator, turn: float) -> None:
    axis = rng.normal(size=3)
    T = perturb(np.eye(4), np.zeros(3), np.array([*turn * axis / np.linalg.norm(axis), 0.5, -1.0, 2.0]))
    centre, rows = np.array([1.0, -2.0, 0.5]), rows_of_inverse(T)
    for k in range(6):
        delta = 1e-6 * np.eye(6)[k]
        ahead, behind = (motion_about(invert(perturb(T, centre, s * delta)), centre) for s in (1.0, -1.0))
        assert rows[:, k] == pytest.approx((ahead - behind) / 2e-6, abs=1e-7)


def test_a_quarter_turn_exchanges_how_well_x_and_y_are_known() -> None:
    quarter = perturb(np.eye(4), np.zeros(3), np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]))
    undone = undone_motion(quarter, np.diag([1e-4, 1e-4, 1e-5, 1e-3, 1e-4, 2e-4]) ** 2, FAR)
    assert np.sqrt(np.diag(undone.covariance))[2:] == pytest.approx([1e-5, 1e-4, 1e-3, 2e-4])
    assert undone.vector == pytest.approx(motion_about(invert(quarter), FAR))
