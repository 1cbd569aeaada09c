"""Arrays of a tile laid aside in a file until a neighbour asks: memory holds the tiles in work and no others."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np


class Spool:
    """A folder with one file a tile; whoever makes the folder removes it.

    A tile's file is written once, by whichever worker has the tile, and read by any number afterwards.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder

    def put(self, tile: int, *arrays: Any) -> None:
        """Lay the arrays of a tile aside: a line of their kinds and shapes, then the numbers."""
        with (self.folder / f"{tile}").open("wb") as file:
            file.write(json.dumps([(array.dtype.str, array.shape) for array in arrays]).encode() + b"\n")
            for array in arrays:
                np.ascontiguousarray(array).tofile(file)

    def get(self, tile: int, n_arrays: int) -> list[Any]:
        """Return the first `n_arrays` arrays of a tile, as they were laid aside."""
        with (self.folder / f"{tile}").open("rb") as file:
            shapes = json.loads(file.readline())[:n_arrays]
            return [np.fromfile(file, kind, math.prod(shape)).reshape(shape) for kind, shape in shapes]
