"""Intensities and colours of formats that do not state their range get that of the whole scan."""

from pathlib import Path

import numpy as np
import pytest

from projects.formats import read_scans
from projects.formats.rawscan import guess_intensity_range, scaled, within_unit_range


def told(blocks, name):
    """Return what blocks of one column become."""
    return np.concatenate([columns[name] for columns in scaled(lambda: iter([{name: np.array(b)} for b in blocks]))])


@pytest.mark.parametrize(
    ("values", "expected"),
    [((0, 1), (0, 1)), ((0, 200), (0, 255)), ((0, 4000), (0, 4095)), ((-1600, 200), (-2048, 2047)),
     ((0, 60000), (0, 65535)), ((-5e5, 5e5), (-5e5, 5e5)), ((np.inf, -np.inf), (0, 1))],
)  # fmt: skip
def test_range_of_intensity_is_one_that_instruments_use(values, expected):
    assert guess_intensity_range(*values) == expected


def test_decibels_reach_from_black_to_white_and_whole_negative_intensities_keep_the_range_of_their_instrument():
    """Reflectances of -25.5 to 4.5 dB became 0.494 to 0.501, one grey: taken for -2048 to 2047."""
    np.testing.assert_allclose(told([[-25.5, -10.5], [4.5]], "intensity"), [0.0, 0.5, 1.0], atol=1e-6)
    np.testing.assert_allclose(
        told([[-25.0, -10.0], [4.0]], "intensity"), np.array([2023, 2038, 2052]) / 4095, atol=1e-6
    )


def test_intensity_beyond_a_range_is_unknown():
    np.testing.assert_array_equal(
        within_unit_range(np.array([-1.0, 5.0, 11.0]), 0.0, 10.0), np.float32([np.nan, 0.5, np.nan])
    )


@pytest.mark.parametrize(
    ("values", "expected"),
    [([[0.5, 0.0, 1.0]], [[128, 0, 255]]), ([[65535, 257 * 200, 256 * 200]], [[255, 200, 200]]),
     ([[255, 1, 0]], [[255, 1, 0]]), ([[1, 0, 0]], [[1, 0, 0]])],
)  # fmt: skip
def test_colours_become_bytes_by_what_they_hold(values, expected):
    assert told([values], "colors").tolist() == expected


def test_the_last_block_tells_the_range_as_the_first_does():
    np.testing.assert_allclose(told([[0.0, 200.0], [np.nan, 51.0], [3000.0]], "intensity"),
                               np.array([0.0, 200.0, np.nan, 51.0, 3000.0]) / 4095.0, atol=1e-7)  # fmt: skip
    assert told([[[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]], [[0.5, 1.0, 0.0]]], "colors")[-1].tolist() == [128, 255, 0]
    assert told([[[200.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], [[51200.0, 0.0, 0.0]]], "colors")[:, 0].tolist() == [0, 0, 200]


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint16, np.float32])
def test_ranges_are_those_of_whole_numbers_too(kind):
    blocks = [np.array([1, 100], kind), np.array([0, 51], kind)]
    np.testing.assert_allclose(told(blocks, "intensity"), np.array([1, 100, 0, 51]) / 255.0, atol=1e-7)
    if kind is not np.uint8:
        assert told([np.array([[1, 100, 0]], kind), np.array([[2, 51, 3]], kind)], "colors").tolist() == [
            [1, 100, 0], [2, 51, 3]]  # fmt: skip


def test_bytes_stay_bytes_and_what_needs_no_range_is_read_once():
    n_read = []

    def read():
        n_read.append(1)
        yield from ({"colors": np.full((2, 3), k, np.uint8), "points": np.zeros((2, 3))} for k in (1, 1, 200))

    assert np.concatenate([c["colors"] for c in scaled(read)])[:, 0].tolist() == [1, 1, 1, 1, 200, 200]
    assert len(n_read) == 1


def test_intensities_that_rise_after_the_first_eight_megabytes_are_all_there(tmp_path: Path):
    n = 420_000
    points = np.random.default_rng(1).uniform(1.0, 9.0, (n, 3))
    value = np.where(np.arange(n) < n - 9_000, 51, 3000)
    path = tmp_path / "scan.xyz"
    path.write_bytes(b"".join(b"%.6f %.6f %.6f %d\n" % (*p, v) for p, v in zip(points.tolist(), value, strict=True)))
    assert path.stat().st_size > 1.3 * 2**23
    (scan,) = read_scans(path)
    found = np.concatenate([chunk.cloud.intensity for chunk in scan.chunks()])
    np.testing.assert_allclose(found, value / 4095.0, atol=1e-7)


@pytest.mark.parametrize("colour", [np.nan, 0.0])
def test_colours_that_nobody_knows_are_none_and_no_black(colour):
    blocks = [{"points": np.ones((2, 3)), "colors": np.full((2, 3), colour)} for _ in range(3)]
    assert all("colors" not in columns for columns in scaled(lambda: iter(blocks)))
    blocks[2]["colors"] = np.array([[1.0, 2.0, 200.0], [0.0, 0.0, 0.0]])
    assert [columns["colors"].tolist() for columns in scaled(lambda: iter(blocks))][2] == [[1, 2, 200], [0, 0, 0]]
