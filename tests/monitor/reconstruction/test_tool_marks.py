"""Relief that repeats: kept at its height, with less noise than smooth fits, and only where it repeats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np
import pytest

from monitor.reconstruction import ReconstructionResult, SurfaceSettings, reconstruct_with_record
from projects.model import Bools, Floats, PointCloud, Surface

SPACING, NOISE, N_SIDE = 0.001, 0.0004, 70
INSIDE = 0.024  # m from the middle
SMOOTH, KEPT = SurfaceSettings(tool_marks=False), SurfaceSettings()

Relief = Callable[[Floats, Floats], Floats]


def waves(length: float, amplitude: float) -> Relief:
    """Return a relief of one wave along x."""
    return lambda x, y: amplitude * np.sin(2.0 * np.pi / length * x)


def chiselled(rng: np.random.Generator, pitch: float, depth: float) -> Relief:
    """Return scalloped furrows side by side, a quarter wider or narrower, some deeper than others."""
    turn = rng.uniform(0.0, np.pi)
    borders = np.cumsum(pitch * rng.uniform(0.75, 1.25, 100)) - 50.0 * pitch
    depths = depth * rng.uniform(0.6, 1.4, 101)

    def relief(x: Floats, y: Floats) -> Floats:
        """Return heights, 0 at the borders of furrows."""
        across = np.cos(turn) * x + np.sin(turn) * y + 0.001 * np.sin(2.0 * np.pi * (y - x) / 0.05)
        k = np.clip(np.searchsorted(borders, across), 1, 99)
        part = (across - borders[k - 1]) / (borders[k] - borders[k - 1])
        return -depths[k] * (1.0 - (2.0 * part - 1.0) ** 2)

    return relief


def cuts(x: Floats, y: Floats) -> Floats:
    """Return strokes of an inscription, 5 mm wide and 2 mm deep, none like another."""
    ends = ((-0.02, -0.02, 0.0, 0.02), (0.0, 0.02, 0.02, -0.01), (-0.01, 0.0, 0.015, 0.0), (-0.022, 0.01, -0.01, 0.022))
    depth = np.zeros_like(x)
    for x0, y0, x1, y1 in ends:
        dx, dy = x1 - x0, y1 - y0
        part = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        depth = np.maximum(depth, 0.002 - 0.8 * np.hypot(x - x0 - part * dx, y - y0 - part * dy))
    return -depth


def slopes(relief: Relief, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return both slopes of a relief."""
    e = 1e-6
    return (relief(x + e, y) - relief(x - e, y)) / (2.0 * e), (relief(x, y + e) - relief(x, y - e)) / (2.0 * e)


