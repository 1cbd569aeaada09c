"""The nearest faces of points that lie side by side, looked for together.

Two epochs of an object nearly coincide: what is nearest to a point lies a fraction of an edge away, and its neighbours
ask for the same faces. They are gathered once for a run of points along the Morton curve, all that come nearer than a
margin to the run's box, and from these those near to a few of its points. A face found nearer than the margin is then
the nearest of all. Where none is, the tree is asked (`search`): the answer is the same to the last bit.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.mesh_tree import FACES_PER_LEAF, leaf_of_node
from monitor.comparison.distances.search import LOOKING, try_face
from monitor.comparison.distances.triangles import FACE
from monitor.tuples import less

MOST_POINTS = 32  # in a run
FEW = 8  # points of it
MOST_FACES = 1024  # that are gathered for it
PLACE = MOST_FACES - 1  # the bits of a place among them


@jit(nopython=True, cache=True, forceinline=True)
def gather_faces(tree, low, high, numbers, boxes, stack):  # type: ignore[no-untyped-def]
    """Write the faces whose boxes meet the one from `low` to `high`: their `numbers`, and `boxes`, a column each of low
    and high corner; return how many they are, -1 where there is no room for all."""
    nodes, n, n_inner, n_faces = tree.nodes, 0, tree.n_leaves - 1, len(tree.faces)
    vertices, faces, shift = tree.vertices, tree.faces, tree.shift
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
            continue
        first = leaf_of_node(tree.deepest, tree.n_leaves, node) * FACES_PER_LEAF
        if n + FACES_PER_LEAF > len(numbers):
            return -1
        for f in range(first, min(first + FACES_PER_LEAF, n_faces)):
            a, b = less(vertices, faces[f, 0], shift), less(vertices, faces[f, 1], shift)
            c = less(vertices, faces[f, 2], shift)
            x0, x1 = min(min(a[0], b[0]), c[0]), max(max(a[0], b[0]), c[0])
            y0, y1 = min(min(a[1], b[1]), c[1]), max(max(a[1], b[1]), c[1])
            z0, z1 = min(min(a[2], b[2]), c[2]), max(max(a[2], b[2]), c[2])
            boxes[0, n], boxes[1, n], boxes[2, n] = x0, y0, z0
            boxes[3, n], boxes[4, n], boxes[5, n] = x1, y1, z1
            numbers[n] = f
            n += ((x0 <= high[0]) & (y0 <= high[1]) & (z0 <= high[2])
                  & (x1 >= low[0]) & (y1 >= low[1]) & (z1 >= low[2]))  # fmt: skip  # else the next is written over it
    return n


@jit(nopython=True, cache=True, forceinline=True)
def pick_faces(boxes, n, low, high, meets, chosen, near):  # type: ignore[no-untyped-def]
    """Write which of the first `n` faces gathered have a box that meets the one from `low` to `high`, and these boxes
    side by side into `near`; return how many they are."""
    few = 0
    for j in range(n):
        meets[j] = ((boxes[0, j] <= high[0]) & (boxes[1, j] <= high[1]) & (boxes[2, j] <= high[2])
                      & (boxes[3, j] >= low[0]) & (boxes[4, j] >= low[1]) & (boxes[5, j] >= low[2]))  # fmt: skip
    for j in range(n):
        chosen[few] = j
        few += meets[j]
    for k in range(6):
        for i in range(few):
            near[k, i] = boxes[k, chosen[i]]
    return few


@jit(nopython=True, cache=True, forceinline=True)
def nearest_among(tree, p, looks, limits, few, chosen, near, numbers, bounds, middles, keys, meets, words):  # type: ignore[no-untyped-def]
    """Return what `nearest_point` does of the faces chosen, the first `few`, that look p's way; that whose box has its
    middle nearest first, so that the bound is tight at once. `bounds` are for squared distances to boxes, `middles`
    (float32) for those to twice their middles, which are seen as whole numbers in `keys`: as such they rise too."""
    vertices, faces, shift = tree.vertices, tree.faces, tree.shift
    best = (limits[0] * limits[0], -1, 0.0, 0.0, FACE, np.inf)
    if few < 1:
        return best
    for i in range(few):
        x0, y0, z0 = near[0, i] - p[0], near[1, i] - p[1], near[2, i] - p[2]
        x1, y1, z1 = p[0] - near[3, i], p[1] - near[4, i], p[2] - near[5, i]
        x, y, z = x0 - x1, y0 - y1, z0 - z1
        middles[i] = x * x + y * y + z * z
        x0, y0, z0 = x0 if x0 > x1 else x1, y0 if y0 > y1 else y1, z0 if z0 > z1 else z1
        x0, y0, z0 = x0 if x0 > 0.0 else 0.0, y0 if y0 > 0.0 else 0.0, z0 if z0 > 0.0 else 0.0
        bounds[i] = x0 * x0 + y0 * y0 + z0 * z0
    least = np.int32(2147483647)
    for i in range(few):
        least = min(least, (keys[i] & np.int32(~PLACE)) | np.int32(i))
    first = np.int64(least & PLACE)
    best = _try_chosen(vertices, faces, shift, p, looks, limits[1], numbers[chosen[first]], bounds[first], best)
    bounds[first] = np.inf
    for i in range(few):
        meets[i] = bounds[i] <= best[0] * (1.0 + 1e-9)
    for i in range(few, few + 8):
        meets[i] = 0
    for word in range((few + 7) // 8):  # eight at once: few are left
        if words[word] == 0:
            continue
        for i in range(8 * word, 8 * word + 8):
            if meets[i] and bounds[i] <= best[0] * (1.0 + 1e-9):
                best = _try_chosen(vertices, faces, shift, p, looks, limits[1], numbers[chosen[i]], bounds[i], best)
    return best


@jit(nopython=True, cache=True, forceinline=True)
def _try_chosen(vertices, faces, shift, p, looks, cos_angle, f, bound2, best):  # type: ignore[no-untyped-def]
    """Return the better one of the `best` foot so far and that of p on face f; see `try_face`."""
    a, b = less(vertices, faces[f, 0], shift), less(vertices, faces[f, 1], shift)
    return try_face(a, b, less(vertices, faces[f, 2], shift), p, looks, cos_angle, LOOKING, f, bound2, best)
