"""Regions that keep their identity from epoch to epoch: what overlaps on the reference surface and has one sign.

In: the comparisons of several epochs with one reference epoch. Out: followed regions with their numbers in each epoch,
and what became of them: appeared, split, merged, asleep.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from projects.model import Bools, ComparedSurface, Comparison, Floats, Ints, NotAssessed

SAME = 0.2  # of the smaller area: two regions that share more are one


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
    def places(self) -> Ints:
        """The region (n,) that each vertex of the reference surface lies in, 0 for none: where it has changed, and
        what is buried under what came as a whole, which alone says where that stands."""
        side = self.side
        return np.where(side.is_changed | np.isin(side.region, self.came), side.region, 0).astype(np.int32)


@dataclass
class Followed:
    """A region while it is followed.

    `identity` is its number, 1 the first; `sign` +1 gained, -1 lost; `latest` and `footprint` are masks (n,) of the
    reference's vertices, where it was last seen and in any epoch; `events` says by epoch what became of it; `parent` is
    the identity that it split from and `merged_into` the one it went into, 0 where none.
    """

    identity: int
    sign: float
    latest: Bools
    footprint: Bools
    numbers: dict[int, int] = field(default_factory=dict)  # epoch -> region
    events: dict[int, str] = field(default_factory=dict)
    parent: int = 0
    merged_into: int = 0


def sign_of_regions(comparison: Comparison) -> Floats:
    """Return the sign of each region's change, by its number; entry 0 is of no region."""
    means = comparison.regions["mean_m"].to_numpy(dtype=float)
    return np.append(0.0, np.sign(means))


def follow_regions(numbers: Sequence[Ints], signs: Sequence[Floats], areas: Floats) -> list[Followed]:
    """Give the regions of successive epochs, by the `numbers` (n,) of each vertex, their identities.

    A region goes on as the one that it shares most area with. Where one becomes two, the larger share keeps the
    identity and the other gets a new one with its `parent`; where two become one, the smaller share ends as
    `merged_into`. A region that is not found in an epoch sleeps, and may go on later.
    """
    followed: list[Followed] = []
    for k, (own, sign) in enumerate(zip(numbers, signs, strict=True)):
        regions = {r: own == r for r in range(1, len(sign)) if (own == r).any()}
        links = sorted(_overlaps(followed, regions, sign, areas), key=lambda link: -link[0])
        taken: dict[int, Followed] = {}
        gone_on: set[int] = set()
        for _, f, r in links:
            if r not in taken and f.identity not in gone_on:
                taken[r] = f
                gone_on.add(f.identity)
        for _, f, r in links:
            if f.identity not in gone_on and not f.merged_into:
                f.merged_into, f.events[k] = taken[r].identity, f"merged into {taken[r].identity}"
        for r, mask in regions.items():
            if r not in taken:
                origin = next((f for _, f, other in links if other == r), None)
                event = f"split from {origin.identity}" if origin else "appeared"
                taken[r] = Followed(len(followed) + 1, float(sign[r]), mask, mask.copy(),
                                    parent=origin.identity if origin else 0, events={k: event})  # fmt: skip
                followed.append(taken[r])
            _go_on(taken[r], k, r, mask)
    return followed


def _overlaps(followed: list[Followed], regions: dict[int, Bools], sign: Floats,
              areas: Floats) -> list[tuple[float, Followed, int]]:  # fmt: skip
    """Return (shared area, followed region, region) of each pair of one sign that shares enough."""
    links = []
    for f in followed:
        for r, mask in regions.items():
            shared = float(areas[f.latest & mask].sum())
            least = min(float(areas[f.latest].sum()), float(areas[mask].sum()))
            if not f.merged_into and f.sign == sign[r] and shared > SAME * least:
                links.append((shared, f, r))
    return links


def _go_on(followed: Followed, epoch: int, region: int, mask: Bools) -> None:
    """Note that a followed region is `region` in an epoch, over the vertices of `mask` (n,)."""
    followed.latest = mask
    followed.footprint |= mask
    followed.numbers[epoch] = region
