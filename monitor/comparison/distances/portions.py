"""Searches on a surface too large for one tree: points in boxes, each with a tree of the faces that lie near.

In: points and a `Shell`. Out: what one tree of all faces would tell, to the last bit. A box is halved until one tree
can hold the faces near it, and on as long as its halves together take less: faces near both are put into two trees.
First faces are taken within a small reach; points that find none within it are asked again with a longer one, and in
the end with the search limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numba import jit

from monitor.boxes import box_of_some
from monitor.comparison.distances.feet import NO_FOOT, NOTHING_NEAR, find_feet
from monitor.comparison.distances.mesh_tree import MeshTree, build_tree
from monitor.comparison.distances.offsets import Offsets, signed_offsets
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.shell import Shell
from monitor.morton import point_order
from projects.model import Floats, Ints, Surface

FIRST_REACH = 1.0 / 16.0  # of the search limit
LONGER = 16.0  # times the reach before, where nothing was found within it
MOST_FACES = 100  # to each point of a box that is not halved again
PER_TREE = 10_000  # faces: what each tree takes besides those that it holds


def search_feet(shell: Shell, points: Floats, normals: Floats) -> tuple[Ints, Floats, Floats, Ints]:
    """Return face, weights of its corners, signed distance and outcome of each point (n,); see `find_feet`.

    `points` (n, 3) [m] and their unit `normals` (n, 3).
    """
    points, normals = np.ascontiguousarray(points), np.ascontiguousarray(normals)
    limit, cosine = shell.limits[0], float(np.cos(shell.limits[1]))
    if shell.tree is not None:
        return find_feet(shell.tree, points, normals, point_order(points), (limit, cosine))
    n = len(points)
    faces: Ints = np.full(n, -1, dtype=np.int32)
    weights: Floats = np.zeros((n, 3))
    distances: Floats = np.full(n, np.nan)
    outcome: Ints = np.full(n, NOTHING_NEAR, dtype=np.uint8)
    weights[:, 0] = 1.0

    def ask(which: Ints, tree: MeshTree, numbers: Ints, reach: float) -> Ints:
        """Write the feet of the points `which` on one portion; return those that found none."""
        near = points[which]
        found = find_feet(tree, near, normals[which], point_order(near), (min(reach, limit), cosine))
        has_foot = found[0] >= 0
        faces[which] = np.where(has_foot, numbers[found[0]], -1)
        weights[which], distances[which], outcome[which] = found[1:]
        return which[np.isin(found[3], (NO_FOOT, NOTHING_NEAR))]

    _ask_by_portions(shell, points, limit, ask)
    return faces, weights, distances, outcome


def search_offsets(shell: Shell, points: Floats) -> Offsets:
    """Return the distance of points (n, 3) [m] to the nearest point of all of the surface; see `signed_offsets`."""
    if shell.tree is not None:
        return signed_offsets(points, shell.tree, np.inf)
    n = len(points)
    known, past_end = np.zeros((2, n), dtype=np.bool_)
    out = Offsets(np.full(n, np.nan), known, past_end, np.full(n, -1, dtype=np.int32))

    def ask(which: Ints, tree: MeshTree, numbers: Ints, reach: float) -> Ints:
        """Write the offsets of the points `which` from one portion; return those that found no face."""
        found = signed_offsets(points[which], tree, reach)
        out.distances[which], out.is_known[which] = found.distances, found.is_known
        out.is_past_end[which] = found.is_past_end
        out.faces[which] = np.where(found.faces >= 0, numbers[found.faces], -1)
        return which[found.faces < 0]

    _ask_by_portions(shell, points, np.inf, ask)
    return out


def _ask_by_portions(
    shell: Shell, points: Floats, limit: float, ask: Callable[[Ints, MeshTree, Ints, float], Ints]
) -> None:
    """Call `ask` with points (their numbers), a tree of all faces within reach of them, the numbers of these, and the
    reach [m], as long as it returns points that are to be asked again and the reach is below `limit` [m]."""
    farthest = _largest_gap(shell.surface.vertices, points) if len(points) else 0.0
    left, reach, is_last = np.arange(len(points), dtype=np.int32), FIRST_REACH * shell.limits[0], False
    new = np.full(len(shell.surface.vertices), -1, dtype=np.int32)
    while len(left) and not is_last:
        is_last = reach >= min(limit, farthest)
        reach = limit if is_last else reach
        again = []
        for which, numbers in _cut(shell, points, left, min(reach, farthest)):
            again.append(ask(which, _tree_of(shell, numbers, new), numbers, reach) if len(numbers) else which)
        left, reach = np.concatenate(again), LONGER * reach


def _largest_gap(vertices: Floats, points: Floats) -> float:
    """Return a distance [m] beyond which nothing of a surface lies from any point."""
    low = np.minimum(vertices.min(axis=0), points.min(axis=0))
    return float(np.linalg.norm(np.maximum(vertices.max(axis=0), points.max(axis=0)) - low))


def _cut(shell: Shell, points: Floats, which: Ints, reach: float) -> Iterator[tuple[Ints, Ints]]:
    """Yield the points `which` (k,) box by box, each with the numbers, rising, of all faces within `reach` [m] of it.

    All faces around a foot within reach are among them, so what is told of its edge or vertex is right.
    """
    margin = reach + 1e-9 * float(np.abs(points).max())  # more than coordinates are rounded by
    everything: Ints = np.arange(len(shell.surface.faces), dtype=np.int32)
    ahead = [(which, everything)]
    while ahead:
        which, among = ahead.pop()
        numbers, halves = _look_at_box(shell, points, which, among, margin)
        if len(numbers) <= shell.faces_per_tree or not halves:
            yield from _cheapest(shell, points, which, numbers, margin)[1]
        else:
            ahead += [(half, numbers) for half in halves]


def _cheapest(shell: Shell, points: Floats, which: Ints, among: Ints, margin: float,
              ) -> tuple[int, list[tuple[Ints, Ints]]]:  # fmt: skip
    """Return what the trees for some points take [faces], and the boxes that take least, as `_cut` yields them."""
    numbers, halves = _look_at_box(shell, points, which, among, margin)
    whole = len(numbers) + PER_TREE
    if not halves or whole <= max(2 * PER_TREE, MOST_FACES * len(which)):
        return whole, [(which, numbers)]
    taken = 0
    boxes: list[tuple[Ints, Ints]] = []
    for half in halves:
        more, parts = _cheapest(shell, points, half, numbers, margin)
        taken, boxes = taken + more, boxes + parts
    return (taken, boxes) if taken < whole else (whole, [(which, numbers)])


def _look_at_box(shell: Shell, points: Floats, which: Ints, among: Ints, margin: float,
                 ) -> tuple[Ints, tuple[Ints, ...]]:  # fmt: skip
    """Return which faces of `among` lie within `margin` [m] of the box of some points, and these points in two halves;
    no halves where the box is smaller than the margin."""
    low, high = box_of_some(points, which)
    numbers = among[
        _meet_box(shell.surface.vertices, np.asarray(shell.surface.faces), among, low - margin, high + margin)
    ]
    axis = int(np.argmax(high - low))
    if high[axis] - low[axis] <= margin:
        return numbers, ()
    along = points[which, axis]
    middle = median(along)
    is_first = along < middle if middle > low[axis] else along <= middle
    return numbers, (which[is_first], which[~is_first])


def _tree_of(shell: Shell, numbers: Ints, new: Ints) -> MeshTree:
    """Return the tree of some faces of the surface, in the order that they have in the tree of all; `new` (n,) is -1
    for each of its vertices, before and after."""
    used, faces = _pick_faces(np.asarray(shell.surface.faces), numbers, new)
    return build_tree(Surface(shell.surface.vertices[used], faces), shell.shift, shell.limits[1], shell.cells)


@jit(nopython=True, cache=True)
def _pick_faces(faces, numbers, new):  # type: ignore[no-untyped-def]
    """Return the vertices that some faces use, and these faces with their vertices numbered among them."""
    used, out, n = np.empty(3 * len(numbers), dtype=np.int32), np.empty((len(numbers), 3), dtype=np.int32), 0
    for i in range(len(numbers)):
        for k in range(3):
            v = faces[numbers[i], k]
            if new[v] < 0:
                new[v], used[n] = n, v
                n += 1
            out[i, k] = new[v]
    for v in used[:n]:
        new[v] = -1
    return used[:n].copy(), out


@jit(nopython=True, cache=True)
def _meet_box(vertices, faces, among, low, high):  # type: ignore[no-untyped-def]
    """Return which faces of `among` (m,) have a box of their own that meets the one from low to high."""
    out = np.empty(len(among), dtype=np.bool_)
    for i in range(len(among)):
        f, meets = among[i], True
        for k in range(3):
            a, b, c = vertices[faces[f, 0], k], vertices[faces[f, 1], k], vertices[faces[f, 2], k]
            meets = meets and min(min(a, b), c) <= high[k] and max(max(a, b), c) >= low[k]
        out[i] = meets
    return out
