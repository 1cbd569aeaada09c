"""Regions that stood still in the coordinates as given, so that it may be all the rest that changed.

Of an object that was cleaned all over but its base, two epochs alone show a rest that moved, or a base that was coated:
which of both was made fit is the registration's choice. Coordinates that agree by themselves speak for one of them.
In and out: a comparison in relative mode, of which nobody said what stood still.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from monitor.comparison.regions.moved_parts import WIDE
from monitor.lengths import in_millimetres
from projects.model import Z95, Comparison
from projects.transforms import apply, invert
from projects.triangles import vertex_areas, vertex_normals

AS_A_WHOLE = ("cleaned", "coated", "moved")  # kinds that may as well be a motion of all the rest
CLEARLY = 3.0  # times its margin: what a region differs from the rest by, for coordinates that agree by chance are rare
NEARLY = 0.3  # of what it differs from the rest by: a wide region that moved by less as given nearly stood still


def doubt_as_given(comparison: Comparison) -> Comparison:
    """Return the comparison with the doubt that the rest changed, where a region that changed evenly did not move in
    the coordinates as given: there its mean change is within its margin of none, or the region is wide and moved by
    little beside what the rest did. Coordinates hold an object to some tenths of a millimetre, not to a margin."""
    registration, side = comparison.registration, comparison.on_compared
    if not registration.converged or np.isfinite(registration.layer):  # beside a layer all over: told as that
        return comparison
    surface = side.surface
    normals = vertex_normals(surface.vertices, surface.faces) if surface.normals is None else surface.normals
    areas = vertex_areas(surface.vertices, surface.faces)
    given = apply(invert(registration.T_target_source), surface.vertices)
    back = np.einsum("ij,ij->i", given - surface.vertices, normals)
    assessed = float(areas[np.isfinite(side.distances)].sum())
    table, still = comparison.regions[comparison.regions["kind"].isin(AS_A_WHOLE)], []
    means, sigmas = (table[name].to_numpy(dtype=float) for name in ("mean_m", "sigma_mean_m"))
    for number, mean, margin in zip(table["region"].to_numpy(dtype=int), means, Z95 * sigmas, strict=True):
        at = (side.region == number) & np.isfinite(side.distances) & np.isfinite(back)
        if not abs(mean) > CLEARLY * margin or not areas[at].sum() > 0.0:
            continue
        as_given = float(np.average(back[at], weights=areas[at])) + mean
        all_over = float(np.sqrt(np.average((back[at] + mean) ** 2, weights=areas[at])))
        is_wide = areas[at].sum() >= WIDE * assessed
        if abs(as_given) <= margin or (is_wide and all_over <= NEARLY * abs(mean)):
            still.append((int(number), float(mean), as_given if abs(as_given) > margin else 0.0))
    if not still:
        return comparison
    told = "; ".join(filter(None, (registration.doubt, _say(still))))
    return dataclasses.replace(comparison, registration=dataclasses.replace(registration, doubt=told))


def _say(still: list[tuple[int, float, float]]) -> str:
    """Return in words which regions, by number, mean change and motion as given [m] (0: within its margin), stood still
    in the coordinates as given, and what the rest did there."""
    which = f"region {still[0][0]}" if len(still) == 1 else f"regions {', '.join(str(k) for k, *_ in still)}"
    mean, most = still[0][1], max(abs(as_given) for *_, as_given in still)
    way = "deeper" if mean > 0.0 else "higher"
    stood = "stood still" if most == 0.0 else f"moved by no more than {in_millimetres(most)}"
    return (
        f"in the coordinates as given {which} {stood}, and the rest, which was taken to stand still, lies "
        f"{in_millimetres(abs(mean))} {way}: if these coordinates hold, it is the rest that changed, and a comparison "
        "with --mode absolute shows it so; control points, or a place where nothing moved, would tell"
    )
