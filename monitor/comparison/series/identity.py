"""Regions that keep their identity from epoch to epoch: what overlaps on the reference surface and has one sign.

In: the comparisons of several epochs with one reference epoch. Out: followed regions with their numbers in each epoch,
and what became of them: appeared, split, merged, asleep. What no single epoch shows and the rates of all do is one of
them (`follow_rates`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from monitor.comparison.series.rate_regions import RateRegions
from projects.model import Bools, Comparison, Floats, Ints

SAME = 0.2  # of the smaller area: two regions that share more are one
MOST = 0.5  # of what its rates show, that a region must cover; else epochs found a part of it


@dataclass
class Followed:
    """A region while it is followed.

    `identity` is its number, 1 the first; `sign` +1 gained, -1 lost; `latest` and `footprint` are masks (n,) of the
    reference's vertices, where it was last seen and in any epoch; `events` says by epoch what became of it; `parent` is
    the identity that it split from and `merged_into` the one it went into, 0 where none, at the epoch `merged_at`, from
    which on that one tells of it. `found_by` says what shows it:
    "epochs" by themselves, its "trend" alone, or "both"; `is_grown` whether its footprint is what its rates show, and
    what epochs found a part of it; `kept` which share of a vertex's sigma the mean over it keeps, where no epoch tells.
    `chosen` [m3] is what noise alone adds to its change over the series where its rates chose its vertices.
    """

    identity: int
    sign: float
    latest: Bools
    footprint: Bools
    numbers: dict[int, int] = field(default_factory=dict)  # epoch -> region
    events: dict[int, str] = field(default_factory=dict)
    parent: int = 0
    merged_into: int = 0
    merged_at: int | None = None
    found_by: str = "epochs"
    is_grown: bool = False
    kept: float = 1.0
    chosen: float = 0.0


def sign_of_regions(comparison: Comparison) -> Floats:
    """Return the sign of each region's change, by its number; entry 0 is of no region. Where its mean is not known, as
    of a piece that is gone and was seen in part, the sign of its extreme."""
    means, extremes = (comparison.regions[name].to_numpy(dtype=float) for name in ("mean_m", "extreme_m"))
    return np.append(0.0, np.sign(np.where(np.isfinite(means), means, extremes)))


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
                f.merged_into, f.merged_at = taken[r].identity, k
                f.events[k] = f"merged into {taken[r].identity}"
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


def follow_rates(followed: list[Followed], rates: RateRegions, areas: Floats, last: int) -> list[Followed]:
    """Return the followed regions, and after them those that no epoch and only their rates show, with new identities.

    `last` is the number of the last epoch. A region of significant rates that shares enough with a followed one of its
    sign is that one; where this covers less than `MOST` of it, what epochs found was a part, and its footprint grows.
    """
    out = list(followed)
    for r, mean in enumerate(rates.means, 1):
        mask, sign = rates.region == r, float(np.sign(mean))
        chosen = float(rates.chosen[r - 1] * areas[mask].sum())
        same = sorted(_found_there(followed, mask, sign, areas), key=lambda f: -areas[f.footprint & mask].sum())
        for f in same:
            f.found_by = "both"
        if not same:
            out.append(Followed(len(out) + 1, sign, mask, mask.copy(), events={last: "found by its trend"},
                                found_by="trend", kept=float(rates.kept[r - 1]), chosen=chosen))  # fmt: skip
        elif areas[same[0].footprint & mask].sum() < MOST * areas[mask].sum():
            others = np.logical_or.reduce([f.footprint for f in followed if f is not same[0]] or [~mask & mask])
            same[0].footprint |= mask & ~others
            same[0].is_grown, same[0].chosen = True, chosen
    return out


def _found_there(followed: list[Followed], mask: Bools, sign: float, areas: Floats) -> list[Followed]:
    """Return the followed regions of one sign, still there, that share enough with `mask` (n,) to be the same."""
    return [f for f in followed if f.sign == sign and not f.merged_into and areas[f.footprint & mask].sum()
            > SAME * min(float(areas[f.footprint].sum()), float(areas[mask].sum()))]  # fmt: skip
