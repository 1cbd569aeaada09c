"""The demo's carved figure in two epochs: before and after, their meshes, their truth and what changed between them.

`carved_figure` gives the figure as it stands in an epoch; `true_changes` what happened between the first and the
second. The second epoch is also moved as a whole (`motion`): it was put back a little off.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from monitor.simulation.changes import Edit, break_off, erode, hollow_out
from monitor.simulation.heads import HEAD
from monitor.simulation.model import only_near
from monitor.simulation.pedestal import DIE, DIE_HALF_WIDTH, HEIGHT, PANEL_DEPTH, pedestal_part
from monitor.simulation.scenes import Body, Truth
from monitor.simulation.shield import shield_corner
from monitor.simulation.solid import Field, Solid, contour
from monitor.simulation.statue import statue_parts
from monitor.simulation.true_change import TrueChange, measure_change
from monitor.simulation.truth import truth_of
from projects.model import Floats
from projects.transforms import rotation_from_vector

REFLECTANCE = 0.55  # light limestone in the near infrared; assumed


@dataclass(frozen=True)
class CarvedFigure:
    """The figure in one epoch, standing on z = 0 about the origin, its front towards -y (before any motion)."""

    body: Body
    field: Field
    truth: Truth


@functools.cache
def intact_figure() -> Solid:
    """Return the whole figure on its pedestal as carved."""
    return Solid((pedestal_part(), *statue_parts()))


def spall() -> Edit:
    """Return the hollow in the left panel of the pedestal that the first epoch has and the second has filled."""
    face = -(DIE_HALF_WIDTH - PANEL_DEPTH)
    centre = np.array([face - 0.092, 0.018, 0.5 * (DIE[0] + DIE[1]) - 0.006])
    return hollow_out("filled hollow in the left panel", centre, np.array([0.100, 0.100, 0.072]))


def lost_corner() -> Edit:
    """Return the loss of the shield's outer upper corner."""
    corner = shield_corner()
    box = np.stack([corner - 0.055, corner + 0.045])
    return break_off(
        "broken corner of the shield", corner + np.array([-0.010, 0.0, -0.017]), np.array([0.45, -0.62, 0.64]), box=box
    )


def worn_patch() -> Edit:
    """Return the wear of the robe over the free knee's thigh."""
    centre = np.array([-0.33, -0.70, 3.15]) * HEAD + [0.0, 0.0, HEIGHT]
    worn = erode("worn patch on the robe", centre, radius=0.082, depth=0.0022)
    return dataclasses.replace(worn, kind="lowered")


def motion() -> Floats:
    """Return T_second_first: the figure was put back 3 mm aside, 2 mm forward, 1 mm higher and turned 0.3 degrees."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_vector(np.radians([0.06, -0.04, 0.30]))
    T[:3, 3] = [0.0030, -0.0020, 0.0010]
    return T


def figure_field(epoch: int) -> Field:
    """Return the field of the figure in epoch 1 or 2, both in the frame of epoch 1."""
    whole = intact_figure()
    if epoch == 1:
        return only_near(spall(), whole)
    return only_near(worn_patch(), only_near(lost_corner(), whole))


def carved_figure(epoch: int, *, cell: float = 0.0025) -> CarvedFigure:
    """Return the figure of epoch 1 or 2 in the frame of epoch 1, its mesh of triangles about `cell` [m] long."""
    field = figure_field(epoch)
    vertices, faces = contour(field, intact_figure().bounds(), cell=cell)
    body = Body("figure", vertices, faces, REFLECTANCE)
    return CarvedFigure(body, field, truth_of(field, body.surface()))


def true_changes() -> tuple[TrueChange, ...]:
    """Return what changed from the first epoch to the second, the motion of the whole apart."""
    before, after = figure_field(1), figure_field(2)
    return tuple(measure_change(edit.name, before, after, edit.box) for edit in (lost_corner(), spall(), worn_patch()))