def scan(relief: Relief, rng: np.random.Generator, noise: float = NOISE) -> PointCloud:
    """Return points 1 mm apart, noise along the normals."""
    at = (np.arange(N_SIDE) + 0.5 - 0.5 * N_SIDE) * SPACING
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, N_SIDE**2) for a in np.meshgrid(at, at))
    slope_x, slope_y = slopes(relief, x, y)
    normals = np.column_stack([-slope_x, -slope_y, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = np.column_stack([x, y, relief(x, y)])
    return PointCloud(points + noise * rng.normal(size=(len(x), 1)) * normals, origins=points + 2.0 * normals)


def errors(result: ReconstructionResult, relief: Relief) -> tuple[Floats, Floats, Bools]:
    """Return how far vertices lie off a relief, their sigma, and which of all they are: away from the border."""
    x, y, z = result.surface.vertices.T
    inside = (abs(x) < INSIDE) & (abs(y) < INSIDE)
    slope_x, slope_y = slopes(relief, x, y)
    off = (z - relief(x, y)) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    assert result.surface.sigma is not None
    return off[inside], result.surface.sigma[inside], inside


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize(("length", "left"), [(0.005, 0.4), (0.008, 0.35), (0.012, 0.5)])
def test_waves_keep_their_height_and_lose_their_noise(length: float, left: float) -> None:
    """Smooth fits keep 0.6 of waves of 5 mm, and 0.93 to 0.95 of 8 and 12 mm at two to four times the noise."""
    relief = waves(length, 0.001)
    cloud = scan(relief, np.random.default_rng(3))
    smooth, kept = (reconstruct_with_record(cloud, settings) for settings in (SMOOTH, KEPT))
    off, sigma, inside = errors(kept, relief)
    assert rms(off) < left * rms(errors(smooth, relief)[0])
    assert rms(off) < 0.1e-3
    assert 0.4 < rms(off / sigma) < 1.15
    x, _, z = kept.surface.vertices[inside].T
    shape = np.column_stack([np.sin(2.0 * np.pi / length * x), np.cos(2.0 * np.pi / length * x), np.ones_like(x)])
    assert np.linalg.lstsq(shape, z, rcond=None)[0][0] == pytest.approx(0.001, rel=0.025)
    assert kept.automatic["waved_share"] > 0.75


def test_waves_longer_than_a_window_is_wide_lose_half_of_their_error() -> None:
    """1.6 waves of 20 mm over a window: fits keep 0.95, with edges here and there that the waves go along with."""
    relief, off, before = waves(0.020, 0.001), [], []
    for seed in (1, 2, 3):
        cloud = scan(relief, np.random.default_rng(seed))
        off.append(rms(errors(reconstruct_with_record(cloud, KEPT), relief)[0]))
        before.append(rms(errors(reconstruct_with_record(cloud, SMOOTH), relief)[0]))
    assert np.mean(off) < 0.7 * np.mean(before)


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_slow_waves_of_a_plate_are_bends(seed: int) -> None:
    """Of windows with a patch of second degree 3 and 6 of 51 took waves, no nearer, at sigmas twice as large."""
    rng = np.random.default_rng(seed)
    relief: Relief = lambda x, y: 0.003 * np.sin(2.0 * np.pi * x / 0.094) * np.cos(2.0 * np.pi * y / 0.078)  # noqa: E731
    cloud = scan(relief, rng, 0.0001)
    smooth, kept = (reconstruct_with_record(cloud, settings).surface for settings in (SMOOTH, KEPT))
    assert np.array_equal(smooth.vertices, kept.vertices)


def test_a_step_asks_for_no_smaller_cells() -> None:
    """It has waves of every length, and a third of the windows see it: all was made anew with cells half as wide."""
    relief: Relief = lambda x, y: np.where(x > 0.003, 0.002, 0.0)  # noqa: E731
    cloud = scan(relief, np.random.default_rng(4), 0.0002)
    smooth, kept = (reconstruct_with_record(cloud, settings) for settings in (SMOOTH, KEPT))
    assert kept.automatic["cell_size_m"] == smooth.automatic["cell_size_m"]


def test_smaller_cells_need_not_be_a_length_that_could_be_set() -> None:
    """Cells of 30 m are automatic, and no setting."""
    relief: Relief = lambda x, y: 10.0 * np.sin(2.0 * np.pi * x / 60.0)  # noqa: E731
    x, y = (20.0 * a for a in scan(lambda x, y: 0.0 * x, np.random.default_rng(5), 0.0).points[:, :2].T / SPACING)
    points = np.column_stack([x, y, relief(x, y) + 2.0 * np.random.default_rng(6).normal(size=len(x))])
    made = reconstruct_with_record(PointCloud(points, origins=points + np.array([0.0, 0.0, 2e3])), KEPT)
    assert 10.0 < made.automatic["cell_size_m"] < 25.0


def test_beside_one_groove_sigma_is_that_of_the_stone() -> None:
    """Long waves that cancel each other were found beside it: 0.5 to 0.8 mm were stated, the error is 0.03."""
    relief: Relief = lambda x, y: -np.maximum(0.0, 0.002 - abs(x))  # noqa: E731
    for seed in (0, 1):
        kept = reconstruct_with_record(scan(relief, np.random.default_rng(seed), 0.0002), KEPT)
        off, sigma, inside = errors(kept, relief)
        beside = abs(kept.surface.vertices[inside, 0]) > 0.008
        assert np.quantile(sigma[beside], 0.9) < 0.2e-3
        assert rms(off[beside]) < 0.06e-3


def test_normals_follow_the_waves() -> None:
    relief = waves(0.008, 0.001)
    kept = reconstruct_with_record(scan(relief, np.random.default_rng(3)), KEPT)
    inside = errors(kept, relief)[2]
    x, y, _ = kept.surface.vertices[inside].T
    true = np.column_stack([-slopes(relief, x, y)[0], np.zeros_like(x), np.ones_like(x)])
    true /= np.linalg.norm(true, axis=1)[:, None]
    angle = np.degrees(np.arccos(np.clip((true * kept.surface.normals[inside]).sum(axis=1), -1.0, 1.0)))
    assert np.sqrt(np.mean(angle**2)) < 3.0


def test_waves_too_short_for_the_cells_ask_for_smaller_ones() -> None:
    """Of waves of 3 mm cells of 1.5 mm show nothing that a face could; smooth fits lose them and state 0.02 mm."""
    relief = waves(0.003, 0.0003)
    cloud = scan(relief, np.random.default_rng(4), 0.0002)
    smooth, kept = (reconstruct_with_record(cloud, settings) for settings in (SMOOTH, KEPT))
    assert kept.automatic["cell_size_m"] < 0.8 * smooth.automatic["cell_size_m"]
    off, sigma, _ = errors(kept, relief)
    assert rms(errors(smooth, relief)[0]) > 0.14e-3
    assert rms(off) < 0.03e-3
    assert 0.4 < rms(off / sigma) < 1.15
    given = reconstruct_with_record(cloud, SurfaceSettings(cell_size=0.0015))
    off, sigma, _ = errors(given, relief)
    assert given.automatic["cell_size_m"] == 0.0015
    assert rms(off / sigma) < 1.3  # lost, and told


def test_what_was_dropped_is_counted_where_smaller_cells_are_asked_for() -> None:
    cloud = scan(waves(0.003, 0.0003), np.random.default_rng(4), 0.0002)
    points, origins = cloud.points.copy(), np.asarray(cloud.origins).copy()
    points[:7], origins[:7] = points[7:14], origins[7:14]
    made = reconstruct_with_record(replace(cloud, points=points, origins=origins), KEPT)
    assert made.automatic["cell_size_m"] < 0.0012
    assert made.counts["points_copied"] == 7


@pytest.mark.parametrize(("pitch", "depth", "left"), [(0.006, 0.0012, 0.85), (0.008, 0.0005, 0.92)])
def test_tool_marks_of_all_widths_are_nearer_to_the_truth(pitch: float, depth: float, left: float) -> None:
    off, before = [], []
    for seed in (1, 2):
        relief = chiselled(np.random.default_rng(seed), pitch, depth)
        cloud = scan(relief, np.random.default_rng(seed + 10))
        off.append(rms(errors(reconstruct_with_record(cloud, KEPT), relief)[0]))
        before.append(rms(errors(reconstruct_with_record(cloud, SMOOTH), relief)[0]))
    assert np.mean(off) < left * np.mean(before)


def test_strokes_are_no_waves() -> None:
    """An inscription on a flat stone, no stroke like another: 6 % of the vertices lie on waves, no farther off."""
    cloud = scan(cuts, np.random.default_rng(6))
    smooth, kept = (reconstruct_with_record(cloud, settings) for settings in (SMOOTH, KEPT))
    assert rms(errors(kept, cuts)[0]) < 1.02 * rms(errors(smooth, cuts)[0])
    assert kept.automatic["waved_share"] < 0.1


def assert_same(made: Surface, other: Surface) -> None:
    """Assert that two surfaces have the same bits."""
    for name in ("vertices", "faces", "normals", "sigma", "n_support"):
        assert np.array_equal(getattr(made, name), getattr(other, name)), name


@pytest.mark.parametrize("radius", [np.inf, 0.08])
@pytest.mark.parametrize("seed", [6, 13])
def test_of_smooth_surfaces_not_one_bit_changes(radius: float, seed: int) -> None:
    """Windows of noise where neighbours are alike by chance, one in twenty, had sigmas up to twice as large."""
    cloud = scan(lambda x, y: (x**2 + y**2) / (2.0 * radius), np.random.default_rng(seed))
    smooth, kept = (reconstruct_with_record(cloud, settings).surface for settings in (SMOOTH, KEPT))
    assert_same(smooth, kept)


def scan_lines(rng: np.random.Generator, common: float, along_x: bool) -> PointCloud:
    """Return points on a plane in lines 1 mm apart, with noise of 0.2 mm, and as much as `common` that lines share."""
    cloud = scan(lambda x, y: 0.0 * x, rng, 0.0002)
    line = np.repeat(np.arange(N_SIDE), N_SIDE) if along_x else np.tile(np.arange(N_SIDE), N_SIDE)
    height = common * rng.normal(size=N_SIDE)[line]
    return replace(cloud, points=cloud.points + height[:, None] * [0.0, 0.0, 1.0])


@pytest.mark.parametrize("common", [0.0001, 0.0002])
@pytest.mark.parametrize("seed", [1, 2])
def test_what_scan_lines_have_in_common_is_no_relief(seed: int, common: float) -> None:
    """It is white across the lines: taken for waves, on smaller cells, it was off by 3 sigmas."""
    cloud = scan_lines(np.random.default_rng(seed), common, along_x=True)
    smooth, kept = (reconstruct_with_record(cloud, settings) for settings in (SMOOTH, KEPT))
    assert kept.automatic["waved_share"] == 0.0
    assert np.array_equal(smooth.surface.vertices, kept.surface.vertices)


def test_lines_of_two_scans_are_hardly_ever_relief() -> None:
    """Lines at right angles: of 12 such planes 2 have 4 % of their vertices on waves, none of the others any."""
    shares = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        one, other = (scan_lines(rng, 0.0002, along_x) for along_x in (True, False))
        points = np.concatenate([one.points, other.points])
        origins = points + np.array([0.0, 0.0, 2.0])
        made = reconstruct_with_record(PointCloud(points, origins=origins), KEPT)
        shares.append(made.automatic["waved_share"])
    assert np.mean(shares) < 0.05


def test_beside_a_step_not_one_bit_changes() -> None:
    """Waves that a step asks for do not go on; sigma beside it was 3 to 4 times too large."""
    relief: Relief = lambda x, y: np.where(x > 0.003, 0.002, 0.0)  # noqa: E731
    cloud = scan(relief, np.random.default_rng(1), 0.0002)
    smooth, kept = (reconstruct_with_record(cloud, settings).surface for settings in (SMOOTH, KEPT))
    assert_same(smooth, kept)


def test_marks_on_a_patch_of_three_windows_are_kept() -> None:
    """48 of 70 mm, waves of 6 mm: 0.2 mm off by smooth fits."""
    relief: Relief = lambda x, y: np.where(np.hypot(x, y) < 0.024, waves(0.006, 0.0006)(x, y), 0.0)  # noqa: E731
    cloud = scan(relief, np.random.default_rng(1))
    smooth, kept = (reconstruct_with_record(cloud, settings) for settings in (SMOOTH, KEPT))
    middle = [np.hypot(*made.surface.vertices[errors(made, relief)[2], :2].T) < 0.016 for made in (smooth, kept)]
    off = [rms(errors(made, relief)[0][here]) for made, here in zip((smooth, kept), middle, strict=True)]
    assert off[1] < 0.7 * off[0]


def test_waves_have_the_same_bits_for_any_number_of_threads() -> None:
    cloud = scan(waves(0.006, 0.0008), np.random.default_rng(9))
    made, before = [], numba.get_num_threads()
    for n_threads in (1, before):
        numba.set_num_threads(n_threads)
        made.append(reconstruct_with_record(cloud, KEPT).surface)
    numba.set_num_threads(before)
    assert np.array_equal(made[0].vertices, made[1].vertices)
    assert np.array_equal(made[0].sigma, made[1].sigma)


def test_an_edge_beside_tool_marks_stays_sharp() -> None:
    """Two planes that meet at 90 degrees, one with waves of 6 mm along the edge."""
    rng = np.random.default_rng(11)
    cloud = scan(lambda x, y: np.where(x < 0.0, 0.0005 * np.sin(2.0 * np.pi / 0.006 * y), 0.0), rng)
    points, origins = cloud.points.copy(), np.asarray(cloud.origins).copy()
    right = points[:, 0] > 0.0
    points[right] = np.column_stack([points[right, 2], points[right, 1], -points[right, 0]])
    origins[right] = points[right] + [2.0, 0.0, 0.0]
    folded = replace(cloud, points=points, origins=origins)
    off = []
    for settings in (SMOOTH, KEPT):
        x, y, z = reconstruct_with_record(folded, settings).surface.vertices.T
        side = (abs(y) < INSIDE) & (z < -0.001) & (z > -INSIDE)
        off.append(rms(x[side]))
    assert off[1] < 1.1 * off[0]
