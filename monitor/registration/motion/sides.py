"""One side of a registration: the usable points of a surface or cloud, centred, with their normals and search tree.

In: `Surface` or `PointCloud`. Out: `Side`, whose normals and spacings are found where they are asked for (a cloud of
a million points is matched at some ten thousand of them). Points without a finite position, on a free edge, of an
invented face, or whose sigma cannot be stated are not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.registration.motion.search_tree import SearchTree
from projects.errors import ShapeError
from projects.model import Bools, Floats, Ints, PointCloud, Surface
from projects.triangles import area_vectors, face_areas, vertex_normals

N_NORMAL_NEIGHBOURS = 16  # of the plane fitted where a cloud brings no normals
N_COVER = 50_000  # points over the whole of a mesh, where its faces are larger than that
LARGE_IN_CELLS = 4.0  # a face of so many of their cells gets points of its own
FEW_FACES = 400_000  # meshes with more need no cover
RAGGED = 0.3  # share of vertices on free edges above which corners are joined first
N_RIM_NEIGHBOURS = 32  # tell a rim within about one spacing
WIDE_RIM_NEIGHBOURS = 128  # tell it within two: so far spots reach past a limb
RIM_SHARE = 50  # one in so many of the points of a side is enough for these
RIMS_AT_ONCE = 8192  # points, of which all neighbours are held in memory
RIM_OFFSET = 0.4  # of the neighbours' mean distance; 0.64 at a straight rim, by chance once in a hundred points
N_SPACING_NEIGHBOURS = 6  # a surface point has about six natural neighbours


class Side:
    """Points (n, 3) [m] less `shift`, with `index` into the input; owns a search tree.

    `cosines` (n,) are of the incidence at which each point was seen, 1 where that is not known; `views` (n, 3) the unit
    directions to look along at the rims of what a scan saw (None: nothing ends where the points end); `shared`
    (n,) [m] is one sigma of the error that whole neighbourhoods share (0 where none is stated). Where a side
    `has_wide_rims`, what lies within two spacings of a rim counts as one.
    """

    def __init__(
        self, points: Floats, normals: Floats | None, sigma: Floats | None, index: Ints,
        cosines: Floats | None = None, views: Floats | None = None, shared: Floats | None = None,
    ) -> None:  # fmt: skip
        self.points = points
        self.sigma = sigma
        self.index = index
        self.cosines = np.ones(len(points)) if cosines is None else cosines
        self.views = views
        self.shared = np.zeros(len(points)) if shared is None else shared
        self._rim = np.full(len(points), np.nan)
        self.is_oriented = normals is not None
        self._normals = np.full(points.shape, np.nan) if normals is None else normals  # filled only where own
        self.has_wide_rims = False
        self._around = Surroundings.of_none(len(points))
        self._tree: SearchTree | None = None

    def __len__(self) -> int:
        return len(self.points)

    def shifted(self, offset: Floats) -> Side:
        """Return the side less `offset` (3,) [m]."""
        return Side(
            self.points - offset, self.own_normals, self.sigma, self.index, self.cosines, self.views, self.shared
        )

    def take(self, keep: Bools) -> Side:
        """Return the side with the points of a mask (n,) alone."""
        normals = self._normals[keep] if self.is_oriented else None
        sigma = None if self.sigma is None else self.sigma[keep]
        views = None if self.views is None else self.views[keep]
        return Side(self.points[keep], normals, sigma, self.index[keep], self.cosines[keep], views, self.shared[keep])

    @property
    def tree(self) -> SearchTree:
        """Search tree over the points, built when first asked for."""
        if self._tree is None:
            self._tree = SearchTree(self.points)
        return self._tree

    @property
    def own_normals(self) -> Floats | None:
        """Unit normals (n, 3) that the points brought along, None where they brought none."""
        return self._normals if self.is_oriented else None

    def normals_of(self, which: Ints) -> Floats:
        """Return unit normals (k, 3); without sign where `is_oriented` is False; NaN where undefined."""
        unknown = np.unique(which[np.isnan(self._normals[which, 0])]) if not self.is_oriented else which[:0]
        if len(unknown):
            self._normals[unknown] = fit_normals(self.tree, unknown)
        return self._normals[which]

    def spacing_of(self, which: Ints) -> Floats:
        """Return the mean distance (k,) [m] to the nearest six other points of this side."""
        rows = self._rows_around(which)
        return self._around.spacing[rows]

    def relief_of(self, which: Ints) -> Floats:
        """Return one sigma (k,) [m] of what the six nearest other points scatter by along each point's normal.

        It holds noise, and relief too fine for the spacing of the points. The point itself is left out, so that no
        weight goes by the error that it weighs.
        """
        rows = self._rows_around(which)
        around = self._around
        unknown = np.isnan(around.relief[rows])
        if unknown.any():
            new, first = np.unique(rows[unknown], return_index=True)
            numbers = which[unknown][first]
            near, normals = around.near[new], self.normals_of(numbers)
            around.relief[new] = scatter_along(self.points[near] - self.points[numbers][:, None], normals)
        return around.relief[rows]

    def _rows_around(self, which: Ints) -> Ints:
        """Return where in `Surroundings` the points (k,) are, looked around first where that was not done before."""
        asked = which[self._around.row[which] < 0]
        if len(asked):
            unknown = asked[np.sort(np.unique(asked, return_index=True)[1])]  # in the order asked, near to near
            self._around = self._around.with_more(unknown, *look_around(self.tree, unknown))
        return self._around.row[which]

    def frontality_of(self, which: Ints) -> Floats:
        """Return how frontally points (k,) were seen: the cosine of the incidence, 0 at a rim of what a scan saw."""
        if self.views is None:
            return self.cosines[which]
        unknown = np.unique(which[np.isnan(self._rim[which])])
        if len(unknown):
            wide = min(WIDE_RIM_NEIGHBOURS, len(self) // RIM_SHARE) if self.has_wide_rims else 0
            self._rim[unknown] = at_rim(self.tree, unknown, self.views[unknown], max(N_RIM_NEIGHBOURS, wide))
        return np.where(self._rim[which] > 0.0, 0.0, self.cosines[which])


@dataclass(frozen=True)
class Surroundings:
    """What lies around those points of a side (n) that were looked around: `row` (n,) in the arrays that follow, -1 of
    the others; the numbers of the `near`est six (m, 6), their mean distance, `spacing` (m,) [m], and what they scatter
    by along the normal, `relief` (m,) [m], NaN until it is asked for."""

    row: Ints
    near: Ints
    spacing: Floats
    relief: Floats

    @classmethod
    def of_none(cls, n: int) -> Surroundings:
        """Return that of no point of a side with n points."""
        return cls(np.full(n, -1, dtype=np.int32), np.empty((0, 0), dtype=np.int64), np.empty(0), np.empty(0))

    def with_more(self, which: Ints, near: Ints, spacing: Floats) -> Surroundings:
        """Return this with what lies around points `which` (k,) besides."""
        n = len(self.spacing)
        row = self.row.copy()
        row[which] = np.arange(n, n + len(which))
        near = np.concatenate([self.near, near]) if n else near
        unknown = np.full(len(which), np.nan)
        return Surroundings(row, near, np.append(self.spacing, spacing), np.append(self.relief, unknown))


def look_around(tree: SearchTree, which: Ints) -> tuple[Ints, Floats]:
    """Return the numbers (k, 6) of the nearest other points of some points, fewer where there are fewer, and their mean
    distance (k,) [m]."""
    k = min(N_SPACING_NEIGHBOURS + 1, tree.n)
    distance, near = tree.query(tree.data[which], k=range(1, k + 1))
    return near[:, 1:], distance[:, 1:].sum(axis=1) / N_SPACING_NEIGHBOURS


def scatter_along(offsets: Floats, normals: Floats) -> Floats:
    """Return the standard deviation (k,) [m], along `normals` (k, 3), of points (k, m, 3) [m] around each of k."""
    heights = np.einsum("nki,ni->nk", offsets, normals)
    heights -= heights.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.einsum("nk,nk->n", heights, heights) / max(heights.shape[1] - 1, 1)))


def at_rim(tree: SearchTree, which: Ints, views: Floats, n_around: int) -> Bools:
    """Return the points (k,) that have all `n_around` neighbours to one side, seen along `views` (k, 3).

    There a surface ends or turns away, and part of the spot misses it. The middle of the neighbours of a point on a
    straight rim lies 0.64 of their mean distance away from it, that of one in a field without end 0.16 on average.
    """
    k = min(n_around + 1, tree.n)
    out = np.empty(len(which), dtype=bool)
    for first in range(0, len(which), RIMS_AT_ONCE):
        block = slice(first, first + RIMS_AT_ONCE)
        some, view = which[block], views[block]
        offsets = tree.data[tree.query(tree.data[some], k=k)[1][:, 1:]] - tree.data[some][:, None]
        offsets -= np.einsum("nki,ni->nk", offsets, view)[:, :, None] * view[:, None]
        reach = np.linalg.norm(offsets, axis=2).mean(axis=1)
        out[block] = np.linalg.norm(offsets.mean(axis=1), axis=1) > RIM_OFFSET * reach
    return out


def fit_normals(tree: SearchTree, which: Ints) -> Floats:
    """Return the unit normals (k, 3), without sign, of planes fitted to the neighbourhoods of points `which`."""
    k = min(N_NORMAL_NEIGHBOURS, tree.n)
    _, neighbours = tree.query(tree.data[which], k=k)
    patches = tree.data[neighbours]
    patches = patches - patches.mean(axis=1, keepdims=True)
    moments = np.einsum("nki,nkj->nij", patches, patches)
    return np.linalg.eigh(moments)[1][:, :, 0]


def prepare_side(nouns: Surface | PointCloud, shift: Floats) -> Side:
    """Return the usable points of a surface or cloud, less `shift` (3,) [m], as one side of a registration.

    `Side.index` is -1 for points put onto large faces.
    """
    normals: Floats | None
    if isinstance(nouns, Surface):
        points, normals, sigma, index = cover_surface(nouns)
    elif isinstance(nouns, PointCloud):
        points, normals, sigma, index = nouns.points, nouns.normals, nouns.sigma, np.arange(len(nouns.points))
    else:
        raise ShapeError(f"a {type(nouns).__name__} cannot be registered; give a Surface or a PointCloud")
    usable = np.isfinite(np.einsum("ij->i", points))
    shared = _shared_sigma(nouns, index)
    if normals is not None:
        usable &= np.abs(np.einsum("ij,ij->i", normals, normals) - 1.0) < 1e-3
    if sigma is not None:
        usable &= np.isfinite(sigma) & (sigma >= 0.0)
    cosines, views = _seen(nouns) if isinstance(nouns, PointCloud) else (np.ones(len(points)), None)
    if not usable.all():
        points, index, cosines, shared = points[usable], index[usable], cosines[usable], shared[usable]
        views = None if views is None else views[usable]
        normals = None if normals is None else normals[usable]
        sigma = None if sigma is None else sigma[usable]
    return Side(points - shift, normals, sigma, index, cosines, views, shared)


def _shared_sigma(nouns: Surface | PointCloud, index: Ints) -> Floats:
    """Return what the scans of a surface disagree by (n,) [m] at its vertices `index`, 0 where nothing states it."""
    if not isinstance(nouns, Surface) or nouns.sigma_shared is None:
        return np.zeros(len(index))
    stated = np.append(np.nan_to_num(nouns.sigma_shared), 0.0)  # -1, a point on a large face, is the last
    return stated[index]


def _seen(cloud: PointCloud) -> tuple[Floats, Floats | None]:
    """Return the cosine (n,) of each point's incidence and the direction (n, 3) to look along at rims: the beam's,
    or the normal where it is not known where the scanner stood; None without either."""
    cosines = cloud.incidence_cosines()
    if cloud.normals is None or cloud.origins is None:
        return cosines, cloud.normals
    beams = np.atleast_2d(cloud.origins) - cloud.points
    beams = beams / np.linalg.norm(beams, axis=1, keepdims=True)
    return cosines, np.where(np.isfinite(beams), beams, cloud.normals)


def cover_surface(surface: Surface) -> tuple[Floats, Floats, Floats | None, Ints]:
    """Return points, normals, sigma and vertex numbers of a mesh: its inner vertices, and points on large faces.

    A CAD model is a few large faces, of which the vertices say nothing; they are covered as densely as
    `N_COVER` points cover the whole. Vertices on a free edge or without a face are left out, and so are faces that
    close holes where nothing was measured.
    """
    normals = vertex_normals(surface.vertices, surface.faces) if surface.normals is None else surface.normals
    usable = ~(on_free_edge(surface) | touches_invented(surface))
    usable &= np.bincount(surface.faces.ravel(), minlength=len(usable)) > 0
    index = np.flatnonzero(usable)
    points, normals = surface.vertices[index], normals[index]
    sigma = None if surface.sigma is None else surface.sigma[index]
    faces, places = cover_large_faces(surface)
    if len(faces):
        corners = surface.faces[faces]
        points = np.vstack([points, np.einsum("nk,nki->ni", places, surface.vertices[corners])])
        flat = area_vectors(surface.vertices[surface.faces[faces]])
        normals = np.vstack([normals, flat / np.linalg.norm(flat, axis=1, keepdims=True)])
        index = np.concatenate([index, np.full(len(faces), -1)])
        if surface.sigma is not None and sigma is not None:
            sigma = np.concatenate([sigma, surface.sigma[corners].mean(axis=1)])
    return points, normals, sigma, index


def cover_large_faces(surface: Surface) -> tuple[Ints, Floats]:
    """Return faces (k,), repeated, and barycentric places (k, 3) that cover the faces too large for their vertices."""
    none = np.empty(0, dtype=int), np.empty((0, 3))
    if not len(surface.faces) or len(surface.faces) > FEW_FACES:
        return none
    areas = face_areas(surface.vertices[surface.faces])
    measured = np.ones(len(areas), dtype=bool) if surface.face_invented is None else ~surface.face_invented
    cell = areas[measured].sum() / N_COVER
    large = np.flatnonzero(measured & (areas > LARGE_IN_CELLS * cell))
    if not len(large):
        return none
    counts = np.ceil(areas[large] / cell).astype(int)
    faces = np.repeat(large, counts)
    # the additive sequence of the plastic number is even over the square, folded onto the triangle
    u, v = np.mod(np.arange(1, len(faces) + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]), 1.0).T
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    return faces, np.column_stack([1.0 - u - v, u, v])


def on_free_edge(surface: Surface) -> Bools:
    """Return for each vertex (n,) whether it lies on a boundary of the mesh.

    Around an inner vertex the opposite edges b -> c close to a ring, so the sum of c - b (as vertex numbers) is zero;
    around a boundary vertex it is the last less the first number of the open fan.
    """
    free = _has_gap(surface.faces, len(surface.vertices))
    if free.mean() > RAGGED:  # each face with its own corners, as STL files have them: join equal corners
        _, joined = np.unique(surface.vertices, axis=0, return_inverse=True)
        free = _has_gap(joined[surface.faces], int(joined.max()) + 1)[joined]
    return free


def _has_gap(faces: Ints, n: int) -> Bools:
    """Return for each of n vertices whether the faces around it leave a gap."""
    gap = np.zeros(n)
    for corner in range(3):
        b, c = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        gap += np.bincount(faces[:, corner], c.astype(float) - b, n)
    return gap != 0.0


def touches_invented(surface: Surface) -> Bools:
    """Return for each vertex (n,) whether a face around it closes a hole where nothing was measured."""
    touched = np.zeros(len(surface.vertices), dtype=bool)
    if surface.face_invented is not None:
        touched[surface.faces[surface.face_invented].ravel()] = True
    return touched
