"""One side of a registration: the usable points of a surface or cloud, centred, with their normals and search tree.

In: `Surface` or `PointCloud`. Out: `Side`, whose normals and spacings are found where they are asked for (a cloud of
a million points is matched at some ten thousand of them). Points without a finite position, on a free edge, of an
invented face, or whose sigma cannot be stated are not used.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from projects.errors import ShapeError
from projects.model import Bools, Floats, Ints, PointCloud, Surface

N_NORMAL_NEIGHBOURS = 16  # of the plane fitted where a cloud brings no normals
N_SPACING_NEIGHBOURS = 6  # a surface point has about six natural neighbours


class Side:
    """Points (n, 3) [m] less `shift`, with `index` into the input; owns a search tree."""

    def __init__(self, points: Floats, normals: Floats | None, sigma: Floats | None, index: Ints) -> None:
        self.points = points
        self.sigma = sigma
        self.index = index
        self.is_oriented = normals is not None
        self._normals = np.full(points.shape, np.nan) if normals is None else normals  # filled only where own
        self._spacing = np.full(len(points), np.nan)
        self._tree: cKDTree | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def tree(self) -> cKDTree:
        """Search tree over the points, built when first asked for."""
        if self._tree is None:
            self._tree = cKDTree(self.points, leafsize=32, balanced_tree=False, compact_nodes=False)
        return self._tree

    def normals_of(self, which: Ints) -> Floats:
        """Return unit normals (k, 3); without sign where `is_oriented` is False; NaN where undefined."""
        unknown = np.unique(which[np.isnan(self._normals[which, 0])]) if not self.is_oriented else which[:0]
        if len(unknown):
            self._normals[unknown] = fit_normals(self.tree, unknown)
        return self._normals[which]

    def spacing_of(self, which: Ints) -> Floats:
        """Return the mean distance (k,) [m] to the nearest six other points of this side."""
        unknown = np.unique(which[np.isnan(self._spacing[which])])
        if len(unknown):
            distance, _ = self.tree.query(self.points[unknown], k=N_SPACING_NEIGHBOURS + 1, workers=-1)
            self._spacing[unknown] = np.where(np.isfinite(distance[:, 1:]), distance[:, 1:], 0.0).mean(axis=1)
        return self._spacing[which]


def fit_normals(tree: cKDTree, which: Ints) -> Floats:
    """Return the unit normals (k, 3), without sign, of planes fitted to the neighbourhoods of points `which`."""
    k = min(N_NORMAL_NEIGHBOURS, tree.n)
    _, neighbours = tree.query(tree.data[which], k=k, workers=-1)
    patches = tree.data[neighbours]
    patches = patches - patches.mean(axis=1, keepdims=True)
    moments = np.einsum("nki,nkj->nij", patches, patches)
    return np.linalg.eigh(moments)[1][:, :, 0]


def prepare_side(nouns: Surface | PointCloud, shift: Floats) -> Side:
    """Return the usable points of a surface or cloud, less `shift` (3,) [m], as one side of a registration."""
    if isinstance(nouns, Surface):
        points, normals = nouns.vertices, nouns.normals
        normals = vertex_normals(nouns) if normals is None else normals
        usable = ~(on_free_edge(nouns) | touches_invented(nouns))
        usable &= np.bincount(nouns.faces.ravel(), minlength=len(points)) > 0
    elif isinstance(nouns, PointCloud):
        points, normals = nouns.points, nouns.normals
        usable = np.ones(len(points), dtype=bool)
    else:
        raise ShapeError(f"a {type(nouns).__name__} cannot be registered; give a Surface or a PointCloud")
    usable &= np.isfinite(points).all(axis=1)
    if normals is not None:
        usable &= np.abs(np.einsum("ij,ij->i", normals, normals) - 1.0) < 1e-3
    if nouns.sigma is not None:
        usable &= np.isfinite(nouns.sigma) & (nouns.sigma >= 0.0)
    if usable.all():
        return Side(points - shift, normals, nouns.sigma, np.arange(len(points)))
    index = np.flatnonzero(usable)
    return Side(
        points[index] - shift,
        None if normals is None else normals[index],
        None if nouns.sigma is None else nouns.sigma[index],
        index,
    )


def vertex_normals(surface: Surface) -> Floats:
    """Return unit normals (n, 3) at the vertices, the area-weighted mean of the faces around; NaN without faces."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.vertices)
    for axis in range(3):
        for corner in range(3):
            normals[:, axis] += np.bincount(surface.faces[:, corner], face_normals[:, axis], len(normals))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.full_like(normals, np.nan), where=length > 0)


def on_free_edge(surface: Surface) -> Bools:
    """Return for each vertex (n,) whether it lies on a boundary of the mesh.

    Around an inner vertex the opposite edges b -> c close to a ring, so the sum of c - b (as vertex numbers) is zero;
    around a boundary vertex it is the last less the first number of the open fan.
    """
    n = len(surface.vertices)
    gap = np.zeros(n)
    for corner in range(3):
        b, c = surface.faces[:, (corner + 1) % 3], surface.faces[:, (corner + 2) % 3]
        gap += np.bincount(surface.faces[:, corner], c.astype(float) - b, n)
    return gap != 0.0


def touches_invented(surface: Surface) -> Bools:
    """Return for each vertex (n,) whether a face around it closes a hole where nothing was measured."""
    touched = np.zeros(len(surface.vertices), dtype=bool)
    if surface.face_invented is not None:
        touched[surface.faces[surface.face_invented].ravel()] = True
    return touched
