"""Three planes that meet at a point, fitted to the points around it.

In: points near a place where edges run into each other, and the normals of the sides. Out: a `Corner`, or None where
three planes do not hold. What the surface is at a place is the highest or the lowest of its heights over the planes, or
one plane and what two others make there (`SHAPES`): the one that leaves least of the points. Points err along their own
side's normal, and a plane is fitted to those that lie clear of the others, so that none is taken for its neighbour's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from monitor.across import frames_across
from monitor.reconstruction.roofs import BEYOND_NOISE, COS_CLEAR, NOISE_MARGIN
from projects.model import Bools, Floats, Ints

FEWEST = 12  # points of each plane, clear of the others
WITHIN, CLEAR = 4.0, 3.0  # sigmas of noise: of a plane, and off the others
COS_SHEET = 0.0  # what looks away from all three is of another sheet
FLAT = 0.2  # volume that the normals span, below which three planes have no point
CLIPPED2 = 9.0  # of a squared residual, in variances
GAIN = 10.0  # what a smooth patch leaves more, in variances: as of one roof alone
N_ROUNDS = 6
ASTRAY = 2.0  # cells: how far from where it was sought it may be
BESIDE = 1.5  # cells: points as near to its edges tell whether these are rounded
SHAPES = tuple((apart, sign) for sign in (1, -1) for apart in (-1, 0, 1, 2))  # the plane apart from both others, -1 for
# none; the surface is the higher of it and of the lower of the others (of none: the highest of all), -1 upside down


class Corner(NamedTuple):
    """Three planes with unit `normals` (3, 3) through `place` (3,) m and what the surface is of them: one of `SHAPES`.

    `errors` (3, 3, 3): covariance of each plane's height at the corner (m) and its slopes along `frames` (3, 2, 3);
    `support` (3,) points; `radius` (m) of the window; by how many standard errors its edges are rounded.
    """

    place: Floats
    normals: Floats
    shape: tuple[int, int]
    errors: Floats
    frames: Floats
    support: Floats
    radius: float
    rounding: float


class Plane(NamedTuple):
    """One plane as a regression along the normal that it had: unit normal (3,), height (m) over the place, covariance
    (3, 3) of height and slopes, frame (2, 3) of the slopes, and how many points it rests on."""

    normal: Floats
    height: float
    errors: Floats
    frame: Floats
    support: int


class Around(NamedTuple):
    """Points (k, 3) m around a place, their weights (k,) and one sigma of their noise (m)."""

    points: Floats
    weights: Floats
    noise: float


def fit_corner(place: Floats, normals: Floats, around: Around, radius: float, cell: float) -> Corner | None:
    """Return the corner of three planes that look about along `normals` (3, 3), near a place (3,); `cell` (m).

    None where a plane has too few points, two are alike, the planes leave more than noise, or a smooth patch would do.
    """
    start, shape, planes = place, SHAPES[0], list[Plane]()
    for _ in range(N_ROUNDS):
        heights = (around.points - place) @ normals.T
        shape = min(SHAPES, key=lambda one: left_by(height_over(heights, one), around))
        found = [fit_plane(a, place, normals[a], heights, shape, around) for a in range(3)]
        planes = [plane for plane in found if plane is not None]
        if len(planes) < 3:
            return None
        normals = np.array([plane.normal for plane in planes])
        if not have_a_point(normals[None])[0]:
            return None
        place = place + np.linalg.solve(normals, [plane.height for plane in planes])
    if np.linalg.norm(place - start) > ASTRAY * cell or not holds(place, normals, shape, around):
        return None
    errors, frames = np.array([plane.errors for plane in planes]), np.array([plane.frame for plane in planes])
    corner = Corner(
        place, normals, shape, errors, frames, np.array([plane.support for plane in planes]), radius, np.nan
    )
    return corner._replace(rounding=rounding(corner, around, BESIDE * cell))


def have_a_point(normals: Floats) -> Bools:
    """Whether each three planes with unit normals (k, 3, 3) meet at a point, and each two of them at an edge."""
    most = np.max([np.einsum("ij,ij->i", normals[:, a], normals[:, b]) for a, b in ((0, 1), (1, 2), (2, 0))], axis=0)
    meet: Bools = (np.abs(np.linalg.det(normals)) > FLAT) & (most < COS_CLEAR)
    return meet


def fit_plane(
    a: int, place: Floats, normal: Floats, heights: Floats, shape: tuple[int, int], around: Around
) -> Plane | None:
    """Return plane a fitted to the points on it, clear of the others; None without enough of them.

    Heights (k, 3) of the points are over the planes as they were.
    """
    clear = np.abs(np.delete(heights, a, axis=1)).min(axis=1) > CLEAR * around.noise
    mine = clear & (plane_under(heights, shape) == a) & (np.abs(heights[:, a]) < WITHIN * around.noise)
    if np.count_nonzero(mine) < FEWEST:
        return None
    frame, weights = frame_across(normal), around.weights[mine]
    rows = np.column_stack([np.ones(len(weights)), (around.points[mine] - place) @ frame.T])
    if np.linalg.matrix_rank(rows) < 3:  # points in one line
        return None
    inverse = np.linalg.inv(rows.T @ (weights[:, None] * rows))
    height, *slopes = inverse @ (rows.T @ (weights * heights[mine, a]))
    errors = around.noise**2 * inverse @ (rows.T @ (weights[:, None] ** 2 * rows)) @ inverse
    turned = normal - slopes @ frame
    length = float(np.linalg.norm(turned))
    return Plane(turned / length, float(height) / length, errors, frame, len(weights))


def frame_across(normal: Floats) -> Floats:
    """Return two unit vectors (2, 3) at right angles to a unit normal and to each other."""
    return np.concatenate(frames_across(normal[None]))


def holds(place: Floats, normals: Floats, shape: tuple[int, int], around: Around) -> bool:
    """Whether planes leave no more than noise of the points around, and a smooth patch clearly more."""
    heights, total = (around.points - place) @ normals.T, float(around.weights.sum())
    left = left_by(height_over(heights, shape), around)
    chance = np.sqrt(2.0 * np.sum(around.weights**2)) / total
    is_noise = left / total <= NOISE_MARGIN + BEYOND_NOISE * chance
    return bool(is_noise and left_by(off_patch(place, normals, around), around) - left > GAIN)


def height_over(heights: Floats, shape: tuple[int, int]) -> Floats:
    """Return how high (k,) places lie over the surface, by their heights (k, 3) over its planes."""
    apart, sign = shape
    signed = sign * heights
    if apart < 0:
        over: Floats = signed.max(axis=1)
    else:
        over = np.maximum(signed[:, apart], np.delete(signed, apart, axis=1).min(axis=1))
    return sign * over


def plane_under(heights: Floats, shape: tuple[int, int]) -> Ints:
    """Return which plane (k,) is the surface at places, by their heights (k, 3)."""
    under: Ints = np.abs(heights - height_over(heights, shape)[:, None]).argmin(axis=1)
    return under


def left_by(off: Floats, around: Around) -> float:
    """Return what is left (k,) m of the points in variances of their noise, clipped, summed with their weights."""
    return float(np.sum(around.weights * np.minimum((off / around.noise) ** 2, CLIPPED2)))


def off_patch(place: Floats, normals: Floats, around: Around) -> Floats:
    """Return how far (k,) m the points lie off a smooth patch of second degree over what the normals look along."""
    up = normals.sum(axis=0) / np.linalg.norm(normals.sum(axis=0))
    u, v, w = ((around.points - place) @ np.vstack([frame_across(up), up]).T).T
    rows, root = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v]), np.sqrt(around.weights)
    q = np.linalg.lstsq(root[:, None] * rows, root * w, rcond=None)[0]
    slope_u, slope_v = q[1] + 2.0 * q[3] * u + q[4] * v, q[2] + q[4] * u + 2.0 * q[5] * v
    off: Floats = (w - rows @ q) / np.sqrt(1.0 + slope_u**2 + slope_v**2)
    return off


def edges_of(corner: Corner) -> dict[tuple[int, int], Floats]:
    """Return the unit direction (3,) from the corner along which each two of its planes have an edge, for (a, b) and
    (b, a): where each of both is the surface on one side."""
    out = {}
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        along = np.cross(corner.normals[a], corner.normals[b])
        along /= np.linalg.norm(along)
        for way in (along, -along):
            heights = np.full((2, 3), corner.normals[c] @ way)
            heights[:, a], heights[:, b] = (1e-6, -1e-6), (-1e-6, 1e-6)
            if set(plane_under(heights, corner.shape).tolist()) == {a, b}:
                out[a, b] = out[b, a] = way
    return out


def rounding(corner: Corner, around: Around, beside: float) -> float:
    """Return by how many standard errors the points within `beside` (m) of the edges lie as those of rounded ones do:
    on the inside of ridges, on the outside of folds."""
    off = around.points - corner.place
    over = height_over(off @ corner.normals.T, corner.shape)
    nearest, sign = np.full(len(off), beside), np.zeros(len(off))
    for (a, b), way in edges_of(corner).items():
        across = np.linalg.norm(off - np.maximum(off @ way, 0.0)[:, None] * way, axis=1)
        heights = np.full((1, 3), corner.normals[3 - a - b] @ way)
        heights[:, a], heights[:, b] = 1e-6, -1e-6
        is_ridge = plane_under(heights, corner.shape)[0] == a
        sign[across < nearest] = -1.0 if is_ridge else 1.0
        nearest = np.minimum(nearest, across)
    n = max(int(np.count_nonzero(sign)), 1)
    return float(np.sum(sign * over) / (around.noise * np.sqrt(n)))


def is_of_sheet(looks: Floats, normals: Floats) -> Bools:
    """Return which of unit normals (k, 3) look along one of three planes' normals (3, 3)."""
    alike: Bools = (looks @ normals.T).max(axis=1) > COS_SHEET
    return alike
