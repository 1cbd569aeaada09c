"""A triangle mesh with what is known of each vertex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from projects.arrays import Bools, Floats, Ints, hold_array, require_sigmas
from projects.errors import ShapeError


@dataclass(frozen=True)
class Surface:
    """A triangle mesh with what is known of each vertex.

    Attributes
    ----------
    vertices : (n, 3) float64, m.
    faces : (m, 3) int32, counter-clockwise seen from outside (from where the scanners stood).
    normals : (n, 3) float64, outward unit normals.
    sigma : (n,) float64, m, one sigma of the vertex along its normal; NaN where it cannot be stated.
    sigma_shared : (n,) float64, m, one sigma of the error that a whole neighbourhood shares: what the scans of the
        epoch disagree by and how well they are placed. NaN where nothing tells either, absent where it was not looked
        for.
    n_support : (n,) int32, how many samples the vertex rests on.
    sample_distance : (n,) float64, m, distance to the nearest sample.
    stray_share : (n,) float32, share of the points measured around the vertex that lie off the surface; NaN where there
        are none, absent where it was not looked for.
    roughness : (n,) uint8, `Roughness` of the nearest samples.
    colors, intensity : as of `PointCloud`.
    is_unresolved : (n,) bool, vertices beside a place left open because two sheets come nearer each other there than
        the cells of the surface tell apart; absent where there are none.
    is_crest : (n,) bool, vertices on the line where two sides of an edge or fold meet, their normals the mean of both;
        absent where there are none.
    face_invented : (m,) bool, faces that close holes where nothing was measured; absent where there are none.
    """

    vertices: Floats
    faces: Ints
    normals: Floats | None = None
    sigma: Floats | None = None
    sigma_shared: Floats | None = None
    n_support: Ints | None = None
    sample_distance: Floats | None = None
    stray_share: Floats | None = None
    roughness: NDArray[np.uint8] | None = None
    colors: NDArray[np.uint8] | None = None
    intensity: Floats | None = None
    is_unresolved: Bools | None = None
    is_crest: Bools | None = None
    face_invented: Bools | None = None

    def __post_init__(self) -> None:
        hold_array(self, "vertices", (None, 3), np.float64)
        hold_array(self, "faces", (None, 3), np.int32)
        n, faces = len(self.vertices), self.faces
        if len(faces) and (faces.min() < 0 or faces.max() >= n):
            raise ShapeError(f"faces name vertices {faces.min()} to {faces.max()}; the surface has 0 to {n - 1}")
        hold_array(self, "normals", (n, 3), np.float64)
        hold_array(self, "colors", (n, 3), np.uint8)
        hold_array(self, "face_invented", (len(faces),), np.bool_)
        kinds = {"sigma": np.float64, "sigma_shared": np.float64, "n_support": np.int32, "sample_distance": np.float64,
                 "stray_share": np.float32, "roughness": np.uint8, "intensity": np.float32, "is_unresolved": np.bool_,
                 "is_crest": np.bool_}  # fmt: skip
        for name, kind in kinds.items():
            hold_array(self, name, (n,), kind)
        require_sigmas(self, "sigma", "sigma_shared")
