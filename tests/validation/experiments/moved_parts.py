"""Parts that moved as a whole, among places that were worn: which are found, and how true their six parameters are.

The raised arm of the attic sculpture, pieces of the Rocaille stove that were set anew, and ribbed bosses on a plaque,
each by some millimetres and milliradians in a direction of its own, through files and the command line, all settings
automatic. The same epochs hold worn, coated and hollowed places, which moved nowhere. Stations are others each time.
"""

from __future__ import annotations

import datetime
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import front_door
import numpy as np
from rows import Row, Size, in_words
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from monitor.simulation import (
    INSTRUMENTS,
    Body,
    Edit,
    Model,
    Scene,
    attic_model,
    build_scene,
    coat,
    erode,
    hollow_out,
    misregister,
    move_part,
    stand_at,
    stove_model,
)
from monitor.simulation.campaign import SurveyedEpoch, write_campaign
from monitor.simulation.scenes import grid_faces
from monitor.simulation.stations import Station
from projects.model import Comparison, Floats, Ints
from projects.transforms import apply, perturb

TITLE = "Parts that moved as a whole, among worn places: their six parameters"
LIMIT = 3600.0
INSTRUMENT = INSTRUMENTS["phase-2020"]
LENGTHS = (0.001, 0.002, 0.004, 0.008)  # m
TURN = 0.5  # of the length over a part's half diagonal, the turn that goes with it
ARM = "raised arm"
PIECES = ("piece 3.4", "piece 4.5", "piece 5.3", "piece 6.5")
BOSSES = np.array([[-0.14, 0.20], [0.0, 0.22], [0.13, 0.17]])  # m, along x and z
BOSS_RADIUS, BOSS_HEIGHT, BOSS_WALL, BOSS_CELL = 0.022, 0.010, 0.003, 0.0008  # m
WORN_REACH = 0.03  # m, beyond the radius of a worn place, within which its region lies
NOTES = (
    "Found: a part of the comparison lies in it. The error of its motion is at the part's middle, against the motion "
    "that it was given; the ellipsoid is that of its covariance (6, 6), with the stable areas' own."
)


@dataclass(frozen=True)
class Move:
    """A part that moves: its name, a box (2, 3) [m] about where it is, its length of shift [m], and T_after_before."""

    name: str
    box: Floats
    length: float
    T: Floats


@dataclass(frozen=True)
class State:
    """A scene after some moves, and where it was worn, (n, 3) m, and how far around [m]."""

    scene: Scene
    moves: tuple[Move, ...]
    worn: Floats
    radius: float


@dataclass(frozen=True)
class Subject:
    """An object: as it stood first, what became of it, the box (2, 3) [m] that is scanned, points so far apart [m]."""

    name: str
    before: Scene
    states: tuple[State, ...]
    box: Floats
    spacing: float
    angles: tuple[float, ...]


@dataclass(frozen=True)
class Found:
    """A part that was moved by a length [m]: whether it was found, its error (6,) [rad, m] and this over sigma."""

    length: float
    error: Floats | None = None
    squared: float = np.nan


def draw_move(name: str, box: Floats, length: float, rng: np.random.Generator) -> Move:
    """Return a shift so long in any direction, and a turn about any axis."""
    way, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = TURN * length / (0.5 * np.linalg.norm(box[1] - box[0]))
    return Move(name, box, length, perturb(np.eye(4), box.mean(axis=0), np.concatenate([turn * axis, length * way])))


def attic(lengths: Sequence[float]) -> Subject:
    """Return the attic sculpture, its arm moved by each length; the cuirass is worn, the pedestal coated."""
    model, rng = attic_model(cell=0.004), np.random.default_rng(31)
    before = build_scene(model)
    worn = _on_surface(before, np.array([[0.0, -0.6, 1.62], [0.3, -0.6, 0.5]]))
    edits = (erode("worn", worn[0], radius=0.05, depth=0.003), coat("crust", worn[1], radius=0.05, height=0.002))
    box = model.part(ARM).bounds()
    states = [_state(model, (draw_move(ARM, box, length, rng),), edits, worn) for length in lengths]
    return Subject("attic sculpture", before, tuple(states), _extent(model), 0.003, (-90.0, -18.0, 54.0, 126.0, 198.0))


def stove(lengths: Sequence[float]) -> Subject:
    """Return the stove, four pieces of its front moved by the lengths in turn; others worn and hollowed."""
    model, rng = stove_model(cell=0.004), np.random.default_rng(32)
    before = build_scene(model)
    fronts = [model.part(name).bounds().mean(axis=0) * [1.0, 0.0, 1.0] - [0.0, 1.0, 0.0]
              for name in ("piece 2.4", "piece 5.5")]  # fmt: skip
    worn = _on_surface(before, np.array(fronts))
    edits = (erode("worn", worn[0], radius=0.05, depth=0.003), hollow_out("lost", worn[1], (0.025, 0.015, 0.02)))
    states = []
    for k in range(len(lengths)):
        moves = tuple(draw_move(name, model.part(name).bounds(), lengths[(k + i) % len(lengths)], rng)
                      for i, name in enumerate(PIECES))  # fmt: skip
        states.append(_state(model, moves, edits, worn))
    box = _extent(model)
    box[1, 1] = 0.0  # its front
    return Subject("stove", before, tuple(states), box, 0.003, (-130.0, -90.0, -50.0))


