"""Long columns written to HDF5 on two threads: shuffled, deflated and summed here, then handed over as finished chunks.

What lies in the file is what HDF5's own filters shuffle, gzip and fletcher32 would have written, so every HDF5
program reads it; HDF5 itself deflates on one thread only, and also what cannot become smaller.
"""

from __future__ import annotations

import zlib
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

import h5py
import numpy as np

from projects import hdf5

N_THREADS = 2
BLOCK = 256  # words that are summed at a time
NOISE_BITS = 7.8  # of 8: deflating would gain at most 1 part in 40
MAX_WAITING = 2 * N_THREADS  # finished chunks that may wait to be written: bounds the memory


class ColumnWriter:
    """Appends rows to one-chunk-after-the-other datasets of a group; `finish` writes the last, partly filled chunks."""

    def __init__(self, group: h5py.Group, pool: ThreadPoolExecutor) -> None:
        self._group = group
        self._pool = pool
        self._rest: dict[str, list[np.ndarray]] = {}
        self._n_written: dict[str, int] = {}
        self._waiting: deque[tuple[h5py.Dataset, int, Future[bytes]]] = deque()

    @property
    def names(self) -> set[str]:
        """The columns that exist."""
        return set(self._rest)

    def append(self, name: str, values: np.ndarray) -> None:
        """Append rows to a column, which comes into being with its first ones."""
        if name not in self._rest:
            shape = values.shape[1:]
            self._group.create_dataset(
                name,
                (0, *shape),
                values.dtype,
                maxshape=(None, *shape),
                chunks=(hdf5.CHUNK_ROWS, *shape),
                **hdf5.FILTERS,
            )
            self._rest[name], self._n_written[name] = [], 0
        self._rest[name].append(np.array(values))
        if sum(map(len, self._rest[name])) < hdf5.CHUNK_ROWS:
            return
        rows = np.concatenate(self._rest[name])
        whole = len(rows) - len(rows) % hdf5.CHUNK_ROWS
        for start in range(0, whole, hdf5.CHUNK_ROWS):
            self._submit(name, rows[start : start + hdf5.CHUNK_ROWS])
        self._rest[name] = [rows[whole:]]

    def finish(self) -> None:
        """Write what is left of every column."""
        for name, rest in self._rest.items():
            rows = np.concatenate(rest)
            if len(rows):
                self._submit(name, rows)
        while self._waiting:
            self._write_oldest()

    def _submit(self, name: str, rows: np.ndarray) -> None:
        """Have a pool compress the rows of one chunk; wait for older ones where too many are under way."""
        while len(self._waiting) >= MAX_WAITING:
            self._write_oldest()
        dataset, start = self._group[name], self._n_written[name]
        self._waiting.append((dataset, start, self._pool.submit(filtered_chunk, rows, hdf5.CHUNK_ROWS)))
        self._n_written[name] = start + len(rows)

    def _write_oldest(self) -> None:
        """Write the chunk that waits longest, its dataset made longer where needed."""
        dataset, start, chunk = self._waiting.popleft()
        n = max(len(dataset), min(start + hdf5.CHUNK_ROWS, self._n_written[dataset.name.rpartition("/")[2]]))
        dataset.resize(n, axis=0)
        dataset.id.write_direct_chunk((start,) + (0,) * (dataset.ndim - 1), chunk.result())


def filtered_chunk(rows: np.ndarray, n_rows: int) -> bytes:
    """Return rows as one stored chunk of `n_rows` (the missing ones zero): shuffle, deflate, Fletcher-32."""
    chunk = np.zeros((n_rows, *rows.shape[1:]), rows.dtype)
    chunk[: len(rows)] = rows
    planes = np.ascontiguousarray(chunk.reshape(-1).view(np.uint8).reshape(-1, chunk.itemsize).T)
    deflated = deflate_planes(planes)
    return deflated + fletcher32(deflated).to_bytes(4, "little")


def deflate_planes(planes: np.ndarray) -> bytes:
    """Return the octets of `planes` (k, n) uint8 as one zlib stream (RFC 1950), each plane deflated as it is worth.

    The lower octets of measured coordinates are noise: they are stored as they are. In the others there are runs;
    searching longer repetitions does not pay. A flush ends each plane on a whole octet, so that they can be joined.
    """
    joined = [b"\x78\x01"]
    for k, plane in enumerate(planes):
        level = 0 if _bits_per_octet(plane) > NOISE_BITS else 1
        stream = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
        joined += [
            stream.compress(plane.data),
            stream.flush(zlib.Z_FINISH if k == len(planes) - 1 else zlib.Z_FULL_FLUSH),
        ]
    return b"".join(joined) + zlib.adler32(planes.data).to_bytes(4, "big")


def _bits_per_octet(plane: np.ndarray) -> float:
    """Return the entropy of a plane's octets, 0 to 8, from every 16th of them."""
    counts = np.bincount(plane[::16], minlength=256)
    shares = counts[counts > 0] / counts.sum()
    return float(-(shares * np.log2(shares)).sum())


def fletcher32(octets: bytes) -> int:
    """Return HDF5's Fletcher-32 checksum: two sums modulo 65535 over big-endian 16-bit words, an odd octet padded."""
    n_words = (len(octets) + 1) // 2
    padded = octets + b"\0" * (-len(octets) % (2 * BLOCK))
    words = np.frombuffer(padded, dtype=">u2").reshape(-1, BLOCK).astype(np.float64)  # exact, and added by BLAS
    sums = words.sum(axis=1).astype(np.int64)
    # the second sum counts every word as often as words follow it, itself included
    followed = n_words - BLOCK * np.arange(len(sums), dtype=np.int64)
    second = int((followed * sums).sum()) - int((words @ np.arange(BLOCK, dtype=np.float64)).sum())
    return _folded(second) << 16 | _folded(int(sums.sum()))


def _folded(total: int) -> int:
    """Return total modulo 65535 as end-around carries leave it: a multiple of 65535 other than 0 stays 65535."""
    return (total - 1) % 65535 + 1 if total else 0
