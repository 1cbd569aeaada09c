"""How small a change is told, against what an unchanged pair said: patches worn or coated by multiples of it.

Bumpy bodies, the demo's figure and its pedestal, through files and the command line, all settings automatic. Two epochs
in which nothing changed say of each place from how large a change on it would be told. Then the object itself is worn
and coated there, in patches as wide as the report says, by 0.5 to 1.5 times as much as the place said, and is scanned
once more from where the second epoch stood, with other noise.
"""

from __future__ import annotations

import dataclasses
import datetime
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import chips
import front_door
import numpy as np
from no_change_pairs import make_body, spread_stations
from rows import Row, Size, judge
from scipy.spatial import cKDTree
from scipy.stats import binom

from monitor.reconstruction.mesh import face_areas_and_normals, normals_by_angle
from monitor.simulation import INSTRUMENTS, Body, Scene
from monitor.simulation.campaign import SurveyedEpoch, write_campaign
from monitor.simulation.demo_campaign import EXTENT, demo_scene, demo_stations
from monitor.simulation.figure import carved_figure
from monitor.simulation.stations import Station
from projects.model import Assessment, Comparison, Floats, Surface

TITLE = "How small a change is told, against what an unchanged pair said"
LIMIT = 3600.0
TIMES = (0.5, 0.7, 0.85, 1.0, 1.2, 1.5)  # of what a place said it would tell
ORDER = (1.0, 0.7, 1.2, 1.0, 0.5, 1.5, 1.0, 0.85)  # in which patches get them: three have what was said
ASKED = 0.95  # of changes as large as is said are told
EDGE = 0.002  # m, in which a patch runs out beyond its width
APART = 2.0  # widths between the middles of two patches
N_PATCHES, MOST_CHANGED = 24, 0.02  # at most, on one object; at most this share of its surface
SAME_WAY = 0.5  # cosine of the angle within which a patch's normals look as its middle's
TOLD_OF_PATCH = 0.2  # of a patch's vertices lie in a region: it is told
FIGURE_CELL, FIGURE_SPACING = 0.0025, 0.004  # m


@dataclass(frozen=True)
class Survey:
    """An object among others (the first body of the scene is the one monitored), what is scanned of it, (2, 3) m, and
    the stations of an epoch."""

    name: str
    scene: Scene
    box: Floats
    stations: Callable[[int], tuple[Station, ...]]


@dataclass(frozen=True)
class Patch:
    """A place that is worn (depth below zero) or coated, (3,) m, how wide [m], by how much [m], and how many times of
    what it said it would tell that is."""

    place: Floats
    normal: Floats
    width: float
    depth: float
    times: float


@dataclass(frozen=True)
class Outcome:
    """What one object showed: of the unchanged pair the width [m], what is told of it [m], the median level [m] and
    regions; of the changed one each patch, whether it was told, and regions beside all of them."""

    name: str
    width: float
    told_from: float
    lod95: float
    n_false: int
    patches: tuple[Patch, ...]
    is_told: tuple[bool, ...]
    n_beside: int


def bumpy_body(seed: int) -> Survey:
    """Return a body of the unchanged pairs, points 3 to 4.5 mm apart."""
    scene, spacing = make_body(seed), np.random.default_rng([seed, 11]).uniform(0.003, 0.0045)

    def stations(epoch: int) -> tuple[Station, ...]:
        """Return those of an epoch, all about the body."""
        spread = spread_stations(np.random.default_rng([seed, 12, epoch]))
        return tuple(Station(f"station {k + 1}", pose, spacing / 1.9, given) for k, (pose, given) in enumerate(spread))

    return Survey(f"bumpy body {seed}", scene, scene.bounds(), stations)


def pedestal(seed: int) -> Survey:
    """Return the pedestal of the chips, unchipped."""
    return Survey(f"pedestal {seed}", chips.scene_of(0), chips.BOX, lambda epoch: chips.stations_of(10 * seed + epoch))


