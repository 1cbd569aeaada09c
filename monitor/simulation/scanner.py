"""A panoramic phase-shift scanner that looks at a scene: scene, instrument and pose in, a `Scan` out.

Rays are cast into the scene's triangles by Open3D (Embree, float32; about a micrometre within ten metres of the
origin, so scenes stay near it). The work goes column by column in blocks with a seed of their own: a scan of any
size streams, and is the same for any number of threads.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.bearings import angles_of, directions_of
from monitor.boxes import corners_of
from monitor.simulation.beam import add_highlights, make_rays, measure_phase, return_powers, sample_beam
from monitor.simulation.instruments import Instrument
from monitor.simulation.scenes import Scene
from projects.errors import ParameterError
from projects.model import Floats, Ints, PointCloud, Scan
from projects.open3d_library import load_open3d
from projects.transforms import apply, invert, perturb, rotate

Seed = int | Sequence[int]
BLOCK_PULSES = 100_000
REFERENCE_RANGE = 10.0  # m and reflectance of the target that an instrument's noise is stated for
REFERENCE_REFLECTANCE = 0.9


@dataclass(frozen=True)
class Window:
    """The field that is scanned, in the scanner's frame [rad]: azimuth from x towards y, elevation above x, y."""

    azimuth_min: float
    azimuth_max: float
    elevation_min: float
    elevation_max: float

    def __post_init__(self) -> None:
        if not (self.azimuth_min < self.azimuth_max and self.elevation_min < self.elevation_max):
            raise ParameterError(f"{self}: each lowest angle must be below its highest")
        if self.azimuth_max - self.azimuth_min > 2.0 * np.pi + 1e-9:
            raise ParameterError(f"{self}: azimuths span more than a full turn")


def window_around(box: Floats, T_project_scanner: Floats, *, margin: float = 0.0) -> Window:
    """Return the smallest window that holds a box (2, 3) [m, project frame], widened by `margin` [rad] on each side."""
    corners = apply(invert(T_project_scanner), corners_of(np.asarray(box, dtype=float)))
    middle = np.arctan2(corners[:, 1].mean(), corners[:, 0].mean())
    azimuth, elevation = angles_of(corners)
    azimuth = middle + (azimuth - middle + np.pi) % (2.0 * np.pi) - np.pi
    return Window(azimuth.min() - margin, azimuth.max() + margin, elevation.min() - margin, elevation.max() + margin)


def stand_at(position: Floats, *, facing: Floats, heading: float = 0.0) -> Floats:
    """Return T_project_scanner of a level scanner at `position`, x axis towards `facing`, turned by `heading` [rad]."""
    towards = np.asarray(facing, dtype=float) - np.asarray(position, dtype=float)
    angle = np.arctan2(towards[1], towards[0]) + heading
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = position
    return pose


def misregister(pose: Floats, rng: np.random.Generator, *, sigma_position: float, sigma_angle: float) -> Floats:
    """Return the pose as a registration with these one-sigma errors [m, rad] would state it."""
    delta = np.concatenate([rng.normal(scale=sigma_angle, size=3), rng.normal(scale=sigma_position, size=3)])
    return perturb(pose, pose[:3, 3], delta)


@dataclass(frozen=True)
class Target:
    """A scene ready for rays: Open3D's `tree` and the optical properties of what they meet.

    `first_face` (b,) is where the faces of each body begin among all of the scene, `reflectance` (m,) that of each
    face, 0 to 1; `gloss` (b,) the share of light that a body mirrors.
    """

    tree: Any
    first_face: Ints
    reflectance: Floats
    gloss: Floats

    @classmethod
    def of(cls, scene: Scene, n_threads: int) -> Target:
        """Return the scene with its tree built."""
        o3d = load_open3d()
        tree = o3d.t.geometry.RaycastingScene(nthreads=n_threads)
        for body in scene.bodies:
            tree.add_triangles(
                o3d.core.Tensor(body.vertices.astype(np.float32)), o3d.core.Tensor(body.faces.astype(np.uint32))
            )
        counts = [len(body.faces) for body in scene.bodies]
        reflectance = [np.broadcast_to(np.float32(body.reflectance), len(body.faces)) for body in scene.bodies]
        gloss = np.array([body.gloss for body in scene.bodies], dtype=np.float32)
        return cls(tree, np.concatenate([[0], np.cumsum(counts)[:-1]]), np.concatenate(reflectance), gloss)


