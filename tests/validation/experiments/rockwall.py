"""A real dry stone wall (`vapc_rockwall`, MIT) thinned to a tenth of its points: noise in flat parts, edges of stones.

The station is not known. Noise: distance from a plane in the flattest patches of the raw points, robust. Edges: in the
patches of most relief the heights of the thinned points over the patch's plane are regressed on the medians of the raw
heights right around them; 1 means that the stones' relief is all there. Patches and medians are those of the raw points
for everyone, and the share is told over that of the raw points themselves, since medians are smoother than points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from peers import open3d_voxels
from rows import Row, Size, in_percent, in_words, judge
from scipy.spatial import cKDTree
from shared_data import data_folder

from monitor.filtering import FilterSettings, ThinningSettings, filter_scan, merge_scans, voxel_median
from monitor.filtering.voxel_median import VoxelMedianSettings
from projects.formats import read_scans
from projects.model import Floats, Ints, PointCloud, Scan

TITLE = "A real dry stone wall thinned to a tenth: noise in flat parts, edges of stones"
SHARE = 0.1
PATCH = 0.15  # m, radius
N_PATCHES = 400
WIDTHS = {"small": 2.0, "full": 21.0}  # m of the wall
READS_REAL_DATA = True
LIMIT = 1800.0


class Patches(NamedTuple):
    """Flat patches and such with edges: centres, planes (point and normal) and the rms relief of the raw points."""

    centres: Floats
    normals: Floats
    flat: Ints
    edged: Ints


def read_wall(width: float) -> Floats:
    """Return the middle `width` metres of the wall."""
    (stream,) = read_scans(data_folder() / "vapc_rockwall" / "vapc_in.laz")
    points = np.concatenate([s.cloud.points for s in stream.chunks()])
    middle = np.median(points[:, 0])
    return points[np.abs(points[:, 0] - middle) < 0.5 * width]


def find_patches(points: Floats, rng: np.random.Generator) -> Patches:
    """Fit planes to discs about random points; the flattest tenth are flat, the tenth of most relief have edges."""
    tree = cKDTree(points)
    centres, normals, relief = [], [], []
    for seed in points[rng.choice(len(points), 10 * N_PATCHES)]:
        own = points[tree.query_ball_point(seed, PATCH)]
        if len(own) < 60:
            continue
        centre = own.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((own - centre).T))
        if values[1] > 0.3 * values[2]:  # a disc of surface, not its border
            centres.append(centre)
            normals.append(vectors[:, 0])
            relief.append(values[0])
    order = np.argsort(relief)
    n = min(N_PATCHES, len(order) // 10)
    return Patches(np.array(centres), np.array(normals), order[:n], order[-n:])


def heights(points: Floats, tree: cKDTree, patches: Patches, k: int) -> tuple[Floats, Floats]:
    """Return points of patch k and their heights [m] over its plane."""
    own = points[tree.query_ball_point(patches.centres[k], PATCH)]
    return own, (own - patches.centres[k]) @ patches.normals[k]


def noise_in_flat(points: Floats, patches: Patches) -> float:
    """Return the robust rms distance from the planes of the flat patches, the plane fitted to these points [m]."""
    tree, found = cKDTree(points), []
    for k in patches.flat:
        own, _ = heights(points, tree, patches, k)
        if len(own) >= 6:
            found.append(np.sqrt(np.sum(_off_plane(own) ** 2) / (len(own) - 3)))
    return float(np.median(found))


def _off_plane(points: Floats) -> Floats:
    """Return the distances (n,) of points from their own plane of least squares."""
    centred = points - points.mean(axis=0)
    return centred @ np.linalg.svd(centred, full_matrices=False)[2][2]


def noise_over_quadrics(points: Floats, raw: Floats, patches: Patches) -> float:
    """Return the rms distance in the flat patches from the quadric of the raw points there, their shape [m]."""
    tree, raw_tree, found = cKDTree(points), cKDTree(raw), []
    for k in patches.flat:
        normal = patches.normals[k]
        axes = np.linalg.svd(np.eye(3) - np.outer(normal, normal))[0][:, :2]

        def design(own: Floats, axes: Floats = axes, k: int = k) -> Floats:
            u, v = ((own - patches.centres[k]) @ axes / PATCH).T
            return np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])

        around, raw_height = heights(raw, raw_tree, patches, k)
        shape = np.linalg.lstsq(design(around), raw_height, rcond=None)[0]
        own, height = heights(points, tree, patches, k)
        if len(own):
            found.append(np.sqrt(np.mean((height - design(own) @ shape) ** 2)))
    return float(np.median(found))


def noise_of_halves(halves: tuple[Floats, Floats], patches: Patches) -> float:
    """Return the noise [m] of points that two halves of the measurements gave independently, in the flat patches.

    Half the squared difference of two heights d apart is the noise variance and what the stone's roughness adds on the
    way, which goes to nothing with d: the line through the robust variances of ten bins of d, up to the points'
    spacing, is followed to d = 0; NaN where that does not tell it from none. Roughness that both halves saw is no part
    of it, unlike that of a plane's residuals.
    """
    apart, rise = [], []
    trees = [cKDTree(half) for half in halves]
    for k in patches.flat:
        (first, z1), (second, z2) = (heights(p, t, patches, k) for p, t in zip(halves, trees, strict=True))
        if min(len(first), len(second)) < 6:
            continue
        flat = np.eye(3) - np.outer(patches.normals[k], patches.normals[k])
        reach = PATCH * np.sqrt(np.pi / len(second))
        near = cKDTree(first @ flat).sparse_distance_matrix(cKDTree(second @ flat), reach, output_type="coo_matrix")
        apart.append(near.data / reach)
        rise.append(z1[near.row] - z2[near.col])
    d, h = np.concatenate(apart), np.abs(np.concatenate(rise))
    bins = np.minimum((10 * d).astype(int), 9)
    variances = np.array([0.5 * (1.4826 * np.median(h[bins == b])) ** 2 for b in range(10)])
    centres = np.array([d[bins == b].mean() for b in range(10)])
    line = np.polyfit(centres, variances, 1, w=np.sqrt(np.bincount(bins, minlength=10)))
    return float(np.sqrt(line[1])) if line[1] > 0.0 else float("nan")


def relief_kept(points: Floats, raw: Floats, reach: float, patches: Patches) -> float:
    """Return the share of the stones' relief that is left: the slope of heights on raw medians within `reach` [m]."""
    tree, raw_tree = cKDTree(points), cKDTree(raw)
    wanted, kept = 0.0, 0.0
    for k in patches.edged:
        own, height = heights(points, tree, patches, k)
        around, raw_height = heights(raw, raw_tree, patches, k)
        if len(own) < 6:
            continue
        flat = np.eye(3) - np.outer(patches.normals[k], patches.normals[k])
        near = cKDTree(around @ flat).query_ball_point(own @ flat, reach)
        known = np.array([len(n) >= 3 for n in near])
        median = np.array([np.median(raw_height[n]) if len(n) >= 3 else np.nan for n in near])[known]
        median, height = median - median.mean(), height[known] - height[known].mean()
        wanted += float(median @ median)
        kept += float(median @ height)
    return kept / wanted


