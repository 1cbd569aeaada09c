"""Wear against motion: which losses pass for parts that moved as a whole, and which motions are told.

A closed body of 0.6 m with soft bumps, scanned without gaps: pairs of surfaces, compared and searched for parts as the
chain does it, all settings automatic. One place of the later one was worn, in several shapes, or moved rigidly.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
from rows import Row, Size, judge
from scipy.spatial import ConvexHull

from monitor.comparison import compare
from monitor.comparison.regions.moved_parts import tell_moved
from monitor.reconstruction.mesh import normals_by_angle
from monitor.registration import register
from monitor.registration.parts import find_parts
from projects.model import Z95, Floats, Ints, Surface
from projects.transforms import apply, perturb

TITLE = "Wear that passes for a part that moved, and parts that did"
LIMIT = 3000.0
N_VERTICES = 16_000
NOISE = 2e-4  # m
RADIUS = 0.3  # m, about
PAIRS = {"small": 1, "full": 6}
SMALL = ("worn as a cosine bowl, 3 mm deep, 0.24 m in radius", "moved by 2.4 mm and 27 mrad, 0.17 m in radius")
SMALL_BARS = SMALL
HALF = 0.55  # rad, of what has a sharp border
TOWARDS = np.array([1.0, 0.2, 0.3]) / np.linalg.norm([1.0, 0.2, 0.3])
ACROSS = np.cross(TOWARDS, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(TOWARDS, [0.0, 0.0, 1.0]))
MOTION = np.array([0.010, -0.020, 0.015, 1e-3, 2e-3, -1e-3])  # rad, m
CAUSES = {
    "moved": "the shape, with so much noise, does not hold all six parameters of so small a motion: no part is stated",
    "worn": "a loss that varies as slowly as a tilt does, up to a sharp border, looks like a tilt: two surfaces alone "
    "do not tell which it was",
}
NOTES = (
    "A part passes for one where the comparison's `parts` hold it; what regions are called is of all pairs. Errors of "
    "a vertex 0.2 mm, vertices 8 mm apart."
)

Depth = Callable[[Floats, Floats], Floats]  # of the angle (n,) [rad] off the middle and the direction (n, 3), in m


def bowl(depth: float, half: float) -> Depth:
    """Return a cosine bowl: it runs out to nothing at `half` [rad]."""
    return lambda angle, d: np.where(angle < half, 0.5 * depth * (1.0 + np.cos(np.pi * angle / half)), 0.0)


def gaussian(depth: float, spread: float) -> Depth:
    """Return a Gaussian bowl."""
    return lambda angle, d: depth * np.exp(-0.5 * (angle / spread) ** 2)


def sharp(depth: float, waves: Depth, fade: float = 1e-9) -> Depth:
    """Return a loss of uneven depth, 1 + `waves` times the mean, that ends at a sharp border, or over `fade` [rad]."""
    return lambda angle, d: depth * (1.0 + waves(angle, d)) * np.clip((HALF - angle) / fade + 0.5, 0.0, 1.0)


def wedge(angle: Floats, d: Floats) -> Floats:
    """Return how the depth of a wedge varies about its mean."""
    return d @ ACROSS / np.sin(HALF)


WEAR: dict[str, Depth] = {
    SMALL[0]: bowl(0.003, 0.8),
    "worn as a cosine bowl, 3 mm deep, 0.15 m in radius": bowl(0.003, 0.5),
    "worn as a Gaussian bowl, 3 mm deep, spread 0.12 m": gaussian(0.003, 0.4),
    "worn as a Gaussian bowl, 3 mm deep, spread 0.08 m": gaussian(0.003, 0.25),
    "worn as a Gaussian bowl, 8 mm deep, spread 0.09 m": gaussian(0.008, 0.3),
    "lost to 1.2 to 4.8 mm, sharp border": sharp(0.003, lambda _, d: 0.6 * np.sin(9.0 * d @ ACROSS + 3.0 * d[:, 2])),
    "lost in blotches of 0.6 to 5.4 mm, sharp border": sharp(
        0.003, lambda _, d: 0.8 * np.sin(2.7 * d[:, 1] + 1.0) * np.cos(2.1 * d[:, 2])
    ),
    "lost as a wedge of 0 to 6 mm that fades over 60 mm": sharp(0.003, wedge, 0.2),
    "lost as a wedge of 0 to 6 mm, sharp border": sharp(0.003, wedge),
}
MOVED = {
    SMALL[1]: MOTION,
    "moved by 2.4 mm, 0.17 m in radius": MOTION * [0, 0, 0, 1, 1, 1],
    "turned by 27 mrad, 0.17 m in radius": MOTION * [1, 1, 1, 0, 0, 0],
    "moved by 1 mm and 11 mrad, 0.17 m in radius": 0.4 * MOTION,
}


def run(size: Size) -> list[Row]:
    """Compare each kind of change in so many pairs."""
    before = scan(1)
    kinds = [name for name in (*WEAR, *MOVED) if size == "full" or name in SMALL]
    return [row_of(name, before, PAIRS[size]) for name in kinds]


def row_of(name: str, before: Surface, n_pairs: int) -> Row:
    """Return the row of one kind of change."""
    told, called = 0, Counter[str]()
    for seed in range(n_pairs):
        after = scan(100 + seed, WEAR.get(name), MOVED.get(name))
        motion = register(after, before)
        comparison = compare(before, after, motion)
        side = comparison.on_compared
        found = find_parts(after, before, motion, None, side.is_changed, side.lod95 / Z95)
        told += bool(found.parts)
        called.update(tell_moved(comparison, found, after.vertices).regions["kind"])
    wanted = n_pairs if name in MOVED else 0
    cause = CAUSES["moved" if name in MOVED else "worn"] if told != wanted else ""
    kinds = ", ".join(f"{n} {kind}" for kind, n in called.most_common())
    return Row(name, f"{told} of {n_pairs}", judge(told == wanted), asked="all" if wanted else "none",
               others={"regions": kinds}, value=told / n_pairs, cause=cause)  # fmt: skip


def scan(seed: int, depth: Depth | None = None, motion: Floats | None = None) -> Surface:
    """Return the body with the errors of a seed, one place of it worn to a depth or moved (w, t) [rad, m]."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(N_VERTICES, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    points, normals = body(d)
    angle = np.arccos(np.clip(d @ TOWARDS, -1.0, 1.0))
    lift = rng.normal(0.0, NOISE, N_VERTICES) - (0.0 if depth is None else depth(angle, d))
    points += normals * lift[:, None]
    if motion is not None:
        part = angle < HALF
        points[part] = apply(perturb(np.eye(4), points[part].mean(axis=0), motion), points[part])
    faces = faces_about(d)
    return Surface(points, faces, normals=normals_by_angle(points, faces), sigma=np.full(N_VERTICES, NOISE))


