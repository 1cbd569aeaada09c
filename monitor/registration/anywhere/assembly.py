"""Many scans put together by shape alone: every two aligned coarsely, the links that agree with each other kept.

In: clouds with oriented normals, each in its own frame. Out: the pose of each in the frame of the first that is placed,
or that it could not be placed. Good enough for the adjustment of all scans at once, which must follow.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.registration.anywhere.coarse import Shape, align_shapes, prepare_oriented, station_of
from monitor.registration.anywhere.shape_features import choose_cell, find_places
from monitor.registration.motion.icp import find_centre
from projects.model import Bools, Floats, PointCloud
from projects.transforms import apply, invert

AGREE_CELLS = 6.0  # three links around a triangle may miss by so much, in the mean over the points


@dataclass(frozen=True)
class Link:
    """Two scans that belong together: T_first_second, the score of that pose, and how many triangles confirm it."""

    first: int
    second: int
    T_first_second: Floats
    score: float
    n_confirmed: int = 0
    n_contradicted: int = 0


@dataclass(frozen=True)
class Assembly:
    """Where each scan belongs: `T_first_scan` (n, 4, 4) in the frame of the first scan placed, NaN where `is_placed`
    (n,) is False; the `links` that were used, those `refused` because others contradict them, and all that were `found`
    between two scans by themselves."""

    T_first_scan: Floats
    is_placed: Bools
    links: tuple[Link, ...]
    refused: tuple[Link, ...]
    found: tuple[Link, ...] = ()


def assemble(clouds: Sequence[PointCloud]) -> Assembly:
    """Put scans together by shape alone.

    Parameters
    ----------
    clouds : two or more, m, each in a frame of its own, with oriented normals; a thinned scan is enough.

    Notes
    -----
    A link is a coarse alignment whose pose is unique. One wrong link bends all that hangs on it, so links are checked
    around triangles, those contradicted more often than confirmed are refused, and the scans hang on the tree of the
    best confirmed ones.
    """
    shifts = [find_centre(cloud) for cloud in clouds]
    sides = [prepare_oriented(cloud, shift) for cloud, shift in zip(clouds, shifts, strict=True)]
    cell = min(choose_cell((a, b)) for a, b in itertools.pairwise(sides))
    shapes = [Shape(side, find_places(side, cell), station_of(cloud, shift))
              for side, cloud, shift in zip(sides, clouds, shifts, strict=True)]  # fmt: skip
    links = []
    for i, j in itertools.combinations(range(len(shapes)), 2):
        found = align_shapes(shapes[j], shapes[i], cell)
        if found.is_unique:
            links.append(Link(i, j, found.T_target_source, found.score))
    good, refused = check_triangles(links, [s.places.points for s in shapes], cell)
    poses, used = hang_on_tree(good, len(shapes))
    told = [tuple(_link_in_given_frames(link, shifts) for link in some) for some in (used, refused, links)]
    return Assembly(_in_given_frames(poses, shifts), np.isfinite(poses[:, 0, 0]), *told)


def check_triangles(links: Sequence[Link], places: Sequence[Floats], cell: float) -> tuple[list[Link], list[Link]]:
    """Return the links with their confirmations, and apart those that are contradicted more often than confirmed."""
    by_ends = {(link.first, link.second): link.T_first_second for link in links}
    by_ends |= {(j, i): invert(T) for (i, j), T in list(by_ends.items())}
    checked = []
    for link in links:
        i, j, confirmed, contradicted = link.first, link.second, 0, 0
        for k in range(len(places)):
            if (i, k) in by_ends and (k, j) in by_ends:
                around = by_ends[i, k] @ by_ends[k, j]
                way = apply(around, places[j]) - apply(link.T_first_second, places[j])
                agrees = np.sqrt(np.mean(np.sum(way**2, axis=1))) < AGREE_CELLS * cell
                confirmed, contradicted = confirmed + bool(agrees), contradicted + (not agrees)
        checked.append(Link(i, j, link.T_first_second, link.score, confirmed, contradicted))
    good = [link for link in checked if link.n_contradicted <= link.n_confirmed]
    return good, [link for link in checked if link.n_contradicted > link.n_confirmed]


def hang_on_tree(links: Sequence[Link], n: int) -> tuple[Floats, list[Link]]:
    """Return the poses (n, 4, 4) in the frame of the first scan of the largest connected part, and the links used."""
    group = list(range(n))
    used = []
    for link in sorted(links, key=lambda link: (-min(link.n_confirmed, 2), -link.score)):
        one, other = group[link.first], group[link.second]
        if one != other:
            used.append(link)
            group = [one if g == other else g for g in group]
    largest = max(set(group), key=lambda g: (group.count(g), -group.index(g)))
    poses = np.full((n, 4, 4), np.nan)
    if group.count(largest) > 1:
        poses[group.index(largest)] = np.eye(4)
    for _ in range(n):
        for link in used:
            i, j = link.first, link.second
            if np.isfinite(poses[i, 0, 0]) and not np.isfinite(poses[j, 0, 0]):
                poses[j] = poses[i] @ link.T_first_second
            elif np.isfinite(poses[j, 0, 0]) and not np.isfinite(poses[i, 0, 0]):
                poses[i] = poses[j] @ invert(link.T_first_second)
    return poses, used


def _in_given_frames(poses: Floats, shifts: Sequence[Floats]) -> Floats:
    """Return poses between frames that were moved by `-shift` as poses between the frames as given."""
    out = poses.copy()
    placed = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
    for k in placed:
        out[k, :3, 3] += shifts[int(placed[0])] - poses[k, :3, :3] @ shifts[int(k)]
    return out


def _link_in_given_frames(link: Link, shifts: Sequence[Floats]) -> Link:
    """Return a link between frames that were moved by `-shift` as one between the frames as given."""
    T = link.T_first_second.copy()
    T[:3, 3] += shifts[link.first] - T[:3, :3] @ shifts[link.second]
    return replace(link, T_first_second=T)