def to_count(thin, n_wanted: int, first: float) -> Floats:
    """Return the points that `thin(spacing)` makes where they are `n_wanted` within 3 %."""
    spacing = first
    for _ in range(6):
        points = thin(spacing)
        if abs(len(points) / n_wanted - 1.0) < 0.03:
            break
        spacing *= np.sqrt(len(points) / n_wanted)
    return points


def _ours(points: Floats, spacing: float) -> Floats:
    """Thin as `monitor process` does an epoch of one scan, whose station is not known."""
    scan = Scan("wall", PointCloud(points), np.eye(4), origin=np.full(3, np.nan))
    settings = FilterSettings(thinning=ThinningSettings(target_spacing=spacing))
    return merge_scans([filter_scan(scan, settings)], settings).cloud.points


def _median(points: Floats, spacing: float) -> Floats:
    """Thin to the medians of voxels (paper 004)."""
    return voxel_median(PointCloud(points), VoxelMedianSettings(voxel_size=spacing)).points


THINNING = {"ours": _ours, "voxel median": _median, "voxel mean": open3d_voxels}


def noise_alone(raw: Floats, n_wanted: int, spacing: float, patches: Patches) -> dict[str, float]:
    """Return the noise [m] of the raw points and of each thinning, from halves of the points drawn at random."""
    is_first = np.random.default_rng(2).random(len(raw)) < 0.5
    halves = raw[is_first], raw[~is_first]
    found = {"raw points": noise_of_halves(halves, patches)}
    for name, thin in THINNING.items():
        few = [to_count(lambda d, h=h, t=thin: t(h, d), n_wanted // 2, spacing * np.sqrt(2.0)) for h in halves]
        found[name] = noise_of_halves((few[0], few[1]), patches)
    return found


def noise_in_words(noise: float) -> str:
    """Return a noise [m] in millimetres, or that roughness hides it."""
    return in_words(1e3 * noise, 3) if noise > 0.0 else "too small to tell"


def run(size: Size) -> list[Row]:
    """Thin and measure."""
    raw, rng = read_wall(WIDTHS[size]), np.random.default_rng(1)
    spacing = float(np.median(cKDTree(raw).query(raw[::50], 7)[0][:, 6])) * np.sqrt(np.pi / 7.0)
    n_wanted, first = int(SHARE * len(raw)), spacing / np.sqrt(SHARE)
    clouds = {
        **{name: to_count(lambda d, t=thin: t(raw, d), n_wanted, first) for name, thin in THINNING.items()},
        "at random": raw[rng.choice(len(raw), n_wanted, replace=False)],
        "raw points": raw,
    }
    patches = find_patches(raw, rng)
    alone = noise_alone(raw, n_wanted, first, patches)
    noise = {name: 1e3 * noise_in_flat(points, patches) for name, points in clouds.items()}
    bent = {name: 1e3 * noise_over_quadrics(points, raw, patches) for name, points in clouds.items()}
    kept = {name: relief_kept(points, raw, 1.5 * spacing, patches) for name, points in clouds.items()}
    share = kept["ours"] / kept["raw points"]
    others = [name for name in clouds if name != "ours"]
    ratio = noise["ours"] / noise["raw points"]
    return [
        Row("share of the points", in_percent(len(clouds["ours"]) / len(raw), 1),
            others={name: in_percent(len(clouds[name]) / len(raw), 1) for name in others}),
        Row("plane residual in flat parts, mm", f"{in_words(noise['ours'], 2)} ({ratio:.2f} of raw)",
            judge(ratio <= 0.5), asked="at most half of raw",
            others={name: in_words(noise[name], 2) for name in others}, value=ratio,
            cause="" if ratio <= 0.5 else "what stays over a plane is the shape of the stone: means leave as much"),
        Row("noise alone, of halves thinned to a tenth each, mm",
            f"{noise_in_words(alone['ours'])} ({alone['ours'] / alone['raw points']:.2f} of raw)"
            if alone["ours"] > 0.0 else noise_in_words(alone["ours"]),
            judge(alone["ours"] <= 0.5 * alone["raw points"]), asked="at most half of raw",
            others={name: noise_in_words(value) for name, value in alone.items() if name != "ours"},
            value=alone["ours"] / alone["raw points"],
            cause="" if alone["ours"] > 0.0 else "what roughness adds with distance hides it: unknown is no pass"),
        Row("the same over the quadrics of the raw patches, mm",
            f"{in_words(bent['ours'], 2)} ({bent['ours'] / bent['raw points']:.2f} of raw)",
            others={name: in_words(bent[name], 2) for name in others}, value=bent["ours"] / bent["raw points"]),
        Row("relief kept of that of the raw points, patches of most relief", in_percent(share), judge(share >= 0.95),
            asked="95 %", others={name: in_percent(kept[name] / kept["raw points"]) for name in others}, value=share),
    ]  # fmt: skip


NOTES = (
    "`vapc_rockwall`, station unknown. The plane residual holds the roughness of the stone beside the noise of the "
    "scanner; the first stays whatever the thinning. Noise alone: how two halves of the points, thinned independently, "
    "differ where they meet; roughness that both saw is no part of it."
)
