"""What of its detail a surface keeps: sine reliefs, a step, edges, a corner, a thin cylinder; noise; peers in the run.

Points 1 mm apart on a grid (jittered by 0.3 mm) seen along z, noise 0.4 mm along the normal, a random rigid motion each
seed. Kept is the amplitude of the sine fitted to the vertices; noise is the scatter about that sine across the surface.
An edge's radius is that of the circle that would leave the same gap to the true corner, along its bisector.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from peers import apss, open3d_poisson
from rows import Row, Size, in_words, judge, mean_of
from scipy.spatial.transform import Rotation

from monitor.filtering import estimate_normals
from monitor.reconstruction import SurfaceSettings, reconstruct, reconstruct_with_record
from projects.model import Floats, Ints, PointCloud
from projects.open3d_library import load_open3d

TITLE = "Detail kept by the surface: amplitude, edges, noise, mm"
WAVELENGTHS = (0.003, 0.005, 0.008, 0.012, 0.020)
AMPLITUDE, SPACING, NOISE, N_SIDE, RIM = 0.001, 0.001, 0.0004, 60, 0.005
STEP, CYLINDER = 0.005, 0.010
TURNS = (45.0, 90.0)  # degrees, of the normals over an edge
SEEDS = {"small": 1, "full": 5}
FARTHEST = 0.004  # m from the relief: vertices of another sheet
MIDDLE = 0.5 * (N_SIDE - 1) * SPACING

AUTOMATIC = "automatic"

Mesh = tuple[Floats, Ints]


class Shape(NamedTuple):
    """A cloud, its true motion, and the mean of the noise drawn [m]."""

    cloud: PointCloud
    rotation: Floats
    translation: Floats
    drawn: float

    def local(self, vertices: Floats) -> Floats:
        """Return vertices in the coordinates of the truth."""
        return (vertices - self.translation) @ self.rotation


def place(points: Floats, normals: Floats, rng: np.random.Generator) -> Shape:
    """Add noise, move the cloud rigidly, and put scanners 2 m out along the normals."""
    noise = NOISE * rng.normal(size=(len(points), 1))
    noisy = points + noise * normals
    rotation, translation = Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.005, 0.005, 3)
    origins = (points + 2.0 * normals) @ rotation.T + translation
    return Shape(
        PointCloud(noisy @ rotation.T + translation, origins=origins), rotation, translation, float(noise.mean())
    )


def grid(rng: np.random.Generator, n_u: int = N_SIDE, n_v: int = N_SIDE) -> tuple[Floats, Floats]:
    """Return a jittered grid about the origin."""
    u, v = np.meshgrid((np.arange(n_u) + 0.5 - n_u / 2) * SPACING, (np.arange(n_v) + 0.5 - n_v / 2) * SPACING)
    return u.ravel() + rng.uniform(-3e-4, 3e-4, u.size), v.ravel() + rng.uniform(-3e-4, 3e-4, u.size)


def make_waves(wavelength: float, rng: np.random.Generator) -> Shape:
    """Draw a relief z = a sin(k x)."""
    x, y = grid(rng)
    k = 2.0 * np.pi / wavelength
    normals = np.column_stack([-AMPLITUDE * k * np.cos(k * x), np.zeros_like(x), np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return place(np.column_stack([x, y, AMPLITUDE * np.sin(k * x)]), normals, rng)


def make_step(rng: np.random.Generator) -> Shape:
    """Draw two levels 5 mm apart and the wall between them, all of it sampled."""
    x, y = grid(rng)
    top = np.column_stack([x, y, np.where(x > 0.0, STEP, 0.0)])
    up = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    v, w = grid(rng, N_SIDE, round(STEP / SPACING))
    wall = np.column_stack([np.zeros_like(v), v, w + 0.5 * STEP])
    return place(np.r_[top, wall], np.r_[up, np.tile([-1.0, 0.0, 0.0], (len(v), 1))], rng)


def make_edge(turn: float, rng: np.random.Generator) -> Shape:
    """Draw two planes that meet along y, their normals `turn` (rad) apart."""
    s, y = grid(rng)
    way = 0.5 * turn * np.sign(s)
    normals = np.column_stack([np.sin(way), np.zeros_like(way), np.cos(way)])
    return place(np.column_stack([s * np.cos(way), y, -s * np.sin(way)]), normals, rng)


def make_corner(sign: float, rng: np.random.Generator) -> Shape:
    """Draw three sides of 30 mm of a cube that meet at the origin, seen from outside (`sign` 1) or from within (-1)."""
    points, normals = [], []
    for axis in range(3):
        u, v = grid(rng, N_SIDE // 2, N_SIDE // 2)
        side = np.column_stack([np.zeros_like(u), u, v]) - [0.0, 0.25 * N_SIDE * SPACING, 0.25 * N_SIDE * SPACING]
        points.append(np.roll(side, axis, axis=1))
        normals.append(np.tile(sign * np.eye(3)[axis], (len(u), 1)))
    return place(np.concatenate(points), np.concatenate(normals), rng)


def make_cylinder(rng: np.random.Generator) -> Shape:
    """Draw a cylinder of 10 mm radius, 60 mm long, open at its ends."""
    along, around = grid(rng, N_SIDE, round(2.0 * np.pi * CYLINDER / SPACING))
    turn = around / CYLINDER
    normals = np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    return place(CYLINDER * normals + along[:, None] * [0.0, 0.0, 1.0], normals, rng)


def all_meshes(shape: Shape, found: dict[str, float]) -> dict[str, Mesh]:
    """Return our surface from the points alone, and the peers' with our normals and, Open3D, our cell.

    What our surface took for the noise [mm] and how wide its fits are [mm] are written into `found`.
    """
    result = reconstruct_with_record(shape.cloud)
    found |= {"noise": 1e3 * result.automatic["noise_m"], "radius": 1e3 * result.automatic["fit_radius_m"]}
    cell = float(result.automatic["cell_size_m"])
    along = reconstruct(shape.cloud, SurfaceSettings(along_furrows=True))
    smooth = reconstruct(shape.cloud, SurfaceSettings(tool_marks=False))
    oriented = estimate_normals(shape.cloud)
    n_cells = int(np.ceil(np.ptp(shape.cloud.points, axis=0).max() / (0.5 * cell)))
    return {
        "ours": (result.surface.vertices, result.surface.faces),
        "ours, along furrows": (along.vertices, along.faces),
        "ours, without waves": (smooth.vertices, smooth.faces),
        "Open3D, same cell": open3d_poisson(oriented, cell),
        "APSS, default": apss(oriented, 2.0, n_cells),
        "APSS, scale 8": apss(oriented, 8.0, n_cells),
    }


def kept_of_waves(wavelength: float, local: Floats) -> tuple[float, float]:
    """Return kept amplitude and noise [mm] of a relief's vertices."""
    k = 2.0 * np.pi / wavelength
    inside = (np.abs(local[:, :2]) < MIDDLE - RIM).all(axis=1) & (np.abs(local[:, 2]) < AMPLITUDE + FARTHEST)
    x, z = local[inside, 0], local[inside, 2]
    design = np.column_stack([np.sin(k * x), np.cos(k * x), np.ones_like(x)])
    fitted = np.linalg.lstsq(design, z, rcond=None)[0]
    slope = k * (fitted[0] * np.cos(k * x) - fitted[1] * np.sin(k * x))
    return 1e3 * fitted[0], 1e3 * float(np.std((z - design @ fitted) / np.sqrt(1.0 + slope**2)))


