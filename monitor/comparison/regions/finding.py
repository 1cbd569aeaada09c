"""Change regions: what hangs together over both surfaces becomes one region with its figures (docs/method.md, step 13).

A region joins changed vertices of one sign that are neighbours on a surface or each other's foot. It must hold as a
whole: it makes a patch that is significant among all patches tested (Bonferroni), so the chance that an unchanged
object shows any region is at most the level. Specks smaller than the area over which errors agree (one independent
witness) are regions only where they are as deep as no error is (`chips`). What is no region is not called changed, nor
is the skirt of a step (`trim_skirts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.stats import norm

from monitor.comparison.detection.reaches import members_of
from monitor.comparison.detection.skirts import trim_skirts
from monitor.comparison.detection.tested import Detected, Tested
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.guesses import BEYOND, SURE, areas_of_guesses, mean_to_samples
from monitor.comparison.noise.model import Noise
from monitor.comparison.regions.beyond import Beyond, grow_regions, join_grown
from monitor.comparison.regions.borders import margin_widths, spread_margin
from monitor.comparison.regions.chips import HANDFUL, stand_alone, turn_sharply
from monitor.comparison.regions.covered import take_covered
from monitor.comparison.regions.enclosure import measure_body, spread_over_assessed
from monitor.comparison.regions.figures import (
    CHOICE,
    depths_of_points,
    describe_region,
    is_volume_known,
    lie_over_hollows,
    settle_kind,
    stands_out,
    view_sides,
)
from monitor.comparison.regions.moved import name_moved
from monitor.comparison.regions.parts import are_set_apart, area_of_parts, connect_apart, connect_sides
from projects.model import REGION_COLUMNS, Z95, Bools, Floats, Ints, Registration


@dataclass(frozen=True)
class Regions:
    """Regions 1 to r: their table (`REGION_COLUMNS`) and, of both sides, the region of each vertex (n,), 0 for none.

    `seen` are the vertices that are changed; `whole` also those that lie outside or inside of the other surface without
    a perpendicular and hang together with them: what broke off, and its fracture. Area, centroid and extent are of it.
    `is_chip` (r,) are those that stand by their depth alone (`chips`), `is_guess` (r,) those whose mean is
    no more than what the surfaces may have made up (`guesses`); empty: none.
    """

    table: pd.DataFrame
    seen: tuple[Ints, Ints]
    whole: tuple[Ints, Ints]
    is_chip: Bools = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    is_guess: Bools = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def keep(self, kept: Ints) -> Regions:
        """Return the rows `kept` of the table in their order, all numbered anew."""
        number = np.zeros(len(self.table) + 1, dtype=np.int32)
        number[kept + 1] = np.arange(1, len(kept) + 1)
        table = self.table.iloc[kept].reset_index(drop=True)
        table["region"] = np.arange(1, len(kept) + 1)
        a, b = self.seen
        c, d = self.whole
        chips, guesses = (which[kept] if len(which) else which for which in (self.is_chip, self.is_guess))
        return Regions(table, (number[a], number[b]), (number[c], number[d]), chips, guesses)

    def without_chips(self) -> Regions:
        """Return those that need no points to bear them out."""
        return self.keep(np.flatnonzero(~self.is_chip)) if self.is_chip.any() else self


def find_regions(sides: tuple[Side, Side], found: Detected, beyond: Beyond, registration: Registration, level: float,
                 are_points_asked: bool, apart: tuple[Bools, Bools] | None) -> Regions:  # fmt: skip
    """Return the regions, largest first; `are_points_asked`: they must be borne out by the points of both epochs yet;
    what of both sides is set `apart` is of no region with the rest.

    `beyond` tells of the vertices that are not assessed whether they lie outside or inside of the other surface: what
    of them hangs together with a region counts in its volume.
    """
    parts = connect_sides(sides, found.sides, beyond)
    if apart is not None:
        parts = connect_apart(sides, parts, connect_sides(sides, found.sides, beyond, apart), apart,
                              least_area(sides, found))  # fmt: skip
    area, least = area_of_parts(sides, parts), least_area(sides, found)
    gone = area_looked_through(sides, beyond, parts, len(area))
    stands = hold_patches(sides, found.test, parts, len(area), level)
    stands &= bear_out_parts(sides, found.noise, parts, len(area))
    alone = stand_alone(sides, found, parts, len(area)) & (area < least)  # what is larger has patches of its own
    stands = (stands | (gone >= least)) & (area >= least)
    kept = np.flatnonzero(stands | alone)
    number = np.zeros(len(area) + 1, dtype=np.int32)
    number[kept] = np.arange(1, len(kept) + 1)
    before, after = (trim_skirts(side, number[part], f.smooth)  # part -1 is the last entry: 0
                     for side, part, f in zip(sides, parts, found.sides, strict=True))  # fmt: skip
    seen = before, after
    signs = np.array([0.0, *(sign_of_region(k, sides, seen, beyond) for k in range(1, len(kept) + 1))])
    whole = grow_regions(sides, beyond, seen, signs, least_beyond(sides, found))
    is_apart = np.append(False, are_set_apart(parts, apart, len(area))[kept])
    one = join_grown(sides, whole, np.where(is_apart, 2.0, 1.0) * signs)  # what is told apart is of another kind
    seen, whole = (one[seen[0]], one[seen[1]]), (one[whole[0]], one[whole[1]])
    gone, n_stand = (np.bincount(one[1:] - 1, v[kept]).astype(np.float64) for v in (gone, stands))
    signs = signs[np.unique(one, return_index=True)[1]]
    widths = margin_widths(sides, found, seen, signs)
    margins = [spread_margin(s, r, widths) for s, r in zip(sides, seen, strict=True)]
    views = [view_sides(k, sides, found, seen, whole, margins, beyond, registration) for k in range(1, len(gone) + 1)]
    table = pd.DataFrame([describe_region(k, v) for k, v in enumerate(views, 1)], columns=[*REGION_COLUMNS, CHOICE])
    table[["volume_m3", "sigma_volume_m3"]] = measure_volumes(
        table, sides, whole, signs, widths, found, beyond, registration
    )
    table["kind"] = [settle_kind(*row) for row in table[["kind", "volume_m3", "sigma_volume_m3"]].to_numpy()]
    table["kind"] = name_moved(table, sides, seen)
    order = np.argsort(-table["area_m2"].to_numpy(dtype=float), kind="stable")
    measured, stated = (
        np.array([stands_out(v, found.test.scans, guessed) for v in views]) for guessed in (False, True)
    )
    shown = significant(table, assessed_area(sides), measured, gone >= least, level)
    by_sigma = known_of(table, sides, seen, stated, found.noise.usual, gone >= least, level)
    is_vague = turn_sharply(sides, seen, len(gone)) | lie_mostly_at_rim(sides, found.noise, seen, len(gone))
    table.loc[(n_stand == 0.0) & is_vague, "sigma_extreme_m"] = np.nan
    table = tell_hollows(table, sides, beyond, whole)
    is_known = by_sigma | (are_points_asked & (n_stand > 0.0) & lies_beyond_guesses(table, sides, seen, stated))
    return Regions(table, seen, whole, n_stand == 0.0, ~is_known).keep(order[shown[order]])


def known_of(table: pd.DataFrame, sides: tuple[Side, Side], seen: tuple[Ints, Ints], z: Floats, usual: float,
             is_gone: Bools, level: float) -> Bools:  # fmt: skip
    """Return which regions (r,), 1 to r of `seen`, no guess of the surfaces can have made.

    Their means lie `z` (r,) sigmas off zero with what the surfaces guess; they are significant with that among all
    places, or `SURE` and significant among the places where surfaces guess: as many as what is guessed of the region
    has room in all that is guessed.
    """
    among_all = significant(table, assessed_area(sides), z, is_gone, level)
    total, within = areas_of_guesses(sides, usual, seen, len(table))
    return among_all | ((z >= SURE) & is_significant(z, total / np.maximum(within, 1e-300), level))


def lies_beyond_guesses(table: pd.DataFrame, sides: tuple[Side, Side], seen: tuple[Ints, Ints], z: Floats) -> Bools:
    """Return which regions (r,), 1 to r of `seen`, hardly any guess can have made: they changed in the mean, `z` (r,)
    sigmas with what surfaces guess, by more than their own margin, and than fits miss so near to samples (`BEYOND`).

    A joint that one epoch looked into and the other saw aslant differs by more, over areas as small as chips: the
    points must bear these regions out, and what stands by its depth alone is not known by this.
    """
    mean = np.abs(table["mean_m"].to_numpy(dtype=float))
    return np.asarray((z >= Z95) & (mean > BEYOND * mean_to_samples(sides, seen, len(table))))


def assessed_area(sides: tuple[Side, Side]) -> float:
    """Return the area [m2] that is assessed, of the side that has more of it."""
    return max(float(side.areas[side.is_assessed].sum()) for side in sides)


def significant(table: pd.DataFrame, area: float, z: Floats, is_gone: Bools, level: float) -> Bools:
    """Return which regions (r,) have a mean of their own that is significant in its family, by how many sigmas `z` (r,)
    it lies off zero.

    The family is as many places as regions of this size have room on the `area` [m2] (Bonferroni). A patch may stand
    out where the region around it, as it is reported, does not; what was looked through (`is_gone`) needs no such
    proof.
    """
    return is_gone | is_significant(z, area / table["area_m2"].to_numpy(dtype=float), level)


def is_significant(z: Floats, n_places: Floats, level: float) -> Bools:
    """Return which of means (r,), `z` sigmas off zero, are significant among `n_places` (r,) like theirs."""
    return np.asarray(~(2.0 * norm.sf(z) * np.maximum(n_places, 1.0) > level))


def sigmas_needed(n_places: Floats, level: float) -> Floats:
    """Return from how many sigmas off zero on means (r,) are significant among `n_places` (r,) like theirs."""
    return np.asarray(norm.isf(0.5 * level / np.maximum(n_places, 1.0)))


def area_looked_through(sides: tuple[Side, Side], beyond: Beyond, parts: tuple[Ints, Ints], n_parts: int) -> Floats:
    """Return the area [m2] of each part that a scan of the other epoch looked through, on the larger side."""
    area = np.zeros(n_parts)
    for side, part, through in zip(sides, parts, beyond.is_through, strict=True):
        area = np.maximum(area, np.bincount(part[through], side.areas[through], minlength=n_parts))
    return area


def sign_of_region(number: int, sides: tuple[Side, Side], regions: tuple[Ints, Ints], beyond: Beyond) -> float:
    """Return +1 for a gain, -1 for a loss."""
    total = 0.0
    for side, region, change in zip(sides, regions, beyond.change, strict=True):
        here = region == number
        value = np.where(side.is_assessed, side.distances, change)[here]
        total += float(side.areas[here] @ np.nan_to_num(value))
    return float(np.sign(total))


def least_beyond(sides: tuple[Side, Side], found: Detected) -> float:
    """Return the change [m] from which a vertex without a perpendicular counts: the median level of detection."""
    return max(float(np.median(f.lod95[s.is_assessed])) for f, s in zip(found.sides, sides, strict=True)
               if s.is_assessed.any())  # fmt: skip


def measure_volumes(table: pd.DataFrame, sides: tuple[Side, Side], grown: tuple[Ints, Ints], signs: Floats,
                    widths: Floats, found: Detected, beyond: Beyond, registration: Registration) -> Floats:  # fmt: skip
    """Return volume and sigma [m3] of each region (r, 2): of the body between the surfaces, NaN where it is not known.

    `signs` (r + 1,) are those of the regions, `widths` (r + 1,) [m] those of the margins. Where a body has too long a
    border to be closed, the sum of its prisms in the table stays.
    """
    grown = take_covered(sides, grown, signs, beyond)
    before, after = (spread_over_assessed(s, g, widths) for s, g in zip(sides, grown, strict=True))
    known = is_volume_known(sides, grown, beyond, found.test.size, len(table))
    volumes = table[["volume_m3", "sigma_volume_m3"]].to_numpy(dtype=float, copy=True)
    for k in range(len(table)):
        body = measure_body(k + 1, sides, (before, after), found, registration, beyond) if known[k] else None
        if body is not None:
            volumes[k] = body.volume, body.sigma
    volumes[~known] = np.nan
    return volumes


def bear_out_parts(sides: Sequence[Side], noise: Noise, parts: Sequence[Ints], n_parts: int) -> Bools:
    """Return which parts (n_parts,) both sides show, or lie mostly away from free edges.

    Where a surface ends its errors have tails that no level describes: one surface alone is no witness there.
    """
    whole, at_rim = areas_at_rim(sides, noise, parts, n_parts)
    return np.asarray((whole > 0.0).all(axis=0) | (at_rim.sum(axis=0) < 0.5 * whole.sum(axis=0)))


def lie_mostly_at_rim(sides: Sequence[Side], noise: Noise, regions: tuple[Ints, Ints], n_regions: int) -> Bools:
    """Return which regions 1 to n (n,) lie mostly beside free edges, where surfaces are rounder than what was measured,
    by more than their vertices know."""
    whole, at_rim = areas_at_rim(sides, noise, [r - 1 for r in regions], n_regions)
    return np.asarray(at_rim.sum(axis=0) > 0.5 * whole.sum(axis=0))


def tell_hollows(table: pd.DataFrame, sides: tuple[Side, Side], beyond: Beyond,
                 regions: tuple[Ints, Ints]) -> pd.DataFrame:  # fmt: skip
    """Return the table (r rows, regions 1 to r) with what is known of regions over hollows that no surface follows: at
    their deepest they are as deep as points lie in them, and nobody knows how much deeper."""
    are_hollows = lie_over_hollows(sides, beyond, regions, len(table))
    depth, extreme = depths_of_points(regions, beyond, len(table)), table["extreme_m"].to_numpy(dtype=float)
    deepest = np.where(are_hollows, np.sign(extreme) * np.maximum(np.abs(extreme), depth), extreme)
    out = table.assign(extreme_m=deepest)
    out.loc[are_hollows, ["sigma_mean_m", "sigma_extreme_m"]] = np.nan
    return out


def areas_at_rim(sides: Sequence[Side], noise: Noise, parts: Sequence[Ints], n_parts: int) -> tuple[Floats, Floats]:
    """Return the assessed area [m2] of each part on each side (2, n_parts), and how much of it lies beside free edges;
    -1 in `parts` is none."""
    whole, at_rim = np.zeros((2, n_parts)), np.zeros((2, n_parts))
    for k, (side, part) in enumerate(zip(sides, parts, strict=True)):
        own = (part >= 0) & side.is_assessed
        rim = own & noise.is_at_rim(side)
        whole[k] = np.bincount(part[own], side.areas[own], minlength=n_parts)
        at_rim[k] = np.bincount(part[rim], side.areas[rim], minlength=n_parts)
    return whole, at_rim


def hold_patches(sides: Sequence[Side], test: Tested, parts: Sequence[Ints], n_parts: int, level: float) -> Bools:
    """Return which parts (n_parts,) make up most of the change of a patch that is significant among all patches tested.

    All parts together are at least half of it, and this one is the largest: a faint change falls to pieces vertex by
    vertex. Noise beside a large change shares its patches, but does not make them.
    """
    stands = np.zeros(n_parts, dtype=np.bool_)
    for k, side in enumerate(sides):
        units = test.units[k]
        at = np.flatnonzero((parts[k] >= 0) & (units.number >= 0))
        change = side.areas[at] * side.distances[at]
        of_units = coo_matrix((change, (units.number[at], parts[k][at])), shape=(len(units.means), n_parts)).tocsr()
        for size, p_values in enumerate(test.p_values[k].T):
            significant = np.flatnonzero(p_values <= level / test.n_tested)
            if not (len(significant) and n_parts):
                continue
            members = members_of(test.reaches[k], size, significant)
            whole = members @ (units.areas * units.means)
            share = (members @ of_units).multiply(1.0 / np.where(whole == 0.0, np.inf, whole)[:, None]).tocsr()
            most = np.asarray(share.argmax(axis=1)).ravel()
            together = np.asarray(share.maximum(0.0).sum(axis=1)).ravel()
            stands[most[together >= 0.5]] = True
    return stands


def least_area(sides: Sequence[Side], found: Detected) -> float:
    """Return the area [m2] below which a speck is no region: one witness, at least a handful of vertices."""
    spacing2 = max(float(np.median(s.areas)) for s in sides)
    return max(min(found.noise.correlation.area, found.test.size**2), HANDFUL * spacing2)
