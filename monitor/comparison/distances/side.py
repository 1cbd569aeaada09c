"""One side of a comparison while it is worked on: a surface, its change at each vertex, and what limits it.

Everything is in the reference epoch's coordinates; distances are positive where material was gained, on both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numba import jit

from monitor.blocks import blocks
from monitor.comparison.distances.judging import NOTHING, Stated, judge_vertices
from monitor.comparison.distances.perpendicular import distances_to_shell, interpolate_at_feet, unit_normals
from monitor.comparison.distances.quantile import median, quantile
from monitor.comparison.distances.rim import distance_to_rim
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.shell import Shell
from monitor.comparison.distances.stars import Neighbours
from monitor.reconstruction.bow import bow_at
from monitor.registration.motion.propagation import propagate
from monitor.robust import MAD_TO_SIGMA
from monitor.threads import map_threads, run_tasks
from projects.model import Bools, Floats, Ints, NotAssessed, Registration, Surface
from projects.transforms import apply, invert, rotate
from projects.triangles import area_vectors, rest_on_nothing

Made = TypeVar("Made")

EXTRAPOLATED = 1.5  # spacings of the vertices from a free edge: samples lie on one side only, or are none
LEAST_SPREAD = 1.1  # of the farthest third's beginning to the nearest third's end; or, where noise is stated,
LEAST_NOISES = 20.0  # of noise between them; else noise decides who is in which
OFF_SAMPLES = 0.3  # spacings of the vertices from the nearest sample, up to which a place was sampled
AT_ONCE = 2_000_000  # vertices of either side up to which both are worked on at once
MOVED_AT_ONCE = 1 << 14  # vertices
N_DRAWN = 200_000  # vertices that show where a third of the lever arm ends, and what is stated of most, at even steps
STATED_STEPS = np.array([4.0])  # times what the surfaces state of most vertices, where one class of it ends
GAP_STEPS = np.array([0.75, 1.0])  # spacings of the vertices to the nearest sample, where one class of gap ends


@dataclass(frozen=True)
class Side:
    """A surface and its change; arrays over its n vertices.

    `foot_faces` are the faces of the other surface that hold the feet, `foot_vertices` their corners next to these, -1
    without a foot; `distances` [m] are NaN where `reasons` (`NotAssessed`) is not 0; `neighbours` are those along the
    surface's edges; `areas` [m2] are a third of the faces around; `is_fringe` is where the surface goes on beyond its
    samples (`fringe_of`), and is no area of the object; `to_rim` [m] is how far the vertex or its foot is from a free
    edge of its surface, the nearer one; `sigma_surfaces` [m] is the noise of both surfaces there,
    `sigma_discord` [m] what their neighbouring fits contradict each other by (`discord`), `sigma_shared` [m] what the
    scans of the two epochs disagree by (common to a neighbourhood), `sigma_motion` [m] that of the registration (common
    to the whole). Where the motion between the epochs stays in the distances, `expected` [m] is what it alone makes of
    them, with one sigma `sigma_expected` [m]; else it is 0, and the sigma that of the motion. `view`, `gap`,
    `stated` and `arm` are classes, 0 the best or not known: how steeply the worse seen epoch saw the place (`views`),
    how far the vertex or its foot, whichever is farther, is from a sample, how much more the surfaces state than of
    most vertices, and the third of the lever arm. `n_scans` is how many scans the epoch of fewer has; 0: not known.
    `limb` [m] is what the scans of an epoch that saw the place only steeply err by beyond `sigma_shared`, common to a
    neighbourhood, too (`sight.limbs`); None: nowhere.
    """

    surface: Surface
    other: Surface
    foot_faces: Ints
    foot_vertices: Ints
    normals: Floats
    neighbours: Neighbours
    areas: Floats
    is_fringe: Bools
    distances: Floats
    to_rim: Floats
    sigma_surfaces: Floats
    sigma_discord: Floats
    sigma_shared: Floats
    sigma_motion: Floats
    is_stable: Bools
    reasons: Ints
    expected: Floats
    sigma_expected: Floats
    view: Ints
    gap: Ints
    stated: Ints
    arm: Ints
    n_scans: int = 0
    limb: Floats | None = None

    @property
    def is_assessed(self) -> Bools:
        """Where the change could be measured."""
        return self.reasons == NotAssessed.ASSESSED

    @property
    def spacing(self) -> float:
        """The spacing [m] of the vertices."""
        return spacing_of(self.areas)

    @property
    def measured_areas(self) -> Floats:
        """The areas (n,) [m2] less those beyond the samples, which are 0."""
        return np.where(self.is_fringe, 0.0, self.areas)

    @property
    def sigma_common(self) -> Floats:
        """One sigma [m] of the errors that no averaging over neighbours removes: scans and registration."""
        return np.hypot(self.sigma_scans, self.sigma_motion)

    @property
    def sigma_scans(self) -> Floats:
        """One sigma [m] of what the scans of the two epochs err by, as stated, at limbs too."""
        return self.sigma_shared if self.limb is None else np.hypot(self.sigma_shared, self.limb)

    def limb_of(self, which: Ints | slice = slice(None)) -> Floats:
        """Return the part of it (n,) [m] that is of limbs, of each vertex or of those in `which`."""
        return np.zeros(len(self.areas[which])) if self.limb is None else self.limb[which]

    @property
    def states_noise(self) -> bool:
        """Whether both surfaces state the noise of their vertices; a finished mesh does not."""
        return self.surface.sigma is not None and self.other.sigma is not None

    def without(self, which: Bools, reason: NotAssessed) -> Side:
        """Return the side whose vertices in `which` (n,) are not assessable for this reason."""
        reasons = np.where(which, reason, self.reasons).astype(self.reasons.dtype)
        return replace(self, reasons=reasons, distances=keep_on_disk(np.where(which, np.nan, self.distances)))

    def without_motion(self) -> Side:
        """Return the side with the motion of the whole taken off: what is left is error where nothing else changed."""
        return replace(self, distances=self.distances - self.expected, sigma_motion=self.sigma_expected,
                       expected=np.zeros(len(self.expected)))  # fmt: skip


def map_sides(function: Callable[[int], Made], n_vertices: int) -> tuple[Made, Made]:
    """Return what `function` makes of side 0 and of side 1: at once, in threads, where each has few vertices.

    What is needed in between would else be needed twice. `function` may start no kernel with `parallel=True`, of which
    there can be one at a time.
    """
    first, second = map_threads(function, (0, 1)) if n_vertices <= AT_ONCE else (function(0), function(1))
    return first, second


def larger_of(sides: tuple[Side, Side]) -> int:
    """Return how many vertices the larger side has."""
    return max(len(s.areas) for s in sides)


def move_surface(surface: Surface, T_target_source: Floats) -> Surface:
    """Return the surface in the target's coordinates."""
    normals = None if surface.normals is None else rotate(T_target_source, surface.normals)
    vertices = np.empty(surface.vertices.shape)
    for first in range(0, len(vertices), MOVED_AT_ONCE):  # one product of all takes four times as long
        block = slice(first, first + MOVED_AT_ONCE)
        vertices[block] = apply(T_target_source, surface.vertices[block])
    vertices = keep_on_disk(vertices)
    return replace(surface, vertices=vertices, normals=None if normals is None else keep_on_disk(normals))