def plaque(lengths: Sequence[float]) -> Subject:
    """Return a plaque, three bosses on it moved by the lengths in turn along it and about their axes."""
    rng = np.random.default_rng(33)
    states = []
    for k in range(len(lengths)):
        moves = []
        for i, middle in enumerate(BOSSES):
            length = lengths[(k + i) % len(lengths)]
            angle = rng.uniform(0.0, 2.0 * np.pi)
            place = np.array([middle[0], 0.0, middle[1]])
            t = length * np.array([np.cos(angle), 0.0, np.sin(angle)])
            w = np.array([0.0, rng.choice([-1.0, 1.0]) * TURN * length / BOSS_RADIUS, 0.0])
            box = place + BOSS_RADIUS * np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
            moves.append(Move(f"boss {i + 1}", box, length, perturb(np.eye(4), place, np.concatenate([w, t]))))
        worn = np.array([[-0.07, 0.0, 0.08], [0.08, 0.0, 0.32]])
        states.append(State(_plaque_scene([m.T for m in moves], worn), tuple(moves), worn, 0.03))
    still = _plaque_scene([np.eye(4)] * len(BOSSES), np.empty((0, 3)))
    box = np.array([[-0.245, -0.05, 0.005], [0.245, 0.03, 0.395]])
    return Subject("plaque", still, tuple(states), box, 0.0015, (-120.0, -90.0, -60.0))


def _plaque_scene(motions: Sequence[Floats], worn: Floats) -> Scene:
    """Return the plaque with each boss moved, and 2 mm worn off at some places (n, 3) m."""
    x, z = np.meshgrid(np.arange(-0.25, 0.25, BOSS_CELL), np.arange(0.0, 0.4, BOSS_CELL), indexing="ij")
    out = 0.004 * np.sin(x / 0.03) * np.cos(z / 0.04)
    for place in worn:
        out -= 0.002 * np.exp(-0.5 * ((x - place[0]) ** 2 + (z - place[2]) ** 2) / 0.012**2)
    for middle, T in zip(BOSSES, motions, strict=True):
        at = apply(np.linalg.inv(T), np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1))
        u, v = at[:, 0] - middle[0], at[:, 2] - middle[1]
        away, ribs = np.hypot(u, v), np.cos(5.0 * np.arctan2(v, u))
        boss = BOSS_HEIGHT * np.clip((BOSS_RADIUS - away) / BOSS_WALL, -1.0, 1.0) + 0.0015 * ribs * np.minimum(
            away / BOSS_RADIUS, 1.0
        )
        out = np.maximum(out, boss.reshape(x.shape))
    faces = grid_faces(*x.shape)  # counter-clockwise from the front, which is -y
    vertices = np.stack([x.ravel(), -out.ravel(), z.ravel()], axis=1)
    return Scene("plaque", (Body("plaque", vertices, np.ascontiguousarray(faces, np.int32), 0.6),))


def _state(model: Model, moves: tuple[Move, ...], edits: Sequence[Edit], worn: Floats) -> State:
    shifts = [move_part(f"{m.name} moved", m.name, m.T) for m in moves]
    return State(build_scene(model, (*edits, *shifts)), moves, worn, 0.05)


def _on_surface(scene: Scene, near: Floats) -> Floats:
    """Return the places (n, 3) of the true surface that are nearest to some."""
    assert scene.truth is not None
    return np.asarray(scene.truth.closest_point(near))


def _extent(model: Model) -> Floats:
    """Return the box (2, 3) [m] about all parts, without the floor."""
    boxes = np.stack([part.bounds() for part in model.parts])
    box = np.stack([boxes[:, 0].min(axis=0) - 0.02, boxes[:, 1].max(axis=0) + 0.02])
    box[0, 2] = 0.02
    return box


def stations(subject: Subject, seed: int) -> tuple[Station, ...]:
    """Return those of an epoch: about the object, some 2.5 m before its surface."""
    rng = np.random.default_rng([seed, 34])
    middle, half = subject.box.mean(axis=0), 0.5 * np.linalg.norm(np.ptp(subject.box, axis=0)[:2])
    out = []
    for k, angle in enumerate(subject.angles, start=1):
        turn, distance = np.radians(angle + rng.normal(scale=6.0)), half + rng.uniform(2.2, 2.8)
        place = middle + distance * np.array([np.cos(turn), np.sin(turn), 0.0]) + [0.0, 0.0, rng.uniform(-0.5, 0.8)]
        pose = stand_at(place, facing=middle, heading=rng.uniform(-0.3, 0.3))
        given = misregister(pose, rng, sigma_position=2e-4, sigma_angle=3e-5)
        out.append(Station(f"station {k}", pose, subject.spacing / (distance - half), given))
    return tuple(out)


