"""Hands and faces as sculptors carve them, for every figure of the laboratory, in units of its head's height.

Fields: coordinates p (3, n) in, distance-like values (n,) out, negative inside.
"""

from __future__ import annotations

import numpy as np

from monitor.simulation.shapes import ball, capsule, ellipsoid
from monitor.simulation.solid import Field, join_blended, smooth_max, smooth_min
from projects.model import Floats


def carve_hand(wrist: Floats, towards: Floats, palm: Floats, curl: float) -> Field:
    """Return a hand: a palm from the wrist `towards` its fingers, facing `palm`, the fingers curled by `curl` rad."""
    forward = towards / np.linalg.norm(towards)
    inward = palm - forward * (palm @ forward)
    inward = inward / np.linalg.norm(inward)
    across = np.cross(forward, inward)
    knuckles = wrist + 0.34 * forward
    pieces: list[tuple[Field, float]] = [(capsule(wrist, wrist + 0.10 * forward, 0.085, 0.095), 0.0)]
    for k in range(4):
        base = knuckles + across * (0.075 * (k - 1.5)) - 0.02 * abs(k - 1.2) * forward
        pieces.append((capsule(wrist + 0.08 * forward + across * (0.05 * (k - 1.5)), base, 0.058, 0.052), 0.05))
        at, heading = base, 0.25 * curl
        for length, radius in ((0.17, 0.046), (0.12, 0.041), (0.09, 0.036)):
            step = length * (np.cos(heading) * forward + np.sin(heading) * inward)
            pieces.append((capsule(at, at + step, radius + 0.003, radius), 0.012))
            at, heading = at + step, heading + curl
    thumb = wrist + 0.13 * forward - 0.10 * across + 0.03 * inward
    middle = thumb + 0.16 * forward - 0.05 * across + 0.09 * inward
    pieces.append((capsule(wrist + 0.05 * forward - 0.04 * across, thumb, 0.07, 0.058), 0.05))
    pieces.append((capsule(thumb, middle, 0.054, 0.046), 0.015))
    pieces.append((capsule(middle, middle + 0.11 * forward + 0.07 * inward + 0.03 * across, 0.045, 0.036), 0.012))
    return join_blended(pieces)


def carve_face(p: Floats) -> Floats:
    """The face and skull; origin at the base of the skull, the face towards -y, its chin at z = 0.14."""
    x = np.abs(p[0])
    m = np.stack([x, p[1], p[2]])
    skull = ellipsoid((0.0, 0.07, 0.72), (0.335, 0.415, 0.38))(p)
    value = smooth_min(skull, ellipsoid((0.0, -0.17, 0.50), (0.262, 0.27, 0.37))(p), 0.12)
    value = smooth_min(value, ellipsoid((0.0, -0.335, 0.215), (0.10, 0.085, 0.075))(p), 0.09)  # chin
    value = smooth_min(value, ball((0.155, -0.315, 0.475), 0.085)(m), 0.10)  # cheek
    socket = ellipsoid((0.125, -0.455, 0.615), (0.092, 0.060, 0.050))(m)
    value = smooth_max(value, -socket, 0.05)
    value = smooth_min(value, capsule((0.045, -0.425, 0.680), (0.175, -0.385, 0.690), 0.024, 0.020)(m), 0.035)  # brow
    eye = ellipsoid((0.125, -0.368, 0.612), (0.068, 0.062, 0.050))(m)
    value = smooth_min(value, eye, 0.008)
    for lift, sink in ((0.034, -0.002), (-0.031, 0.004)):
        lid = capsule((0.070, -0.410 + sink, 0.612 + 0.55 * lift), (0.125, -0.425 + sink, 0.612 + lift), 0.011)(m)
        lid = np.minimum(lid, capsule((0.125, -0.425 + sink, 0.612 + lift), (0.190, -0.375, 0.606), 0.011, 0.008)(m))
        value = smooth_min(value, lid, 0.010)
    bridge = capsule((0.0, -0.420, 0.665), (0.0, -0.520, 0.475), 0.034, 0.044)(p)
    value = smooth_min(value, bridge, 0.035)
    value = smooth_min(value, ball((0.0, -0.535, 0.462), 0.036)(p), 0.02)
    value = smooth_min(value, ball((0.045, -0.470, 0.452), 0.030)(m), 0.018)  # nostril wing
    value = smooth_max(value, -capsule((0.022, -0.50, 0.428), (0.030, -0.475, 0.440), 0.011)(m), 0.008)
    upper = capsule((0.0, -0.452, 0.352), (0.085, -0.405, 0.343), 0.024, 0.010)(m)
    lower = capsule((0.0, -0.446, 0.312), (0.070, -0.408, 0.330), 0.027, 0.012)(m)
    value = smooth_min(value, upper, 0.014)
    value = smooth_min(value, lower, 0.014)
    value = smooth_max(value, -capsule((0.0, -0.482, 0.334), (0.090, -0.420, 0.338), 0.006)(m), 0.008)
    return smooth_max(value, -capsule((0.0, -0.470, 0.392), (0.0, -0.462, 0.375), 0.008)(p), 0.012)  # philtrum
