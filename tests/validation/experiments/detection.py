"""Power of detection: steps of 1 to 5 times what a patch can show, and pairs in which nothing changed.

A bumpy sheet of 120 x 120 mm, points 1 mm apart, noise 0.3 mm, in two epochs, each made into a surface, registered and
compared, all settings automatic. The step is 20 x 20 mm, in a random place, gained or lost. What the patch can show is
measured: 1.96 times the scatter, over unchanged pairs and places, of the mean distance over such a patch; beside it
steps by what is stated of that mean, and steps as wide as an unchanged pair says and as large as it says are told.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rows import Row, Size, in_percent, in_words, judge
from scipy.stats import binom, norm

from monitor.comparison import compare
from monitor.comparison.detection.detect import detect
from monitor.comparison.distances.both_ways import make_shells, measure_sides
from monitor.comparison.distances.side import move_surface
from monitor.comparison.regions.figures import sigma_of_mean
from monitor.reconstruction import reconstruct
from monitor.registration import register
from projects.model import Z95, Assessment, Bools, Comparison, Floats, Ints, PointCloud, Surface

TITLE = "Power of detection, and pairs without a change"
N_SIDE, SPACING, NOISE, EDGE = 120, 0.001, 0.0003, 0.020
REACH = 0.008  # m, how far a counterpart is looked for
PAIRS = {"small": 2, "full": 20}
N_UNCHANGED = {"small": 2, "full": 8}
N_STATED = {"small": 1, "full": 20}
STEPS = {"small": (5.0,), "full": (1.0, 2.0, 3.5, 5.0)}
TRIED = {3.5: 20}  # pairs, of each step; 6 of the others
SHARES: dict[Size, tuple[float, ...]] = {"small": (1.0,), "full": (0.6, 1.0)}  # of what is said to be told
LIMIT = 3000.0
FIRST_SEED = 2000  # of these none was looked at when the test was chosen


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


def squares_of(vertices: Floats, known: Bools) -> list[Ints]:
    """Return the known vertices of each of the squares of the step's size that the sheet holds."""
    cell = np.floor(vertices[:, :2] / EDGE).astype(int)
    number = np.where(known & (np.abs(cell + 0.5) < 2.0).all(axis=1), (cell + 2) @ [4, 1], -1)
    squares = [np.flatnonzero(number == k) for k in range(16)]
    return [s for s in squares if len(s) > 50]


def patch_means(result: Comparison) -> list[float]:
    """Return the mean distance [m] over each of the squares."""
    side = result.on_compared
    squares = squares_of(side.surface.vertices, side.assessment != Assessment.NOT_ASSESSABLE)
    return [float(side.distances[s].mean()) for s in squares]


def stated_level(reference: Surface, compared: Surface) -> float:
    """Return the median lod95 [m] that is stated of the mean change of a square."""
    motion = register(compared, reference)
    moved = move_surface(compared, motion.T_target_source)
    sides = measure_sides(make_shells(reference, moved, (REACH, np.radians(60.0))), motion)
    found = detect(sides, motion, 0.05, 0)
    squares = squares_of(sides[1].surface.vertices, sides[1].is_assessed)
    return Z95 * float(np.median([sigma_of_mean(sides[1], found, s, motion) for s in squares]))


def is_found(result: Comparison, place: Floats, depth: float, edge: float = EDGE) -> bool:
    """Return whether a region of the right sign lies at the step."""
    at = result.regions
    near = (np.abs(at["x"] - place[0]) < edge / 2) & (np.abs(at["y"] - place[1]) < edge / 2)
    return bool((near & (np.sign(at["mean_m"]) == np.sign(depth))).any())


