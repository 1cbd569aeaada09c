"""Which points of the source are matched: even over the surface, and more of those that hold the weakest motion.

A mostly flat relief or a nearly round vase is held by few points. Half of the sample is spread evenly in space, the
other half is drawn with a probability in proportion to the leverage J (J'J)^-1 J' of the point on the six parameters
(after Gelfand et al. 2003, geometrically stable sampling; Glira et al. 2015, maximum leverage sampling).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from monitor.registration.motion.sides import Side
from projects.model import Floats, Ints

N_CANDIDATES_PER_SAMPLE = 4
N_CUBES_ACROSS = 30

Beside = Literal["nothing", "layer", "scale"]  # what is estimated beside a motion, as its seventh parameter


def motion_rows(points: Floats, normals: Floats, centre: Floats) -> Floats:
    """Return J (n, 6): the way along the normal under a small motion, J (w, t) = n'(w x (x - c) + t)."""
    return np.hstack([np.cross(points - centre, normals), normals])


def lever_of(points: Floats, centre: Floats) -> float:
    """Return the root mean square distance [m] of points (n, 3) from a centre: by what a turn moves them."""
    return float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))


def parameter_rows(points: Floats, normals: Floats, centre: Floats, beside: Beside = "nothing") -> Floats:
    """Return J (n, 6) of a small motion, or (n, 7) of one beside a layer all over, whose thickness [m] residuals are
    less by, or beside a scale, by whose excess over 1 times n'(x - c) they are."""
    rows = motion_rows(points, normals, centre)
    if beside == "nothing":
        return rows
    depth = np.ones(len(rows)) if beside == "layer" else np.einsum("ij,ij->i", points - centre, normals)
    return np.hstack([rows, -depth[:, None]])


def cell_numbers(points: Floats, cell: float) -> Ints:
    """Return one number (n,) per point that is equal for points in the same cube of edge `cell` [m]."""
    return number_cells(points, cell)[0]


def number_cells(points: Floats, cell: float) -> tuple[Ints, tuple[int, int]]:
    """Return `cell_numbers` (n,) and by how much they grow from a cube to the next along x and y; along z by one.

    Beyond the last cube along y and z two more are counted, so that the numbers of neighbours are nobody else's.
    """
    steps = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    along_y = int(steps[:, 2].max()) + 3
    along_x = along_y * (int(steps[:, 1].max()) + 3)
    return steps @ np.array([along_x, along_y, 1]), (along_x, along_y)


def crowd_around(cells: Ints, count: Ints, along: tuple[int, int]) -> Ints:
    """Return how many points lie in each cube (c,) and the 26 around it, from the `count` in each; numbers rise."""
    total = np.append(0, np.cumsum(count))
    crowd = np.zeros(len(cells), dtype=np.int64)
    for x in (-along[0], 0, along[0]):
        for y in (-along[1], 0, along[1]):
            row = cells + x + y
            crowd += total[np.searchsorted(cells, row + 1, "right")] - total[np.searchsorted(cells, row - 1, "left")]
    return crowd


def sample_source(side: Side, n_samples: int, rng: np.random.Generator) -> Ints:
    """Return the indices (at most `n_samples`) of the points of a side to match, neighbours in space near in order."""
    if len(side) <= n_samples:
        return in_space_order(side.points, np.arange(len(side)))
    n_candidates = min(len(side), N_CANDIDATES_PER_SAMPLE * n_samples)
    candidates = np.sort(rng.choice(len(side), n_candidates, replace=False))
    points = side.points[candidates]
    even = even_probability(points, n_samples)
    hold = leverage(points, side.normals_of(candidates), even)
    probability = 0.5 * even + 0.5 * hold * even / np.sum(hold * even)
    return in_space_order(side.points, np.sort(candidates[draw(probability, n_samples, rng)]))


def in_space_order(points: Floats, which: Ints) -> Ints:
    """Return `which` sorted by cubes in space, so that searches for one after the other stay in one part of a tree."""
    cell = float(np.ptp(points[which], axis=0).max()) / N_CUBES_ACROSS + 1e-12
    return which[np.argsort(cell_numbers(points[which], cell), kind="stable")]


def even_probability(points: Floats, n_samples: int) -> Floats:
    """Return probabilities (n,) under which a drawn sample is even over the surface: one over the crowd around.

    The crowd is that of a point's cell and of the 26 around it. In the cell alone, points whose noise carries them
    beyond a face would be lonely and drawn the more, and the sample would lie beside the surface.
    """
    spread = np.sort(np.ptp(points, axis=0))
    cell = np.sqrt(max(spread[2] * spread[1], 1e-12 * spread[2] ** 2) / n_samples) * 2.0 / 3.0
    numbers, along = number_cells(points, max(cell, 1e-12))
    cells, which, count = np.unique(numbers, return_inverse=True, return_counts=True)
    probability = 1.0 / crowd_around(cells, count, along)[which]
    return probability / probability.sum()


def leverage(points: Floats, normals: Floats, probability: Floats) -> Floats:
    """Return the leverage (n,) of each point on the six parameters of a motion."""
    centre = probability @ points
    rows = motion_rows(points, np.nan_to_num(normals), centre)
    rows[:, :3] /= np.sqrt(probability @ np.sum((points - centre) ** 2, axis=1)) + 1e-300
    information = np.einsum("ni,nj->ij", rows * probability[:, None], rows)
    information += 1e-6 * np.trace(information) * np.eye(6)  # a plane has motions that nothing holds
    return np.asarray(np.einsum("ni,ni->n", rows @ np.linalg.inv(information), rows))


def draw(probability: Floats, n: int, rng: np.random.Generator) -> Ints:
    """Return n different indices drawn with the given probabilities (Efraimidis & Spirakis 2006)."""
    keys = rng.exponential(size=len(probability)) / np.maximum(probability, 1e-300)
    return np.argpartition(keys, n - 1)[:n]
