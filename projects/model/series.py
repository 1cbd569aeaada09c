"""What goes on over several epochs: rates at each vertex, regions that are followed, motions of the whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from projects.arrays import Floats, Ints, hold_array

SERIES_COLUMNS = ("identity", "first_seen", "last_seen", "parent", "merged_into", "area_m2", "model",
                  "rate_m_per_year", "sigma_rate_m_per_year", "p_rate", "acceleration_m_per_year2",
                  "sigma_acceleration_m_per_year2", "p_acceleration", "p_onset", "onset_from_years", "onset_to_years",
                  "p_fit", "x", "y", "z", "found_by", "volume_rate_m3_per_year",
                  "sigma_volume_rate_m3_per_year")  # fmt: skip
HISTORY_COLUMNS = ("identity", "epoch", "years", "region", "event", "mean_m", "sigma_mean_m", "change_m3",
                   "sigma_change_m3", "area_m2", "sigma_area_m2")  # fmt: skip
FORECAST_COLUMNS = ("identity", "years", "mean_m", "sigma_m")
MOTION_COLUMNS = ("epoch", "years", "shift_m", "sigma_shift_m", "turn_rad", "sigma_turn_rad", "probability_unmoved",
                  "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m")  # fmt: skip
CLOSURE_COLUMNS = ("reference", "compared", "misfit_sigma")


@dataclass(frozen=True)
class Series:
    """What goes on over several epochs, on the surface of their reference epoch.

    `reference_id` and `reference_date` (ISO) name that epoch; `epoch_ids`, `dates` (ISO) and `years` (k,) since then
    are of the epochs compared with it. Over the n vertices of the reference surface: `rate`, `sigma_rate` [m/year],
    `acceleration`, `sigma_acceleration` [m/year2], NaN where unknown, positive = gained, and `identity`, the followed
    region (0: none). `regions` (`SERIES_COLUMNS`) has a row for each followed region, `history` (`HISTORY_COLUMNS`) one
    for each of them in each epoch, measured over its whole footprint: `change_m3` is the volume of the bodies that
    the epoch's comparison found there, and of prisms beside them; of all of it where it found none, mean change times
    area, as much larger as bodies are than prisms in the epoch nearest in size. `mean_m` is along perpendiculars, which
    fall short of the depth where a change is deep for its width; `model`, its p values and the rate of the volume are
    of the volumes. `area_m2` is that of the epoch's own region, NaN where it has none: whether a place spreads shows
    there. Of a region `found_by` its "trend" no single epoch
    shows anything, and `first_seen` and `last_seen` are empty; others were found by "epochs", or "both". `forecast`
    (`FORECAST_COLUMNS`) says for regions with a trend which mean difference an epoch at a time should show if it goes
    on as before. `motions` (`MOTION_COLUMNS`) says how the object stood as a whole in each epoch against the first,
    from one adjustment of all registrations, its `probability_unmoved` NaN where it is not known how far the frames of
    both may differ, `closures` (`CLOSURE_COLUMNS`) how well each of them fits it; empty where there was no such
    network.
    `rate_assessment` (n,) is the `Assessment` of each vertex's rate: CHANGED where it is significant, with false
    discoveries held over the surface and over patches of every size, so that one vertex's rate over its sigma does not
    decide; NOT_ASSESSABLE where fewer than two epochs tell one; None where an older program left it open.
    `rate_told_from` (n,) float32 [m/year], NaN where not assessed, is from about how large a rate on one is told, of a
    place as wide as errors agree, in 19 of 20 cases; more where surfaces guess what lies between their points. It and
    its figures are NaN all over where not all surfaces state their noise, as finished meshes do not.
    `statistics` hold its median (`told_from_median_m_per_year`), beyond how large a rate a place that tells none
    smaller is coarse (`coarse_from_m_per_year`), which share of the assessed area is (`coarse_area_share`), and from
    how large a rate on nearly all of that tells one (`coarse_told_from_m_per_year`); empty of older programs.
    Where it is known how far the frames of the first and two more epochs may be off, they hold as `steady_motion` how
    the object moves on as a whole: `rate` (6,) of (w, t) about `centre` [rad/year, m/year], its `covariance`, all
    lists, arrays of older programs, by how many `epochs`, and how often chance makes as much of an object at rest
    (`p_rate`; `p_turn`, `p_shift`) or leaves as much of one that moves steadily (`p_fit`).
    As `doubts`, where there are any, they hold a list of what speaks against how an `epoch` lies on the first (`of`
    "pose"), or how its scans lie on each other ("scans"): the `doubt` in words.
    """

    reference_id: str
    reference_date: str
    epoch_ids: tuple[str, ...]
    dates: tuple[str, ...]
    years: Floats
    rate: Floats
    sigma_rate: Floats
    acceleration: Floats
    sigma_acceleration: Floats
    identity: Ints
    regions: pd.DataFrame
    history: pd.DataFrame
    forecast: pd.DataFrame
    motions: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(MOTION_COLUMNS)))
    closures: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(CLOSURE_COLUMNS)))
    rate_assessment: NDArray[np.uint8] | None = None
    rate_told_from: Floats | None = None
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "epoch_ids", tuple(self.epoch_ids))
        object.__setattr__(self, "dates", tuple(self.dates))
        hold_array(self, "years", (len(self.dates),), np.float64)
        n = len(np.atleast_1d(self.rate))
        for name in ("rate", "sigma_rate", "acceleration", "sigma_acceleration"):
            hold_array(self, name, (n,), np.float64)
        hold_array(self, "identity", (n,), np.int32)
        hold_array(self, "rate_assessment", (n,), np.uint8)
        hold_array(self, "rate_told_from", (n,), np.float32)