def compare_states(subject: Subject) -> list[Comparison]:
    """Return the comparisons of how a subject stood first with each of its states."""
    scenes = [subject.before, *(state.scene for state in subject.states)]
    dates = [f"20{20 + k}-05-01" for k in range(len(scenes))]
    with tempfile.TemporaryDirectory() as name:
        surveyed = [SurveyedEpoch(scene, stations(subject, k), datetime.date.fromisoformat(date))
                    for k, (scene, date) in enumerate(zip(scenes, dates, strict=True))]  # fmt: skip
        written = write_campaign(Path(name) / "scans", surveyed, INSTRUMENT, box=subject.box, seed=len(scenes))
        epochs = [front_door.Epoch(f"e{k}", date, [path])
                  for k, (date, path) in enumerate(zip(dates, written.epochs, strict=True))]  # fmt: skip
        project = front_door.process(Path(name), epochs, extent=written.extent)
        return [front_door.compare(project, "e0", epoch.name) for epoch in epochs[1:]]


def look(found: Comparison, state: State) -> tuple[list[Found], int, int]:
    """Return what was found of each move, how many parts lie in none, and how many worn places are called moved."""
    parts = found.statistics.get("parts", [])
    centres = np.array([part["centre"] for part in parts]).reshape(-1, 3)
    of_move = [((centres >= m.box[0] - m.length) & (centres <= m.box[1] + m.length)).all(axis=1) for m in state.moves]
    told = [_hold_against(parts, np.flatnonzero(inside), move)
            for move, inside in zip(state.moves, of_move, strict=True)]  # fmt: skip
    n_false = int(np.sum(~np.any(of_move, axis=0))) if len(parts) else 0
    moved = found.regions.loc[found.regions["kind"] == "moved", ["x", "y", "z"]].to_numpy(dtype=float)
    apart = np.linalg.norm(moved[:, None] - state.worn[None], axis=2)
    return told, n_false, int(np.sum((apart < state.radius + WORN_REACH).any(axis=1)))


def _hold_against(parts: Sequence[Mapping[str, Any]], which: Ints, move: Move) -> Found:
    """Return the largest of some parts against the move that it is of."""
    if not len(which):
        return Found(move.length)
    part = max((parts[int(k)] for k in which), key=lambda p: p["n_points"])
    centre = np.array(part["centre"])
    truth = np.concatenate([Rotation.from_matrix(move.T[:3, :3]).as_rotvec(), apply(move.T, centre[None])[0] - centre])
    error = np.array(part["motion"]) - truth
    return Found(move.length, error, float(error @ np.linalg.solve(np.array(part["covariance"]), error)))


def run(size: Size) -> list[Row]:
    """Move parts of each subject and say which are found, how true their motions are, and what is called so falsely."""
    makers: dict[Callable[[Sequence[float]], Subject], Sequence[float]] = (
        {attic: LENGTHS, stove: LENGTHS, plaque: LENGTHS} if size == "full" else {plaque: (0.004,)})  # fmt: skip
    rows, every = [], []
    for maker, lengths in makers.items():
        subject = maker(lengths)
        comparisons = compare_states(subject)
        looked = [look(found, state) for found, state in zip(comparisons, subject.states, strict=True)]
        all_found = [f for told, _, _ in looked for f in told]
        n_false, n_worn = (sum(one[k] for one in looked) for k in (1, 2))
        level = float(np.median([c.statistics["lod95_median_m"] for c in comparisons]))
        rows += [row_of(subject.name, length, all_found, level) for length in lengths]
        rows.append(Row(f"{subject.name}: parts where nothing moved, worn places called moved", f"{n_false}, {n_worn}",
                        value=float(n_false + n_worn)))  # fmt: skip
        every += [f for f in all_found if f.error is not None]
    inside = sum(f.squared < chi2.ppf(0.95, 6) for f in every)
    rows.append(Row("true motions within the 95 % ellipsoid", f"{inside} of {len(every)}",
                    value=inside / len(every) if every else np.nan))  # fmt: skip
    return rows


def row_of(name: str, length: float, found: Sequence[Found], level: float) -> Row:
    """Return how many of the parts that moved by a length were found, and how true their motions are."""
    which = [f for f in found if f.length == length]
    errors = [f.error for f in which if f.error is not None]
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else np.full(6, np.nan)
    others = {"shift off, mm rms": in_words(1e3 * float(np.sqrt(np.sum(rms[3:] ** 2)))),
              "turn off, mrad rms": in_words(1e3 * float(np.sqrt(np.sum(rms[:3] ** 2))), 2),
              "median level, mm": in_words(1e3 * level, 2)}  # fmt: skip
    return Row(f"{name}: moved by {1e3 * length:.0f} mm: found", f"{len(errors)} of {len(which)}", others=others,
               value=float(len(errors)))  # fmt: skip