def body(d: Floats) -> tuple[Floats, Floats]:
    """Return the points and normals (n, 3) of the body in some directions (n, 3), the same for every call."""
    rng = np.random.default_rng(5)
    waves, phases, heights = rng.normal(size=(12, 3)) * 4.0, rng.uniform(0, 2 * np.pi, 12), rng.uniform(5e-3, 0.012, 12)

    def point(d: Floats) -> Floats:
        d = d / np.linalg.norm(d, axis=1)[:, None]
        bumps = (heights * np.cos(d @ waves.T + phases)).sum(axis=1)
        return d * (RADIUS * np.linalg.norm(d * [1.0, 0.8, 1.2], axis=1) + bumps)[:, None]

    along = np.cross(d, [0.3, 0.5, 0.81])
    along /= np.linalg.norm(along, axis=1)[:, None]
    other, step = np.cross(d, along), 1e-5
    normals = np.cross(point(d + step * along) - point(d - step * along),
                       point(d + step * other) - point(d - step * other))  # fmt: skip
    normals *= (np.sign(np.einsum("ij,ij->i", normals, d)) / np.linalg.norm(normals, axis=1))[:, None]
    return point(d), normals


def faces_about(d: Floats) -> Ints:
    """Return the faces (m, 3) between directions, seen from outside."""
    faces = ConvexHull(d).simplices
    a, b, c = (d[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    faces[inward] = faces[inward, ::-1]
    return faces
