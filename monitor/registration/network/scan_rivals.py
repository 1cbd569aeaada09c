"""Scans of an epoch that fit as well elsewhere: a step, a period or a flute further along the others.

In: scans where an adjustment put them. Out: which of them would fit as well elsewhere, and whether the poses as given
tell. A scan that sees another part of the object fits more of the others once it slides onto them, so that more in
common is no reason against a pose as it is between epochs: refused is what was moved nearly as far as its rival lies.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.registration.motion.alignment import AlignmentRules
from monitor.registration.motion.matching import MatchLimits, Samples, match
from monitor.registration.motion.rivals import TELLING, find_rival
from monitor.registration.motion.self_likeness import Fit
from monitor.registration.motion.sides import Side
from monitor.registration.network.overlaps import FEWEST_PAIRS, Overlaps
from monitor.robust import robust_scale
from projects.model import Floats, Ints
from projects.transforms import apply, rotate

MOST_POINTS = 100_000  # of all scans together, that tell where one of them could lie
ANGLE = np.radians(45.0)
REACH_SPACINGS = 4.0
ROUNDING = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class ScanRival:
    """What speaks against the pose of a scan, in `words`, and whether the pose as given is no help (`is_ambiguous`)."""

    scan: int
    is_ambiguous: bool
    words: str


def find_scan_rivals(overlaps: Overlaps, motions: Sequence[Floats], held: Collection[int]) -> list[ScanRival]:
    """Return the scans that fit as well elsewhere among the others.

    Parameters
    ----------
    overlaps, motions : the scans, and where they were put, T_common_given (4, 4) each.
    held : scans whose targets or control tell where they are.
    """
    everything, scan_of = _join(overlaps, motions)
    free = [k for k in range(len(motions)) if k not in held]
    rivals = [_rival_of(k, overlaps.samples[k], everything.take(scan_of != k), motions) for k in free]
    return [rival for rival in rivals if rival is not None]


def _join(overlaps: Overlaps, motions: Sequence[Floats]) -> tuple[Side, Ints]:
    """Return points of all scans in the common frame as one side, and which scan each is of."""
    step = max(sum(len(side) for side in overlaps.sides) // MOST_POINTS, 1)
    chosen = [np.arange(0, len(side), step) for side in overlaps.sides]
    points = [apply(T, s.points[c]) for T, s, c in zip(motions, overlaps.sides, chosen, strict=True)]
    normals = [rotate(T, s.normals_of(c)) for T, s, c in zip(motions, overlaps.sides, chosen, strict=True)]
    scan_of = np.repeat(np.arange(len(chosen)), [len(c) for c in chosen])
    return Side(np.concatenate(points), np.concatenate(normals), None, np.arange(len(scan_of))), scan_of


def _rival_of(k: int, samples: Samples, others: Side, motions: Sequence[Floats]) -> ScanRival | None:
    """Return what speaks against the pose of scan k, None where nothing does or it shares too little."""
    reach = REACH_SPACINGS * float(np.median(others.spacing_of(np.arange(0, len(others), max(len(others) // 500, 1)))))
    rules = AlignmentRules(reach, ANGLE, FEWEST_PAIRS, 1e-6, 1)
    samples = replace(samples, sigma=np.zeros(len(samples.points)))
    matches = match(samples, others, motions[k], MatchLimits(reach, 0.0, ANGLE), True)
    if len(matches) < FEWEST_PAIRS:
        return None
    sigma = max(robust_scale(matches.residuals), ROUNDING * reach)  # copies miss each other by nothing
    rival = find_rival(Fit(samples, others, motions[k], matches, sigma, rules, True))
    if rival is None:
        return None
    given = np.mean([apply(T, samples.points) for j, T in enumerate(motions) if j != k], axis=0)
    here, there = (_rms(apply(T, samples.points) - given) for T in (motions[k], rival.T_target_source))
    return ScanRival(k, there <= TELLING * here, f"scan {k + 1} fits the others as well elsewhere: {rival.describe()}")


def _rms(ways: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(ways**2, axis=1))))
