"""Parts that moved are told from wear, each with its six parameters."""

import numpy as np
import pytest
from body_with_parts import WAYS, N, shift_part
from bumpy_body import NOISE, noisy_cloud, unit
from scipy.spatial.transform import Rotation

from monitor.registration import register
from monitor.registration.parts import find_parts
from projects.errors import ParameterError
from projects.model import Floats, PointCloud
from projects.transforms import apply, invert, perturb


@pytest.fixture(scope="module")
def reference() -> PointCloud:
    return noisy_cloud(N, np.random.default_rng(1))


def test_two_parts_are_found_with_their_motions_and_nothing_else(reference: PointCloud) -> None:
    later = noisy_cloud(N, np.random.default_rng(2))
    later, knob, T_knob = shift_part(later, "knob")
    later, cap, T_cap = shift_part(later, "cap")
    found = find_parts(later, reference, register(later, reference))
    assert len(found.parts) == 2
    for members, T in ((knob, T_knob), (cap, T_cap)):
        number = np.bincount(found.part_of[members]).argmax()
        assert number > 0
        assert np.mean(found.part_of[members] == number) > 0.85
        assert np.mean(found.part_of[~members] == number) < 0.02
        part = found.parts[number - 1]
        truth = np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), apply(T, part.centre) - part.centre])
        sigma = np.sqrt(np.diag(part.covariance))
        assert (np.abs(part.motion - truth) < 4.0 * sigma + np.repeat([2e-4, 2e-5], 3)).all()
        assert sigma[3:].max() < NOISE
        back = apply(invert(perturb(np.eye(4), part.centre, part.motion)), later.points[members])
        left = back - apply(np.linalg.inv(T), later.points[members])
        assert np.sqrt((left**2).sum(axis=1).mean()) < 2.5e-4


@pytest.mark.parametrize(("half", "seed"), [(0.5, 3), (0.8, 4), (0.8, 5), (1.0, 3), (1.0, 4)])
def test_wear_and_growth_are_no_parts(reference: PointCloud, half: float, seed: int) -> None:
    towards = WAYS["knob"][0]

    def wear(d: Floats) -> Floats:
        angle = np.arccos(np.clip(d @ towards, -1.0, 1.0))
        return np.where(angle < half, -3e-3 * 0.5 * (1 + np.cos(np.pi * angle / half)), 0.0)

    worn = noisy_cloud(N, np.random.default_rng(seed), wear)
    assert find_parts(worn, reference, register(worn, reference)).parts == ()


@pytest.mark.parametrize(("shape", "seed"), [("blotchy", 3), ("blotchy", 4), ("uneven", 6), ("bowl", 6)])
def test_loss_of_uneven_depth_is_no_part(reference: PointCloud, shape: str, seed: int) -> None:
    """A motion fits patches of it, which end where it fits no more: half of it and more goes on beside them."""
    towards = WAYS["knob"][0]

    def loss(d: Floats) -> Floats:
        angle = np.arccos(np.clip(d @ towards, -1.0, 1.0))
        if shape == "bowl":
            return -3e-3 * np.exp(-0.5 * (angle / 0.4) ** 2)
        along = unit(np.cross(towards, [[0.0, 0.0, 1.0]]))[0]
        waves = {"blotchy": 0.8 * np.sin(2.7 * d[:, 1] + 1.0) * np.cos(2.1 * d[:, 2]),
                 "uneven": 0.6 * np.sin(9.0 * d @ along + 3.0 * d[:, 2])}[shape]  # fmt: skip
        return np.where(angle < 0.58, -3e-3 * (1.0 + waves), 0.0)

    worn = noisy_cloud(N, np.random.default_rng(seed), loss)
    assert find_parts(worn, reference, register(worn, reference)).parts == ()


def test_unchanged_body_has_no_parts(reference: PointCloud) -> None:
    again = noisy_cloud(N, np.random.default_rng(4))
    found = find_parts(again, reference, register(again, reference))
    assert found.parts == ()
    assert not found.part_of.any()


def test_flat_piece_pushed_in_is_not_called_a_motion_of_six_parameters(rng: np.random.Generator) -> None:
    """A tile within a plane may have slid anywhere: only its depth is known."""
    xy = rng.uniform(-0.3, 0.3, (2, N))
    wavy = 0.02 * np.sin(15 * xy[0]) * np.cos(13 * xy[1]) * (np.abs(xy[0]) > 0.12)
    flat = PointCloud(np.column_stack([*xy, wavy + rng.normal(0, NOISE, N)]))
    pushed = flat.points - np.outer((np.abs(xy) < 0.06).all(axis=0) * 3e-3, [0.0, 0.0, 1.0])
    found = find_parts(PointCloud(pushed), flat, register(PointCloud(pushed), flat))
    assert found.parts == ()


def test_errors_that_are_not_of_the_source_are_refused(reference: PointCloud) -> None:
    with pytest.raises(ParameterError, match=r"sigma has the shape \(10,\): give one for each of the source's 24000"):
        find_parts(reference, reference, register(reference, reference), sigma=np.ones(10))
