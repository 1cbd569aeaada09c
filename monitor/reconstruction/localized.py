"""The localized Poisson surface: the field solved tile by tile in the sampled band, contoured into one mesh.

In: points and outward normals near the origin, a cell size. Out: a raw mesh that has no seam: tiles agree on their
borders because each node's value belongs to one tile and all others use it. After Nothegger, "Improving completeness
of geometric models from terrestrial laser scanning data" (`001`), section 3; the tiles exchange border values as in
the additive Schwarz method (Toselli & Widlund 2004), restricted to the owner. No result depends on the order in which
tiles are worked on, nor on how many at a time. What a tile hands on lies in files meanwhile: besides the points and the
mesh, memory holds the tiles in work.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from monitor.boxes import box_of
from monitor.reconstruction.band import (
    Tiles,
    cut_tiles,
    in_box,
    index_nodes,
    link_nodes,
    mark_cells,
    number_nodes,
    take_values,
)
from monitor.reconstruction.conjugate_gradients import solve_field
from monitor.reconstruction.contour import contour_tile
from monitor.reconstruction.poisson import (
    BAND,
    BLUR_PASSES,
    SCREENING_LENGTH,
    blur,
    divergence,
    field_and_start,
    screening_cells,
    screening_rows,
    screening_weights,
    splat_normals,
)
from monitor.reconstruction.spool import Spool
from monitor.reconstruction.stitching import stitch
from projects.model import Bools, Floats, Ints

TRIM = 2.3  # cells from an occupied cell within which the field is contoured: 1.5 times the largest gap
REACH = BAND + 2  # cells beyond which a point does not touch a tile
HALO = 24  # cells around a tile that are solved with it: six screening lengths
SPLAT_HALO = BLUR_PASSES + BAND + 1  # cells beyond the halo whose points reach into it
SWEEPS = 2  # the first knows no neighbours; after the second the tiles agree within a micrometre (see the tests)
TILE = 128  # cells
MOST_ITERATIONS = 1000
ROUGHLY, EXACTLY = 1e-6, 1e-7  # rms residual in cells, of all sweeps but the last and of the last


class Band(NamedTuple):
    """A tile's part of the band: dense node index, nodes in tile coordinates, and where that frame begins."""

    index: Any
    nodes: Ints
    low: Ints  # (3,) lattice coordinates of the tile frame's origin


class Lattice(NamedTuple):
    """All that a tile needs to be worked on: where the points lie, which way they look, how many fill a cell."""

    tiles: Tiles
    normals: Any  # (n, 3) float32, in the order of `tiles.points`
    full_cell: float
    longest: float  # cells over which the points hold the field, at most
    by_turn: float  # cells and rad: over how many where normals turn (`screening_by_turn`)


def localized_mesh(
    points: Floats, normals: Floats, cell: float, spacing: float, screening: float = SCREENING_LENGTH, *,
    by_turn: float = np.inf, tile: int = TILE,
    map_tiles: Callable[[Callable[[int], Any], Sequence[int]], Any] | None = None,
) -> tuple[Floats, Ints]:  # fmt: skip
    """Return vertices (n, 3) m and faces (m, 3) of the zero level of the field, within reach of the points.

    Parameters
    ----------
    points, normals : (n, 3), m and unit vectors outwards.
    cell, spacing : m; the edge of a cell, and the distance between points that makes a cell count as full.
    screening : cells over which the points hold the field (`screening_length`), at most.
    by_turn : cells and rad; this over the turn of the normals at a place is the length there, where that is shorter.
    tile : cells along a tile's edge.
    map_tiles : like `map`, over tile numbers; by default threads on this machine.
    """
    low = _place_lattice(points, cell, tile)
    tiles = cut_tiles(_on_lattice(points, cell, low), tile, REACH)
    lattice = Lattice(tiles, normals.astype(np.float32).take(tiles.order, axis=0), (cell / spacing) ** 2, screening,
                      by_turn)  # fmt: skip
    run = map_tiles or _map_threads
    numbers = range(len(tiles.corners))
    with tempfile.TemporaryDirectory(prefix="surface-tiles-") as folder:
        fields: Spool | None = None
        prepared = Spool(Path(folder, "prepared"))
        list(run(partial(prepare_tile, lattice, prepared), numbers))
        for sweep in range(SWEEPS):
            tolerance = EXACTLY if sweep == SWEEPS - 1 else ROUGHLY
            solved = Spool(Path(folder, f"sweep-{sweep}"))
            list(run(partial(solve_tile, lattice, prepared, fields, solved, tolerance), numbers))
            fields = solved
        assert fields is not None
        pieces = Spool(Path(folder, "pieces"))
        counts = list(run(partial(mesh_tile, lattice, fields, pieces), numbers))
        vertices, faces = stitch(pieces, tiles, np.array(counts).reshape(-1, 2))
    vertices += low
    vertices *= cell
    return vertices, faces


def _place_lattice(points: Floats, cell: float, tile: int) -> Floats:
    """Return the lattice point (3,) from which as few tiles as can be hold the band, it being in their middle.

    A sheet that merely came near a tile's face would be solved on both sides of it.
    """
    first, last = (np.floor(place / cell) for place in box_of(points))
    extent = last - first + 1.0
    n_tiles = np.ceil((extent + 2.0 * REACH) / tile)
    low: Floats = first - np.floor(0.5 * (n_tiles * tile - extent))
    return low


def _on_lattice(points: Floats, cell: float, low: Floats) -> Floats:
    """Return points (n, 3) m in cells from the lattice point `low`."""
    places = points / cell
    places -= low
    return places


