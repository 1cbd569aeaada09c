"""Directions about a station, put into cells: those of the six faces of a cube about it, at even steps of angle.

In: beams from the station. Out: the cell that each lies in, and the part of the cell, as one bit of 64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from projects.model import Floats, Ints

Bits = NDArray[np.uint64]

SIDE_BITS = 24
MIDDLE = 0.8  # rad, more than from the middle of a cube's face to its edge: no angle on it is below 0
SUB_CELLS = 8  # parts of a cell along its edge


def direction_keys(beams: Floats, cell: float) -> tuple[Ints, Ints, Ints]:
    """Return the key (n,) of the cell of directions that each beam lies in, its row and column on its cube's face."""
    face, *angles = face_angles(beams)
    row, column = (np.floor(angle / cell).astype(np.int64) for angle in angles)
    return join_key(face, row, column), row, column


def face_angles(beams: Floats) -> tuple[Ints, Floats, Floats]:
    """Return the face (n,) of the cube that each beam meets, 2 axis + (1 on its positive side), and both angles (n,)
    [rad] from its middle, towards the next axis and the one after, `MIDDLE` added."""
    axis = np.abs(beams).argmax(axis=1)
    along = beams[np.arange(len(beams)), axis]
    u, v = (beams[np.arange(len(beams)), (axis + k) % 3] / np.abs(along) for k in (1, 2))
    return 2 * axis + (along > 0.0), np.arctan(u) + MIDDLE, np.arctan(v) + MIDDLE


def join_key(face: Ints, row: Ints, column: Ints) -> Ints:
    """Return the key (n,) of cells on faces of the cube."""
    return (face << (2 * SIDE_BITS)) | (row << SIDE_BITS) | column


def face_of_key(key: Ints) -> Ints:
    """Return the face (n,) of the cube that cells lie on."""
    return key >> (2 * SIDE_BITS)


def part_bits(beams: Floats, cell: float) -> Bits:
    """Return the bit (n,) of the part of its cell that each beam lies in: parts are counted along its columns first."""
    _, *angles = face_angles(beams)
    row, column = (np.minimum((angle / cell % 1.0 * SUB_CELLS).astype(np.int64), SUB_CELLS - 1) for angle in angles)
    return np.left_shift(np.uint64(1), (row * SUB_CELLS + column).astype(np.uint64))
