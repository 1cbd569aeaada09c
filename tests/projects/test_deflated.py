"""Chunks deflated outside of HDF5 are what HDF5's own filters read, checksum included."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest

from projects import hdf5
from projects.deflated import ColumnWriter, fletcher32


def slow_fletcher32(octets: bytes) -> int:
    """Return the checksum word by word, as H5_checksum_fletcher32 does."""
    octets = octets + b"\0" * (len(octets) % 2)
    first = second = 0
    for k in range(0, len(octets), 2):
        first += octets[k] << 8 | octets[k + 1]
        first = (first & 0xFFFF) + (first >> 16)
        second += first
        second = (second & 0xFFFF) + (second >> 16)
    return second << 16 | first


@pytest.mark.parametrize("n", [0, 1, 2, 3, 511, 512, 513, 1024, 9999])
def test_checksum_is_that_of_its_slow_twin(rng, n):
    for octets in (rng.bytes(n), b"\0" * n, b"\xff" * n, b"\xff\xfe\0\1" * (n // 4)):
        assert fletcher32(octets) == slow_fletcher32(octets)


@pytest.mark.parametrize("n", [1, hdf5.CHUNK_ROWS - 1, hdf5.CHUNK_ROWS, hdf5.CHUNK_ROWS + 1, 3 * hdf5.CHUNK_ROWS + 17])
@pytest.mark.parametrize("step", [40_000, 1_000_000])
def test_columns_come_back_whatever_their_length_and_type(tmp_path, rng, n, step):
    columns = {
        "points": rng.normal(size=(n, 3)),
        "intensity": rng.random(n).astype(np.float32),
        "colors": rng.integers(0, 256, (n, 3), dtype=np.uint8),
        "rows": np.arange(n, dtype=np.int32),
        "zero": np.zeros(n),
    }
    with hdf5.create_file(tmp_path / "a.h5") as file, ThreadPoolExecutor(2) as pool:
        writer = ColumnWriter(file.create_group("g"), pool)
        for start in range(0, n, step):
            for name, values in columns.items():
                writer.append(name, values[start : start + step])
        writer.finish()
    with h5py.File(tmp_path / "a.h5") as file:
        for name, values in columns.items():
            assert file["g"][name].fletcher32
            np.testing.assert_array_equal(file["g"][name][:], values)


def test_caller_may_reuse_its_array_after_appending(tmp_path, rng):
    values = np.arange(10.0)
    with hdf5.create_file(tmp_path / "a.h5") as file, ThreadPoolExecutor(2) as pool:
        writer = ColumnWriter(file.create_group("g"), pool)
        writer.append("x", values)
        values[:] = -1
        writer.append("x", values)
        writer.finish()
        assert file["g/x"][:].tolist() == [*range(10), *[-1] * 10]
