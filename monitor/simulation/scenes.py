"""What a simulated scanner looks at: bodies (triangle meshes with a reflectance), and the truth about their surface.

A `Scene` goes to `scan`; a `Truth` answers where the surface is, exactly, for tests and benchmarks. Plane, sphere,
step and wave relief are here; the carved figure is in `figure`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from projects.errors import ParameterError, ShapeError
from projects.model import Bools, Floats, Ints, Surface
from projects.transforms import apply, invert, rotate


@dataclass(frozen=True)
class Truth:
    """The exact surface of a scene.

    Attributes
    ----------
    closest_point : (n, 3) m -> (n, 3) m, the nearest point of the surface.
    signed_distance : (n, 3) m -> (n,) m, positive outside (towards the scanner: material would be gained).
    normal : (n, 3) m -> (n, 3), outward unit normal at the nearest point.
    curvature : (n, 3) m -> (n, 2) 1/m, principal curvatures at the nearest point, the larger first, positive where
        the surface is convex seen from outside (1/r, 1/r of a ball); their mean is the mean curvature, half the
        divergence of the outward normal. NaN on edges, and where it is not known.
    """

    closest_point: Callable[[Floats], Floats]
    signed_distance: Callable[[Floats], Floats]
    normal: Callable[[Floats], Floats]
    curvature: Callable[[Floats], Floats] = lambda points: np.full((len(points), 2), np.nan)

    def moved(self, T_project_scene: Floats) -> Truth:
        """Return the truth of the same surface moved rigidly."""
        inverse = invert(T_project_scene)
        return Truth(
            closest_point=lambda points: apply(T_project_scene, self.closest_point(apply(inverse, points))),
            signed_distance=lambda points: self.signed_distance(apply(inverse, points)),
            normal=lambda points: rotate(T_project_scene, self.normal(apply(inverse, points))),
            curvature=lambda points: self.curvature(apply(inverse, points)),
        )


@dataclass(frozen=True)
class Body:
    """One piece of a scene: a triangle mesh, its diffuse reflectance and the share of light it mirrors.

    Attributes
    ----------
    vertices : (n, 3) m; faces : (m, 3), counter-clockwise from outside.
    reflectance : 0 to 1, one value or (m,) one per face.
    gloss : 0 to 1, share of the light reflected as by a mirror (glaze, polished stone).
    """

    name: str
    vertices: Floats
    faces: Ints
    reflectance: float | Floats = 0.6
    gloss: float = 0.0

    def __post_init__(self) -> None:
        if np.ndim(self.reflectance) == 1 and len(np.asarray(self.reflectance)) != len(self.faces):
            raise ShapeError(f"{self.name}: {len(np.asarray(self.reflectance))} reflectances, {len(self.faces)} faces")
        if np.min(self.reflectance) < 0 or np.max(self.reflectance) > 1 or not 0 <= self.gloss <= 1:
            raise ParameterError(f"{self.name}: reflectance and gloss must lie between 0 and 1")

    def moved(self, T_project_body: Floats) -> Body:
        """Return the body moved rigidly."""
        vertices = apply(T_project_body, self.vertices)
        return Body(self.name, vertices, self.faces, self.reflectance, self.gloss)

    def surface(self) -> Surface:
        """Return the body's mesh."""
        return Surface(self.vertices, self.faces)


@dataclass(frozen=True)
class TrueTarget:
    """A survey target: a sphere, or a black-and-white board, whose centre is known.

    Attributes
    ----------
    kind : sphere or board.
    centre : (3,) m, of the sphere, or of the board's face, where its four fields meet.
    size : m, radius of the sphere, or side of the board.
    normal : (3,), of the board's face; None for a sphere.
    """

    name: str
    kind: str
    centre: Floats
    size: float
    normal: Floats | None = None


@dataclass(frozen=True)
class Scene:
    """Bodies that stand together, and the truth of the one that is monitored.

    Attributes
    ----------
    truth : of the monitored body or bodies.
    regions : named parts of its surface: points (n, 3) m near it -> mask (n,), whether they belong to the part.
    targets : survey targets in the scene.
    """

    name: str
    bodies: tuple[Body, ...]
    truth: Truth | None = None
    regions: Mapping[str, Callable[[Floats], Bools]] = field(default_factory=dict)
    targets: tuple[TrueTarget, ...] = ()

    def bounds(self) -> Floats:
        """Return the lowest and highest corner, (2, 3) m."""
        low = np.min([body.vertices.min(axis=0) for body in self.bodies], axis=0)
        high = np.max([body.vertices.max(axis=0) for body in self.bodies], axis=0)
        return np.stack([low, high])


