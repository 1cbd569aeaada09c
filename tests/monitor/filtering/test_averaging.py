"""Repeated scans averaged to one: noise, drift, mixed pixels, with and without a grid, and through the chain."""

import dataclasses

import numpy as np
import pytest

from monitor.cli import run
from monitor.filtering import average_scans
from monitor.filtering.averaging import average_ranges, error_of_mean
from monitor.filtering.drift import Drift as FoundDrift
from monitor.filtering.drift import _trend, drift_at, estimate_drift
from monitor.filtering.nearest import canonical_order
from monitor.simulation import INSTRUMENTS, Scene, Window, simulate_scan, without_errors
from monitor.simulation.repeated import Drift, repeat_scan
from monitor.simulation.scenes import make_box
from projects import Project
from projects.errors import ParameterError
from projects.formats import write_e57
from projects.model import PointCloud, Scan

EXACT = without_errors(INSTRUMENTS["faro-photon120"])
NOISY = dataclasses.replace(EXACT, noise_floor=1e-3)
# Two walls that meet in an edge and one oblique one: slopes in azimuth and elevation for the angles to show in.
ROOM = Scene(
    "room",
    (
        make_box("wall", np.array([3.0, -2.0, -2.0]), np.array([3.1, 2.0, 2.0]), reflectance=0.9),
        make_box("shelf", np.array([2.0, -2.0, -0.60]), np.array([3.0, 2.0, -0.55]), reflectance=0.9),
        make_box("pier", np.array([2.0, 0.55, -2.0]), np.array([3.0, 0.6, 2.0]), reflectance=0.9),
    ),
)
WINDOW = Window(0.0, 0.28, -0.26, -0.02)


def repeat(n_scans, instrument=NOISY, step=0.002, **options):
    return list(repeat_scan(ROOM, instrument, np.eye(4), WINDOW, n_scans=n_scans, step=step, n_subrays=1, **options))


def lengths(scan):
    return np.linalg.norm(scan.cloud.points, axis=1)


def by_cell(scan):
    """Return ranges in the order of row and column."""
    return lengths(scan)[np.lexsort((scan.columns, scan.rows))]


def test_the_mean_of_sixteen_has_a_quarter_of_the_noise_and_says_so():
    clean = repeat(1, EXACT)[0]
    found = average_scans(repeat(16))
    assert len(found.scan.cloud) > 0.995 * len(clean.cloud)
    table = dict(zip(zip(clean.rows, clean.columns, strict=True), lengths(clean), strict=True))
    cells = zip(found.scan.rows, found.scan.columns, strict=True)
    error = lengths(found.scan) - np.array([table[cell] for cell in cells])
    assert np.std(error) == pytest.approx(1e-3 / 4.0, rel=0.03)  # 17 000 cells: half a percent one sigma
    assert np.sqrt(np.mean((error / found.scan.cloud.sigma) ** 2)) == pytest.approx(1.0, abs=0.06)
    assert np.median(found.scan.cloud.n_merged) == 16
    assert found.automatic["noise_of_one_scan"] == pytest.approx(1e-3, rel=0.03)
    assert not found.drift.removes_range
    assert not found.drift.removes_angles


@pytest.mark.parametrize("n", [1, 5, 15])
def test_fewer_cells_than_a_run_tell_no_drift(n):
    scans = [scan.take(np.arange(n)) for scan in repeat(3)]
    found = average_scans(scans)
    assert 1 <= len(found.scan.cloud) <= n
    assert not found.drift.removes_range
    assert np.isnan(found.drift.sigma_range).all()


def test_a_block_of_fewer_cells_than_a_run_has_the_offset_of_its_scan_alone():
    unit = np.array([1e-3, 0.0, -1e-3])
    drift = FoundDrift(unit, 0 * unit + 1e-5, unit, unit, unit, unit, 0.0, 0.0, 0.0, 0.0, True, True)
    shift = drift_at(drift, np.tile([1.0, 0.0, 0.0], (5, 1)), np.full((3, 5), 2.0))
    np.testing.assert_allclose(shift, np.tile(unit[:, None], (1, 5)))


