"""Thinning to a tenth of the points (Nothegger & Dorninger 2007, fig. 7): noise left against detail kept.

An upright panel of strips, one flat, the others waves of 2 to 20 mm and 0.5 mm amplitude, scanned from three stations
that are misregistered by 0.2 mm; a bar stands 30 mm before it, so that the beam is split at its edges (mixed pixels);
one pulse in a hundred is a gross error of up to 20 mm. Everything enters as raw scans. Peers get all raw points, after
Open3D's statistical outlier removal, and are brought to the same number of points.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from peers import apss_of_count, open3d_normals, open3d_voxels, open3d_without_outliers
from rows import Row, Size, in_percent, in_words, judge

from monitor.filtering import FilterSettings, ThinningSettings, filter_scan, merge_scans
from monitor.simulation import (
    INSTRUMENTS,
    Body,
    Scene,
    misregister,
    plane_scene,
    simulate_scan,
    stand_at,
    window_around,
)
from monitor.simulation.scenes import make_box
from projects.model import Bools, Floats, PointCloud, Scan
from projects.transforms import apply

TITLE = "Thinning to a tenth of the points: noise left and detail kept"
WAVELENGTHS = (0.0, 0.002, 0.003, 0.005, 0.008, 0.012, 0.020)  # of the strips from below; 0 is flat
AMPLITUDE, HEIGHT, WIDTH = 0.0005, 0.022, 0.120
SHARE = 0.1
LIMIT = 1800.0
BAR = (0.030, 0.012)  # m: before the panel, width
STATIONS = ((0.0, -2.6), (-1.1, -2.4), (1.2, -2.3))  # x, y [m]
SPACING, SIGMA_REGISTERED = 0.0007, 0.0002
SPACINGS = {"small": 0.001, "full": SPACING}
GROSS_SHARE, GROSS = 0.01, 0.020
# The beam is finer than a phase scanner's, so that the instrument itself does not erase the shorter waves.
INSTRUMENT = dataclasses.replace(
    INSTRUMENTS["phase-2020"], name="fine beam", beam_diameter=0.001, beam_divergence=0.15e-3, noise_floor=0.4e-3,
    noise_10m=0.2e-3,
)  # fmt: skip
FARTHEST = 0.025  # m off the panel: points of the bar are not the panel's
TOLERANCE = 0.01  # of the amplitude: its standard error in one scan of the panel
STRAY = 0.002  # m: farther off is not noise but a stray point, and counted


class Strip(NamedTuple):
    """What is left of one strip: amplitude kept (1 = all), rms of what is not the wave [mm], share of strays."""

    kept: float
    noise: float
    stray: float


def panel() -> Scene:
    """Return the panel, facing -y, and the bar before it."""
    bodies, low = [], -0.5 * HEIGHT * len(WAVELENGTHS)
    for k, wavelength in enumerate(WAVELENGTHS):
        n = 2 if wavelength == 0.0 else int(24 * WIDTH / wavelength) + 1
        x = np.linspace(-0.5 * WIDTH, 0.5 * WIDTH, n)
        y = np.zeros(n) if wavelength == 0.0 else -AMPLITUDE * np.sin(2.0 * np.pi * x / wavelength)
        bottom, top = low + k * HEIGHT, low + (k + 1) * HEIGHT
        vertices = np.r_[np.column_stack([x, y, np.full(n, bottom)]), np.column_stack([x, y, np.full(n, top)])]
        i = np.arange(n - 1)
        faces = np.r_[np.column_stack([i, i + 1, n + i + 1]), np.column_stack([i, n + i + 1, n + i])]
        bodies.append(Body(f"strip {k}", vertices, faces.astype(np.int32)))
    half = 0.5 * BAR[1]
    bar = make_box("bar", np.array([-half, -BAR[0] - BAR[1], -0.2]), np.array([half, -BAR[0], 0.2]))
    return Scene("strips", (*bodies, bar))


def scan_panel(
    scene: Scene, seed: int, n_stations: int = 3, *, is_clean: bool = False, spacing: float = SPACING
) -> list[Scan]:
    """Scan a scene of the panel's size from the stations; `is_clean`: Gaussian noise and nothing else."""
    rng = np.random.default_rng([seed, 7])
    half = 0.5 * HEIGHT * len(WAVELENGTHS)
    box = np.array([[-0.5 * WIDTH, -0.001, -half], [0.5 * WIDTH, 0.001, half]])
    scans = []
    for k, (x, y) in enumerate(STATIONS[:n_stations]):
        pose = stand_at(np.array([x, y, 0.0]), facing=np.zeros(3))
        stated = pose if is_clean else misregister(pose, rng, sigma_position=SIGMA_REGISTERED, sigma_angle=2e-5)
        scan = simulate_scan(
            scene, INSTRUMENT, pose, window_around(box, pose), step=spacing / np.hypot(x, y), seed=10 * seed + k,
            n_subrays=1 if is_clean else 9, registered=stated, name=f"station {k + 1}",
        )  # fmt: skip
        scans.append(scan if is_clean else with_gross_errors(scan, rng))
    return scans


