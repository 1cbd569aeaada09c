"""Absolute mode is the default only where control points hold both epochs."""

import datetime
from typing import Any, cast

import numpy as np
import pytest

from monitor.chain import default_mode
from projects import Project
from projects.model import ControlPoint, EpochRecord, Step


class Told:
    """A project of epochs "a", "b" with control points and a mesh with some; `found` (a, b) by their adjustments, and
    how sure [m] these are of the whole."""

    def __init__(self, *found: int, sigma: float = 2e-4) -> None:
        self.sigma = sigma
        self.found = dict(zip(("a", "b"), found, strict=False))

    def epoch(self, object_id: str, epoch_id: str) -> EpochRecord:
        control = (ControlPoint("P1", np.zeros(3)),)
        return EpochRecord(object_id, epoch_id, datetime.date(2024, 1, 1), control=control, is_mesh=epoch_id == "mesh")

    def latest(self, _: str, epoch_id: str, product: str) -> Step | None:
        n = self.found.get(epoch_id)
        return (
            None if n is None else Step("n" * 16, product, automatic={"n_control": n, "sigma_position_m": self.sigma})
        )


def mode(told: Any, reference_id: str, compared_id: str) -> str:
    return default_mode(cast(Project, told), "o", reference_id, compared_id)


@pytest.mark.parametrize(("found", "told"), [((3, 3), "absolute"), ((3, 0), "relative"), ((0, 3), "relative")])
def test_control_that_no_scan_saw_holds_nothing(found: tuple[int, int], told: str) -> None:
    assert mode(Told(*found), "a", "b") == told


def test_control_points_about_which_the_whole_may_turn_do_not_hold_it() -> None:
    """An unmoved ball with two control points an epoch was absolute by default, and had nine regions of change."""
    assert mode(Told(2, 2, sigma=np.nan), "a", "b") == "relative"


def test_scans_without_an_adjustment_stand_as_their_control_says_and_a_mesh_does_not() -> None:
    assert mode(Told(), "a", "b") == "absolute"
    assert mode(Told(3), "a", "mesh") == "relative"
