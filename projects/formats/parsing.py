"""Has a file parsed by a child process (`projects.formats.child`) and gives back what it answers, or one clear error.

The file's bytes are untrusted: a crafted or broken one can exhaust memory, never end, or kill the process that parses
it. Here that process is not ours.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from projects.errors import FormatError, ParameterError
from projects.formats.frames import read_frame
from projects.formats.rawscan import Columns

# the package itself is entered without running projects/__init__.py, which imports more than a child needs
START = """
import sys, types
projects = types.ModuleType("projects")
projects.__path__ = [sys.argv[1]]
sys.modules["projects"] = projects
from projects.formats.child import main
main()
"""
PACKAGE = Path(__file__).resolve().parents[1]
SLOWEST = 20e6  # bytes/s, of a busy network folder
MEMORY_SIGNALS = {"SIGKILL", "SIGABRT", "SIGSEGV", "SIGBUS"}


@dataclass(frozen=True, kw_only=True)
class ReadLimits:
    """What a file may cost to read; generous for honest files, which are read in chunks of a million points.

    Attributes
    ----------
    memory_gib : address space of the process that reads, GiB.
    seconds : without any progress, after which reading is given up, s; one more for every 20 MB of the file, which
        may have to be gone through once before the first points come.
    """

    memory_gib: float = 4.0
    seconds: float = 120.0

    def __post_init__(self) -> None:
        if not (self.memory_gib >= 0.5 and self.seconds > 0):
            raise ParameterError(
                f"ReadLimits(memory_gib={self.memory_gib:g}, seconds={self.seconds:g}): at least 0.5 GiB and "
                "more than 0 s are needed"
            )


def ask_child(path: Path, request: dict[str, Any], limits: ReadLimits) -> Iterator[tuple[dict[str, Any], Columns]]:
    """Yield the messages and arrays with which a child process answers a request about the file.

    Parameters
    ----------
    path : the file.
    request : `format`, `job` ("list", "scan" or "mesh") and for a scan its header.
    limits : what the child may use.

    Raises
    ------
    FormatError
        The file's name and why it could not be read: the reader's own reason, or how the child died.
    """
    seconds = limits.seconds + path.stat().st_size / SLOWEST
    order = {**request, "path": str(path.resolve()), "memory_gib": limits.memory_gib, "seconds": seconds}
    with tempfile.TemporaryFile() as stderr:
        child = _start_child(stderr)
        try:
            assert child.stdin is not None
            _send_order(child.stdin, json.dumps(order).encode() + b"\n")
            yield from _answers(child, path, seconds, stderr)
        finally:
            _end_child(child)


def _start_child(stderr: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start the parsing process: few threads and little reserved memory, and nothing imported from the cwd."""
    few = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "2", "MALLOC_ARENA_MAX": "2"}
    return subprocess.Popen(
        [sys.executable, "-P", "-c", START, str(PACKAGE)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        env={**os.environ, **few},
        bufsize=0,
    )


def _send_order(stdin: IO[bytes], order: bytes) -> None:
    """Hand over the request; a child that died before reading it is reported by its answer."""
    try:
        stdin.write(order)
        stdin.close()
    except BrokenPipeError:
        return


def _answers(
    child: subprocess.Popen[bytes], path: Path, seconds: float, stderr: IO[bytes]
) -> Iterator[tuple[dict[str, Any], Columns]]:
    """Yield frames until the child says that it is done; raise what it reports or how it ended."""
    while True:
        with _Watch(child, seconds) as watch:
            frame = _next_frame(child, path)
        if frame is None:
            why = f"no progress for {seconds:.3g} s" if watch.has_barked else _cause_of_death(child, stderr)
            raise FormatError(f"{path}: cannot be read ({why}); the file is broken or made to exhaust the reader")
        message, columns = frame
        if message.get("kind") == "error":
            raise FormatError(f"{path}: {_one_line(message.get('message', ''))}")
        if message.get("kind") == "end":
            return
        yield message, columns


def _next_frame(child: subprocess.Popen[bytes], path: Path) -> tuple[dict[str, Any], Columns] | None:
    """Return the next frame; an answer that is not one counts as damage to the file's reading."""
    try:
        return read_frame(child.stdout)  # type: ignore[arg-type]
    except (FormatError, ValueError, KeyError, TypeError) as problem:
        raise FormatError(f"{path}: cannot be read (the reader's answer is garbled: {problem})") from problem


class _Watch:
    """Kills the child if the block takes longer than it may."""

    def __init__(self, child: subprocess.Popen[bytes], seconds: float) -> None:
        self.has_barked = False
        self._child = child
        self._timer = threading.Timer(seconds, self._bark)
        self._timer.daemon = True

    def _bark(self) -> None:
        """End the child."""
        self.has_barked = True
        self._child.kill()

    def __enter__(self) -> _Watch:
        self._timer.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._timer.cancel()


def _cause_of_death(child: subprocess.Popen[bytes], stderr: IO[bytes]) -> str:
    """Say how a child ended that did not finish its answer."""
    code = child.wait()
    stderr.seek(0, os.SEEK_END)
    stderr.seek(max(0, stderr.tell() - 4000))
    lines = [line for line in stderr.read().decode(errors="replace").splitlines() if line.strip()]
    last = f": {_one_line(lines[-1])}" if lines else ""
    if code >= 0:
        return f"the reader ended with code {code}{last}"
    name = signal.Signals(-code).name
    if name == "SIGXCPU":
        return "it used too much processor time without progress"
    return f"the reader was killed by {name}{', perhaps for memory' if name in MEMORY_SIGNALS else ''}{last}"


def _end_child(child: subprocess.Popen[bytes]) -> None:
    """Let go of the child, whatever it is doing."""
    if child.poll() is None and child.stdout is not None:
        child.kill()
    for pipe in (child.stdin, child.stdout):
        if pipe is not None:
            pipe.close()
    child.wait()


def _one_line(text: object) -> str:
    """Return text fit for one line of a message."""
    line = " ".join(str(text).split())
    return "".join(c for c in line if c.isprintable())[:600]
