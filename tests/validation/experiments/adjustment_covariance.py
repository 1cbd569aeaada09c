"""Is the true pose of each scan of one adjustment where its covariance says that it is?

Four scans of a bumpy ball, whose noise neighbours share over 30 mm, fitted by their shape alone and with targets and
control points; and bodies 0.3 m wide under the simulated scanner, seen from four or three stations all around that are
registered with 0.1 to 0.3 mm, filtered as the chain does it. There all scans can move outward together and still fit,
so this common motion is told apart; three share only what they see at 60 degrees and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from network_of_caps import simulate_network, small_motion
from no_change_pairs import make_body, spread_stations
from registration_covariance import share_row
from rows import Row, Size, judge

from monitor.filtering import filter_scan
from monitor.registration.network.adjustment import Adjustment, adjust_scans
from monitor.simulation import INSTRUMENTS, simulate_scan, window_around
from projects.model import Floats
from projects.transforms import invert

TITLE = "Scans of one adjustment: true poses within the 95 % ellipsoid"
LIMIT = 3600.0
N_SIMULATED = {"small": 6, "full": 200}
N_RINGS = {"small": {4: 2, 3: 1}, "full": {4: 64, 3: 32}}  # by the number of stations
NUMBERS = {3: "three", 4: "four"}
REACH = 0.03  # m, over which neighbouring points of a scan err together
NOTES = (
    "Inside: share of scans whose true pose lies in the 95 % ellipsoid that is stated of it, with the 95 % interval of "
    "as many observations as there are adjustments, the scans of one counted as one. Outward: the mean way of the four "
    "scans towards their stations. Adjustments that leave the poses as given (they fit as well) state nothing and are "
    "counted apart."
)


class Ring(NamedTuple):
    """One adjustment around a body: squared errors (k,) of the scans by their covariance, the mean way of scans as
    given and left, the outward motion as given and left, and its sigma [m]."""

    squared: Floats
    way_given: float
    way_left: float
    outward_given: float
    outward_left: float
    sigma_outward: float
    is_applied: bool


def run(size: Size) -> list[Row]:
    """Adjust networks of many seeds."""
    n = N_SIMULATED[size]
    rows = []
    for is_absolute, what in ((False, "shape alone"), (True, "shape, targets and control")):
        squared = np.concatenate([simulate_network(seed, REACH, is_absolute=is_absolute)[0] for seed in range(n)])
        rows.append(share_row(f"bumpy ball, {what}", squared, n))
    for n_stations, n_rings in N_RINGS[size].items():
        rows += ring_rows([adjust_ring(seed, n_stations) for seed in range(n_rings)], NUMBERS[n_stations])
    return rows


def adjust_ring(seed: int, n_stations: int = 4) -> Ring:
    """Return how one ring of stations around a body comes out."""
    rng = np.random.default_rng([seed, 1])
    scene, instrument = make_body(seed), INSTRUMENTS[("phase-2020", "leica-hds6000")[seed % 2]]
    spacing = rng.uniform(0.003, 0.0045)
    clouds, errors, poses = [], [], []
    for k, (pose, registered) in enumerate(spread_stations(rng, n_stations)):
        scan = simulate_scan(scene, instrument, pose, window_around(scene.bounds(), pose, margin=0.01),
                             step=spacing / 1.9, seed=1000 * seed + k, registered=registered)  # fmt: skip
        clouds.append(filter_scan(scan))
        errors.append(registered @ invert(pose))
        poses.append(pose)
    return judge_ring(adjust_scans(clouds), errors, poses, np.array([c.points.mean(axis=0) for c in clouds]))


def judge_ring(found: Adjustment, errors: Sequence[Floats], poses: Sequence[Floats], middles: Floats) -> Ring:
    """Return errors against covariance, less the mean of all scans, which nothing holds."""
    outward = np.array([pose[:3, 3] / np.linalg.norm(pose[:3, 3]) for pose in poses])
    given = less_mean(errors, middles)
    left = less_mean([M @ E for M, E in zip(found.motions, errors, strict=True)], middles)
    ways = [float(np.sqrt(np.mean(np.sum(e[:, 3:] ** 2, axis=1)))) for e in (given, left)]
    ways += [float(np.mean(np.sum(e[:, 3:] * outward, axis=1))) for e in (given, left)]
    if not found.applied:
        return Ring(np.empty(0), *ways, float("nan"), False)
    squared = np.array([e @ np.linalg.solve(C, e) for e, C in zip(left, found.covariances, strict=True)])
    n = len(outward)
    along = np.hstack([np.zeros((n, 3)), outward / n]).ravel()
    return Ring(squared, *ways, float(np.sqrt(along @ found.joint_covariance @ along)), True)


def less_mean(errors: Sequence[Floats], middles: Floats) -> Floats:
    """Return (w, t) (n, 6) of each motion about its own middle, less the mean motion of all about the origin."""
    motions = np.array([small_motion(E, np.zeros(3)) for E in errors])
    motions -= motions.mean(axis=0)
    return np.hstack([motions[:, :3], motions[:, 3:] + np.cross(motions[:, :3], middles)])


def ring_rows(rings: Sequence[Ring], number: str) -> list[Row]:
    """Return the rows of the bodies under the scanner, seen from a `number` of stations."""
    moved, body = [r for r in rings if r.is_applied], f"body of 0.3 m, {number} stations"
    rows = [rms_row(f"{body}: way off", [r.way_given for r in rings], [r.way_left for r in rings]),
            rms_row(f"{body}: outward", [r.outward_given for r in rings], [r.outward_left for r in rings]),
            Row(f"{body}: adjustments that moved scans", f"{len(moved)} of {len(rings)}")]  # fmt: skip
    if not moved:
        return rows
    ratio = float(np.sqrt(np.mean([(r.outward_left / r.sigma_outward) ** 2 for r in moved])))
    squared = np.concatenate([r.squared for r in moved])
    return [*rows, Row(f"{body}: outward over its stated sigma, rms", f"{ratio:.2f}", value=ratio),
            share_row(body, squared, len(moved))]  # fmt: skip


def rms_row(what: str, as_given: Sequence[float], as_left: Sequence[float]) -> Row:
    """Return the row of a root mean square [m] over adjustments, which none may enlarge."""
    given, left = (1e3 * float(np.sqrt(np.mean(np.square(ways)))) for ways in (as_given, as_left))
    return Row(f"{what}, mm rms", f"{left:.3f}", judge(left <= given), asked=f"no more than as given, {given:.3f}",
               value=left)  # fmt: skip
