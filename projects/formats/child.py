"""The process in which an untrusted file is parsed, with limits on memory, time and writing.

Started by `projects.formats.parsing`. Reads one request (a line of JSON) from
standard input, answers in frames (`projects.formats.frames`) on standard output, and imports no more than the reader
of the one format needs.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from collections.abc import Callable
from typing import Any, BinaryIO

from projects.errors import MonitorError
from projects.formats.frames import write_frame
from projects.formats.rawscan import CHUNK, Columns, ScanHeader

READERS = ("e57", "ptx", "pts", "las", "ply", "pcd", "obj", "stl", "glb", "xyz")
LONGEST_STDERR = 2**20


def main() -> None:
    """Answer the request on standard input."""
    out = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # what a library prints must not mix with the answer
    request = json.loads(sys.stdin.buffer.readline())
    renew_time = limit_this_process(float(request["memory_gib"]), float(request["seconds"]))
    try:
        _answer(request, out, renew_time)
        write_frame(out, {"kind": "end"})
    except MonitorError as problem:
        write_frame(out, {"kind": "error", "message": str(problem)})
    except MemoryError:
        needed = f"reading it needs more than {request['memory_gib']:g} GiB of memory (ReadLimits.memory_gib)"
        write_frame(out, {"kind": "error", "message": f"{needed}; the file is broken or made to exhaust the reader"})
    except BaseException as problem:  # noqa: BLE001  (lazrs panics are no Exception; nothing may end in silence)
        text = next(iter(str(problem).strip().splitlines()), "") or "no reason given"
        write_frame(out, {"kind": "error", "message": f"cannot be decoded ({type(problem).__name__}: {text[:300]})"})


def limit_this_process(memory_gib: float, seconds: float) -> Callable[[], None]:
    """Limit memory, processor time and what may be written; return what grants the time anew.

    Where the platform has no such limits (Windows) the parent's watch on progress is what remains.
    """
    try:
        import resource
    except ImportError:
        return lambda: None
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = int(memory_gib * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (most if hard < 0 else min(most, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LONGEST_STDERR, LONGEST_STDERR))
    threads = os.cpu_count() or 1

    def renew_time() -> None:
        """Allow as many seconds of processor time again, from now on."""
        used = resource.getrusage(resource.RUSAGE_SELF)
        most_cpu = int(used.ru_utime + used.ru_stime + seconds * threads) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (most_cpu, resource.getrlimit(resource.RLIMIT_CPU)[1]))

    renew_time()
    return renew_time


def _answer(request: dict[str, Any], out: BinaryIO, renew_time: Callable[[], None]) -> None:
    """Do the one job that was asked for."""
    if request["format"] not in READERS:
        raise ValueError(f"no reader for {request['format']}")
    reader = importlib.import_module(f"projects.formats.{request['format']}")
    path = request["path"]
    if request["job"] == "list":
        headers = reader.list_scans(path)
        write_frame(out, {"kind": "scans", "scans": [header.to_json() for header in headers]})
    elif request["job"] == "scan":
        _send_scan(reader, path, ScanHeader(**request["scan"]), out, renew_time)
    elif request["job"] == "mesh":
        _send_mesh(reader.read_mesh(path), out, renew_time)


def _send_scan(reader: Any, path: str, header: ScanHeader, out: BinaryIO, renew_time: Callable[[], None]) -> None:
    """Send the measured points of one scan, chunk by chunk."""
    from projects.formats.measured import keep_measurements

    for columns, dropped in keep_measurements(reader.read_scan(path, header), header.is_centred):
        write_frame(out, {"kind": "chunk", "dropped": dropped}, columns)
        renew_time()


def _send_mesh(mesh: Columns, out: BinaryIO, renew_time: Callable[[], None]) -> None:
    """Send a whole mesh in pieces: vertices with what is known of each, then faces, and which of them are invented."""
    faces = {name: mesh.pop(name) for name in ("faces", "invented") if name in mesh}
    for start in range(0, len(mesh["points"]), CHUNK):
        write_frame(out, {"kind": "vertices"}, {name: v[start : start + CHUNK] for name, v in mesh.items()})
        renew_time()
    for start in range(0, len(faces["faces"]), CHUNK):
        write_frame(out, {"kind": "faces"}, {name: v[start : start + CHUNK] for name, v in faces.items()})
        renew_time()