def edge_radius(mesh: Mesh, corner: Floats, outward: Floats, sign: float) -> float:
    """Return the radius [mm] of an edge along y at `corner` (x, z), looking down its bisector from outside.

    `sign` +1 for a ridge, whose mesh lies inside of the corner, -1 for a fold, whose mesh lies outside of it.
    """
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(mesh[0].astype(np.float32)), o3d.core.Tensor(mesh[1].astype(np.uint32)))
    along = np.linspace(-0.02, 0.02, 201)
    start = np.column_stack([np.full_like(along, corner[0]), along, np.full_like(along, corner[1])]) + 0.006 * outward
    rays = np.column_stack([start, np.tile(-outward, (len(along), 1))]).astype(np.float32)
    gap = scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy() - 0.006
    gap = gap[np.isfinite(gap) & (np.abs(gap) < 0.005)]
    return float(1e3 * sign * gap.mean() / (np.sqrt(2.0) - 1.0)) if len(gap) else float("nan")


def edges_of_step(mesh: Mesh, drawn: float) -> tuple[float, float]:
    """Return the radii [mm] of the upper edge and of the fold at its foot."""
    outward = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
    return edge_radius(mesh, np.array([0.0, STEP]), outward, 1.0), edge_radius(mesh, np.zeros(2), outward, -1.0)


