"""Power of detection: steps of 1 to 5 times what a patch can show, and pairs in which nothing changed.

A bumpy sheet of 120 x 120 mm, points 1 mm apart, noise 0.3 mm, in two epochs, each made into a surface, registered and
compared, all settings automatic. The step is 20 x 20 mm, in a random place, gained or lost. What the patch can show is
measured, not taken from the product: 1.96 times the scatter, over unchanged pairs and places, of the mean distance over
such a patch.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rows import Row, Size, in_percent, in_words, judge
from scipy.stats import binom, norm

from monitor.comparison import compare
from monitor.reconstruction import reconstruct
from monitor.registration import register
from projects.model import Assessment, Comparison, Floats, PointCloud, Surface

TITLE = "Power of detection, and pairs without a change"
N_SIDE, SPACING, NOISE, EDGE = 120, 0.001, 0.0003, 0.020
PAIRS = {"small": 2, "full": 20}
N_UNCHANGED = {"small": 2, "full": 8}
STEPS = {"small": (5.0,), "full": (1.0, 2.0, 3.5, 5.0)}
TRIED = {3.5: 20}  # pairs, of each step; 6 of the others
LIMIT = 3000.0


Change = Callable[[Floats, Floats], Floats]  # height [m] that is put on the sheet at x, y [m]


def step(place: Floats, edge: float, depth: float) -> Change:
    """Return a square step of `depth` [m] about `place` [m]."""
    return lambda x, y: depth * ((np.abs(x - place[0]) < edge / 2) & (np.abs(y - place[1]) < edge / 2))


def sheet_height(x: Floats, y: Floats) -> Floats:
    """Return the height [m] of the bumpy sheet."""
    return np.asarray(0.005 * np.sin(x / 0.02) * np.cos(y / 0.03) + 0.002 * np.sin((x + 2.0 * y) / 0.013))


def make_surface(rng: np.random.Generator, change: Change | None = None) -> Surface:
    """Measure the sheet, with a change where one is given, and make its surface."""
    g = (np.arange(N_SIDE) + 0.5 - N_SIDE / 2) * SPACING
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, N_SIDE**2) for a in np.meshgrid(g, g))
    z = sheet_height(x, y)
    if change is not None:
        z = z + change(x, y)
    cloud = PointCloud(np.column_stack([x, y, z + NOISE * rng.normal(size=len(x))]), origins=np.array([0.0, 0.0, 2.0]))
    return reconstruct(cloud)


def compare_pair(reference: Surface, compared: Surface) -> Comparison:
    """Register and compare."""
    return compare(reference, compared, register(compared, reference))


def patch_means(result: Comparison) -> list[float]:
    """Return the mean distance [m] over each of the squares of the step's size that the sheet holds."""
    side = result.on_compared
    known = side.assessment != Assessment.NOT_ASSESSABLE
    cell = np.floor(side.surface.vertices[known, :2] / EDGE).astype(int)
    inside = (np.abs(cell + 0.5) < 2.0).all(axis=1)
    number = (cell[inside] + 2) @ [4, 1]
    distances = side.distances[known][inside]
    return [float(distances[number == k].mean()) for k in range(16) if np.count_nonzero(number == k) > 50]


def is_found(result: Comparison, place: Floats, depth: float) -> bool:
    """Return whether a region of the right sign lies at the step."""
    at = result.regions
    near = (np.abs(at["x"] - place[0]) < EDGE / 2) & (np.abs(at["y"] - place[1]) < EDGE / 2)
    return bool((near & (np.sign(at["mean_m"]) == np.sign(depth))).any())


def run(size: Size) -> list[Row]:
    """Compare unchanged pairs, then changed ones."""
    n = PAIRS[size]
    references = [make_surface(np.random.default_rng([k, 0])) for k in range(n)]
    unchanged = [
        compare_pair(r, make_surface(np.random.default_rng([k, 1])))
        for k, r in enumerate(references[: N_UNCHANGED[size]])
    ]
    shown = 1.96 * float(np.std([m for result in unchanged for m in patch_means(result)]))
    rows = rows_of_unchanged(unchanged, shown)
    for times in STEPS[size]:
        found = 0
        for k, reference in enumerate(references[: TRIED.get(times, 6)]):
            rng = np.random.default_rng([k, round(10 * times)])
            place, depth = rng.uniform(-0.04, 0.04, 2), times * shown * rng.choice([-1.0, 1.0])
            found += is_found(compare_pair(reference, make_surface(rng, step(place, EDGE, depth))), place, depth)
        tried = k + 1
        asked, verdict = ("95 %", judge(found >= 0.95 * tried)) if times == 3.5 else ("", "stated")
        most = in_percent(best_power(times * shown, int(unchanged[0].statistics["n_patches"])))
        rows.append(
            Row(f"step of {times:g} times: found", f"{found} of {tried}", verdict, "", asked,
                {"best filter": most}, value=found / tried)
        )  # fmt: skip
    return rows


def best_power(depth: float, n_tests: int) -> float:
    """Return how often the best filter finds the step among so many tests, at a family's level of 5 %.

    It knows place and shape, has the bare points and their true noise, and nothing lost to a registration: the
    mean over the step's points (Neyman and Pearson 1933).
    """
    z = depth / (np.sqrt(2.0) * NOISE * SPACING / EDGE)
    return float(norm.sf(norm.isf(0.05 / (2.0 * n_tests)) - z))


def rows_of_unchanged(results: list[Comparison], shown: float) -> list[Row]:
    """Return the rows of pairs without a change."""
    n_with = sum(len(result.regions) > 0 for result in results)
    above = [float(result.statistics["share_above_lod95"]) for result in results]
    known = [result.on_compared.assessment != Assessment.NOT_ASSESSABLE for result in results]
    lod = float(np.median([np.nanmedian(result.on_compared.lod95) for result in results]))
    most = int(binom.ppf(0.95, len(results), 0.05))
    mean, error = float(np.mean(above)), 1.96 * float(np.std(above) / np.sqrt(len(above)))
    return [
        Row("what a patch of 20 x 20 mm can show, mm", in_words(1e3 * shown), value=1e3 * shown),
        Row("median lod95 of a vertex, mm", in_words(1e3 * lod), value=1e3 * lod),
        Row("unchanged pairs with a region", f"{n_with} of {len(results)}", judge(n_with <= most), "",
            f"5 % (at most {most})", value=n_with / len(results)),
        Row("unchanged, assessable vertices above lod95", f"{in_percent(mean, 1)} ± {in_percent(error, 1)}",
            judge(mean - error <= 0.05 <= mean + error and error <= 0.015), "", "5 % within ± 1.5 %", value=mean),
        Row("unchanged, vertices assessable", in_percent(float(np.mean([k.mean() for k in known])), 1)),
    ]  # fmt: skip


NOTES = (
    "Independent noise and one scan an epoch, so that the registration is the only error in common; pairs through the "
    "whole method, in classes of noise and stations, are a row of their own. The best filter knows place and shape "
    "of the step and has the bare points with their true noise; it is held to as many tests."
)
