"""The staircase of paper 002, fig. 4: many stations, control points, and a settlement of the whole by 6 mm.

The landing with its walls and balustrade, 16 x 8 x 8 m, from five stations of which two stand before it; poses are
given to 10 mm and 0.05 degrees, as a tripod's estimate. Panoramas are too coarse for targets, so each station also
scans those in sight in fine windows, as crews do. Every other target is a control point (0.5 mm), the others are check
targets. A scan's error at a check target is by how much its registration displaces the target's true
centre. In the second epoch the staircase has sunk by 6 mm; the targets stand still.
"""

from __future__ import annotations

import datetime
import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import front_door
import numpy as np
from rows import Row, Size, in_percent, in_words, judge

from monitor.simulation import INSTRUMENTS, Scene, Window, misregister, move_whole, simulate_scan, stand_at
from monitor.simulation.campaign import write_extent
from monitor.simulation.scanner import Target, cast, window_around
from monitor.simulation.scenes import TrueTarget
from monitor.simulation.staircase import STATIONS, settlement, staircase_scene
from projects.formats import write_e57
from projects.model import Assessment, Comparison, Floats
from projects.transforms import apply, invert

TITLE = "Staircase (paper 002, fig. 4): control points, and a settlement of 6 mm"
INSTRUMENT = INSTRUMENTS["leica-hds6000"]
PLACES = {"small": (2, 6), "full": (2, 3, 6, 7, 8)}  # of STATIONS
STEPS = {"small": 0.008, "full": 0.00275}  # rad, of the panoramas
GROWTH: dict[Size, tuple[float, ...]] = {"small": (), "full": (0.02, 0.009)}  # rad; the first compiles, not counted
SIGMA_POSITION, SIGMA_ANGLE = 0.010, float(np.radians(0.05))
ACROSS, FARTHEST, STEEPEST = 40, 10.0, float(np.radians(60.0))  # pulses, m, rad: fine scans of the targets
BOX = np.array([[-8.0, -4.2, 0.05], [8.0, 4.2, 8.0]])
SINKS = 0.006
LIMIT = 3600.0


@dataclass(frozen=True)
class Survey:
    """The files of an epoch and their points; of each station the true pose, the one stated, and its first scan."""

    files: list[Path]
    true: list[Floats]
    stated: list[Floats]
    first: list[int]
    n_points: int


def survey(scene: Scene, size: Size, folder: Path, seed: int, step: float | None = None) -> Survey:
    """Scan and write: from each station a panorama, and a fine window of each target in sight."""
    rng = np.random.default_rng([seed, 11])
    tree, step = Target.of(scene, 1), step or STEPS[size]
    files, true, stated, first = [], [], [], []
    n_scans = n_points = 0
    for k in PLACES[size]:
        pose = stand_at(
            STATIONS[k] + rng.normal(scale=0.03, size=3), facing=np.zeros(3), heading=rng.uniform(-0.3, 0.3)
        )
        given = misregister(pose, rng, sigma_position=SIGMA_POSITION, sigma_angle=SIGMA_ANGLE)
        fields = [(f"station {k}", Window(-np.pi, np.pi - step, -1.1, 0.9), step)]
        fields += [(f"station {k}, {t.name}", *window_at(t, pose)) for t in in_sight(scene.targets, tree, pose)]
        scans = [
            simulate_scan(tree, INSTRUMENT, pose, window, step=fine, seed=[100 * seed + k, n], registered=given,
                          name=name)
            for n, (name, window, fine) in enumerate(fields)
        ]  # fmt: skip
        files.append(folder / f"epoch{seed}-station{k}.e57")
        write_e57(files[-1], scans)
        true.append(pose)
        stated.append(given)
        first.append(n_scans)
        n_scans += len(scans)
        n_points += sum(len(scan.cloud) for scan in scans)
    return Survey(files, true, stated, first, n_points)


def in_sight(targets: Sequence[TrueTarget], tree: Target, pose: Floats) -> list[TrueTarget]:
    """Return the targets that the crew scans finely from here: near, free to see and not too steep."""
    seen = []
    for target in targets:
        way = target.centre - pose[:3, 3]
        distance = float(np.linalg.norm(way))
        ray = np.concatenate([pose[:3, 3], way / distance]).astype(np.float32)[None, None]
        is_free = float(cast(tree, ray, 1).t[0, 0]) > distance - 2.0 * target.size
        is_steep = target.normal is not None and -float(way @ target.normal) < np.cos(STEEPEST) * distance
        if distance < FARTHEST and is_free and not is_steep:
            seen.append(target)
    return seen