def error_of_edge(turn: float, mesh: Mesh, drawn: float) -> tuple[float, float]:
    """Return the rms [mm] of the vertices within 3 mm of an edge off both planes, and of those from there to 10 mm."""
    x, y, z = mesh[0].T
    off = np.abs(x) * np.sin(0.5 * turn) + z * np.cos(0.5 * turn) - drawn
    along = np.hypot(x, z)
    known = (np.abs(y) < MIDDLE - RIM) & (np.abs(off) < FARTHEST)
    near, aside = known & (along < 0.003), known & (along >= 0.003) & (along < 0.01)
    return 1e3 * float(np.sqrt(np.mean(off[near] ** 2))), 1e3 * float(np.sqrt(np.mean(off[aside] ** 2)))


def error_of_corner(mesh: Mesh, drawn: float) -> tuple[float, float]:
    """Return how far [mm] the mesh is from the corner, and its vertices within 5 mm of that are off its sides, rms."""
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(mesh[0].astype(np.float32)), o3d.core.Tensor(mesh[1].astype(np.uint32)))
    past = float(scene.compute_distance(o3d.core.Tensor(np.zeros((1, 3), np.float32)), nthreads=1).numpy()[0])
    near = mesh[0][np.linalg.norm(mesh[0], axis=1) < 0.005]
    off = np.linalg.norm(np.maximum(near, 0.0), axis=1) + np.minimum(near.max(axis=1), 0.0)
    return 1e3 * past, 1e3 * float(np.sqrt(np.mean(off**2))) if len(near) else float("nan")


def error_of_cylinder(mesh: Mesh, drawn: float) -> tuple[float, float]:
    """Return net mean error and its scatter [mm], positive outwards, away from the open ends."""
    local = mesh[0]
    error = np.hypot(local[:, 0], local[:, 1]) - CYLINDER
    inside = (np.abs(local[:, 2]) < MIDDLE - RIM) & (np.abs(error) < FARTHEST)
    return 1e3 * float(error[inside].mean() - drawn), 1e3 * float(error[inside].std())


Measured = dict[str, list[tuple[float, float]]]


def over_seeds(size: Size, number: int, make: Callable[[np.random.Generator], Shape],
               measure: Callable[[Mesh, float], tuple[float, float]]) -> Measured:  # fmt: skip
    """Return for each program the pair of figures of each seed, and what ours found automatically ("automatic")."""
    found: Measured = {}
    automatic: dict[str, float] = {}
    for seed in range(SEEDS[size]):
        shape = make(np.random.default_rng([seed, number]))
        for name, (vertices, faces) in all_meshes(shape, automatic).items():
            found.setdefault(name, []).append(measure((shape.local(vertices), faces), shape.drawn))
        found.setdefault(AUTOMATIC, []).append((automatic["noise"], automatic["radius"]))
    return found


def run(size: Size) -> list[Row]:
    """Measure the reliefs, the step, the edges, the corner and the cylinder."""
    rows = []
    for number, wavelength in enumerate(WAVELENGTHS if size == "full" else WAVELENGTHS[2:4]):
        found = over_seeds(
            size, number, lambda rng, w=wavelength: make_waves(w, rng),
            lambda mesh, drawn, w=wavelength: kept_of_waves(w, mesh[0]),
        )  # fmt: skip
        rows.append(row_of_waves(wavelength, found))
    rows += rows_of_step(over_seeds(size, 10, make_step, edges_of_step))
    for number, degrees in enumerate(TURNS if size == "full" else TURNS[1:]):
        turn = float(np.radians(degrees))
        found = over_seeds(
            size, 30 + number, lambda rng, t=turn: make_edge(t, rng),
            lambda mesh, drawn, t=turn: error_of_edge(t, mesh, drawn),
        )  # fmt: skip
        rows.append(row_of_edge(degrees, found))
    for number, (name, sign) in enumerate((("", 1.0), (" from within", -1.0))):
        found = over_seeds(size, 40 + number, lambda rng, s=sign: make_corner(s, rng), error_of_corner)
        rows.append(row_of_corner(name, found))
    rows.append(row_of_cylinder(over_seeds(size, 20, make_cylinder, error_of_cylinder)))
    return rows


def programs(found: Measured) -> list[str]:
    """Return the names of the programs that were measured."""
    return [name for name in found if name != AUTOMATIC]


def cause_of(found: Measured, which: str) -> str:
    """Return what the surface took for its noise and its fits' radius, where a bar is missed."""
    noise, radius = column(found, AUTOMATIC, 0)[0], column(found, AUTOMATIC, 1)[0]
    return (
        f"noise was taken for {noise:.2f} mm (drawn: {1e3 * NOISE:.2f}), {which} rest on fits of {radius:.1f} mm radius"
    )


def column(found: Measured, name: str, which: int) -> tuple[float, float]:
    """Return mean and standard error over seeds of one figure of one program."""
    return mean_of([pair[which] for pair in found[name]])


