"""The nearest faces of points that lie side by side, looked for together.

Two epochs of an object nearly coincide: what is nearest to a point lies a fraction of an edge away, in one of few
leaves of the tree, and its neighbours ask for the same ones. They are gathered once for a run of points along the
Morton curve, all that come nearer than a margin to the run's box; a face found nearer than the margin is then the
nearest of all. Where none is, the tree is asked (`search`): the answer is the same to the last bit.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.mesh_tree import FACES_PER_LEAF, leaf_of_node
from monitor.comparison.search import LOOKING, barred, try_faces
from monitor.comparison.triangles import FACE, cone_looks

MOST_POINTS = 12  # in a run
MOST_LEAVES = 96  # that are gathered for it


@jit(nopython=True, cache=True, forceinline=True)
def gather_leaves(tree, low, high, leaves, room, stack):  # type: ignore[no-untyped-def]
    """Write the leaves (nodes) whose boxes meet the one from `low` to `high`; return how many they are, -1 where there
    is no room for all. `room` has the middle and half the size of their boxes in its first six rows."""
    nodes, n, n_inner = tree.nodes, 0, tree.n_leaves - 1
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if (nodes[node, 0] > high[0] or nodes[node, 1] > high[1] or nodes[node, 2] > high[2]
                or nodes[node, 3] < low[0] or nodes[node, 4] < low[1] or nodes[node, 5] < low[2]):  # fmt: skip
            continue
        if node < n_inner:
            stack[top], stack[top + 1] = 2 * node + 2, 2 * node + 1
            top += 2
        elif n == len(leaves):
            return -1
        else:
            leaves[n] = node
            for k in range(3):
                room[k, n] = 0.5 * (np.float64(nodes[node, k]) + np.float64(nodes[node, 3 + k]))
                room[3 + k, n] = 0.5 * (np.float64(nodes[node, 3 + k]) - np.float64(nodes[node, k]))
            n += 1
    return n


@jit(nopython=True, cache=True, forceinline=True)
def nearest_in_leaves(tree, p, looks, limits, n, leaves, room):  # type: ignore[no-untyped-def]
    """Return what `nearest_point` does of the faces that look p's way in the first `n` leaves; the leaf whose middle is
    nearest first, so that the bound is tight at once."""
    bounds, to_middle = room[6], room[7]
    nodes, vertices, faces, shift = tree.nodes, tree.vertices, tree.faces, tree.shift
    best = (limits[0] * limits[0], -1, 0.0, 0.0, FACE, np.inf)
    if n < 1:
        return best
    for j in range(n):
        x, y, z = abs(p[0] - room[0, j]), abs(p[1] - room[1, j]), abs(p[2] - room[2, j])
        to_middle[j] = x * x + y * y + z * z
        x, y, z = x - room[3, j], y - room[4, j], z - room[5, j]
        x, y, z = x if x > 0.0 else 0.0, y if y > 0.0 else 0.0, z if z > 0.0 else 0.0
        bounds[j] = x * x + y * y + z * z
    first, least = 0, np.inf
    for j in range(n):
        if to_middle[j] < least:
            first, least = j, to_middle[j]
    for k in range(-1, n):
        j = first if k < 0 else k
        if bounds[j] > best[0] or k == first:
            continue
        if not cone_looks(looks, nodes, leaves[j]):
            best = barred(best, bounds[j])
            continue
        begin = leaf_of_node(tree.deepest, tree.n_leaves, leaves[j]) * FACES_PER_LEAF
        end = min(begin + FACES_PER_LEAF, len(faces))
        best = try_faces(vertices, faces, shift, p, looks, limits[1], LOOKING, begin, end, bounds[j], best)
    return best
