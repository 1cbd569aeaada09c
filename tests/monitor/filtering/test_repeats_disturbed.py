"""Repeated scans that something disturbed: somebody walked by, a tripod was knocked against, cells are missing."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.filtering import average_scans
from monitor.filtering.averaging import average_ranges
from monitor.filtering.medians import median_known
from projects.errors import ParameterError
from projects.model import PointCloud, Scan

NOISE = 0.5e-3
SIDE = 80  # cells of the grid
ROW, COLUMN = (a.ravel() for a in np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij"))


def wall(step=0.002, ripple=0.0):
    """Return directions (n, 3) of a grid and the ranges (n,) [m] of a wavy wall 3 m off, rippled like an ornament."""
    azimuth, elevation = (COLUMN - SIDE / 2) * step, (ROW - SIDE / 2) * step
    beams = np.c_[np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    waves = 0.02 * np.sin(20.0 * beams[:, 1]) * np.cos(17.0 * beams[:, 2])
    return beams, 3.0 / beams[:, 0] + waves + ripple * np.sin(270.0 * beams[:, 1]) * np.cos(240.0 * beams[:, 2])


def scan(beams, ranges, keep=None):
    """Return a scan of the grid's cells `keep` (all where not given)."""
    made = Scan("s", PointCloud(beams * ranges[:, None]), np.eye(4), rows=ROW, columns=COLUMN)
    return made if keep is None else made.take(keep)


def repeat(rng, n_scans, drift=0.0, missing=0.0, **shape):
    """Return the true ranges of a wall and scans of it that drift by so many m each and lack a share of the cells."""
    beams, true = wall(**shape)
    off = drift * (np.arange(n_scans) - 0.5 * (n_scans - 1))
    ranges = true + off[:, None] + rng.normal(0.0, NOISE, (n_scans, len(true)))
    return true, [scan(beams, r, rng.random(len(r)) >= missing) for r in ranges]


def errors(found, true):
    """Return how far [m] the averaged ranges are off, and their cells."""
    cell = found.scan.rows * SIDE + found.scan.columns
    return np.linalg.norm(found.scan.cloud.points, axis=1) - true[cell], cell