def figure(seed: int) -> Survey:
    """Return the demo's figure before anything happened to it, points 4 mm apart."""

    def stations(epoch: int) -> tuple[Station, ...]:
        """Return the demo's, those of later epochs further round."""
        return demo_stations(seed=10 * seed + epoch, spacing=FIGURE_SPACING, heading=0.15 * epoch)

    return Survey(f"figure {seed}", demo_scene(carved_figure(1, cell=FIGURE_CELL)), EXTENT, stations)


def surveys(size: Size) -> Iterator[Survey]:
    """Yield the objects one after another, as each takes memory."""
    kinds = {bumpy_body: 8, pedestal: 2, figure: 2} if size == "full" else {bumpy_body: 1}
    for kind, n in kinds.items():
        for seed in range(1, n + 1):
            yield kind(seed)


def change(body: Body, patches: tuple[Patch, ...]) -> Body:
    """Return the body with each patch worn or coated along its normals."""
    vertices, normals = body.vertices.copy(), normals_by_angle(body.vertices, body.faces)
    tree = cKDTree(body.vertices)
    for patch in patches:
        at = np.array(tree.query_ball_point(patch.place, 0.5 * patch.width + EDGE), dtype=int)
        at = at[normals[at] @ patch.normal > SAME_WAY]
        away = np.linalg.norm(body.vertices[at] - patch.place, axis=1)
        share = np.clip((0.5 * patch.width + EDGE - away) / EDGE, 0.0, 1.0)
        vertices[at] += patch.depth * share[:, None] * normals[at]
    return dataclasses.replace(body, vertices=vertices)