def with_gross_errors(scan: Scan, rng: np.random.Generator) -> Scan:
    """Return the scan with a share of its ranges grossly wrong."""
    points = scan.cloud.points
    ranges = np.linalg.norm(points, axis=1)
    wrong = rng.uniform(size=len(points)) < GROSS_SHARE
    factor = np.where(wrong, 1.0 + rng.uniform(-GROSS, GROSS, len(points)) / ranges, 1.0)
    return dataclasses.replace(scan, cloud=dataclasses.replace(scan.cloud, points=points * factor[:, None]))


def raw_points(scans: list[Scan]) -> Floats:
    """Return all points in the project's frame."""
    return np.concatenate([apply(scan.pose, scan.cloud.points) for scan in scans])


def measure(points: Floats) -> list[Strip]:
    """Return what is left of each strip, 3 mm away from its borders and from the bar."""
    found, low = [], -0.5 * HEIGHT * len(WAVELENGTHS)
    clear = (np.abs(points[:, 0]) < 0.5 * WIDTH - 0.003) & (np.abs(points[:, 0]) > 0.5 * BAR[1] + 0.003)
    clear &= np.abs(points[:, 1]) < FARTHEST
    for k, wavelength in enumerate(WAVELENGTHS):
        own = clear & (np.abs(points[:, 2] - low - (k + 0.5) * HEIGHT) < 0.5 * HEIGHT - 0.003)
        found.append(measure_strip(points[own, 0], -points[own, 1], wavelength))
    return found


def measure_strip(x: Floats, z: Floats, wavelength: float) -> Strip:
    """Fit plane and wave, gross errors left out."""
    design = np.column_stack([np.ones_like(x), x])
    if wavelength:
        phase = 2.0 * np.pi * x / wavelength
        design = np.column_stack([design, np.sin(phase), np.cos(phase)])
    keep = np.abs(z) < STRAY
    if np.count_nonzero(keep) < 50:
        return Strip(float("nan"), float("nan"), float("nan"))
    for _ in range(3):
        fitted = np.linalg.lstsq(design[keep], z[keep], rcond=None)[0]
        residual = z - design @ fitted
        keep = np.abs(residual) < 4.0 * 1.4826 * np.median(np.abs(residual[keep]))
    kept = np.hypot(fitted[2], fitted[3]) / AMPLITUDE if wavelength else float("nan")
    is_stray = np.abs(residual) > STRAY
    return Strip(float(kept), 1e3 * float(np.sqrt(np.mean(residual[~is_stray] ** 2))), float(np.mean(is_stray)))


def to_count(thin: Callable[[float], Floats], n_wanted: int, first: float, n_steps: int = 5) -> Floats:
    """Return the points that `thin(spacing)` makes where they are `n_wanted` within 3 %."""
    spacing = first
    for _ in range(n_steps):
        points = thin(spacing)
        if abs(len(points) / n_wanted - 1.0) < 0.03:
            break
        spacing *= np.sqrt(len(points) / n_wanted)
    return points


def thin_ours(scans: list[Scan], spacing: float | None) -> Floats:
    """Return our thinned points: each scan, then merged, as `monitor process` does."""
    settings = FilterSettings(thinning=ThinningSettings(target_spacing=spacing))
    return merge_scans([filter_scan(scan, settings) for scan in scans], settings).cloud.points


def as_smooth(thin: Callable[[float], Floats], noise: float, low: float, high: float, n_steps: int = 5) -> Floats:
    """Return the points of `thin(parameter)` whose noise on the flat strip is `noise` mm, by halving in the logarithm.

    The larger the parameter, the smoother; its end where even that does not reach the noise.
    """
    for _ in range(n_steps):
        middle = float(np.sqrt(low * high))
        points = thin(middle)
        if len(points) == 0 or not measure(points)[0].noise <= noise:
            low = middle
        else:
            high = middle
    return thin(high)


def all_clouds(scans: list[Scan], raw: Floats, n_wanted: int) -> dict[str, Floats]:
    """Return the thinned clouds of all methods, by name."""
    ours = to_count(lambda spacing: thin_ours(scans, spacing), n_wanted, 0.0015)
    noise = measure(ours)[0].noise
    clean = open3d_without_outliers(raw)
    cloud = PointCloud(clean, normals=open3d_normals(clean, np.array([0.0, -2.6, 0.0])))
    return {
        "ours": ours,
        "raw points": raw,
        "ours, automatic": thin_ours(scans, None),
        "voxel mean": to_count(lambda size: open3d_voxels(clean, size), n_wanted, 0.001, 30),
        "voxel mean, as smooth": as_smooth(lambda size: open3d_voxels(clean, size), noise, 0.001, 0.006),
        "MLS, as smooth": as_smooth(lambda scale: apss_of_count(cloud, n_wanted, scale, 0.001), noise, 2.0, 8.0, 4),
    }


