"""How thick a body comes out of which no station sees two opposite faces, and how well that is known.

A pedestal of flat faces, each of which two of four stations all around see, as `chips` places them. Nothing but edges,
mouldings and the top holds a face against the opposite one. One adjustment of filtered scans a draw, by shape alone;
the poses are registered to 0.2 mm. Truths are the stations' true poses.
"""

from __future__ import annotations

from typing import NamedTuple

import chips
import numpy as np
from network_of_caps import small_motion
from rows import Row, Size, judge

from monitor.filtering import filter_scan
from monitor.registration.network.adjustment import adjust_scans
from monitor.simulation import INSTRUMENTS, simulate_scan, window_around
from projects.model import Floats, PointCloud
from projects.transforms import apply, invert

TITLE = "Opposite faces that no station sees together: how thick a pedestal comes out"
LIMIT = 3000.0
N_DRAWS: dict[Size, int] = {"small": 1, "full": 16}
FACES = ((0, (0, 1), (2, 3)), (1, (1, 2), (3, 0)))  # axis, the stations that see the face there, and the opposite one


class Thickness(NamedTuple):
    """How far [m] a die is too thick along both axes (2,), as given and as adjusted, and one sigma of the latter."""

    given: Floats
    left: Floats
    sigma: Floats


def run(size: Size) -> list[Row]:
    """Adjust so many draws, and hold how thick the die comes out against what is stated of it."""
    found = [adjust_pedestal(seed) for seed in range(N_DRAWS[size])]
    given, left, stated, z = (
        float(np.sqrt(np.mean(np.square(values))))
        for values in zip(*((f.given, f.left, f.sigma, f.left / f.sigma) for f in found), strict=True)
    )
    return [
        Row("thickness of the die, mm rms", f"{1e3 * left:.3f}", judge(left <= given),
            asked=f"no more than as given, {1e3 * given:.3f}", value=1e3 * left),
        Row("one sigma stated of it, mm rms", f"{1e3 * stated:.3f}", value=1e3 * stated),
        Row(f"error over sigma, rms of {2 * len(found)}", f"{z:.2f}", value=z),
    ]  # fmt: skip


def adjust_pedestal(seed: int) -> Thickness:
    """Return how thick the pedestal of one draw comes out."""
    clouds, errors = zip(*(scan_pedestal(seed, k) for k in range(4)), strict=True)
    found = adjust_scans(list(clouds))
    rows = rows_of_thickness(found.centres)
    left = [M @ E for M, E in zip(found.motions, errors, strict=True)]
    as_given, as_left = (
        rows @ np.concatenate([small_motion(E, centre) for E, centre in zip(those, found.centres, strict=True)])
        for those in (errors, left)
    )
    return Thickness(as_given, as_left, np.sqrt(np.einsum("ij,jk,ik->i", rows, found.joint_covariance, rows)))


def scan_pedestal(seed: int, k: int) -> tuple[PointCloud, Floats]:
    """Return the filtered scan of one station where it is registered, and by what motion (4, 4) that is wrong."""
    station = chips.stations_of(seed)[k]
    pose, registered = station.T_project_scanner, station.registered
    assert registered is not None  # as `chips` makes them
    window = window_around(chips.BOX, pose, margin=0.01)
    scan = simulate_scan(chips.scene_of(0), INSTRUMENTS["phase-2020"], pose, window,
                         step=station.step, seed=1000 * seed + k, registered=registered)  # fmt: skip
    places = apply(registered, scan.cloud.points)
    is_inside = ((places > chips.BOX[0]) & (places < chips.BOX[1])).all(axis=1)
    return filter_scan(scan.take(is_inside)), registered @ invert(pose)


def rows_of_thickness(centres: Floats) -> Floats:
    """Return what (w, t) of each scan about its centre (4, 3) adds to the thickness along both axes (2, 24)."""
    rows = np.zeros((2, 4, 6))
    for axis, before, behind in FACES:
        normal = np.eye(3)[axis]
        for sign, stations in ((1.0, before), (-1.0, behind)):
            place = sign * chips.DIE_HALF_WIDTH * normal + [0.0, 0.0, 0.5 * sum(chips.DIE)]
            for k in stations:
                rows[axis, k] += 0.5 * sign * np.hstack([np.cross(place - centres[k], normal), normal])
    return rows.reshape(2, 24)


NOTES = (
    "The die is 0.33 m thick; sigma is of the adjustment's joint covariance. No bar is asked for but to be no worse."
)