def drop_contradicted(side: Side, back: Side) -> Side:
    """Return the side without the vertices whose change the other surface contradicts, seen from the foot.

    Where two sheets lie close, or a surface was seen in one epoch only, a vertex may find the wrong sheet: from there
    the change looks less than half as large, beyond four sigma. Such a vertex is not assessable.
    """
    sigma = np.hypot(np.hypot(side.sigma_surfaces, side.sigma_common), unstated_noise(side))
    seen_back = np.where(back.is_assessed, back.distances, np.nan)[side.foot_vertices]
    contradicted = side.is_assessed & (np.abs(side.distances) > 2.0 * np.abs(seen_back) + 4.0 * sigma)
    return side.without(contradicted, NotAssessed.SHEET_BETWEEN)


def unstated_noise(side: Side) -> float:
    """Return the scatter [m] of the distances where a surface states no noise, 0 where both do."""
    if side.states_noise or not side.is_assessed.any():
        return 0.0
    return MAD_TO_SIGMA * median(np.abs(side.distances[side.is_assessed]))


def measure_side(shell: Shell, other_shell: Shell, sign: float, registration: Registration,
                 left: Registration | None) -> Side:  # fmt: skip
    """Measure one side against the other; `sign` is +1 on compared, -1 on reference.

    `registration` is what the frames of both are held by, `left` the motion that stays in the distances. The change is
    the perpendicular distance to the other surface, which between the corners of a face is not flat (`bow_at`).

    A stated sigma that is NaN makes the vertex too uncertain; a surface that states none at all leaves its noise to
    the floor that the stable areas show. Near a free edge of either surface the surface goes on beyond its samples, so
    nothing is said there.
    """
    surface, other = shell.surface, other_shell.surface
    normals = unit_normals(surface, shell.normals)
    feet = distances_to_shell(surface, normals, other_shell)
    stated = Stated(_or_nothing(surface.sigma), shell.discord), Stated(_or_nothing(other.sigma), other_shell.discord)
    own_rim = NOTHING if shell.rim is None else distance_to_rim(shell.rim, surface.vertices)
    least_to_rim = EXTRAPOLATED * spacing_of(shell.areas)
    judged = judge_vertices(feet, np.asarray(other.faces), stated, bow_at(other, feet.faces, feet.weights), own_rim,
                            _unmeasured(surface), sign, least_to_rim)  # fmt: skip
    sigma, reasons, corners = judged.sigma, judged.reasons, judged.corners
    motion = keep_on_disk(_motion_sigma(registration, surface.vertices, normals))
    is_stable = np.zeros(len(normals), dtype=np.bool_)
    shared, noise = np.zeros(len(normals)), sigma
    if surface.sigma_shared is not None or other.sigma_shared is not None:
        shared = np.hypot(_shared_sigma(surface), interpolate_at_feet(_shared_sigma(other), other, feet))
        shared[~np.isfinite(shared)] = 0.0
        shared, noise = keep_on_disk(shared), np.hypot(sigma, shared)
    expected = np.zeros(len(normals)) if left is None else expected_change(surface.vertices, normals, left, sign)
    sigma_expected = motion if left is None else _motion_sigma(left, surface.vertices, normals)
    return Side(
        surface, other, keep_on_disk(feet.faces), keep_on_disk(corners), normals, shell.neighbours, shell.areas,
        fringe_of(surface, own_rim, shell.areas), keep_on_disk(judged.distances), keep_on_disk(judged.to_rim),
        keep_on_disk(sigma), keep_on_disk(judged.discord), shared, motion, is_stable, reasons,
        expected, sigma_expected, np.zeros(len(normals), dtype=np.uint8),
        np.maximum(_gap_of(shell), np.append(_gap_of(other_shell), np.uint8(0))[corners]),
        class_of_stated(sigma, reasons == NotAssessed.ASSESSED),
        thirds_of(surface.vertices, registration.centre, reasons == NotAssessed.ASSESSED, noise),
    )  # fmt: skip