def test_every_measurement_is_accounted_for():
    scans = repeat(5)
    scans[2] = scans[2].take(np.arange(len(scans[2].cloud)) % 7 > 0)
    counts = dict(average_scans(scans).counts)
    assert counts.pop("in") == sum(len(s.cloud) for s in scans)
    assert sum(counts.values()) == sum(len(s.cloud) for s in scans)


def test_drift_of_range_and_angles_is_found_and_removed():
    """Against what was simulated, within four of the stated sigmas, which are small against it."""
    drift = Drift(range_rate=0.2e-3, azimuth_rate=1.5e-4, elevation_rate=-1.0e-4)
    found = average_scans(repeat(8, drift=drift)).drift
    steady = np.arange(8) - 3.5
    assert found.removes_range
    assert found.removes_angles
    assert np.all(np.abs(found.range - 0.2e-3 * steady) < 4.0 * found.sigma_range)
    assert np.all(np.abs(found.azimuth - 1.5e-4 * steady) < 4.0 * found.sigma_azimuth + 0.03 * 5e-4)
    assert np.all(np.abs(found.elevation + 1.0e-4 * steady) < 4.0 * found.sigma_elevation + 0.03 * 4e-4)
    assert found.sigma_range.max() < 0.05e-3
    assert max(found.sigma_azimuth.max(), found.sigma_elevation.max()) < 1e-4
    assert abs(found.rate - 0.2e-3) < 4.0 * found.sigma_rate < 0.1e-3


def test_removing_the_drift_leaves_the_noise_of_one_scan_in_the_spread():
    drifting = average_scans(repeat(8, drift=Drift(range_rate=0.5e-3)))
    assert drifting.automatic["noise_of_one_scan"] == pytest.approx(1e-3, rel=0.04)  # with the drift left in: 1.5 mm


def test_no_drift_is_called_one_as_rarely_as_asked():
    """24 pairs of scans without any: at a hundredth, two or more false calls have a chance of 2 %."""
    chances = [average_scans(repeat(4, seed=seed, step=0.004)).drift for seed in range(24)]
    assert sum(d.p_range < 0.01 for d in chances) <= 2
    assert sum(d.p_angles < 0.01 for d in chances) <= 2
    assert np.mean([d.p_range < 0.5 for d in chances]) == pytest.approx(0.5, abs=0.3)


def drifts_of_nothing(n_scans, n_draws=200):
    """Return what is found in draws of so many scans of a wavy wall whose instrument does not drift, 0.5 mm noise."""
    across = np.arange(-0.12, 0.12, 0.003)
    y, z = (a.ravel() for a in np.meshgrid(across, across))
    directions = np.column_stack([np.full(y.size, 3.0), y, z])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions = directions[canonical_order(directions)]
    true = 3.0 / directions[:, 0] + 0.02 * np.sin(20.0 * directions[:, 1]) * np.cos(17.0 * directions[:, 2])
    draws = np.random.default_rng(n_scans)
    return [
        estimate_drift(true + draws.normal(0, 0.5e-3, (n_scans, true.size)), directions, 0.01) for _ in range(n_draws)
    ]


@pytest.mark.parametrize("n_scans", [2, 3, 5, 20])
def test_without_drift_chance_is_told_right_and_the_rate_scatters_as_its_sigma_says(n_scans):
    """Taken as independent, shifts from a common mean gave two scans twice the chi-square that they have."""
    drifts = drifts_of_nothing(n_scans)
    for chances in ([d.p_range for d in drifts], [d.p_angles for d in drifts]):
        assert np.mean(np.less(chances, 0.05)) == pytest.approx(0.05, abs=0.04)  # binomial: 0.015 one sigma
    scatter = np.sqrt(np.mean([(d.rate / d.sigma_rate) ** 2 for d in drifts]))
    assert scatter == pytest.approx(1.0, abs=0.13)  # 0.05 one sigma, and some sigmas come from the scatter itself
    shifts = np.array([d.range / d.sigma_range for d in drifts if not d.removes_angles])
    assert np.sqrt(np.mean(shifts**2)) == pytest.approx(1.0, abs=0.15)