@pytest.mark.parametrize("n_scans", [2, 3, 5, 8])
@pytest.mark.parametrize("away", [0.03, 1.0])
def test_who_walks_before_the_wall_in_one_scan_moves_nothing(rng, n_scans, away):
    """Over a third of the field; it once drew the whole wall, where nobody stood too, by up to half of the way."""
    true, scans = repeat(rng, n_scans - 1)
    beams, _ = wall()
    behind = np.abs(COLUMN - SIDE / 2) < SIDE / 6
    before = true - np.where(behind, away * (1.0 + 0.1 * np.cos(0.05 * COLUMN)), 0.0)
    found = average_scans([*scans, scan(beams, before + rng.normal(0.0, NOISE, len(true)))])
    off, cell = errors(found, true)
    assert np.abs(off).max() < 6.0 * NOISE
    assert np.sqrt(np.mean((off / found.scan.cloud.sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert np.isin(np.flatnonzero(~behind), cell).mean() > 0.99
    assert np.isin(np.flatnonzero(behind), cell).mean() == pytest.approx(0.0 if n_scans == 2 else 1.0, abs=0.06)
    assert not found.drift.removes_range


@pytest.mark.parametrize(("n_scans", "stays"), [(4, True), (10, False)])
def test_who_walks_before_the_sky_in_one_of_many_scans_is_no_surface(rng, n_scans, stays):
    """Where the others measured nothing; the mean of ten held the whole of who was there in one of them."""
    beams, true = wall()
    sky, body = COLUMN > 0.6 * SIDE, (COLUMN > 0.7 * SIDE) & (COLUMN < 0.8 * SIDE) & (ROW > 20)
    rest = ~sky | (COLUMN == SIDE - 1)  # a mast beyond: the others looked there too
    with_body = np.where(body, 2.0, true) + rng.normal(0.0, NOISE, len(true))
    scans = [scan(beams, true + rng.normal(0.0, NOISE, len(true)), rest) for _ in range(n_scans - 1)]
    found = average_scans([*scans, scan(beams, with_body, rest | body)])
    cell = found.scan.rows * SIDE + found.scan.columns
    assert np.isin(np.flatnonzero(body), cell).mean() == stays
    assert np.isin(np.flatnonzero(rest), cell).mean() > 0.99
    assert found.counts["in"] == sum(n for reason, n in found.counts.items() if reason != "in")


def test_what_only_an_overview_holds_stays(rng):
    """Nine windows within one overview: beyond them nobody else looked."""
    true, scans = repeat(rng, 10)
    windows = [s.take((s.rows < 30) & (s.columns < 30)) for s in scans[1:]]
    assert average_scans([scans[0], *windows]).counts["out"] > 0.99 * len(true)


def test_three_ranges_of_which_no_two_agree_are_not_averaged(rng):
    ranges = 3.0 + rng.normal(0.0, NOISE, (3, 640))
    ranges[1, ::8] -= 0.5
    ranges[2, ::8] -= 0.9
    kept = average_ranges(ranges).n_kept > 0
    assert not kept[::8].any()
    assert kept.sum() == 560


def test_a_tripod_knocked_against_leaves_the_others_where_they_are(rng):
    """5 mm nearer in the last of five: the mean of all lay 1 mm off, at a stated 0.2 mm."""
    true, scans = repeat(rng, 4)
    beams, _ = wall()
    found = average_scans([*scans, scan(beams, true - 5e-3 + rng.normal(0.0, NOISE, len(true)))])
    off, _ = errors(found, true)
    assert np.sqrt(np.mean((off / found.scan.cloud.sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(found.drift.range, [1e-3, 1e-3, 1e-3, 1e-3, -4e-3], atol=1e-4)
    assert found.drift.removes_range


@pytest.mark.parametrize(
    ("n_scans", "missing", "ripple"), [(20, 0.02, 0.0), (2, 0.3, 0.0), (5, 0.2, 0.0), (10, 0.0, 0.03)]
)
def test_drift_is_noticed_where_cells_are_missing_and_on_an_ornament(rng, n_scans, missing, ripple):
    """Runs of cells that all twenty scans have all of, or that are smooth, there are hardly any."""
    true, scans = repeat(rng, n_scans, drift=1e-3, missing=missing, ripple=ripple, step=0.004 if ripple else 0.002)
    found = average_scans(scans)
    assert found.drift.removes_range
    assert abs(found.drift.rate - 1e-3) < 4.0 * found.drift.sigma_rate < 1e-4
    assert found.automatic["noise_of_one_scan"] == pytest.approx(NOISE, rel=0.05)
    if missing < 0.3:  # of two, one alone is a drift off where the other has nothing
        off, _ = errors(found, true)
        assert np.sqrt(np.mean((off / found.scan.cloud.sigma) ** 2)) == pytest.approx(1.0, abs=0.1)


def test_a_scan_that_was_broken_off_tells_nothing_and_hides_no_drift(rng):
    true, scans = repeat(rng, 5, drift=1e-3)
    scans[3] = scans[3].take(np.arange(len(true)) < 12)
    found = average_scans(scans).drift
    assert found.removes_range
    assert np.isnan(found.sigma_range).tolist() == [False, False, False, True, False]
    np.testing.assert_allclose(found.range[[0, 1, 2, 4]], np.array([-1.75, -0.75, 0.25, 2.25]) * 1e-3, atol=5e-5)
    assert abs(found.rate - 1e-3) < 4.0 * found.sigma_rate


def test_where_too_little_was_scanned_to_tell_offsets_nothing_is_lost(rng):
    """20 x 20 cells, 2 mm from scan to scan: the spread holds what nobody can tell from noise."""
    true, scans = repeat(rng, 10, drift=2e-3)
    scans = [s.take((s.rows < 20) & (s.columns < 20)) for s in scans]
    found = average_scans(scans)
    assert len(found.scan.cloud) == 400
    assert np.abs(errors(found, true)[0]).max() < 1e-3


def test_a_copy_is_refused_in_whatever_order_and_format(rng):
    """A copy of the first in another order was averaged: noise of 0.1 um was stated."""
    _, scans = repeat(rng, 2)
    copy = scans[0].take(rng.permutation(SIDE**2)[:3000])
    copy = replace(copy, cloud=PointCloud(copy.cloud.points.astype(np.float32)))
    for given in ([*scans, copy], [replace(s, rows=None, columns=None) for s in (copy, *scans)]):
        with pytest.raises(ParameterError, match="is a copy of"):
            average_scans(given)


@pytest.mark.parametrize("noise", [0.05e-3, 0.2e-3, 0.5e-3])
@pytest.mark.parametrize("n_scans", [2, 10])
def test_coordinates_rounded_to_a_millimetre_have_their_true_sigma_and_lose_nothing(rng, n_scans, noise):
    """A quarter of the cells went, and a nanometre was stated of those that stayed."""
    beams, true = wall()
    noisy = [scan(beams, true + rng.normal(0.0, noise, len(true))) for _ in range(n_scans)]
    found = average_scans([replace(s, cloud=PointCloud(np.round(s.cloud.points, 3))) for s in noisy])
    off, _ = errors(found, true)
    assert len(off) > 0.99 * len(true)
    assert 0.7 < np.sqrt(np.mean((off / found.scan.cloud.sigma) ** 2)) < 1.1
    assert found.automatic["coordinate_step"] == pytest.approx(1e-3)
    assert found.automatic["noise_of_one_scan"] == pytest.approx(np.hypot(noise, 1e-3 / np.sqrt(6.0)), rel=0.3)


def test_the_median_of_what_is_known_is_that_of_numpy(rng):
    values = np.where(rng.random((7, 50)) < 0.3, np.nan, rng.normal(size=(7, 50)))
    values[:, 0] = np.nan
    for axis in (0, 1):
        expected = [np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan
                    for row in np.moveaxis(values, axis, -1)]  # fmt: skip
        np.testing.assert_array_equal(median_known(values, axis), expected)
