"""One station scanned many times (paper 003): repeated scans that share their grid, with a slow drift between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from monitor.declare import check_settings, setting
from monitor.simulation.instruments import Instrument
from monitor.simulation.scanner import Window, simulate_scan
from monitor.simulation.scenes import Scene
from projects.errors import ParameterError
from projects.model import Floats, Scan


@dataclass(frozen=True, kw_only=True)
class Drift:
    """By how much an instrument's readings move from one scan to the next, steadily, also while it scans."""

    range_rate: float = setting(0.0, unit="m", meaning="of the range, per scan; positive: later scans read longer")
    azimuth_rate: float = setting(0.0, unit="rad", meaning="of the true azimuth against the one recorded, per scan")
    elevation_rate: float = setting(0.0, unit="rad", meaning="of the true elevation against the recorded, per scan")

    def __post_init__(self) -> None:
        check_settings(self)


def drift_of_paper_003() -> Drift:
    """Return the drift that paper 003, section 3.1, suspects.

    Its instrument showed 0.4 mm (one sigma) when one point was measured 20 times and 0.8 mm over 100 repeated
    profiles, "which might derive from ... a drift effect". If all of the difference is a steady drift, that is
    sqrt(12 * (0.8**2 - 0.4**2)) = 2.4 mm over 100 repetitions, 24 micrometres each. For the angles it says nothing: 0.
    """
    return Drift(range_rate=24e-6)


def repeat_scan(
    scene: Scene, instrument: Instrument, T_project_scanner: Floats, window: Window, *, n_scans: int,
    drift: Drift | None = None, step: float | None = None, seed: int = 0, n_subrays: int = 9,
    registered: Floats | None = None, name: str = "scan", n_threads: int = 2,
) -> Iterator[Scan]:  # fmt: skip
    """Yield `n_scans` scans of one station one after the other, each with noise of its own on the same grid.

    Row and column name the same nominal direction in all of them, so they can be averaged cell by cell. Parameters
    as in `simulate_scan`; `drift` None means none.
    """
    if n_scans < 1:
        raise ParameterError(f"n_scans = {n_scans}: at least one scan is needed")
    drift = Drift() if drift is None else drift
    rates = np.array([drift.range_rate, drift.azimuth_rate, drift.elevation_rate])
    for k in range(n_scans):
        yield simulate_scan(
            scene, instrument, T_project_scanner, window, step=step, seed=(seed, k), n_subrays=n_subrays,
            registered=registered, name=f"{name} {k + 1}", drift=np.stack([k * rates, (k + 1) * rates]),
            n_threads=n_threads,
        )  # fmt: skip
