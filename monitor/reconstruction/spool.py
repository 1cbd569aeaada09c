"""Arrays of a tile laid aside in a file until a neighbour asks: memory holds the tiles in work and no others."""

from __future__ import annotations

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
        """Lay the arrays of a tile aside."""
        with (self.folder / f"{tile}.npy").open("wb") as file:
            for array in arrays:
                np.save(file, array, allow_pickle=False)

    def get(self, tile: int, n_arrays: int) -> list[Any]:
        """Return the first `n_arrays` arrays of a tile, as they were laid aside."""
        with (self.folder / f"{tile}.npy").open("rb") as file:
            return [np.load(file, allow_pickle=False) for _ in range(n_arrays)]