def spacing_of(areas: Floats) -> float:
    """Return the spacing [m] of vertices of such areas (n,) [m2]."""
    return float(np.sqrt(median(areas)))


def fringe_of(surface: Surface, to_own_rim: Floats, areas: Floats) -> Bools:
    """Return where a surface goes on beyond its samples (n,): where it rests on nothing, and away from samples, next
    to its own free edges, which are `to_own_rim` (n,) [m] away; there not on a surface that does not state how far its
    samples are, as a finished mesh, which ends where its maker let it end.

    A surface ends where nothing was sampled for some cells. Of plates sampled every 2 and 4 mm the whole surface is 2.2
    to 3.0 spacings of the points wider than the plate on each side, less its fringe -0.1 to 0.5 (`test_fringe`).
    """
    out = np.zeros(len(areas), dtype=np.bool_)
    if surface.sample_distance is not None and len(to_own_rim):
        spacing = spacing_of(areas)
        out = (to_own_rim < EXTRAPOLATED * spacing) & (surface.sample_distance > OFF_SAMPLES * spacing)
    return np.asarray(out if surface.face_invented is None else out | rest_on_nothing(surface))


def thirds_of(points: Floats, centre: Floats, is_assessed: Bools, noise: Floats) -> Ints:
    """Return the third (n,) uint8 of the distance to `centre` that each vertex lies in, of those assessed.

    Of a round body, whose lever arms are all alike, it is 0: which third a vertex is in would tell its `noise` (n,)
    [m], as far as that is stated.
    """
    places, out = np.flatnonzero(is_assessed), np.zeros(len(points), dtype=np.uint8)
    if not len(places):
        return out
    some = np.linalg.norm(points[places[:: max(len(places) // N_DRAWN, 1)]] - centre, axis=1)
    thirds = [quantile(some, 1.0 / 3.0), quantile(some, 2.0 / 3.0)]
    typical = median(noise[places])
    is_told = typical > 0.0 and thirds[1] - thirds[0] > LEAST_NOISES * typical
    if thirds[1] < LEAST_SPREAD * thirds[0] and not is_told:
        return out
    run_tasks(_write_thirds, len(out), points, centre, thirds[0], thirds[1], out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def _write_thirds(first, last, points, centre, near, far, out):  # type: ignore[no-untyped-def]
    """Write the third (0 near, 1, 2 far) of the lever arm about `centre` of the vertices `first` to `last`."""
    for v in range(first, last):
        x, y, z = points[v, 0] - centre[0], points[v, 1] - centre[1], points[v, 2] - centre[2]
        arm = np.sqrt(x * x + y * y + z * z)
        out[v] = np.uint8(not arm < near) + np.uint8(not arm < far)


def _or_nothing(stated: Floats | None) -> Floats:
    """Return what is stated of a surface's vertices (n,), empty where nothing is."""
    return NOTHING if stated is None else np.asarray(stated, dtype=float)


def _motion_sigma(registration: Registration, points: Floats, normals: Floats) -> Floats:
    """Return one sigma (n,) [m] along the normals that the uncertainty of a motion causes."""
    return propagate(registration.covariance, registration.centre, points, normals)


def _gap_of(shell: Shell) -> Ints:
    """Return the class (n,) uint8 of how far each vertex is from a sample; 0 where the surface does not say."""
    distance = shell.surface.sample_distance
    if distance is None:
        return np.zeros(len(shell.areas), dtype=np.uint8)
    return np.searchsorted(GAP_STEPS, distance / np.sqrt(median(shell.areas)), side="right").astype(np.uint8)


def class_of_stated(sigma: Floats, is_assessed: Bools) -> Ints:
    """Return the class (n,) uint8 of how much more is stated of each vertex, `sigma` (n,) [m], than of most of those
    assessed; 0 where nothing is."""
    places, out = np.flatnonzero(is_assessed), np.zeros(len(sigma), dtype=np.uint8)
    usual = median(sigma[places[:: max(len(places) // N_DRAWN, 1)]]) if len(places) else 0.0
    for block in blocks(len(sigma) if usual > 0.0 else 0):
        out[block] = np.searchsorted(STATED_STEPS * usual, np.nan_to_num(sigma[block]), side="right")
    return out


def expected_change(points: Floats, normals: Floats, left: Registration, sign: float) -> Floats:
    """Return the change (n,) [m] along the normals that the motion between the epochs alone makes.

    What lay at x in the reference epoch lies at T^-1 x in the compared one, what lies there at y lay at T y.
    """
    T = left.T_target_source if sign > 0.0 else invert(left.T_target_source)
    return np.asarray(sign * np.einsum("ij,ij->i", normals, points - apply(T, points)))


def _shared_sigma(surface: Surface) -> Floats:
    """Return what the scans of a surface disagree by (n,) [m]; 0 where nothing shows it: the floor then holds it."""
    if surface.sigma_shared is None:
        return np.zeros(len(surface.vertices))
    return np.where(np.isfinite(surface.sigma_shared), surface.sigma_shared, 0.0)


def cosine_to_foot(side: Side, vertices: Ints) -> Floats:
    """Return the cosine between a vertex's normal and the way to its foot, which is the normal of the foot's face."""
    corners = side.other.vertices[side.other.faces[side.foot_faces[vertices]]]
    normal = area_vectors(corners)
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    return np.clip(np.einsum("ij,ij->i", normal, side.normals[vertices]) / length, 0.0, 1.0)


def _unmeasured(surface: Surface) -> Bools:
    """Return which vertices (n,) nobody measured; empty where no face is invented."""
    return np.zeros(0, dtype=np.bool_) if surface.face_invented is None else rest_on_nothing(surface)