def test_the_sigma_of_a_rate_grows_where_shifts_wander_from_their_line():
    shift, sigma2 = np.array([0.0, 3.0, -3.0, 3.0, 0.0]) * 1e-4, np.full(5, 1e-10 * 0.8)
    rate, sigma = _trend(shift, sigma2, np.arange(5.0))
    assert rate == pytest.approx(0.0, abs=1e-12)
    left2 = ((shift - shift.mean()) ** 2).sum() / 3.0
    assert sigma == pytest.approx(np.sqrt(left2 / 10.0))
    assert _trend(np.zeros(5), sigma2, np.arange(5.0))[1] == pytest.approx(1e-5 / np.sqrt(10.0))


@pytest.mark.parametrize("n", [4, 10, 20])
def test_noise_alone_seldom_splits_a_cell_and_two_surfaces_do(rng, n):
    ranges = 3.0 + rng.normal(0, 1e-3, (n, 20_000))
    assert average_ranges(ranges).is_split.mean() < 0.005
    ranges[: n // 2, ::40] += 10e-3
    split = average_ranges(ranges).is_split
    assert split[::40].mean() > 0.99
    assert split.mean() < 0.025 + 0.005


@pytest.mark.parametrize("n", [20, 50])
def test_what_the_cut_takes_of_honest_noise_is_in_what_is_stated(rng, n):
    """Within three sigmas noise looks 1.3 % smaller than it is, and their mean errs by 1.5 % more than that of all."""
    averages = average_ranges(5.0 + 1e-3 * rng.normal(size=(n, 60_000)), n_looked=n)
    sigma = error_of_mean(averages.spread, averages.n_kept)
    assert np.sqrt(np.mean(averages.spread**2)) == pytest.approx(1e-3, rel=0.003)
    assert np.sqrt(np.mean(((averages.ranges - 5.0) / sigma) ** 2)) == pytest.approx(1.0, abs=0.03)


def test_single_gross_errors_do_not_move_the_mean(rng):
    """Two of 15 ranges are 10 to 30 mm off in every third cell: the plain mean would be off by 2.7 mm there."""
    ranges = 3.0 + rng.normal(0, 1e-3, (15, 9000))
    ranges[[2, 7], ::3] += rng.uniform(10e-3, 30e-3, (2, 3000))
    found = average_ranges(ranges)
    hit = np.arange(9000) % 3 == 0
    kept = ~found.is_split
    assert kept[hit].mean() > 0.95
    assert abs(np.mean(found.ranges[hit & kept] - 3.0)) < 0.05e-3
    assert np.median(found.n_kept[hit & kept]) == 13


def test_without_a_grid_the_nearest_directions_are_averaged(rng):
    scans = [dataclasses.replace(s.take(rng.permutation(len(s.cloud))), rows=None, columns=None) for s in repeat(9)]
    found = average_scans(scans)
    assert found.automatic["by"] == "nearest direction"
    on_grid = average_scans(repeat(9))
    assert len(found.scan.cloud) == len(on_grid.scan.cloud)
    np.testing.assert_allclose(np.sort(lengths(found.scan)), np.sort(lengths(on_grid.scan)), atol=2e-4)


@pytest.mark.parametrize("is_grid", [True, False])
@pytest.mark.parametrize(("first", "n_shared"), [(40, 20), (60, 0)])
def test_windows_that_overlap_in_part_or_nowhere_lose_no_point(rng, first, n_shared, is_grid):
    """Without a grid all of the second window was left out beside the larger first: 2400 of 6000 points."""
    column, row = (a.ravel() for a in np.meshgrid(np.arange(100), np.arange(60)))
    azimuth, elevation = 0.002 * column, 0.002 * row
    beams = np.c_[np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    scans = []
    for k, seen in enumerate((column < 60, (column >= first) & (column < first + 40))):
        ranges = 3.0 / beams[:, 0] + rng.normal(0.0, 0.5e-3, len(beams))
        grid = {"rows": row[seen], "columns": column[seen]} if is_grid else {}
        scans.append(Scan(str(k), PointCloud((beams * ranges[:, None])[seen]), np.eye(4), **grid))
    found = average_scans(scans)
    assert found.counts["no_counterpart"] == 0
    assert found.counts["out"] >= 0.99 * 60 * (100 - n_shared)
    assert (found.scan.cloud.n_merged == 2).sum() == pytest.approx(60 * n_shared, abs=0.01 * 6000)


def test_rows_that_name_other_directions_are_not_trusted():
    scans = repeat(3)
    cut = scans[1].take(scans[1].columns >= 20)
    shifted = dataclasses.replace(cut, columns=cut.columns - 20)
    found = average_scans([scans[0], shifted, scans[2]])
    assert found.automatic["by"] == "nearest direction"
    assert abs(np.median(by_cell(average_scans(scans).scan)) - np.median(lengths(found.scan))) < 2e-3


def test_the_order_of_the_points_changes_nothing(rng):
    scans = repeat(3, step=0.004)
    here = average_scans(scans).scan
    there = average_scans([s.take(rng.permutation(len(s.cloud))) for s in scans]).scan
    for f in dataclasses.fields(PointCloud):
        a, b = getattr(here.cloud, f.name), getattr(there.cloud, f.name)
        assert (a is None and b is None) or np.array_equal(a, b), f.name
    assert np.array_equal(here.rows, there.rows)


def test_scans_of_two_stations_and_of_none_are_refused():
    first = simulate_scan(ROOM, EXACT, np.eye(4), WINDOW, step=0.01)
    moved = np.eye(4)
    moved[0, 3] = 0.02
    with pytest.raises(ParameterError, match=r"20\.0 mm from"):
        average_scans([first, dataclasses.replace(first, pose=moved)])
    with pytest.raises(ParameterError, match="where the scanner stood"):
        average_scans([first, dataclasses.replace(first, origin=np.full(3, np.nan))])
    with pytest.raises(ParameterError, match="no scan"):
        average_scans([])


def test_repeated_files_become_one_filtered_scan_through_the_command_line(tmp_path):
    """Six files, one step `scan000` of all their points, whose noise is that of the mean of six."""
    files = []
    for k, scan in enumerate(repeat(6, step=0.003)):
        files.append(str(tmp_path / f"scan-{k}.e57"))
        write_e57(tmp_path / f"scan-{k}.e57", [scan])
    project = str(tmp_path / "project")
    for words in (
        ["init", project],
        ["add-object", project, "room"],
        ["add-epoch", project, "room", "2024", "--date", "2024-05-01", "--repeated", *files],
        ["process", project, "room", "2024"],
    ):
        assert run(words) == 0
    kept = Project.open(tmp_path / "project")
    steps = {s.product: s for s in kept.steps("room", "2024")}
    assert [name for name in steps if name.startswith("scan")] == ["scan000"]
    step = steps["scan000"]
    lost = sum(step.counts[reason] for reason in ("no_counterpart", "split", "disagreeing", "averaged"))
    assert step.counts["read"] == lost + step.counts["in"]
    assert step.counts["averaged"] > 4.9 * step.counts["in"]
    assert step.automatic["noise_before"] == pytest.approx(1e-3 / np.sqrt(6), rel=0.25)
    assert step.automatic["averaging"]["n_scans"] == 6


def test_repeated_files_that_do_not_say_where_the_scanner_stood_are_refused_until_poses_do(tmp_path, capsys):
    """They were taken, fitted onto each other and merged, and the report said that they were averaged."""
    files = [tmp_path / f"{k}.xyz" for k in range(2)]
    for file, scan in zip(files, repeat(2, step=0.01), strict=True):
        np.savetxt(file, scan.cloud.points, fmt="%.6f")
    project, poses = str(tmp_path / "project"), tmp_path / "poses"
    poses.write_text("".join(f"{file.name} 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" for file in files))
    assert run(["init", project]) == run(["add-object", project, "room"]) == 0
    words = ["add-epoch", project, "room", "2024", "--date", "2024-05-01", "--repeated"]
    assert run([*words, *map(str, files)]) == 2
    *_, said = capsys.readouterr().err.splitlines()
    assert "2 of 2 scans do not say where the scanner stood (0.xyz, 1.xyz)" in said
    assert "--poses FILE" in said
    assert run([*words, "--poses", str(poses), *map(str, files)]) == 0
    headers = Project.open(tmp_path / "project").scan_headers("room", "2024")
    assert all((header.origin == 0.0).all() for header in headers)


@pytest.mark.parametrize("off", [1e-3, 2e-2])
def test_of_three_scans_one_that_lies_off_is_told_by_how_much(off):
    """The median of three is always the nearer of the other two: as if they had hardly any noise, beyond which all is
    strange. 1 mm had been 0.86."""
    scans = repeat(3)
    ranges = np.array([by_cell(s)[:12_800] for s in scans]) + np.array([[0.0], [off], [0.0]])
    order = np.lexsort((scans[0].columns, scans[0].rows))[:12_800]
    directions = scans[0].cloud.points[order] / np.linalg.norm(scans[0].cloud.points[order], axis=1)[:, None]
    found = estimate_drift(ranges, directions, 0.01)
    assert found.range == pytest.approx(off * np.array([-1.0, 2.0, -1.0]) / 3.0, abs=4.0 * found.sigma_range.max())
    assert found.sigma_range.max() < 3e-5
    assert found.removes_range


def test_a_scan_of_three_that_saw_something_else_in_every_beam_is_outvoted():
    """All that it measured is far off: none of it says anything of drift, nor is it noise."""
    scans = repeat(3)
    cloud = scans[1].cloud
    scans[1] = dataclasses.replace(scans[1], cloud=dataclasses.replace(cloud, points=0.7 * cloud.points))
    found, alone = average_scans(scans), average_scans(scans[::2])
    assert len(found.scan.cloud) > 0.9 * len(alone.scan.cloud)
    assert np.median(lengths(found.scan)) == pytest.approx(np.median(lengths(alone.scan)), abs=1e-2)
    assert found.automatic["noise_of_one_scan"] == pytest.approx(1e-3, rel=0.05)
    assert found.counts["disagreeing"] > 0.9 * len(cloud)


def wall_scan(rng, surface, step, *, off=(0.0, 0.0), bias=0.0):
    """Return a scan without a grid of what `surface` has as ranges in directions, steps aside by `off` [rad], with
    0.5 mm of noise and `bias` [m]."""
    places = np.arange(-0.12, 0.12, step)
    azimuth, elevation = (a.ravel() + o for a, o in zip(np.meshgrid(places, places), off, strict=True))
    beams = np.c_[np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    ranges = surface(beams) + bias + rng.normal(0.0, 0.5e-3, len(beams))
    return Scan(f"{step} {bias}", PointCloud(beams * ranges[:, None]), np.eye(4))


def waves(beams):
    return 3.0 / beams[:, 0] + 0.02 * np.sin(20.0 * beams[:, 1]) * np.cos(17.0 * beams[:, 2])


def aslant(beams):
    return 3.0 / (beams @ [1.0, 0.7, 0.4])


def errors_of(found, surface):
    """Return by how much the points lie off a surface along their beams [m]."""
    ranges = lengths(found.scan)
    return ranges - surface(found.scan.cloud.points / ranges[:, None])


@pytest.mark.parametrize("surface", [waves, aslant])
@pytest.mark.parametrize("aside", [(0.5, 0.5), (0.3, 0.0)])
def test_directions_that_lie_beside_each_other_are_no_drift(surface, aside):
    """Half a step aside was taken for angles that are off by as much: a false drift of 0.2 and 3 mm in each of 8
    draws, and means 0.17 and 2 mm off. 40 % of the second scan lay in no cell."""
    off = 0.003 * np.array(aside)
    chances = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        found = average_scans([wall_scan(rng, surface, 0.003), wall_scan(rng, surface, 0.003, off=off)])
        error = errors_of(found, surface)
        assert abs(error.mean()) < 0.03e-3  # 0.005 mm one sigma
        assert np.sqrt(np.mean((error / found.scan.cloud.sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
        assert found.counts["no_counterpart"] < 0.15 * found.counts["in"]
        chances += [found.drift.p_range, found.drift.p_angles]
    assert min(chances) > 1e-3
    assert np.mean(np.less(chances, 0.05)) <= 0.25


def test_over_a_jump_ranges_stay_as_they_are():
    """A step of 0.2 m has no slope: by that of the cells around it 652 ranges would disagree, not the 164 beside it."""
    rng = np.random.default_rng(3)

    def step(beams):
        return np.where(beams[:, 1] < 1e-4, 3.0, 3.2) / beams[:, 0]

    found = average_scans([wall_scan(rng, step, 0.003), wall_scan(rng, step, 0.003, off=(0.0009, 0.0))])
    depth = found.scan.cloud.points[:, 0]
    assert np.minimum(np.abs(depth - 3.0), np.abs(depth - 3.2)).max() < 3e-3
    assert found.counts["disagreeing"] < 250


@pytest.mark.parametrize("is_aside", [True, False])
def test_drift_is_told_between_coarse_scans_and_a_fine_one(is_aside):
    """Three coarse scans and one fine one 1 mm off gave a drift of 0, and means 0.9 mm off, 1.7 times their sigma."""
    rng = np.random.default_rng(5)
    asides = rng.uniform(0.0, 0.008, (3, 2)) * is_aside
    coarse = [wall_scan(rng, waves, 0.008, off=off) for off in asides]
    found = average_scans([*coarse, wall_scan(rng, waves, 0.002, bias=1e-3)])
    drift, error = found.drift, errors_of(found, waves)
    assert drift.removes_range
    assert np.all(np.abs(drift.range - np.array([-0.25, -0.25, -0.25, 0.75]) * 1e-3) < 4.0 * drift.sigma_range)
    assert drift.sigma_range.max() < 0.04e-3
    assert abs(error.mean()) < 0.06e-3
    assert np.sqrt(np.mean((error / found.scan.cloud.sigma) ** 2)) == pytest.approx(1.0, abs=0.2)


def test_without_drift_coarse_and_fine_scans_are_told_to_be_alike_as_often_as_chance_has_it():
    drifts = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        coarse = [wall_scan(rng, waves, 0.006, off=rng.uniform(0.0, 0.006, 2)) for _ in range(3)]
        drifts.append(average_scans([*coarse, wall_scan(rng, waves, 0.003)]).drift)
    assert sum(d.p_range < 0.01 for d in drifts) <= 2
    shifts = np.array([d.range / d.sigma_range for d in drifts])
    assert np.sqrt(np.mean(shifts**2)) == pytest.approx(1.0, abs=0.3)  # 96 of them, 72 free: 0.085 one sigma


def test_what_a_scan_that_shares_too_little_is_off_is_said_not_to_be_known():
    rng = np.random.default_rng(1)
    few = wall_scan(rng, waves, 0.02, bias=1e-3)
    found = average_scans([wall_scan(rng, waves, 0.004), wall_scan(rng, waves, 0.004), few])
    assert np.isfinite(found.drift.sigma_range).tolist() == [True, True, False]
    assert found.automatic["drift"]["n_not_told"] == 1