@dataclass(frozen=True)
class Hits:
    """What rays (n, k) meet: range `t` (n, k) [m] (inf: nothing), unit normals (n, k, 3), body and face (n, k), the
    latter as index into the scene's reflectances."""

    t: Floats
    normals: Floats
    body: Ints
    face: Ints


def cast(target: Target, rays: Floats, n_threads: int) -> Hits:
    """Return what rays (n, k, 6) meet."""
    o3d = load_open3d()
    answer = target.tree.cast_rays(o3d.core.Tensor(rays), nthreads=n_threads)
    t = answer["t_hit"].numpy()
    met = np.isfinite(t)
    body = np.where(met, answer["geometry_ids"].numpy(), 0)
    face = np.where(met, answer["primitive_ids"].numpy(), 0).astype(np.int64)
    if len(target.first_face) > 1:
        face += target.first_face[body]
    return Hits(t, answer["primitive_normals"].numpy(), body, face)


def _mirror(target: Target, rays: Floats, hits: Hits, n_threads: int) -> tuple[Floats, Floats]:
    """Range (n, 1) and power (n, 1) of what the centre rays see in the mirror of a glossy surface; power 0: nothing."""
    d, n = rays[:, 0, 3:], hits.normals[:, 0]
    gloss = target.gloss[hits.body[:, 0]]
    meets = np.isfinite(hits.t[:, 0]) & (gloss > 0.0)
    first = np.where(meets, hits.t[:, 0], 0.0)
    away = d - 2.0 * np.einsum("ij,ij->i", d, n)[:, None] * n
    start = rays[:, 0, :3] + first[:, None] * d + 1e-4 * away
    rays2 = np.concatenate([start, away], axis=1).astype(np.float32)[:, None]
    second = cast(target, rays2, n_threads)
    t = np.where(meets[:, None], first[:, None] + 1e-4 + second.t, np.inf)
    power = return_powers(t, rays2, second.normals, second.face, target.reflectance, np.ones(1))
    # The light passes the mirror twice, on its way there and back.
    return t, power * gloss[:, None] ** 2


def _grid(low: float, high: float, step: float) -> Floats:
    """Return the angles from `low` to at most `high` at even steps."""
    return low + step * np.arange(int(np.floor((high - low) / step + 1e-9)) + 1)


def lay_grid(window: Window, step: float) -> tuple[Floats, Ints, Ints]:
    """Return azimuth and elevation (n, 2) [rad] of a window, with row and column (n,), by columns."""
    azimuths = _grid(window.azimuth_min, window.azimuth_max, step)
    elevations = _grid(window.elevation_min, window.elevation_max, step)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(len(azimuths)), np.arange(len(elevations)), indexing="ij"))
    return np.column_stack([azimuths[column], elevations[row]]), row, column


def cyclic_error(instrument: Instrument, ranges: Floats) -> Floats:
    """Return the cyclic range error [m] that the instrument adds at true ranges (n,) [m]; paper 000, section 2.1."""
    turn = 2.0 * np.pi * ranges / instrument.cyclic_wavelength
    waves = zip(instrument.cyclic_amplitudes, instrument.cyclic_phases, strict=True)
    return sum((a * np.sin((k + 1) * turn + phase) for k, (a, phase) in enumerate(waves)), np.zeros_like(ranges))


def range_noise(instrument: Instrument, power: Floats) -> Floats:
    """Return the one-sigma range noise [m] of pulses that return `power`, in units of P10 (see `Instrument`)."""
    return np.sqrt(instrument.noise_floor**2 + instrument.noise_10m**2 / np.maximum(power, 1e-12))


