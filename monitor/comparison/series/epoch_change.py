"""One epoch of a series: its name, its date, and its comparison with the reference epoch of all."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np

from projects.model import ComparedSurface, Comparison, Floats, Ints, NotAssessed


@dataclass(frozen=True)
class EpochChange:
    """One epoch against the reference: its name, date, and comparison."""

    epoch_id: str
    date: datetime.date
    comparison: Comparison

    @property
    def side(self) -> ComparedSurface:
        """The change on the reference surface."""
        return self.comparison.on_reference

    @property
    def came(self) -> Ints:
        """The numbers of the regions that came as a whole: most of what stands there was looked through before."""
        later = self.comparison.on_compared
        number, n = later.changed_region, len(self.comparison.regions) + 1
        n_through = np.bincount(number[later.reasons == NotAssessed.LOOKED_THROUGH], minlength=n)
        return np.setdiff1d(np.flatnonzero(2 * n_through > np.bincount(number, minlength=n)), [0])

    @property
    def choices(self) -> Floats:
        """What noise alone had added to the mean change of each region [m], by its number; entry 0 is of no region.
        Comparisons of older versions do not tell."""
        shapes = self.comparison.statistics.get("region_shapes", [])
        out = np.zeros(max([0, *(int(s["region"]) for s in shapes)]) + 1)
        for s in shapes:
            out[int(s["region"])] = float(s.get("choice_m", 0.0))
        return np.append(out, np.zeros(max(len(self.comparison.regions) + 1 - len(out), 0)))

    @property
    def places(self) -> Ints:
        """The region (n,) that each vertex of the reference surface lies in, 0 for none: where it has changed, and
        what is buried under what came as a whole, which alone says where that stands."""
        side = self.side
        return np.where(side.is_changed | np.isin(side.region, self.came), side.region, 0).astype(np.int32)
