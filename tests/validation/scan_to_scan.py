"""Models of single scans compared two by two, as paper 002, fig. 3, and what the truth says of where they differ.

What counts is what `compare` assesses: at rims, where sheets contradict each other and where a model states no
uncertainty it says nothing, so no difference model shows a distance there. All that has a counterpart stands beside it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import front_door
import numpy as np
from rows import Row, in_percent, in_words, judge

from monitor.adjusted import move_cloud
from monitor.comparison import CompareSettings, compare
from monitor.comparison.distances.perpendicular import normal_distances
from monitor.reconstruction import reconstruct
from monitor.reconstruction.bow import bow_at
from monitor.simulation import Scene, Station
from monitor.simulation.scanner import Target, cast
from projects.model import Assessment, Bools, Floats, NotAssessed, Registration, Surface
from projects.transforms import invert

FARTHEST = 0.02  # m: models of single scans are compared up to here
BEAM = 0.003  # m, about a beam's diameter: where the range jumps that near, mixed pixels may lie
JUMP = 0.004  # m, off the plane of the surface
BEFORE = 1e-3  # m: what is met nearer than this before a point hides it


@dataclass(frozen=True)
class Differences:
    """Distances of single-scan models.

    Attributes
    ----------
    distances : (n,) m, each vertex of one model along the other's normal, where the other has a surface.
    is_assessed : (n,), whether `compare` says what has changed there.
    both_see : (n,), whether both stations truly see the true surface there.
    is_free : (n,), whether to both the range jumps nowhere within `BEAM` about it.
    """

    distances: Floats
    is_assessed: Bools
    both_see: Bools
    is_free: Bools

    def where(self, which: Bools) -> Differences:
        """Return those differences only."""
        return Differences(
            *(getattr(self, name)[which] for name in ("distances", "is_assessed", "both_see", "is_free"))
        )


def network_motions(project: Path, epoch: str) -> list[Floats]:
    """Return where the registration put each scan, T_project_given (4, 4)."""
    network: dict[str, Any] = front_door.product(project, epoch, "network")
    return list(network["T_project_given"])


def true_motions(stations: Sequence[Station]) -> list[Floats]:
    """Return the motion (4, 4) from the stated pose of each station to its true one."""
    return [
        np.eye(4) if s.registered is None else s.T_project_scanner @ invert(s.registered) for s in stations
    ]  # fmt: skip


def differ(
    project: Path, epoch: str, motions: Sequence[Floats], stations: Sequence[Station], scene: Scene
) -> Differences:
    """Return how the models of the filtered scans, each moved from its stated pose, lie from each other."""
    clouds = [front_door.product(project, epoch, f"scan{k:03d}") for k in range(len(motions))]
    models = [reconstruct(move_cloud(cloud, T)) for cloud, T in zip(clouds, motions, strict=True)]
    target, found = Target.of(scene, 2), []
    seen = [[_look_all(target, scene, one, station) for station in stations] for one in models]
    for k, m in itertools.combinations(range(len(models)), 2):
        sides = _assessed(models[k], models[m])
        for one, other, is_assessed in ((k, m, sides[0]), (m, k, sides[1])):
            pair = normal_distances(models[one], models[other], FARTHEST)
            known = pair.reasons == NotAssessed.ASSESSED
            both, free = (seen[one][k][which] & seen[one][m][which] for which in (0, 1))
            distances = pair.distances - bow_at(models[other], pair.faces, pair.weights)
            found.append((distances[known], is_assessed[known], both[known], free[known]))
    return Differences(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _assessed(one: Surface, other: Surface) -> tuple[Bools, Bools]:
    """Return where `compare` assesses two models in one frame, on each of them."""
    n = len(other.vertices)
    in_place = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True, stable_share=1.0,
                            is_stable=np.ones(n, dtype=bool))  # fmt: skip
    result = compare(one, other, in_place, CompareSettings(search_limit=FARTHEST))
    states = result.on_reference.assessment, result.on_compared.assessment
    return states[0] != Assessment.NOT_ASSESSABLE, states[1] != Assessment.NOT_ASSESSABLE


def _look_all(target: Target, scene: Scene, model: Surface, station: Station) -> tuple[Bools, Bools]:
    """Return `_look` of a station at where the vertices of a model truly lie."""
    assert scene.truth is not None
    feet = scene.truth.closest_point(model.vertices)
    return _look(target, station.T_project_scanner[:3, 3], feet, scene.truth.normal(model.vertices))


def _look(target: Target, eye: Floats, points: Floats, normals: Floats) -> tuple[Bools, Bools]:
    """Return whether a scanner at `eye` sees points of the surface, and whether the range jumps nowhere near them."""
    away = points - eye
    r = np.linalg.norm(away, axis=1)
    beam = away / r[:, None]
    height = (away * normals).sum(axis=1)
    sees = (height < 0.0) & (_ranges(target, eye, beam) > r - BEFORE)
    side = np.cross(beam, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    free = np.ones(len(points), dtype=bool)
    for turn in np.arange(8) * np.pi / 4:
        ray = beam + BEAM / r[:, None] * (np.cos(turn) * side + np.sin(turn) * np.cross(side, beam))
        slope = (ray * normals).sum(axis=1)
        on_plane = height / np.where(np.abs(slope) < 1e-3, -1e-3, slope)
        free &= np.abs(_ranges(target, eye, ray) - on_plane) < JUMP
    return sees, sees & free


def _ranges(target: Target, eye: Floats, rays: Floats) -> Floats:
    """Return how far rays (n, 3) from `eye` go, in their own lengths; inf where they meet nothing."""
    starts = np.broadcast_to(eye, rays.shape)
    found: Floats = cast(target, np.concatenate([starts, rays], axis=1).astype(np.float32)[:, None], 2).t[:, 0]
    return found


def rows_of(as_registered: Differences, at_truth: Differences) -> list[Row]:
    """Return the share within 1 mm as the paper has it, and beside it what the instrument could reach."""
    assessed, at_truth = as_registered.where(as_registered.is_assessed), at_truth.where(at_truth.is_assessed)
    within = _within(assessed.distances)
    share = float(np.mean(as_registered.is_assessed))
    far = np.abs(assessed.distances) >= 0.001
    hidden = float(np.mean(~assessed.both_see[far])) if far.any() else 0.0
    cause = (
        f"{in_percent(hidden)} of what lies beyond 1 mm is surface that one of the two scans does not truly see, where "
        "its model can only rest on mixed pixels or close a gap; the registration takes "
        f"{in_words(100.0 * (_within(at_truth.distances) - within), 1)} % of the whole"
    )
    return [
        Row("scan to scan within 1 mm, where assessed", in_percent(within, 1), judge(within >= 0.95),
            "differences < 1 mm", "95 %", _rms(assessed.distances), within, "" if within >= 0.95 else cause),
        Row("share assessed of what has a counterpart", in_percent(share), value=share),
        _stated("all that has a counterpart, rims and contradicting sheets too", as_registered.distances),
        _stated("where assessed, at the scans' true poses", at_truth.distances),
        _stated("of that, where both scans see the true surface", at_truth.where(at_truth.both_see).distances),
        _stated("of that, where no range jumps within a beam", at_truth.where(at_truth.is_free).distances),
    ]  # fmt: skip


def _stated(what: str, distances: Floats) -> Row:
    return Row(what, in_percent(_within(distances), 1), others=_rms(distances), value=_within(distances))


def _within(distances: Floats) -> float:
    return float(np.mean(np.abs(distances) < 0.001))


def _rms(distances: Floats) -> dict[str, str]:
    return {"rms, mm": in_words(1e3 * float(np.sqrt(np.mean(distances**2))), 2)}