def row_of_waves(wavelength: float, found: Measured) -> Row:
    """At least the amplitude that Open3D and APSS at their defaults keep, at lower noise."""
    kept, error = column(found, "ours", 0)
    noise, _ = column(found, "ours", 1)
    texts = {n: f"{in_words(column(found, n, 0)[0])}, {in_words(column(found, n, 1)[0])}" for n in programs(found)}
    rivals = ("Open3D, same cell", "APSS, default")
    allowance = 2.0 * float(np.nan_to_num(error))
    holds = all(
        kept + allowance >= column(found, n, 0)[0] and noise <= column(found, n, 1)[0] for n in rivals
    )  # fmt: skip
    return Row(
        f"waves of {1e3 * wavelength:g} mm: amplitude of 1 kept, noise", texts.pop("ours"), judge(holds), "",
        "as much as both defaults, less noise", texts, kept, "" if holds else cause_of(found, "vertices"),
    )  # fmt: skip


def rows_of_step(found: Measured) -> list[Row]:
    """Edge radii no larger than the peers'."""
    rows = []
    for which, name in enumerate(("ridge", "fold")):
        means = {n: column(found, n, which)[0] for n in programs(found)}
        ours = means.pop("ours")
        best = min(abs(means[n]) for n in ("Open3D, same cell", "APSS, default"))
        allowance = 2.0 * float(np.nan_to_num(column(found, "ours", which)[1]))
        texts = {n: in_words(v, 2) for n, v in means.items()}
        holds = abs(ours) <= best + allowance
        rows.append(
            Row(f"step of 5 mm: radius of the {name}", in_words(ours, 2), judge(holds), "",
                "no larger than both defaults", texts, ours, "" if holds else cause_of(found, "its edges"))
        )  # fmt: skip
    return rows


def row_of_edge(degrees: float, found: Measured) -> Row:
    """Vertices beside an edge no farther off it than the peers'."""
    texts = {n: f"{in_words(column(found, n, 0)[0])}, {in_words(column(found, n, 1)[0])}" for n in programs(found)}
    ours, error = column(found, "ours", 0)
    best = min(column(found, n, 0)[0] for n in ("Open3D, same cell", "APSS, default"))
    holds = ours <= best + 2.0 * float(np.nan_to_num(error))
    return Row(
        f"edge of {degrees:g} degrees: vertices within 3 mm, and 10, off it, rms", texts.pop("ours"), judge(holds),
        "", "no farther than both defaults", texts, ours, "" if holds else cause_of(found, "vertices"),
    )  # fmt: skip


def row_of_corner(name: str, found: Measured) -> Row:
    """The mesh no farther from a corner than the peers', its vertices no farther off the sides."""
    texts = {n: f"{in_words(column(found, n, 0)[0], 2)}, {in_words(column(found, n, 1)[0])}" for n in programs(found)}
    (ours, error), off = column(found, "ours", 0), column(found, "ours", 1)[0]
    rivals = ("Open3D, same cell", "APSS, default")
    holds = all(
        ours <= column(found, n, 0)[0] + 2.0 * float(np.nan_to_num(error)) and off <= column(found, n, 1)[0]
        for n in rivals
    )
    return Row(
        f"corner of a cube{name}: from the mesh; vertices within 5 mm off it, rms", texts.pop("ours"), judge(holds), "",
        "no farther than both defaults", texts, ours, "" if holds else cause_of(found, "vertices"),
    )  # fmt: skip


def row_of_cylinder(found: Measured) -> Row:
    """Mean error and scatter on a thin cylinder."""
    mean, error = column(found, "ours", 0)
    spread, _ = column(found, "ours", 1)
    texts = {
        n: f"{in_words(column(found, n, 0)[0], signed=True)}, {in_words(column(found, n, 1)[0])}"
        for n in programs(found)
    }
    rivals = ("Open3D, same cell", "APSS, default")
    allowed = 2.0 * float(np.nan_to_num(error))
    holds = abs(mean) <= min(abs(column(found, n, 0)[0]) for n in rivals) + allowed and all(
        spread <= column(found, n, 1)[0] for n in rivals
    )
    return Row("cylinder of 10 mm radius: net mean, std", texts.pop("ours"), judge(holds), "",
               "no worse than both defaults", texts, mean)  # fmt: skip


NOTES = (
    "1 mm between points, noise 0.4 mm, all settings automatic, the mean of five seeds; two standard errors are "
    "allowed for. Peers get our normals. A negative radius: the edge stands out beyond the true corner."
)
