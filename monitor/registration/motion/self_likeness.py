"""Where a surface lies on what looks alike once it is moved: steps of a stair, periods of a relief, flutes of a column.

In: a fit of two surfaces. Out: steps, as transforms after the pose found, worth a try: shifts by the correlation of the
fields of normals, turns about the axis that the coarse shape leaves free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage
from scipy.spatial.transform import Rotation

from monitor.registration.motion.alignment import AlignmentRules
from monitor.registration.motion.matching import Matches, Samples
from monitor.registration.motion.sampling import cell_numbers, lever_of, motion_rows
from monitor.registration.motion.sides import Side
from projects.model import Floats
from projects.transforms import apply

N_VOXELS = 250_000  # of the grid in which the surface is laid over itself: a thirtieth of a second
FARTHEST = 0.5  # of the extent along each axis: how far it is laid aside
ALIKE = 0.4  # of the surface that looks alike, laid aside, for a place to be tried
MOST_TRIED = 3
LOWEST_SHAPE = 1e-3  # of the information of all normals: what less holds is noise
COARSE_CELLS = 8.0  # along the longest extent: ornament is gone, the body is left
ROUND = 0.05  # of the mean information of the coarse shape: a turn that less holds is tried all around
N_TURNS, N_TURNED = 120, 100
N_OF_BODY = 5_000  # pairs that tell the coarse shape
SAME = 3.0  # voxels, within which a shift is none


@dataclass(frozen=True)
class Fit:
    """A fit of two surfaces: samples and target, where it ended, its pairs and one sigma [m] of them."""

    samples: Samples
    target: Side
    T_target_source: Floats
    matches: Matches
    sigma: float
    rules: AlignmentRules
    both_oriented: bool


@dataclass(frozen=True)
class Steps:
    """Motions (4, 4) after the pose found that are worth a try, how far around each to look, `reach` [m], and the rms
    way [m] below which they are none, `least`."""

    motions: list[Floats]
    reach: float
    least: float


def alike_shifts(fit: Fit) -> Steps:
    """Return the shifts under which much of the surface lies on what looks alike.

    They are the maxima of the correlation of both sides' normals over all shifts at once (by FFT), each component by
    what it holds, sum n' (sum n n')^-1 n, so that a relief counts as much as the wall that it is on.
    """
    pairs, target = fit.matches, fit.target.points[fit.matches.target]
    corner = np.minimum(pairs.points.min(axis=0), target.min(axis=0))
    extent = np.maximum(pairs.points.max(axis=0), target.max(axis=0)) - corner
    voxel, shape = choose_grid(extent)
    held = pairs.normals_source.T @ pairs.normals_target / max(len(pairs), 1)
    values, vectors = np.linalg.eigh(0.5 * (held + held.T))
    turned = vectors / np.sqrt(np.maximum(values, LOWEST_SHAPE))
    one = fields(pairs.points - corner, pairs.normals_source @ turned, voxel, shape)
    other = fields(target - corner, pairs.normals_target @ turned, voxel, shape)
    alike = correlate_fields(one, other)
    most = [int(FARTHEST * e / voxel) for e in extent]
    peaks = (alike == ndimage.maximum_filter(alike, size=3, mode="wrap")) & (alike > ALIKE * alike[0, 0, 0])
    places = np.argwhere(peaks)
    height = alike[peaks]
    shifts = np.where(places > np.array(shape) // 2, places - np.array(shape), places)
    keep = (np.linalg.norm(shifts, axis=1) > SAME) & np.all(np.abs(shifts) <= most, axis=1)
    best = np.flatnonzero(keep)[np.argsort(-height[keep], kind="stable")[:MOST_TRIED]]
    return Steps([as_shift(voxel * shifts[k]) for k in best], 2.0 * voxel, SAME * voxel)


def as_shift(way: Floats) -> Floats:
    """Return the transform that moves by `way` (3,) [m]."""
    T = np.eye(4)
    T[:3, 3] = way
    return T


def choose_grid(extent: Floats) -> tuple[float, tuple[int, ...]]:
    """Return the edge [m] of the voxels of a box and their numbers, with room to be laid aside."""
    room, low, high = (1.0 + FARTHEST) * extent, 1e-9 + float(extent.max()) * 1e-4, float(extent.max())
    for _ in range(30):
        voxel = float(np.sqrt(low * high))
        if np.prod(room / voxel + 2.0) > N_VOXELS:
            low = voxel
        else:
            high = voxel
    return high, tuple(int(fft.next_fast_len(int(n) + 2, real=True)) for n in room / high)


def fields(points: Floats, vectors: Floats, voxel: float, shape: tuple[int, ...]) -> Floats:
    """Return the mean vectors of the points in each voxel, (3, *shape)."""
    cells = np.minimum((points / voxel).astype(np.int64), np.array(shape) - 1)
    number = np.ravel_multi_index(tuple(cells.T), shape)
    count = np.maximum(np.bincount(number, minlength=int(np.prod(shape))), 1)
    sums = [np.bincount(number, column, len(count)) / count for column in vectors.T]
    return np.array(sums, dtype=np.float32).reshape(3, *shape)


def correlate_fields(one: Floats, other: Floats) -> Floats:
    """Return how alike the fields are with the first moved by whole voxels, *shape, wrapped around."""
    axes = (1, 2, 3)
    product = np.sum(np.conj(fft.rfftn(one, axes=axes)) * fft.rfftn(other, axes=axes), axis=0)
    shape = one.shape[1:]
    for axis, n in enumerate(shape):  # surfaces are thinner than voxels: blur by one
        f = fft.rfftfreq(n) if axis == 2 else fft.fftfreq(n)
        product *= (
            np.exp(-2.0 * (np.pi * f) ** 2).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
        )
    return np.asarray(fft.irfftn(product, s=shape, axes=(0, 1, 2)))


def alike_turns(fit: Fit) -> Steps:
    """Return the turns about the axis that the coarse shape leaves free after which the surfaces lie near each other,
    the smallest first; none where the coarse shape holds all."""
    found = free_turn(fit.matches)
    if found is None:
        return Steps([], 0.0, 0.0)
    axis, through = found
    places = apply(fit.T_target_source, fit.samples.points)
    places = places[:: max(len(places) // N_TURNED, 1)]
    angles = 2.0 * np.pi * fft.fftfreq(N_TURNS)
    turns = [about_axis(axis, through, angle) for angle in angles]
    moved = np.concatenate([apply(T, places) for T in turns])
    limit = float(np.ptp(places, axis=0).max()) / COARSE_CELLS
    distance, nearest = fit.target.tree.query(moved, distance_upper_bound=limit)
    apart, near = np.full(len(moved), limit), np.isfinite(distance)
    offsets, normals = moved[near] - fit.target.points[nearest[near]], fit.target.normals_of(nearest[near])
    apart[near] = np.abs(np.einsum("ij,ij->i", offsets, normals))
    apart = apart.reshape(N_TURNS, -1).mean(axis=1)
    lowest = (apart <= np.roll(apart, 1)) & (apart <= np.roll(apart, -1)) & (apart < np.median(apart))
    lowest[[0, 1, -1]] = False
    around = np.flatnonzero(lowest)
    nearest_first = around[np.argsort(np.abs(angles[around]), kind="stable")]
    arc = 2.0 * np.pi / N_TURNS * float(np.sqrt(np.mean(np.sum(np.cross(places - through, axis) ** 2, axis=1))))
    return Steps([turns[k] for k in nearest_first[:MOST_TRIED]], 2.0 * arc, arc)


def free_turn(matches: Matches) -> tuple[Floats, Floats] | None:
    """Return the axis (3,) and a point on it (3,) [m] of the turn that the coarse shape, without ornament, does not
    hold; None where it holds all."""
    matches = matches.take(np.arange(len(matches)) % max(len(matches) // N_OF_BODY, 1) == 0)
    cell = float(np.ptp(matches.points, axis=0).max()) / COARSE_CELLS + 1e-12
    member = np.unique(cell_numbers(matches.points, cell), return_inverse=True)[1]
    centre = matches.points.mean(axis=0)
    lever = lever_of(matches.points, centre) + 1e-12
    scale = np.repeat([1.0 / lever, 1.0], 3)
    rows = motion_rows(matches.points, matches.normals, centre) * scale
    count = np.bincount(member)
    rows = np.stack([np.bincount(member, column) / count for column in rows.T], axis=1)
    values, vectors = np.linalg.eigh(rows.T @ (rows * count[:, None]))
    motion = scale * vectors[:, 0]
    w, t = motion[:3], motion[3:]
    if values[0] > ROUND * values.mean() or np.linalg.norm(w) * lever < np.linalg.norm(t):
        return None
    length = float(np.linalg.norm(w))
    return w / length, centre + np.cross(w, t) / length**2


def about_axis(axis: Floats, through: Floats, angle: float) -> Floats:
    """Return the turn (4, 4) by `angle` [rad] about an axis through a point."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix()
    T[:3, 3] = through - T[:3, :3] @ through
    return T