def _map_threads(function: Callable[[int], Any], numbers: Sequence[int]) -> list[Any]:
    """Return what `function` makes of each tile, on up to four threads."""
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        return list(pool.map(function, numbers))


def prepare_tile(lattice: Lattice, prepared: Spool, tile: int) -> None:
    """Lay aside what a tile with its halo is solved from: its nodes, first values, divergence, cells with points."""
    corner, edge = lattice.tiles.corners[tile], lattice.tiles.edge
    low, high = corner - HALO, corner + edge + HALO
    band, rows, local = tile_band(lattice.tiles, tile, HALO + SPLAT_HALO, BAND)
    sums = splat_normals(local, lattice.normals.take(rows, axis=0), band.index, len(band.nodes))
    sums = blur(sums, link_nodes(band.nodes, band.index), BLUR_PASSES)
    band, keep = restrict(band, low, high)
    mean, start = field_and_start(sums.compress(keep, axis=0), band.nodes)
    rhs = divergence(mean, link_nodes(band.nodes, band.index))
    local = local.compress(in_box(local, low - band.low, high - band.low - 1), axis=0)
    cells, places, full = screening_cells(local, band.index.shape, lattice.full_cell)
    holds = screening_weights(cells, full, mean, band.index, lattice.longest, lattice.by_turn)
    frame = np.array([band.low, band.index.shape])
    prepared.put(tile, frame, band.nodes, start, rhs, cells.astype(np.int16), places, holds)


def solve_tile(
    lattice: Lattice, prepared: Spool, known: Spool | None, solved: Spool, tolerance: float, tile: int
) -> None:
    """Solve one tile with its halo; where its neighbours' values are `known`, they hold the rim of the halo.

    What the tile owns goes to `solved`: the numbers of its nodes within the tile, and their values in cells.
    """
    corner, edge = lattice.tiles.corners[tile], lattice.tiles.edge
    (low, shape), nodes, start, rhs, cells, places, holds = prepared.get(tile, 7)
    band = Band(index_nodes(nodes, shape), nodes, low)
    links = link_nodes(band.nodes, band.index)
    corners, weights = screening_rows(cells, places, band.index)
    is_fixed = np.zeros(len(start), np.bool_)
    if known is not None:
        given = spread(band, known, lattice.tiles, lattice.tiles.neighbours(tile, HALO))
        is_known = np.isfinite(given)
        start = np.where(is_known, given, start)
        is_fixed = is_known & ~in_box(nodes, corner - HALO + 1 - low, corner + edge + HALO - 1 - low)
    solve_field(start, rhs, links, (corners, weights, holds), is_fixed, tolerance, MOST_ITERATIONS)
    own = owned(band, corner, edge)
    inside = (nodes.compress(own, axis=0) + low - corner).astype(np.int32)
    solved.put(tile, (inside[:, 0] * edge + inside[:, 1]) * edge + inside[:, 2], start[own])


def mesh_tile(lattice: Lattice, fields: Spool, pieces: Spool, tile: int) -> tuple[int, int]:
    """Contour the cells whose lowest node the tile owns; return how many vertices and triangles they have.

    `pieces` gets lattice vertices (k, 3), the lattice edge (k, 4) of each as node and axis, and triangles (m, 3).
    """
    band = tile_band(lattice.tiles, tile, REACH, TRIM)[0]
    values = spread(band, fields, lattice.tiles, lattice.tiles.neighbours(tile, REACH))
    own = owned(band, lattice.tiles.corners[tile], lattice.tiles.edge)
    vertices, origin, triangles = contour_tile(values, band.index, band.nodes, own)
    edges = np.column_stack([band.nodes[origin[:, 0]] + band.low, origin[:, 1]])
    pieces.put(tile, vertices + band.low, edges, triangles)
    return len(vertices), len(triangles)


def tile_band(tiles: Tiles, tile: int, margin: int, radius: float) -> tuple[Band, Ints, Floats]:
    """Return the band of a tile and `margin` cells around it, and the points it rests on: rows, and in its frame."""
    rows = tiles.points_within(tile, margin)
    points = tiles.points.take(rows, axis=0)
    reach = int(np.ceil(radius)) + 1
    first, last = (np.floor(place).astype(np.int64) for place in box_of(points))
    low, shape = first - reach, last - first + 2 * reach + 2
    points -= low
    marks = mark_cells(points, (int(shape[0]), int(shape[1]), int(shape[2])), float(radius))
    index, nodes = number_nodes(marks)
    return Band(index, nodes, low), rows, points


def restrict(band: Band, low: Ints, high: Ints) -> tuple[Band, Bools]:
    """Return the band with only the nodes in [low, high) of the lattice, and which those are."""
    keep = in_box(band.nodes, low - band.low, high - band.low)
    nodes = band.nodes.compress(keep, axis=0)
    return Band(index_nodes(nodes, np.array(band.index.shape)), nodes, band.low), keep


def owned(band: Band, corner: Ints, edge: int) -> Bools:
    """Return which nodes of the band lie in the tile at `corner`."""
    mask: Bools = in_box(band.nodes, corner - band.low, corner + edge - band.low)
    return mask


def spread(band: Band, fields: Spool, tiles: Tiles, owners: list[int]) -> Any:
    """Return the owners' values at the band's nodes (n,) float32, NaN where no owner has one."""
    out = np.full(len(band.nodes), np.nan, np.float32)
    for j in owners:
        number, values = fields.get(j, 2)
        take_values(number, values, tiles.edge, tiles.corners[j] - band.low, band.index, out)
    return out