def _sweep(rays: Floats, up: Floats, shares: Floats, sweep: float, rng: np.random.Generator) -> None:
    """Turn the sub-rays (n, k, 6) of each pulse towards `up` (n, 3), as a sweep of `sweep` [rad] does, in place.

    The mirror turns while the phase is measured (paper 003, section 1.2.2). Pairs of equal share go opposite ways,
    so that the mean stays, by as much as gives the spread of an even sweep, sweep / sqrt(12).
    """
    n, k = rays.shape[:2]
    pairs = rng.choice([-1.0, 1.0], size=(n, (k - 1) // 2))
    sign = np.concatenate([np.zeros((n, 1)), np.stack([pairs, -pairs], axis=2).reshape(n, -1)], axis=1)
    sign[:, 1:] *= _is_paired(k)
    turn = sweep * sign / np.sqrt(12.0 * max(float(shares[1:] @ _is_paired(k)), 1e-9))
    rays[:, :, 3:] += turn[:, :, None] * up[:, None]


def _is_paired(n_subrays: int) -> Floats:
    """Return 1 for each sub-ray of the two rings (k - 1,) that has a partner beside it in its own ring, else 0."""
    n_ring = (n_subrays - 1) // 2
    ring, place = np.divmod(np.arange(n_subrays - 1), max(n_ring, 1))
    partner = np.arange(n_subrays - 1) ^ 1
    return np.where((partner // max(n_ring, 1)) == ring, 1.0, 0.0) * (place >= 0)


def _measure_block(
    target: Target, instrument: Instrument, pose: Floats, angles: Floats, rng: np.random.Generator,
    beam: tuple[Floats, Floats], step: float, drift: Floats, n_threads: int,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return measured ranges (n,) [m], NaN where there is none, and intensity (n,) of pulses at `angles` (n, 2).

    `drift` (n, 3): by how much range [m], azimuth and elevation [rad] have drifted away at each pulse.
    """
    n = len(angles)
    error = rng.normal(scale=1.0, size=(n, 2)) * instrument.angular_noise + drift[:, 1:]
    azimuth, elevation = (angles + error).T
    azimuth = azimuth + instrument.trunnion_error * np.tan(elevation)
    azimuth = azimuth + instrument.collimation_error / np.cos(elevation)
    offsets, shares = beam
    rays = make_rays(
        pose[:3, 3], rotate(pose, directions_of(azimuth, elevation)), offsets,
        exit_sigma=instrument.beam_diameter / 4.0, divergence_sigma=instrument.beam_divergence / 4.0,
        twist=rng.uniform(0.0, 2.0 * np.pi, n),
    )  # fmt: skip
    if instrument.smear:
        up = rotate(pose, directions_of(azimuth, elevation + 0.5 * np.pi))
        _sweep(rays, up, shares, instrument.smear * step, rng)
    hits = cast(target, rays, n_threads)
    t, powers = hits.t, return_powers(hits.t, rays, hits.normals, hits.face, target.reflectance, shares)
    dazzled = np.zeros(n, dtype=bool)
    if target.gloss.any():
        cosines = np.abs(np.einsum("ijk,ijk->ij", rays[..., 3:], hits.normals))
        powers = add_highlights(powers, t, cosines, target.gloss[hits.body], shares)
        dazzled = (powers * np.where(np.isfinite(t), t, 0.0) ** 2).sum(axis=1) > instrument.saturation
        mirrored = _mirror(target, rays, hits, n_threads)
        t, powers = np.concatenate([t, mirrored[0]], axis=1), np.concatenate([powers, mirrored[1]], axis=1)
    ranges, amplitude = measure_phase(t, powers, instrument.unit_length)
    power = amplitude * REFERENCE_RANGE**2 / REFERENCE_REFLECTANCE
    measured = ranges + cyclic_error(instrument, ranges) + rng.normal(size=n) * range_noise(instrument, power)
    measured = measured + drift[:, 0]
    lost = (rng.uniform(size=n) < instrument.dropout) | (power < instrument.power_min)
    lost |= dazzled
    lost |= ~((ranges >= instrument.range_min) & (ranges <= instrument.range_max))
    intensity = np.clip(amplitude * ranges**2 * (1.0 + 0.02 * rng.normal(size=n)), 0.0, 1.0)
    return np.where(lost, np.nan, measured), intensity


def stream_scan(
    scene: Scene | Target, instrument: Instrument, T_project_scanner: Floats, window: Window, *,
    step: float | None = None, seed: Seed = 0, n_subrays: int = 9, registered: Floats | None = None, name: str = "scan",
    drift: Floats | None = None, n_threads: int = 2,
) -> Iterator[Scan]:  # fmt: skip
    """Yield a scan in blocks of whole columns, so that a scan of any size fits; see `simulate_scan`."""
    step = instrument.angular_step if step is None else step
    azimuths = _grid(window.azimuth_min, window.azimuth_max, step)
    low, high = max(window.elevation_min, instrument.elevation_min), min(window.elevation_max, instrument.elevation_max)
    elevations = _grid(low, high, step) if high > low else np.empty(0)
    if len(elevations) == 0:
        raise ParameterError(f"{window}: the instrument sees no elevation of this window")
    target = scene if isinstance(scene, Target) else Target.of(scene, n_threads)
    beam = sample_beam(n_subrays)
    registered = T_project_scanner if registered is None else registered
    drifts = np.zeros((2, 3)) if drift is None else np.asarray(drift, dtype=float)
    per_block = max(1, BLOCK_PULSES // len(elevations))
    for first in range(0, len(azimuths), per_block):
        columns = np.arange(first, min(first + per_block, len(azimuths)))
        column, row = (a.ravel() for a in np.meshgrid(columns, np.arange(len(elevations)), indexing="ij"))
        angles = np.column_stack([azimuths[column], elevations[row]])
        rng = np.random.default_rng([*np.atleast_1d(seed), first])
        drifted = drifts[0] + (column / len(azimuths))[:, None] * (drifts[1] - drifts[0])
        ranges, intensity = _measure_block(
            target, instrument, T_project_scanner, angles, rng, beam, step, drifted, n_threads
        )  # fmt: skip
        seen = np.isfinite(ranges)
        points = ranges[seen, None] * directions_of(angles[seen, 0], angles[seen, 1])
        cloud = PointCloud(points, origins=np.zeros(3), intensity=intensity[seen])
        yield Scan(
            name, cloud, registered, rows=row[seen], columns=column[seen], scanner=instrument.name,
            dropped={"no return": int((~seen).sum())},
        )  # fmt: skip


def simulate_scan(
    scene: Scene | Target, instrument: Instrument, T_project_scanner: Floats, window: Window, *,
    step: float | None = None, seed: Seed = 0, n_subrays: int = 9, registered: Floats | None = None, name: str = "scan",
    drift: Floats | None = None, n_threads: int = 2,
) -> Scan:  # fmt: skip
    """Return what an instrument measures of a scene from one station.

    Parameters
    ----------
    scene : what stands there, in the project's frame; ready for rays (`Target.of`) where many scans are made of it.
    instrument : of `monitor.simulation.instruments`.
    T_project_scanner : (4, 4), where the scanner really stands.
    window : the field scanned, in the scanner's frame.
    step : rad, angular step in both directions; None: the instrument's finest.
    seed : of all random numbers, a number or several; the result does not depend on `n_threads`.
    n_subrays : rays a pulse, 1 (no footprint) or odd from 7.
    registered : (4, 4), the pose that the registration states; None: the true one (see `misregister`).
    drift : (2, 3), by how much range [m], azimuth and elevation [rad] are off at the first and the last column; None:
        not at all (see `monitor.simulation.repeated`).

    Returns
    -------
    Scan, points (n, 3) [m] in the scanner's own frame at the angles of its grid, `rows` counted from the lowest
    elevation, `columns` from the lowest azimuth, intensity as apparent reflectance 0 to 1, pose = `registered`.
    """
    return join_blocks(
        stream_scan(
            scene, instrument, T_project_scanner, window, step=step, seed=seed, n_subrays=n_subrays,
            registered=registered, name=name, drift=drift, n_threads=n_threads,
        )
    )  # fmt: skip


def join_blocks(blocks: Iterable[Scan]) -> Scan:
    """Return the blocks of `stream_scan` as the one scan that they are of."""
    blocks = list(blocks)
    rows, columns = (np.concatenate([getattr(b, which) for b in blocks]) for which in ("rows", "columns"))
    cloud = PointCloud(
        np.concatenate([b.cloud.points for b in blocks]), origins=np.zeros(3),
        intensity=np.concatenate([b.cloud.intensity for b in blocks]),
    )  # fmt: skip
    dropped = {"no return": sum(b.dropped["no return"] for b in blocks)}
    return dataclasses.replace(blocks[0], cloud=cloud, rows=rows, columns=columns, dropped=dropped)
