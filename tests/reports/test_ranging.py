"""What the report says of a range calibration, from records as the chain keeps them."""

import datetime

import numpy as np
import pytest

from projects.model import EpochRecord, Step
from reports.history import EpochHistory
from reports.ranging import draw_calibration, gather_calibrations


class Kept:
    """A project that holds one profile for each calibration."""

    def get(self, object_id, epoch_id, product, step_id):
        return {"profile": np.full((3, 3), float(product[-3:]))}


def history(*applied):
    """Return an epoch with a calibration of each scan, applied or not."""
    found = {"amplitudes": [1.6e-3, 0.8e-3], "n_patches": 12, "mad_before": 1e-3, "mad_after": 0.4e-3}
    steps = [
        Step(f"s{k}", f"calibration{k:03d}", {"name": f"room{k}.ptx"}, automatic={**found, "is_applied": is_applied})
        for k, is_applied in enumerate(applied)
    ]
    return EpochHistory(EpochRecord("o", "e", datetime.date(2026, 5, 1)), (Step("r", "raw"), *steps))


def test_the_first_corrected_scan_is_told_with_its_figures():
    (told,) = gather_calibrations(Kept(), "o", history(False, True, True))
    assert told.profile[0, 0] == 1.0
    for words in (
        "room1.ptx",
        "12 plane patches",
        "1.6 mm, 0.80 mm",
        "1.0 mm before and 0.40 mm after",
        "1 other scan was corrected likewise.",
    ):
        assert words in told.text


@pytest.mark.parametrize("epoch", [history(), history(False, False)])
def test_where_nothing_was_corrected_nothing_is_told(epoch):
    assert gather_calibrations(Kept(), "o", epoch) == ()


def test_the_drawing_is_the_same_every_time_and_small(rng):
    ranges = np.sort(rng.uniform(2, 5, 4000))
    profile = np.c_[ranges, 1e-3 * np.sin(2 * np.pi * ranges / 0.6), rng.normal(0, 1e-4, 4000)]
    drawn = draw_calibration(profile)
    assert drawn == draw_calibration(profile.copy())
    assert drawn.startswith(b"<?xml")
    assert len(drawn) < 200_000