def make_box(name: str, low: ArrayLike, high: ArrayLike, *, reflectance: float = 0.6) -> Body:
    """Return a closed box between two corners [m]."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    start, end = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    vertices = start + corners * (end - start)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))], dtype=np.int32)
    return Body(name, vertices, faces, reflectance)


def grid_faces(n_u: int, n_v: int) -> Ints:
    """Return the triangles of an n_u x n_v grid of vertices (row-major in u), counter-clockwise seen from +z."""
    index = np.arange(n_u * n_v).reshape(n_u, n_v)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32)


def make_slab(
    name: str, size: float, step: float, height: Callable[[Floats, Floats], Floats], reflectance: float = 0.6
) -> Body:
    """Return a closed slab, `size` square, its top z = height(x, y) on a grid, its bottom 0.1 m below that."""
    n = max(2, round(size / step) + 1)
    axis = np.linspace(-size / 2, size / 2, n)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    top = np.column_stack([x, y, height(x, y)])
    vertices, faces = close_slab(top, (n, n), np.array([0.0, 0.0, top[:, 2].min() - 0.1]))
    return Body(name, vertices, faces, reflectance)


def close_slab(top: Floats, shape: tuple[int, int], under: Floats) -> tuple[Floats, Ints]:
    """Return vertices and faces of a closed slab: its top is a grid of `shape`, its flat bottom a fan about `under`."""
    rim = rim_of_grid(*shape)
    below = np.column_stack([top[rim, :2], np.full(len(rim), under[2])])
    vertices = np.concatenate([top, below, [under]])
    after, low = np.roll(rim, -1), len(top) + np.arange(len(rim))
    next_low, centre = np.roll(low, -1), np.full(len(rim), len(vertices) - 1)
    walls = [np.column_stack([low, next_low, after]), np.column_stack([low, after, rim])]
    faces = np.concatenate([grid_faces(*shape), *walls, np.column_stack([next_low, low, centre])])
    return vertices, faces.astype(np.int32)


def rim_of_grid(n_u: int, n_v: int) -> Ints:
    """Return the nodes round the rim of a grid, counter-clockwise seen from where its faces look."""
    index = np.arange(n_u * n_v).reshape(n_u, n_v)
    return np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])


def plane_scene(*, size: float = 1.0, reflectance: float = 0.6) -> Scene:
    """Return a square slab whose top is the plane z = 0; the truth is the unbounded plane."""
    body = make_slab("plane", size, size, lambda x, y: np.zeros_like(x), reflectance)
    truth = Truth(
        closest_point=lambda p: p * [1.0, 1.0, 0.0],
        signed_distance=lambda p: p[:, 2].copy(),
        normal=lambda p: np.tile([0.0, 0.0, 1.0], (len(p), 1)),
        curvature=lambda p: np.zeros((len(p), 2)),
    )
    return Scene("plane", (body,), truth)


def sphere_scene(*, radius: float = 0.1, reflectance: float = 0.6, n_rings: int = 400) -> Scene:
    """Return a sphere about the origin; the truth is the sphere, see `make_ball` for its mesh."""
    truth = Truth(
        closest_point=lambda x: radius * x / np.linalg.norm(x, axis=1, keepdims=True),
        signed_distance=lambda x: np.linalg.norm(x, axis=1) - radius,
        normal=lambda x: x / np.linalg.norm(x, axis=1, keepdims=True),
        curvature=lambda x: np.full((len(x), 2), 1.0 / radius),
    )
    return Scene("sphere", (make_ball("sphere", np.zeros(3), radius, reflectance=reflectance, n_rings=n_rings),), truth)


def make_ball(name: str, centre: Floats, radius: float, *, reflectance: float = 0.6, n_rings: int = 200) -> Body:
    """Return a closed ball, its vertices on the sphere; its faces lie up to (pi / n_rings)**2 / 4 radii inside it."""
    polar = np.pi * (np.arange(1, n_rings)) / n_rings
    turn = np.pi * np.arange(2 * n_rings) / n_rings
    t, p = (a.ravel() for a in np.meshgrid(polar, turn, indexing="ij"))
    ring = np.column_stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
    vertices = radius * np.concatenate([ring, [[0, 0, 1.0], [0, 0, -1.0]]])
    m = 2 * n_rings
    index = np.arange(len(ring)).reshape(n_rings - 1, m)
    right = np.roll(index, -1, axis=1)
    a, b, c, d = (x.ravel() for x in (index[:-1], index[1:], right[1:], right[:-1]))
    caps_top = np.column_stack([np.full(m, len(ring)), index[0], right[0]])
    caps_low = np.column_stack([np.full(m, len(ring) + 1), right[-1], index[-1]])
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d]), caps_top, caps_low])
    return Body(name, np.asarray(centre, dtype=float) + vertices, faces.astype(np.int32), reflectance)


def step_scene(*, height: float = 0.05, size: float = 1.0, reflectance: float = 0.6) -> Scene:
    """Return two half planes, z = 0 for x < 0 and z = height for x > 0, joined by a wall at x = 0."""
    h = size / 2
    low = make_box("low", np.array([-h, -h, -0.1]), np.array([0.0, h, 0.0]), reflectance=reflectance)
    high = make_box("high", np.array([0.0, -h, -0.1]), np.array([h, h, height]), reflectance=reflectance)

    def candidates(p: Floats) -> tuple[Floats, Floats]:
        """Nearest points on the low plane, the high plane and the wall, (3, n, 3), and their distances (3, n)."""
        on_low = np.column_stack([np.minimum(p[:, 0], 0.0), p[:, 1], np.zeros(len(p))])
        on_high = np.column_stack([np.maximum(p[:, 0], 0.0), p[:, 1], np.full(len(p), height)])
        on_wall = np.column_stack([np.zeros(len(p)), p[:, 1], np.clip(p[:, 2], 0.0, height)])
        feet = np.stack([on_low, on_high, on_wall])
        return feet, np.linalg.norm(feet - p, axis=2)

    def closest(p: Floats) -> Floats:
        """Return the nearest points (n, 3) of the step."""
        feet, distance = candidates(p)
        return feet[distance.argmin(axis=0), np.arange(len(p))]

    def signed(p: Floats) -> Floats:
        """Return the distances (n,) [m] from the step, positive above."""
        outside = p[:, 2] > np.where(p[:, 0] > 0.0, height, 0.0)
        return np.where(outside, 1.0, -1.0) * candidates(p)[1].min(axis=0)

    def normal(p: Floats) -> Floats:
        """Return the unit normals (n, 3) of the nearest of the three planes."""
        nearest = candidates(p)[1].argmin(axis=0)
        return np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])[nearest]

    def curvature(p: Floats) -> Floats:
        """Zero on the planes, unknown where the foot lies on the upper or lower edge."""
        foot = closest(p)
        on_edge = (np.abs(foot[:, 0]) < 1e-9) & (np.minimum(np.abs(foot[:, 2]), np.abs(foot[:, 2] - height)) < 1e-9)
        return np.where(on_edge[:, None], np.nan, np.zeros((len(p), 2)))

    return Scene("step", (low, high), Truth(closest, signed, normal, curvature))


def wave_scene(
    *, wavelength: float = 0.01, amplitude: float = 0.001, size: float = 0.2, reflectance: float = 0.6
) -> Scene:
    """Return a relief z = amplitude * cos(2 pi x / wavelength) on a slab; its mesh has 24 cells a wave."""
    k = 2.0 * np.pi / wavelength
    body = make_slab("waves", size, wavelength / 24, lambda x, y: amplitude * np.cos(k * x), reflectance)

    def closest(p: Floats) -> Floats:
        """Return the nearest points (n, 3) of the wave, by Newton from the best of many starts."""
        # The best of 65 starts within one wavelength, then Newton on d/dx of the squared distance.
        start = p[:, :1] + wavelength * np.linspace(-1.0, 1.0, 65)
        gap2 = (start - p[:, :1]) ** 2 + (amplitude * np.cos(k * start) - p[:, 2:]) ** 2
        x = start[np.arange(len(p)), gap2.argmin(axis=1)]
        for _ in range(20):
            z, slope, bend = (
                amplitude * np.cos(k * x), -amplitude * k * np.sin(k * x), -amplitude * k * k * np.cos(k * x)
            )  # fmt: skip
            first = (x - p[:, 0]) + (z - p[:, 2]) * slope
            second = 1.0 + slope**2 + (z - p[:, 2]) * bend
            x = x - np.where(second > 0.1, first / np.maximum(second, 0.1), 0.1 * first)
        return np.column_stack([x, p[:, 1], amplitude * np.cos(k * x)])

    def signed(p: Floats) -> Floats:
        """Return the distances (n,) [m] from the wave, positive above."""
        outside = p[:, 2] > amplitude * np.cos(k * p[:, 0])
        return np.where(outside, 1.0, -1.0) * np.linalg.norm(p - closest(p), axis=1)

    def normal(p: Floats) -> Floats:
        """Return the unit normals (n, 3) of the wave, upwards."""
        n = np.column_stack([amplitude * k * np.sin(k * closest(p)[:, 0]), np.zeros(len(p)), np.ones(len(p))])
        return n / np.linalg.norm(n, axis=1, keepdims=True)

    def curvature(p: Floats) -> Floats:
        """Return the principal curvatures (n, 2) [1/m], the larger first; positive on crests."""
        x = closest(p)[:, 0]
        bent = amplitude * k * k * np.cos(k * x) / (1.0 + (amplitude * k * np.sin(k * x)) ** 2) ** 1.5
        return np.column_stack([np.maximum(bent, 0.0), np.minimum(bent, 0.0)])

    return Scene("waves", (body,), Truth(closest, signed, normal, curvature))