def run(size: Size) -> list[Row]:
    """Thin the panel and a clean flat by all methods."""
    scans = scan_panel(panel(), seed=1, n_stations=3 if size == "full" else 1, spacing=SPACINGS[size])
    raw = raw_points(scans)
    clouds = all_clouds(scans, raw, int(SHARE * len(raw)))
    found = {name: measure(points) for name, points in clouds.items()}
    shares = {name: len(points) / len(raw) for name, points in clouds.items()}
    return [*rows_of_panel(found, shares), row_of_clean_flat(size)]


def rows_of_panel(found: dict[str, list[Strip]], shares: dict[str, float]) -> list[Row]:
    """Return smoothness, then the amplitude kept at each wavelength."""
    flat = {name: strips[0] for name, strips in found.items()}

    def texts(of: Callable[[str], str]) -> dict[str, str]:
        return {name: of(name) for name in found if name != "ours"}

    rows = [
        Row("share of the points", f"{shares['ours']:.1%}", others=texts(lambda n: f"{shares[n]:.1%}")),
        Row("noise left on the flat strip, mm", in_words(flat["ours"].noise), judge(
            flat["ours"].noise <= flat["voxel mean"].noise), "almost similar, by eye", "less than the voxel mean",
            texts(lambda n: in_words(flat[n].noise)), flat["ours"].noise),
        Row("stray points, beyond 2 mm, flat strip", f"{flat['ours'].stray:.2%}",
            others=texts(lambda n: f"{flat[n].stray:.2%}"), value=flat["ours"].stray),
    ]  # fmt: skip
    for k, wavelength in enumerate(WAVELENGTHS[1:], start=1):
        kept = {name: strips[k].kept for name, strips in found.items()}
        off = {name: abs(share - kept["raw points"]) for name, share in kept.items()}
        holds = all(not off["ours"] > off[n] + TOLERANCE for n in found if "smooth" in n)
        rows.append(
            Row(f"waves of {1e3 * wavelength:g} mm: kept", in_percent(kept["ours"]), judge(holds), "better, by eye",
                "as near to raw as those as smooth", texts(lambda n, kept=kept: in_percent(kept[n])), kept["ours"])
        )  # fmt: skip
    return rows


def row_of_clean_flat(size: Size) -> Row:
    """On a clean Gaussian flat the mean is best: state what the mode loses."""
    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    scene = Scene("flat", (plane_scene(size=0.4).bodies[0].moved(upright),))
    scans = scan_panel(scene, seed=2, n_stations=1, is_clean=True, spacing=SPACINGS[size])
    raw = raw_points(scans)
    raw = raw[inner(raw)]
    n_wanted = int(SHARE * len(raw))
    clouds = {
        "ours": to_count(lambda spacing: inside(thin_ours(scans, spacing)), n_wanted, 0.0015),
        "voxel mean": to_count(lambda size: open3d_voxels(raw, size), n_wanted, 0.0015, 30),
        "mean of square columns": column_means(raw, n_wanted),
    }
    error = {name: 1e3 * float(np.std(points[:, 1])) for name, points in clouds.items()}
    loss = error["ours"] / error["mean of square columns"]
    return Row(
        "clean Gaussian flat: noise left, mm", f"{in_words(error['ours'])} ({loss:.2f} of the columns' mean)",
        asked="the loss stated", others={n: in_words(e) for n, e in error.items() if n != "ours"}, value=loss,
    )  # fmt: skip


def column_means(points: Floats, n_wanted: int) -> Floats:
    """Return the mean of the points of each column of a square grid across the plane x, z."""
    edge = np.sqrt(np.prod(np.ptp(points[:, [0, 2]], axis=0)) / n_wanted)
    cell = np.floor((points[:, [0, 2]] - points[:, [0, 2]].min(axis=0)) / edge).astype(np.int64)
    _, column, n = np.unique(cell[:, 0] * 100_000 + cell[:, 1], return_inverse=True, return_counts=True)
    return np.column_stack([np.bincount(column, points[:, k]) / n for k in range(3)])


def inside(points: Floats) -> Floats:
    """Return the points 3 mm inside of the panel."""
    return points[inner(points)]


def inner(points: Floats) -> Bools:
    """Return which points lie 3 mm inside of the panel."""
    half = 0.5 * HEIGHT * len(WAVELENGTHS)
    return (np.abs(points[:, 0]) < 0.5 * WIDTH - 0.003) & (np.abs(points[:, 2]) < half - 0.003)


NOTES = (
    "Noise of a pulse 0.45 mm; the raw points hold less than all of the short waves, by beam and misregistration. The "
    "peers' input has passed Open3D's statistical outlier removal. As smooth: voxel size (Open3D) or filter scale "
    "(APSS of pymeshlab, as many points as ours) chosen for our noise on the flat strip. More than the raw points hold "
    "is taken for an artefact of cells or sheets that split the noise; by amplitude alone that MLS is above ours at "
    "every wavelength, and as smooth."
)