def run(size: Size) -> list[Row]:
    """Compare unchanged pairs, then changed ones."""
    n = PAIRS[size]
    references = [make_surface(np.random.default_rng([FIRST_SEED + k, 0])) for k in range(n)]
    unchanged = [
        compare_pair(r, make_surface(np.random.default_rng([FIRST_SEED + k, 1])))
        for k, r in enumerate(references[: N_UNCHANGED[size]])
    ]
    shown = 1.96 * float(np.std([m for result in unchanged for m in patch_means(result)]))
    stated = float(np.median([stated_level(r, make_surface(np.random.default_rng([FIRST_SEED + k, 1])))
                              for k, r in enumerate(references[: N_STATED[size]])]))  # fmt: skip
    rows = rows_of_unchanged(unchanged, shown, stated)
    n_tests = int(unchanged[0].statistics["n_patches"])
    for times in STEPS[size]:
        rows.append(row_of_steps(f"step of {times:g} times", times, shown, references[: TRIED.get(times, 6)], n_tests))
    if size == "full":
        rows.append(row_of_steps("step of 3.5 times what is stated", 3.5, stated, references, n_tests))
    return rows + rows_of_told(unchanged, references, SHARES[size])


def rows_of_told(unchanged: list[Comparison], references: list[Surface], shares: tuple[float, ...]) -> list[Row]:
    """Return how wide and how large a change unchanged pairs say is told, and how many steps of so many shares of it
    are found, one on each reference."""
    width, least = np.median([result.statistics["told_by_width_m"][0] for result in unchanged], axis=0)
    rows = [Row(f"said to be told of changes {1e3 * width:.0f} mm wide, mm", in_words(1e3 * least), value=1e3 * least)]
    for share in shares:
        found = 0
        for k, reference in enumerate(references):
            rng = np.random.default_rng([FIRST_SEED + k, round(1000 * share)])
            place, depth = rng.uniform(-0.04, 0.04, 2), share * least * rng.choice([-1.0, 1.0])
            changed = make_surface(rng, step(place, width, depth))
            found += is_found(compare_pair(reference, changed), place, depth, width)
        asked, verdict = ("95 %", judge(found >= 0.95 * len(references))) if share == 1.0 else ("", "stated")
        rows.append(Row(f"step of {share:g} of that: found", f"{found} of {len(references)}", verdict, "", asked,
                        value=found / len(references)))  # fmt: skip
    return rows


def row_of_steps(what: str, times: float, level: float, references: list[Surface], n_tests: int) -> Row:
    """Return how many steps of so many times `level` [m] are found, one on each reference."""
    found = 0
    for k, reference in enumerate(references):
        rng = np.random.default_rng([FIRST_SEED + k, round(10 * times)])
        place, depth = rng.uniform(-0.04, 0.04, 2), times * level * rng.choice([-1.0, 1.0])
        found += is_found(compare_pair(reference, make_surface(rng, step(place, EDGE, depth))), place, depth)
    tried, best = len(references), in_percent(best_power(times * level, n_tests))
    asked, verdict = ("95 %", judge(found >= 0.95 * tried)) if times == 3.5 else ("", "stated")
    return Row(f"{what}: found", f"{found} of {tried}", verdict, "", asked, {"best filter": best}, value=found / tried)


def best_power(depth: float, n_tests: int) -> float:
    """Return how often the best filter finds the step among so many tests, at a family's level of 5 %.

    It knows place and shape, has the bare points and their true noise, and nothing lost to a registration: the
    mean over the step's points (Neyman and Pearson 1933).
    """
    z = depth / (np.sqrt(2.0) * NOISE * SPACING / EDGE)
    return float(norm.sf(norm.isf(0.05 / (2.0 * n_tests)) - z))


def rows_of_unchanged(results: list[Comparison], shown: float, stated: float) -> list[Row]:
    """Return the rows of pairs without a change."""
    n_with = sum(len(result.regions) > 0 for result in results)
    above = [float(result.statistics["share_above_lod95"]) for result in results]
    known = [result.on_compared.assessment != Assessment.NOT_ASSESSABLE for result in results]
    lod = float(np.median([np.nanmedian(result.on_compared.lod95) for result in results]))
    most = int(binom.ppf(0.95, len(results), 0.05))
    mean, error = float(np.mean(above)), 1.96 * float(np.std(above) / np.sqrt(len(above)))
    return [
        Row("what a patch of 20 x 20 mm can show, mm", in_words(1e3 * shown), value=1e3 * shown),
        Row("what is stated of its mean (lod95), mm", in_words(1e3 * stated), value=1e3 * stated),
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
