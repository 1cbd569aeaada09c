"""Lengths in messages keep two digits at every scale."""

import numpy as np
import pytest

from monitor.comparison.regions.shapes import name_region
from monitor.lengths import in_millimetres
from monitor.registration.motion.rivals import Rival


@pytest.mark.parametrize(
    ("metres", "text"),
    [
        (3.46e-5, "0.035 mm"),
        (2.44e-3, "2.4 mm"),
        (0.0996, "100 mm"),
        (1.5, "1500 mm"),
        (-4e-7, "-0.00040 mm"),
        (0.0, "0 mm"),
    ],
)
def test_millimetres_have_two_digits_and_no_exponent(metres: float, text: str) -> None:
    assert in_millimetres(metres) == text


def test_a_chip_of_less_than_a_millimetre_has_a_size_in_its_name() -> None:
    assert name_region("lost", np.array([0.00084, 0.00036, 0.0])) == "lost, 0.84 mm by 0.36 mm"
    assert name_region("lost", np.array([0.24, 0.036, 0.0])) == "lost, 240 mm by 36 mm"


def test_another_pose_of_a_small_thing_is_told_with_how_far_off_it_is() -> None:
    rival = Rival(np.eye(4), 0.00042, "slide", here=0.97, there=0.96, telling=0.02)
    assert "fit 0.42 mm off" in rival.describe()
