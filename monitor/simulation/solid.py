"""Solids as fields (negative inside, metres) and their contouring into closed triangle meshes.

A `Field` maps coordinates (3, n) to (n,). Parts are joined smoothly into a `Solid`, which skips the parts that are
far from the points asked for. `contour` finds the cells that hold the surface on an octree, places one vertex in
each (surface nets, Gibson 1998) and moves it onto the field's zero, so a vertex of the mesh is a point of the solid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from projects.errors import ParameterError
from projects.model import Floats, Ints

Field = Callable[[Floats], Floats]
N_THREADS = 2


def smooth_min(a: Floats, b: Floats, k: float) -> Floats:
    """Return the smaller of two fields, blended over a width k where they are equal (polynomial)."""
    if k <= 0.0:
        return np.minimum(a, b)
    h = np.maximum(k - np.abs(a - b), 0.0)
    return np.minimum(a, b) - h * h * (0.25 / k)


def smooth_max(a: Floats, b: Floats, k: float) -> Floats:
    """Return the larger of two fields, blended over a width k where they are equal."""
    return -smooth_min(-a, -b, k)


def join_blended(pieces: Sequence[tuple[Field, float]]) -> Field:
    """Return the union of fields, each blended over its width with those before it; that of the first is not used."""

    def field(p: Floats) -> Floats:
        """Return the smallest of the fields (n,) at p (3, n), smoothly."""
        value = pieces[0][0](p)
        for piece, blend in pieces[1:]:
            value = smooth_min(value, piece(p), blend)
        return value

    return field


@dataclass(frozen=True, eq=False)  # known by identity, as functions are
class Part:
    """A piece of a solid: its field, a box (2, 3) that holds it, and the width of its blend with what came before.

    With `cut` the piece is taken away instead of added.
    """

    name: str
    field: Field
    box: Floats
    blend: float = 0.0
    cut: bool = False


@dataclass(frozen=True, eq=False)
class Solid:
    """Parts added to and cut from one another, in order."""

    parts: tuple[Part, ...]

    def __call__(self, p: Floats) -> Floats:
        """Return the field at p (3, n); parts further than their blend from all points only bound it from below."""
        low, high = p.min(axis=1), p.max(axis=1)
        value = np.full(p.shape[1], np.inf)
        for part in self.parts:
            gap = float(np.linalg.norm(np.maximum(np.maximum(part.box[0] - high, low - part.box[1]), 0.0)))
            near = gap <= 2.0 * part.blend + 1e-3
            if part.cut:
                value = smooth_max(value, -part.field(p), part.blend) if near else value
            elif near:
                value = smooth_min(value, part.field(p), part.blend)
            else:
                value = np.minimum(value, gap)
        return value

    def bounds(self) -> Floats:
        """Return the box (2, 3) that holds every part added."""
        boxes = np.stack([part.box for part in self.parts if not part.cut])
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def evaluate(field: Field, points: Floats) -> Floats:
    """Return the field at points (n, 3), in blocks of space so that a `Solid` can skip what is far."""
    if len(points) == 0:
        return np.empty(0)
    # Some thousand points a block: points near a surface fill about extent**2 of space.
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    block = max(extent * np.sqrt(2000.0 / (len(points) + 1.0)), 1e-9)
    key = np.floor(points / block).astype(np.int64)
    key -= key.min(axis=0)
    n = key.max(axis=0) + 1
    flat = (key[:, 0] * n[1] + key[:, 1]) * n[2] + key[:, 2]
    order = np.argsort(flat, kind="stable")
    starts = np.flatnonzero(np.diff(flat[order], prepend=-1))
    pieces = [
        q
        for block_points in np.split(order, starts[1:])
        for q in np.array_split(block_points, len(block_points) // 50_000 + 1)
    ]
    value = np.empty(len(points))

    def work(which: Ints) -> None:
        """Write the values at the points `which`."""
        value[which] = field(np.ascontiguousarray(points[which].T))

    with ThreadPoolExecutor(N_THREADS) as pool:
        list(pool.map(work, pieces))
    return value


def gradient(field: Field, points: Floats, *, step: float = 1e-4) -> Floats:
    """Return the gradient of the field at points (n, 3) by central differences."""
    shifts = step * np.eye(3)
    sides = [evaluate(field, points + s) - evaluate(field, points - s) for s in shifts]
    return np.column_stack(sides) / (2.0 * step)


def principal_curvatures(field: Field, points: Floats, *, step: float = 2e-4) -> Floats:
    """Return the principal curvatures (n, 2) [1/m] of the field's level surfaces at points (n, 3), the larger first.

    Eigenvalues of P H P / |g| within the tangent plane, with the gradient g and the Hessian H of the field by central
    differences over `step` [m] and P = I - n n'; positive where convex seen from outside. A crease within `step`
    reads as a curvature of about 1 / step, and a field tabulated at a wider spacing than `step` shows its table.
    """
    e = step * np.eye(3)
    middle, hessian = evaluate(field, points), np.empty((len(points), 3, 3))
    for i in range(3):
        ahead, behind = evaluate(field, points + e[i]), evaluate(field, points - e[i])
        hessian[:, i, i] = (ahead - 2.0 * middle + behind) / step**2
        for j in range(i):
            corners = [a * b * evaluate(field, points + a * e[i] + b * e[j]) for a in (-1, 1) for b in (-1, 1)]
            hessian[:, i, j] = hessian[:, j, i] = sum(corners) / (4.0 * step**2)
    g = gradient(field, points, step=step)
    length = np.maximum(np.linalg.norm(g, axis=1), 1e-12)
    n = g / length[:, None]
    tangent = np.eye(3) - n[:, :, None] * n[:, None, :]
    shape = tangent @ hessian @ tangent / length[:, None, None]
    # The tangent plane's two eigenvalues from trace and second invariant; the third is 0, along n.
    trace = np.trace(shape, axis1=1, axis2=2)
    second = 0.5 * (trace**2 - np.einsum("nij,nji->n", shape, shape))
    root = np.sqrt(np.maximum(0.25 * trace**2 - second, 0.0))
    return np.column_stack([0.5 * trace + root, 0.5 * trace - root])


def project(field: Field, points: Floats, *, n_steps: int = 4) -> Floats:
    """Return points (n, 3) moved along the field's gradient onto its zero (Newton)."""
    x = np.array(points, dtype=float)
    for _ in range(n_steps):
        g = gradient(field, x)
        x -= (evaluate(field, x) / np.maximum((g * g).sum(axis=1), 1e-3))[:, None] * g
    return x


