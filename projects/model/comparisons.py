"""What changed between two epochs: at each vertex of both surfaces, and as a table of regions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from projects.arrays import Bools, Floats, Ints
from projects.model.registrations import Registration
from projects.model.states import Assessment
from projects.model.surfaces import Surface

Z95 = 1.959963984540054  # sigmas, two-sided: 95 % of normal errors lie within


@dataclass(frozen=True)
class ComparedSurface:
    """One side of a comparison: a surface in the reference epoch's coordinates and the change at each vertex.

    `distances` [m], perpendicular to the other surface, are positive where material was gained, on both sides. Where
    the vertices of that surface have fitted normals and a sigma, it bows between the corners of a face as the normals
    say; to the flat face it is up to the bow more or less. `distances` and `lod95` [m] are NaN where `assessment` is
    NOT_ASSESSABLE, and `reasons` (`NotAssessed`) says why. Where a vertex is CHANGED because a scan of the other epoch
    looked through it (reason LOOKED_THROUGH), it is gone, or new, as a whole: `distances` is then that to the nearest
    point of the other surface in any direction, or, over a crack or another hollow too narrow for a surface, how deep
    the deepest of the points in it lies there; `lod95` is then the median of the side.
    `region` is 0 outside of regions. A region also holds vertices that are NOT_ASSESSABLE, where what hangs together
    with its changed vertices lies outside or inside of the other surface without a perpendicular, as a piece that broke
    off and its fracture do: its area is that of all of them, the mean of both sides, but of a piece that is gone, or
    came, as a whole that of its own surface, before a loss and after a gain. The fringe of a surface, where it goes on
    beyond its samples next to a free edge, is no area of it; its volume ends there, too.
    `told_from` [m] float32, NaN where not assessed, is from about how large a mean change of the place of a vertex, as
    wide as errors agree or less, on it is told, in 19 of 20 cases: what its patch needs to be significant among all
    patches, and more where the surfaces guess what lies between their points. Where it is more than `coarse_from` [m]
    "unchanged" says much less than on most of the surface. Both are NaN all over where not both surfaces state their
    noise, as finished meshes do not; None is of older programs: not known.
    """

    surface: Surface
    distances: Floats
    lod95: Floats
    assessment: NDArray[np.uint8]
    region: Ints
    reasons: NDArray[np.uint8]
    told_from: Floats | None = None
    coarse_from: float = float("nan")

    @property
    def is_coarse(self) -> Bools:
        """Which vertices (n,) are unchanged as far as can be told, where only much larger changes are told."""
        if self.told_from is None:
            return np.zeros(len(self.assessment), dtype=np.bool_)
        return np.asarray((self.assessment == Assessment.UNCHANGED) & (self.told_from > self.coarse_from))

    @property
    def is_changed(self) -> Bools:
        """Which vertices (n,) have changed."""
        return np.asarray(self.assessment == Assessment.CHANGED)

    @property
    def changed_region(self) -> Ints:
        """The region (n,) of each vertex that has changed, 0 elsewhere."""
        return np.where(self.is_changed, self.region, 0).astype(np.int32)


REGION_COLUMNS = ("region", "kind", "area_m2", "sigma_area_m2", "volume_m3", "sigma_volume_m3", "extreme_m",
                  "sigma_extreme_m", "mean_m", "sigma_mean_m", "x", "y", "z")  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """What changed between two epochs, where, how much and how sure.

    `on_compared` and `on_reference` hold the change at the vertices of the later and of the earlier surface, both in
    the reference epoch's coordinates. `registration` is of the compared epoch onto the reference; in the `mode`
    "relative" its motion was removed, in "absolute" it stays in the differences. `regions` is a table with the columns
    `REGION_COLUMNS`, largest first; `mean_m` is free of what noise alone adds to it, by that vertices whose noise
    goes that way are the ones that count (`choice_m` of the statistic `region_shapes` [m]: so much it was larger).
    Where the registration tells a layer all over, regions are what stands out of it, and their figures are beside
    it, as the statistic `lod95_beside_layer_median_m` says by being there; distances and `lod95` are with it.
    `statistics` holds the figures of the summary file (`stable_share`, `bias_m`, `nmad_m`, `rmse_m`,
    `lod95_median_m`, `n_vertices`, `n_not_assessable`, `n_unchanged`, `n_changed`, `share_above_lod95`,
    `motion_significance`, ...); `motion_significance` is NaN, and `motion_is_significant` None, where it is not
    known how far the frames of both epochs may differ; `told_by_width_m` has rows of how wide [m] a change is and
    from how large a mean change [m] on one so wide is told in 19 of 20 cases, the median over the surface; NaN, as
    `told_from` is, where not both surfaces state their noise.
    """

    on_compared: ComparedSurface
    on_reference: ComparedSurface
    regions: pd.DataFrame
    registration: Registration
    mode: str
    statistics: Mapping[str, Any]
