"""Raw points to HDF5 and back: ours (gzip on two threads) beside h5py's own gzip and lzf, in one run.

python tests/benchmarks/bench_store.py
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np

from projects import hdf5
from projects.deflated import N_THREADS, ColumnWriter

N_POINTS = (500_000, 2_000_000, 8_000_000)
PEERS: dict[str, dict] = {
    "h5py gzip 1": {"compression": "gzip", "compression_opts": 1},
    "h5py lzf": {"compression": "lzf"},
}


def chunks(n: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield a panoramic scan with 1 mm of noise, half a million points at a time."""
    rng = np.random.default_rng(1)
    m = 500_000
    for k in range(n // m):
        azimuth, height = (
            np.repeat(np.linspace(k, k + 1, 1000), m // 1000),
            np.tile(np.linspace(-1, 1, m // 1000), 1000),
        )
        distance = 5.0 + np.sin(3 * azimuth) + rng.normal(0, 1e-3, m)
        beam = np.column_stack([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)])
        yield {
            "points": distance[:, None] * beam,
            "intensity": (rng.integers(0, 4096, m) / 4095).astype(np.float32),
            "colors": rng.integers(100, 140, (m, 3), dtype=np.uint8),
            "rows": np.tile(np.arange(m // 1000, dtype=np.int32), 1000),
            "columns": np.repeat(np.arange(1000, dtype=np.int32), m // 1000),
        }


def write_ours(path: Path, pieces: list[dict[str, np.ndarray]]) -> None:
    with hdf5.create_file(path) as file, ThreadPoolExecutor(N_THREADS) as pool:
        writer = ColumnWriter(file.create_group("scan"), pool)
        for piece in pieces:
            for name, values in piece.items():
                writer.append(name, values)
        writer.finish()


def write_peer(path: Path, pieces: list[dict[str, np.ndarray]], filters: dict) -> None:
    with hdf5.create_file(path) as file:
        for name, first in pieces[0].items():
            shape, n = first.shape[1:], sum(len(p[name]) for p in pieces)
            layout = {"chunks": (hdf5.CHUNK_ROWS, *shape), "shuffle": True, "fletcher32": True, **filters}
            dataset = file.create_dataset(f"scan/{name}", (n, *shape), first.dtype, **layout)
            start = 0
            for piece in pieces:
                dataset[start : start + len(piece[name])] = piece[name]
                start += len(piece[name])


def timed(function: Callable[[], None]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for n in N_POINTS:
            pieces, path = list(chunks(n)), Path(folder) / "scan.h5"
            ours = timed(lambda pieces=pieces, path=path: write_ours(path, pieces))
            with h5py.File(path) as file:
                assert (file["scan/points"][-1000:] == pieces[-1]["points"][-1000:]).all()
            size = path.stat().st_size
            line = f"{n:>9} points: ours {n / ours / 1e6:.1f} M/s, {size / n:.1f} octets a point"
            for name, filters in PEERS.items():
                peer = timed(lambda p=pieces, path=path, f=filters: write_peer(path, p, f))
                line += (
                    f"; {name} {n / peer / 1e6:.1f} M/s ({peer / ours:.2f} of our time), {path.stat().st_size / n:.1f}"
                )
            print(line)


if __name__ == "__main__":
    main()