def window_at(target: TrueTarget, pose: Floats) -> tuple[Window, float]:
    """Return the window of a target's fine scan, twice as wide as the target, and its step [rad]."""
    width = target.size if target.kind == "board" else 2.0 * target.size
    box = np.array([target.centre - width, target.centre + width])
    return window_around(box, pose), width / ACROSS / float(np.linalg.norm(target.centre - pose[:3, 3]))


def write_control(path: Path, targets: Sequence[TrueTarget], seed: int) -> Path:
    """Write control points as a tachymeter gave them, 0.5 mm."""
    rng = np.random.default_rng([seed, 12])
    lines = ["name,x,y,z,sigma"]
    for target in targets:
        x, y, z = target.centre + rng.normal(scale=0.0005, size=3)
        lines.append(f"{target.name},{x:.5f},{y:.5f},{z:.5f},0.0005")
    path.write_text("\n".join(lines) + "\n")
    return path


def run(size: Size) -> list[Row]:
    """Survey both epochs, process with control, compare in both modes; before, the growth of time with points."""
    before = staircase_scene()
    after = staircase_scene(changes=[move_whole("settlement", settlement(SINKS))])
    near = [t for t in before.targets if abs(t.centre[0]) < 10.0]
    control, check = near[0::2], near[1::2]
    costs = [cost_of(before, control, size, step) for step in GROWTH[size]][1:]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        surveys = [survey(scene, size, folder, seed) for seed, scene in enumerate((before, after))]
        told = [tell_epoch(folder, surveyed, control, k) for k, surveyed in enumerate(surveys)]
        started = time.process_time()
        project = front_door.process(folder, told, extent=write_extent(folder / "extent.json", BOX))
        costs.append(Cost(sum(s.n_points for s in surveys) / 2, (time.process_time() - started) / 2, peak_memory()))
        errors = [errors_at(project, epoch.name, s, check) for epoch, s in zip(told, surveys, strict=True)]
        rows = rows_of_targets(errors)
        for mode, rows_of in (("absolute", rows_of_absolute), ("relative", rows_of_relative)):
            try:
                rows += rows_of(front_door.compare(project, "e0", "e1", mode=mode))
            except front_door.Refused as refusal:
                rows.append(Row(f"settlement of 6 mm, {mode} mode", "refused", "not yet", cause=str(refusal)))
    return rows + rows_of_growth(costs)


def tell_epoch(folder: Path, surveyed: Survey, control: Sequence[TrueTarget], k: int) -> front_door.Epoch:
    """Return what `add-epoch` is told of epoch k."""
    path = write_control(folder / f"control{k}.csv", control, k)
    return front_door.Epoch(f"e{k}", str(datetime.date(2008 + k, 5, 1)), surveyed.files, ("--control", str(path)))


@dataclass(frozen=True)
class Cost:
    """What an epoch took: raw points, processor time [s], and the peak memory of this process so far [MiB]."""

    n_points: float
    seconds: float
    peak: float


def cost_of(scene: Scene, control: Sequence[TrueTarget], size: Size, step: float) -> Cost:
    """Return what the first epoch takes from files to surface, its panoramas scanned with this step [rad]."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        surveyed = survey(scene, size, folder, 0, step)
        told = tell_epoch(folder, surveyed, control, 0)
        started = time.process_time()
        front_door.process(folder, [told], extent=write_extent(folder / "extent.json", BOX))
        return Cost(surveyed.n_points, time.process_time() - started, peak_memory())


def peak_memory() -> float:
    """Return the peak resident memory [MiB] of this process since it began."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def rows_of_growth(costs: Sequence[Cost]) -> list[Row]:
    """Return the time of an epoch for its points, and the exponent of their law; sizes rise."""
    rows = [
        Row(f"an epoch of {c.n_points / 1e6:.2f} M raw points, files to surface", f"CPU {c.seconds:.0f} s",
            others={"points a CPU second": f"{c.n_points / c.seconds:.0f}", "peak memory": f"{c.peak / 1024:.1f} GiB"})
        for c in costs
    ]  # fmt: skip
    if len(costs) > 1:
        points, seconds = (np.log([getattr(c, name) for c in costs]) for name in ("n_points", "seconds"))
        exponent = float(np.polyfit(points, seconds, 1)[0])
        rows.append(Row("law of growth: processor time as points to the power of", in_words(exponent, 2),
                        value=exponent))  # fmt: skip
    return rows