def _refine(field: Field, low: Floats, shape: Ints, cell: float, n_levels: int, slope: float) -> Ints:
    """Return the finest cells (m, 3) near the surface, found from coarse to fine."""
    size = 2**n_levels
    count = -(-shape // size)
    cells = np.stack(np.meshgrid(*(np.arange(c) for c in count), indexing="ij"), axis=-1).reshape(-1, 3)
    octants = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    while size > 1:
        centres = low + (cells + 0.5) * (size * cell)
        near = np.abs(evaluate(field, centres)) <= slope * 0.5 * np.sqrt(3.0) * size * cell
        cells = (2 * cells[near][:, None] + octants).reshape(-1, 3)
        size //= 2
    return cells


@njit(cache=True)
def _place_vertices(cells, value, index, low, cell, vertices, normals):  # type: ignore[no-untyped-def]
    """Put a vertex into each cell whose corners differ in sign: the mean of its edges' crossings; return how many."""
    n = 0
    for c in range(len(cells)):
        i, j, k = cells[c]
        inside = 0
        for corner in range(8):
            if value[i + (corner >> 2), j + ((corner >> 1) & 1), k + (corner & 1)] < 0.0:
                inside += 1
        if inside == 0 or inside == 8:
            continue
        x, y, z, crossings = 0.0, 0.0, 0.0, 0
        gx, gy, gz = 0.0, 0.0, 0.0
        for a in range(8):
            ai, aj, ak = a >> 2, (a >> 1) & 1, a & 1
            va = value[i + ai, j + aj, k + ak]
            gx += va if ai else -va
            gy += va if aj else -va
            gz += va if ak else -va
            for axis in range(3):
                step = 4 >> axis
                if a & step:
                    continue
                b = a | step
                bi, bj, bk = b >> 2, (b >> 1) & 1, b & 1
                vb = value[i + bi, j + bj, k + bk]
                if (va < 0.0) != (vb < 0.0):
                    t = va / (va - vb)
                    x += ai + t * (bi - ai)
                    y += aj + t * (bj - aj)
                    z += ak + t * (bk - ak)
                    crossings += 1
        vertices[n, 0] = low[0] + (i + x / crossings) * cell
        vertices[n, 1] = low[1] + (j + y / crossings) * cell
        vertices[n, 2] = low[2] + (k + z / crossings) * cell
        normals[n, 0], normals[n, 1], normals[n, 2] = gx, gy, gz
        index[i, j, k] = n
        n += 1
    return n


@njit(cache=True)
def _join_vertices(cells, value, index, faces):  # type: ignore[no-untyped-def]
    """Join the four cells around each edge that crosses the surface by two triangles; return how many."""
    n = 0
    for c in range(len(cells)):
        i, j, k = cells[c]
        for axis in range(3):
            di, dj, dk = int(axis == 0), int(axis == 1), int(axis == 2)
            inside = value[i, j, k] < 0.0
            if inside == (value[i + di, j + dj, k + dk] < 0.0):
                continue
            if axis == 0:
                a, b, d = index[i, j - 1, k], index[i, j - 1, k - 1], index[i, j, k - 1]
            elif axis == 1:
                a, b, d = index[i, j, k - 1], index[i - 1, j, k - 1], index[i - 1, j, k]
            else:
                a, b, d = index[i - 1, j, k], index[i - 1, j - 1, k], index[i, j - 1, k]
            o = index[i, j, k]
            if inside:
                faces[n, 0], faces[n, 1], faces[n, 2] = o, a, b
                faces[n + 1, 0], faces[n + 1, 1], faces[n + 1, 2] = o, b, d
            else:
                faces[n, 0], faces[n, 1], faces[n, 2] = o, b, a
                faces[n + 1, 0], faces[n + 1, 1], faces[n + 1, 2] = o, d, b
            n += 2
    return n


def contour(field: Field, box: Floats, *, cell: float, slope: float = 1.3, n_levels: int = 4) -> tuple[Floats, Ints]:
    """Return the zero surface of a field inside a box as a closed mesh.

    Parameters
    ----------
    field : negative inside.
    box : (2, 3) m, holding the whole solid.
    cell : m, grid spacing, about the edge length of the triangles.
    slope : how steep the field is expected to be; where it is steeper the surface is followed from cell to cell.
    n_levels : the search starts with cells 2**n_levels times as large.

    Returns
    -------
    vertices : (n, 3) m, on the surface to about a micrometre where the field is smooth.
    faces : (m, 3) int32, counter-clockwise seen from outside.
    """
    low = np.asarray(box[0], dtype=float) - 2 * cell
    shape = np.ceil((np.asarray(box[1]) + 2 * cell - low) / cell).astype(np.int64)
    if np.prod(shape.astype(float)) > 4e8:
        raise ParameterError(f"a grid of {shape} cells is too large; take a larger cell than {cell} m")
    cells = _refine(field, low, shape, cell, n_levels, slope)
    cells = cells[(cells > 0).all(axis=1) & (cells < shape - 1).all(axis=1)]
    value = np.full(tuple(shape + 1), np.nan, dtype=np.float32)
    held, fresh = np.zeros(tuple(shape), dtype=bool), cells
    held[tuple(cells.T)] = True
    while len(fresh):  # the surface is followed out of the cells found wherever the field was steeper than expected
        _fill_corners(field, fresh, value, low, cell)
        fresh = np.unique(_list_open_neighbours(fresh, value, held), axis=0)
        held[tuple(fresh.T)] = True
        cells = np.concatenate([cells, fresh])
    if (
        held[0].any()
        or held[-1].any()
        or held[:, 0].any()
        or held[:, -1].any()
        or held[..., 0].any()
        or held[..., -1].any()
    ):
        raise ParameterError("the solid leaves the box given for it; give a larger one")
    index = np.full(tuple(shape + 1), -1, dtype=np.int32)
    vertices, normals = np.empty((len(cells), 3)), np.empty((len(cells), 3))
    n = _place_vertices(cells, value, index, low, cell, vertices, normals)
    faces = np.empty((6 * n + 6, 3), dtype=np.int32)
    m = _join_vertices(cells, value, index, faces)
    return _pull(field, vertices[:n], normals[:n], cell), faces[:m]


def _fill_corners(field: Field, cells: Ints, value: Any, low: Floats, cell: float) -> None:
    """Write the field into `value` at those corners of `cells` where it is not yet known."""
    wanted = np.zeros(value.shape, dtype=bool)
    for corner in range(8):
        i, j, k = (cells + np.array([corner >> 2, (corner >> 1) & 1, corner & 1])).T
        wanted[i, j, k] = True
    at = np.argwhere(wanted & np.isnan(value))
    found = evaluate(field, low + at * cell)
    value[tuple(at.T)] = np.where(np.abs(found) < 1e-9, 1e-9, found)


@njit(cache=True)
def _list_open_neighbours(cells, value, held):  # type: ignore[no-untyped-def]
    """Return the cells not held that share a face with one of `cells` through which the surface passes."""
    found = np.empty((6 * len(cells), 3), dtype=np.int64)
    n = 0
    at = np.empty(3, dtype=np.int64)
    for c in range(len(cells)):
        for axis in range(3):
            for side in range(2):
                at[0], at[1], at[2] = cells[c]
                at[axis] += 2 * side - 1
                if at.min() < 0 or at[0] >= held.shape[0] or at[1] >= held.shape[1] or at[2] >= held.shape[2]:
                    continue
                if held[at[0], at[1], at[2]]:
                    continue
                inside = 0
                for corner in range(4):
                    shift = np.zeros(3, dtype=np.int64)
                    shift[axis] = side
                    shift[(axis + 1) % 3] = corner >> 1
                    shift[(axis + 2) % 3] = corner & 1
                    i, j, k = cells[c, 0] + shift[0], cells[c, 1] + shift[1], cells[c, 2] + shift[2]
                    inside += int(value[i, j, k] < 0.0)
                if 0 < inside < 4:
                    found[n] = at
                    n += 1
    return found[:n]


def _pull(field: Field, vertices: Floats, normals: Floats, cell: float) -> Floats:
    """Return the vertices moved along their normals onto the field's zero (secant steps of at most half a cell)."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    n = normals / np.maximum(length, 1e-12)
    slope = length[:, 0] / (4.0 * cell)
    moved = np.zeros(len(vertices))
    before = evaluate(field, vertices)
    open_ = np.flatnonzero(np.abs(before) > 1e-7)
    for _ in range(3):
        step = np.clip(-before[open_] / np.maximum(slope[open_], 0.2), -0.5 * cell, 0.5 * cell)
        moved[open_] += step
        after = evaluate(field, vertices[open_] + moved[open_, None] * n[open_])
        bend = np.abs(step) > 1e-7
        slope[open_] = np.where(bend, np.abs((after - before[open_]) / np.where(bend, step, 1.0)), slope[open_])
        before[open_] = after
        open_ = open_[np.abs(after) > 1e-6]
    pulled = vertices + np.clip(moved, -cell, cell)[:, None] * n
    # At creases the grid's normal may miss the surface: there the field's own gradient leads.
    stray = np.flatnonzero(np.abs(before) > 1e-6)
    led = project(field, vertices[stray], n_steps=5)
    reached = np.abs(evaluate(field, led)) < np.abs(evaluate(field, pulled[stray]))
    reached &= np.linalg.norm(led - vertices[stray], axis=1) < cell
    pulled[stray[reached]] = led[reached]
    return pulled