def choose_patches(unchanged: Comparison, seed: int) -> tuple[Patch, ...]:
    """Return patches where the earlier surface of an unchanged pair is seen all over, looks one way and tells as small
    changes as most of it, as wide as the narrowest that the report gives."""
    side, width = unchanged.on_reference, unchanged.statistics["told_by_width_m"][0][0]
    vertices, normals = side.surface.vertices, normals_by_angle(side.surface.vertices, side.surface.faces)
    assert side.told_from is not None
    tree, rng = cKDTree(vertices), np.random.default_rng([seed, 13])
    chosen: list[Patch] = []
    is_fit = (side.assessment == Assessment.UNCHANGED) & np.isfinite(side.told_from) & ~side.is_coarse
    n = most_patches(side.surface, width)
    for v in rng.permutation(np.flatnonzero(is_fit)):
        if len(chosen) == n:
            break
        if any(np.linalg.norm(vertices[v] - p.place) < APART * width for p in chosen):
            continue
        at = np.array(tree.query_ball_point(vertices[v], 0.5 * width))
        if is_fit[at].all() and (normals[at] @ normals[v]).min() > SAME_WAY:
            k = seed + len(chosen)  # one patch on each of many objects has every depth too
            times, sign = ORDER[k % len(ORDER)], (-1.0) ** (k // len(ORDER))
            depth = -sign * times * float(np.median(side.told_from[at]))
            chosen.append(Patch(vertices[v], normals[v], width, depth, times))
    return tuple(chosen)


def most_patches(surface: Surface, width: float) -> int:
    """Return how many patches so wide [m] an object has: several changes teach the noise that they are judged by."""
    area = float(face_areas_and_normals(surface.vertices, surface.faces)[0].sum())
    return min(N_PATCHES, max(1, round(MOST_CHANGED * area / (0.25 * np.pi * width**2))))


def is_told(changed: Comparison, patch: Patch) -> bool:
    """Return whether a region of the patch's sign holds a fifth of its vertices."""
    side = changed.on_reference
    near = np.linalg.norm(side.surface.vertices - patch.place, axis=1) < 0.5 * patch.width
    holds = side.is_changed & (np.sign(side.distances) == np.sign(patch.depth))
    return bool(holds[near].mean() > TOLD_OF_PATCH)


def count_beside(changed: Comparison, patches: tuple[Patch, ...]) -> int:
    """Return how many regions have no vertex within a width of a patch's middle."""
    beside = set(changed.regions["region"].to_numpy().tolist())
    for side in (changed.on_reference, changed.on_compared):
        for patch in patches:
            near = np.linalg.norm(side.surface.vertices - patch.place, axis=1) < patch.width
            beside -= set(side.changed_region[near].tolist())
    return len(beside)


def try_survey(survey: Survey, seed: int) -> Outcome:
    """Compare two unchanged epochs, change the object, and compare again."""
    box, instrument, dates = survey.box, INSTRUMENTS["phase-2020"], [f"202{k}-05-01" for k in range(3)]

    def scan(folder: Path, scene: Scene, epoch: int, stations: tuple[Station, ...]) -> tuple[front_door.Epoch, Path]:
        """Write the scans of one epoch; return it as the command line is told of it, and its extent."""
        told = SurveyedEpoch(scene, stations, datetime.date.fromisoformat(dates[epoch]))
        written = write_campaign(folder / f"scans-{epoch}", [told], instrument, box=box, seed=1000 * seed + 10 * epoch)
        return front_door.Epoch(f"e{epoch}", dates[epoch], written.epochs), written.extent

    with tempfile.TemporaryDirectory() as name:
        folder, later = Path(name), survey.stations(1)
        first, extent = scan(folder, survey.scene, 0, survey.stations(0))
        project = front_door.process(folder, [first, scan(folder, survey.scene, 1, later)[0]], extent=extent)
        unchanged = front_door.compare(project, "e0", "e1")
        patches = choose_patches(unchanged, seed)
        body, *others = survey.scene.bodies
        worn = dataclasses.replace(survey.scene, bodies=(change(body, patches), *others))
        front_door.add(project, scan(folder, worn, 2, later)[0])
        changed = front_door.compare(project, "e0", "e2")
    width, told_from = unchanged.statistics["told_by_width_m"][0]
    return Outcome(
        survey.name, width, told_from, unchanged.statistics["lod95_median_m"], len(unchanged.regions), patches,
        tuple(is_told(changed, p) for p in patches), count_beside(changed, patches),
    )  # fmt: skip


def run(size: Size) -> list[Row]:
    """Try each object; tell of all together how many patches of each depth were told, and of each what it said."""
    outcomes = [try_survey(survey, seed) for seed, survey in enumerate(surveys(size), start=1)]
    tried = {patch.times for outcome in outcomes for patch in outcome.patches}
    return [*(row_of_times(times, outcomes) for times in TIMES if times in tried), *map(row_of_object, outcomes)]


def row_of_times(times: float, outcomes: list[Outcome]) -> Row:
    """Return how many patches so many times as deep as was said are told; a bar where it is once, which holds unless
    fewer are told than one time in twenty by chance."""
    told = [t for o in outcomes for p, t in zip(o.patches, o.is_told, strict=True) if p.times == times]
    n, k = len(told), sum(told)
    what = f"patches {times:.2f} times as deep as was said: told"
    if times != 1.0:
        return Row(what, f"{k} of {n}", value=k / n)
    least = int(binom.ppf(0.05, n, ASKED))
    return Row(what, f"{k} of {n}", judge(k >= least), asked=f"95 % (at least {least})", value=k / n)


def row_of_object(outcome: Outcome) -> Row:
    """Return what the unchanged pair of an object said, and what is false of it and beside the patches."""
    others = {
        "of changes so wide, mm": f"{1e3 * outcome.width:.0f}",
        "median level, mm": f"{1e3 * outcome.lod95:.2f}",
        "patches": str(len(outcome.patches)),
        "regions where nothing changed": f"{outcome.n_false} and {outcome.n_beside}",
    }
    return Row(f"{outcome.name}: told from, mm", f"{1e3 * outcome.told_from:.2f}", others=others,
               value=1e3 * outcome.told_from)  # fmt: skip


NOTES = (
    "Through the command line, E57, stations registered to 0.1 to 0.3 mm. Every place says how small a change "
    "on it is told (median over the patch); told is one a fifth of whose vertices lie in a region of its sign. "
    "At most 2 % of an object are changed, one patch at least: changes not told teach the noise. Regions where "
    "nothing changed: of the unchanged pair, and beside the patches of the changed one."
)
SMALL_BARS = ()