def errors_at(project: Path, epoch: str, surveyed: Survey, check: Sequence[TrueTarget]) -> Floats:
    """Return by how much each station of an epoch displaces the check targets, (stations, targets, 3) m."""
    motions = front_door.product(project, epoch, "network")["T_project_given"][surveyed.first]
    centres = np.array([target.centre for target in check])
    return np.array([
        apply(T @ given @ invert(pose), centres) - centres
        for T, given, pose in zip(motions, surveyed.stated, surveyed.true, strict=True)
    ])  # fmt: skip


def rms(errors: Floats) -> float:
    """Return the rms length [mm] of 3-D errors (..., 3) m."""
    return 1e3 * float(np.sqrt(np.mean((errors**2).sum(axis=-1))))


def rows_of_targets(errors: list[Floats]) -> list[Row]:
    """Return absolute error at the check targets, and relative: of each scan to the mean of its epoch."""
    absolute = rms(np.concatenate([e.reshape(-1, 3) for e in errors]))
    relative = rms(np.concatenate([(e - e.mean(axis=0)).reshape(-1, 3) for e in errors]))
    epochs = rms(errors[1].mean(axis=0) - errors[0].mean(axis=0))
    return [
        Row("check targets, absolute, rms 3-D, mm", in_words(absolute, 2), judge(absolute <= 5.0), "5", "5",
            value=absolute),
        Row("check targets, scans among each other, rms 3-D, mm", in_words(relative, 2), judge(relative <= 2.0), "2",
            "2", value=relative),
        Row("check targets, epoch to epoch, rms 3-D, mm", in_words(epochs, 2)),
    ]  # fmt: skip


def rows_of_absolute(comparison: Comparison) -> list[Row]:
    """Return how far the treads and the landing are seen to have sunk."""
    side = comparison.on_reference
    normals = side.surface.normals
    assert normals is not None
    flat = (normals[:, 2] > 0.9) & np.isfinite(side.distances)
    sunk = 1e3 * float(np.median(side.distances[flat]))
    changed = float(np.mean(side.assessment[flat] == Assessment.CHANGED))
    return [
        Row("settlement of 6 mm, absolute mode: median on treads, mm", in_words(sunk, 2, signed=True),
            judge(abs(sunk + 1e3 * SINKS) <= 2.0), "10 mm threshold", "−6 within 2",
            {"of them called changed": in_percent(changed)}, sunk),
    ]  # fmt: skip


def rows_of_relative(comparison: Comparison) -> list[Row]:
    """Return the motion of the whole, and what else is called changed."""
    centre = np.array([[0.0, 0.0, 3.6]])
    back = 1e3 * float((apply(comparison.registration.T_target_source, centre) - centre)[0, 2])
    side = comparison.on_reference
    known = side.assessment != Assessment.NOT_ASSESSABLE
    called = float(np.mean(side.assessment[known] == Assessment.CHANGED))
    is_told = abs(back - 1e3 * SINKS) <= 2.0 and float(comparison.statistics["motion_significance"]) > 0.95
    return [
        Row("settlement of 6 mm, relative mode: motion told, mm", in_words(-back, 2, signed=True), judge(is_told), "",
            "−6 within 2, significant", value=-back),
        Row("relative mode: surface called changed", in_percent(called, 2), judge(called <= 0.01), "", "1 %"),
    ]  # fmt: skip


NOTES = (
    "Through the command line, E57, control points as CSV; each station a panorama, and a fine window of 40 pulses "
    "across of each target in sight within 10 m. Reduced: the landing from five stations instead of the whole "
    "staircase. Where its shape can slide along the steps, that part of the motion stays as the control points say."
)
SMALL_BARS = ("check targets, absolute, rms 3-D, mm", "settlement of 6 mm, absolute mode: median on treads, mm",
              "relative mode: surface called changed")  # fmt: skip
