"""What a comparison found, vertex by vertex: the test of its patches, and what it says of each vertex of both sides."""

from __future__ import annotations

from dataclasses import dataclass

from monitor.comparison.detection.patches import Layout
from monitor.comparison.detection.reaches import Reaches
from monitor.comparison.detection.units import Units
from monitor.comparison.noise.model import Masks, Noise
from monitor.comparison.noise.patch_errors import PatchErrors
from monitor.comparison.noise.scan_errors import ScanErrors
from projects.model import Bools, Floats


@dataclass(frozen=True)
class Tested:
    """The units of both sides, the `reaches` of their patches, what these say of each unit, and by what measure.

    `p_gained`, `p_lost` (u,) of each side: smallest p value of a unit's patches above and below zero; `limit`, the
    largest p value that is significant (0: none is); `size` [m] of a unit; `errors` of each size of patch, smallest
    first, and of their `scans`; `n_tested` patches in all; `p_values` (p, s) of them on each side; `lies_beyond` (u,)
    of each side, units that lie farther off zero than the rest; `far`, by how many levels of detection no vertex lies
    off zero by chance; `level`, the share of false discoveries that is held; `is_whole` (u,) of each side, units
    that are no scraps.
    """

    units: tuple[Units, Units]
    reaches: tuple[Reaches, Reaches]
    p_gained: tuple[Floats, Floats]
    p_lost: tuple[Floats, Floats]
    limit: float
    size: float
    errors: tuple[PatchErrors, ...]
    scans: ScanErrors
    n_tested: int
    p_values: tuple[Floats, Floats]
    lies_beyond: tuple[Bools, Bools]
    far: float
    level: float
    is_whole: tuple[Bools, Bools]


@dataclass(frozen=True)
class Detection:
    """One side's answer: `lod95` [m]; `mean` [m] of the change around each vertex; `smooth` [m], the same with its
    steps kept, and `smooth_lod95` [m] of it; `is_changed`."""

    lod95: Floats
    mean: Floats
    smooth: Floats
    smooth_lod95: Floats
    is_changed: Bools


@dataclass(frozen=True)
class Detected:
    """The answer for both sides (reference, compared), the noise, the test that it rests on, its patches, and which
    vertices the noise was learned from."""

    sides: tuple[Detection, Detection]
    noise: Noise
    test: Tested
    layout: Layout
    calm: Masks
