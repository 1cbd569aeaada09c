"""Files cut off anywhere: the whole cloud where nothing but blanks was lost, an error otherwise; never fewer points.

Files with bytes changed: an error or as many points as before (a changed coordinate cannot be seen without checksums).
Read without the child process, so that thousands of cases stay cheap; what the decoder panics with counts as an error,
as the child reports it as one.
"""

import importlib

import numpy as np
import pytest

from projects.errors import MonitorError
from projects.formats import sniff_format, write_e57, write_glb, write_las, write_ply_mesh, write_ptx, write_stl
from projects.formats.measured import keep_measurements
from projects.model import PointCloud, Scan, Surface

N = 60
N_CASES = 80


def read_here(path):
    """Return the points of every scan, or None for an error."""
    try:
        reader = importlib.import_module(f"projects.formats.{sniff_format(path)}")
        clouds = []
        for header in reader.list_scans(str(path)):
            if header.n_declared and header.n_declared > 64 * path.stat().st_size:
                return None
            blocks = keep_measurements(reader.read_scan(str(path), header), header.is_centred)
            clouds.append(np.concatenate([columns["points"] for columns, _ in blocks]))
    except MonitorError:
        return None
    except BaseException as problem:
        if isinstance(problem, KeyboardInterrupt):
            raise
        return None  # the child turns every other exception into an error, and so does its test
    return clouds


def cloud(rng):
    return PointCloud(rng.normal(size=(N, 3)), intensity=rng.random(N), colors=rng.integers(0, 256, (N, 3)))


def scans(rng):
    rows, columns = np.divmod(np.arange(N), 6)
    return [Scan("S", cloud(rng), np.eye(4), rows=rows, columns=columns)] * 2


def surface(rng):
    return Surface(rng.normal(size=(N, 3)), rng.integers(0, N, (N, 3)))


def write_counted_text(path, rng):
    rows = "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in rng.normal(size=(N, 3)))
    path.write_text(f"X Y Z\n{N}\n{rows}")


WRITERS = {
    "a.e57": lambda path, rng: write_e57(path, scans(rng)),
    "a.ptx": lambda path, rng: write_ptx(path, scans(rng)),
    "a.las": lambda path, rng: write_las(path, cloud(rng)),
    "a.laz": lambda path, rng: write_las(path, cloud(rng)),
    "a.ply": lambda path, rng: write_ply_mesh(path, surface(rng)),
    "a.stl": lambda path, rng: write_stl(path, surface(rng)),
    "a.glb": lambda path, rng: write_glb(path, surface(rng)),
    "a.txt": write_counted_text,
}


def last_number_is_cut(path, n_cut):
    """A last number that lost digits behind its point still is one: text without a checksum cannot tell."""
    return path.suffix in (".ptx", ".txt") and n_cut < 8


@pytest.mark.parametrize("name", WRITERS)
def test_cut_file_never_gives_fewer_points(tmp_path, rng, name):
    path = tmp_path / name
    WRITERS[name](path, rng)
    whole, expected = path.read_bytes(), read_here(path)
    assert expected is not None
    n_end = 0 if name == "a.ply" else len(whole)  # a PLY's points stand before its faces
    lengths = {*rng.integers(1, len(whole), N_CASES).tolist(), *range(len(whole) - 12, len(whole))}
    for n in sorted(lengths):
        path.write_bytes(whole[:n])
        got = read_here(path)
        if got is None:
            continue
        assert n >= n_end or n_end == 0 or last_number_is_cut(path, len(whole) - n), f"{n} of {len(whole)} bytes"
        assert [len(points) for points in got] == [len(points) for points in expected]
        if not last_number_is_cut(path, len(whole) - n):
            np.testing.assert_array_equal(np.concatenate(got), np.concatenate(expected))


@pytest.mark.parametrize("name", ["a.e57", "a.las", "a.laz", "a.ply", "a.ptx", "a.txt", "a.glb"])
def test_changed_bytes_never_lose_points_in_silence(tmp_path, rng, name):
    path = tmp_path / name
    WRITERS[name](path, rng)
    whole, expected = path.read_bytes(), read_here(path)
    n_points = [len(points) for points in expected]
    for _ in range(N_CASES):
        damaged = bytearray(whole)
        for at in rng.integers(0, min(len(whole), int(rng.choice([400, len(whole)]))), 2):
            damaged[at] = rng.integers(0, 256)
        path.write_bytes(damaged)
        got = read_here(path)
        assert got is None or sum(map(len, got)) >= sum(n_points) - 2, f"{[len(points) for points in got]}"
