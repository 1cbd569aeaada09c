"""The colours of change: range, signs, states, and whether people with colour-blind eyes can tell them apart."""

from dataclasses import replace

import numpy as np
import pytest
from small_comparison import DEPTH, LEVEL, make_comparison

from projects.model import Assessment
from reports.colours import (
    COARSE,
    NOT_ASSESSABLE,
    UNCHANGED,
    change_ramp,
    change_range,
    choose_limit,
    round_up,
    vertex_colours,
)

# Machado, Oliveira, Fernandes 2009, severity 1.0, for linear light
DEUTERANOPIA = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
PROTANOPIA = [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
TRITANOPIA = [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]


def linear(colours):
    c = np.asarray(colours, dtype=float) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(light):
    """Return CIE L*a*b* (D65) of linear sRGB light."""
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = np.clip(light, 0, 1) @ matrix.T / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def test_range_is_the_round_number_above_nearly_all_changed_values():
    size = np.linspace(0.0005, 0.0043, 2001)  # its 99.5 % quantile is 4.28 mm
    distances = np.where(np.arange(2001) % 2, size, -size)
    level = np.full(2001, 0.0004)
    assert change_range(distances, level) == pytest.approx(0.005)
    assert change_range(-distances, level) == change_range(distances, level)
    assert change_range(np.append(distances, 0.4), np.append(level, 0.0004)) == pytest.approx(0.005)  # one outlier
    assert change_range(np.append(distances, np.nan), np.append(level, np.nan)) == pytest.approx(0.005)


def test_range_does_not_look_at_what_is_below_the_level_of_detection():
    level = np.full(3, 0.002)
    assert change_range(np.array([0.001, -0.0019, 0.0005]), level) == pytest.approx(0.004)  # twice the level
    assert change_range(np.array([0.001, -0.0019, 0.0101]), level) == pytest.approx(0.015)


def test_range_is_a_millimetre_where_nothing_is_known():
    assert change_range(np.full(4, np.nan), np.full(4, np.nan)) == 1e-3


@pytest.mark.parametrize(("value", "rounded"), [(0.0101, 0.015), (0.01, 0.01), (0.00031, 0.0004), (7.0, 8.0), (9, 10)])
def test_rounding_goes_up_to_the_next_step(value, rounded):
    assert round_up(value) == pytest.approx(rounded, rel=1e-12)


def test_limit_of_a_comparison_covers_both_signs():
    assert choose_limit(make_comparison(60)) == pytest.approx(DEPTH)


def test_vertices_have_the_colour_of_their_state_and_sign():
    side = make_comparison(60).on_compared
    colours = vertex_colours(side, DEPTH).astype(int)
    assert colours.shape == (len(side.surface.vertices), 3)
    assert (colours[side.assessment == Assessment.UNCHANGED] == UNCHANGED).all()
    assert (colours[side.assessment == Assessment.NOT_ASSESSABLE] == NOT_ASSESSABLE).all()
    gained, lost = colours[side.region == 1], colours[side.region == 2]
    assert (gained[:, 2] > gained[:, 0] + 40).all()  # blue
    assert (lost[:, 0] > lost[:, 2] + 40).all()  # red


def test_vertices_that_tell_only_large_changes_are_darker():
    side = make_comparison(60).on_compared
    top = side.surface.vertices[:, 2] > 0.05
    known = replace(side, told_from=np.where(top, 5 * LEVEL, LEVEL), coarse_from=4 * LEVEL)
    colours = vertex_colours(known, DEPTH)
    is_coarse = top & (side.assessment == Assessment.UNCHANGED)
    assert (colours[is_coarse] == COARSE).all()
    assert (colours[~is_coarse] == vertex_colours(side, DEPTH)[~is_coarse]).all()
    grey, darker, unknown = (lab(linear(np.array([c])))[0] for c in (UNCHANGED, COARSE, NOT_ASSESSABLE))
    assert min(np.linalg.norm(darker - grey), np.linalg.norm(darker - unknown)) > 8.0  # 2.3 can just be seen


def test_ramps_darken_with_the_change_and_end_at_the_limit():
    size = np.linspace(0.001, 1.0, 101)
    for sign in (-1, 1):
        lightness = lab(linear(change_ramp(sign * size, 1.0)))[:, 0]
        assert (np.diff(lightness) < 0).all()
    np.testing.assert_array_equal(change_ramp(np.array([1.0, 7.0]), 1.0)[0], change_ramp(np.array([7.0]), 1.0)[0])


@pytest.mark.parametrize("eye", [np.eye(3), DEUTERANOPIA, PROTANOPIA, TRITANOPIA])
def test_signs_and_grey_can_be_told_apart_by_every_eye(eye):
    size = np.linspace(0.0, 1.0, 41)
    seen = [lab(linear(c) @ np.array(eye).T) for c in (change_ramp(-size - 1e-9, 1.0), change_ramp(size, 1.0),
                                                       np.array([UNCHANGED]))]  # fmt: skip
    for one, other in ((0, 1), (0, 2), (1, 2)):
        apart = np.linalg.norm(seen[one][:, None] - seen[other][None], axis=-1)
        assert apart.min() > 10.0  # a difference of 2.3 can just be seen
