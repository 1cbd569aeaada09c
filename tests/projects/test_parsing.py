"""The parsing process: whatever it does, the parent gets points or one clear error, and soon."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from projects.errors import FormatError, ParameterError
from projects.formats import ReadLimits, parsing, read_scans
from projects.formats.frames import HEAD, MARK

ENTER = "import sys, os\nsys.stdin.readline()\n"


@pytest.fixture
def points_file(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text("1 2 3\n4 5 6\n")
    return path


def read(path, **limits):
    return [list(stream.chunks()) for stream in read_scans(path, limits=ReadLimits(**limits))]


@pytest.mark.parametrize(
    ("deed", "message"),
    [
        ("os.kill(os.getpid(), 11)", "killed by SIGSEGV, perhaps for memory"),
        ("os.kill(os.getpid(), 9)", "killed by SIGKILL, perhaps for memory"),
        ("os.abort()", "killed by SIGABRT"),
        ("print('it hurts', file=sys.stderr); sys.exit(3)", "ended with code 3: it hurts"),
        ("sys.exit(0)", "ended with code 0"),
        ("os.write(1, b'no frame at all')", "garbled"),
        (f"os.write(1, {HEAD.pack(MARK, 5, 0)!r} + b'[1,2]')", "garbled"),
        (f"os.write(1, {HEAD.pack(MARK, 2**31, 0)!r})", "garbled"),
        ("while True: pass", "no progress for 1 s"),
        ("import time; time.sleep(60)", "no progress for 1 s"),
    ],
)
def test_child_that_dies_or_lies_gives_one_clear_error(monkeypatch, points_file, deed, message):
    monkeypatch.setattr(parsing, "START", ENTER + deed)
    limits = {"seconds": 1.0} if message.startswith("no progress") else {}  # a busy machine starts no child in 1 s
    begin = time.monotonic()
    with pytest.raises(FormatError, match=rf"a\.xyz: cannot be read.*{message}") as caught:
        read(points_file, **limits)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - begin < 20


@pytest.mark.parametrize(
    "name_and_count", [("points", 10**7), ("points", -1), ("points", True), ("secrets", 1), ("points", "3")]
)
def test_array_that_was_not_expected_is_not_believed(monkeypatch, points_file, name_and_count):
    frame = f'{{"kind":"chunk","dropped":{{}},"arrays":[{list(name_and_count)!r}]}}'.replace("'", '"').lower().encode()
    deed = f"os.write(1, {HEAD.pack(MARK, len(frame), 1) + frame!r})"
    monkeypatch.setattr(parsing, "START", ENTER + deed)
    with pytest.raises(FormatError, match="cannot be read"):
        read(points_file)


def test_reader_that_needs_too_much_memory_is_stopped(tmp_path):
    path = tmp_path / "greedy.pcd"
    n = 150_000_000
    head = (
        f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA binary_compressed\n"
    )
    packed = b"\x00a" + b"\xe0\xff\x00" * (12 * n // 264) + b"\0" * 9
    path.write_bytes(head.encode() + np.array([len(packed), 12 * n], "<u4").tobytes() + packed)
    with pytest.raises(FormatError, match=r"greedy\.pcd: .*more than 0\.5 GiB of memory"):
        read(path, memory_gib=0.5, seconds=100.0)


def test_limits_that_make_no_sense_are_refused():
    with pytest.raises(ParameterError, match=r"at least 0\.5 GiB"):
        ReadLimits(memory_gib=0.0)
    with pytest.raises(ParameterError, match="more than 0 s"):
        ReadLimits(seconds=0.0)


def test_child_is_gone_when_the_reading_is_left_early(points_file):
    points_file.write_text("1 2 3\n" + "4.25 5.5 6.5\n" * 1_200_000)
    (stream,) = read_scans(points_file)
    chunks = stream.chunks()
    next(chunks)
    chunks.close()
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    if not children.exists():
        pytest.skip("this platform does not list a process's children")
    assert "projects.formats.child" not in "".join(
        Path(f"/proc/{child}/cmdline").read_text()
        for child in children.read_text().split()
        if Path(f"/proc/{child}").exists()
    )


def test_reading_works_from_a_script_without_a_main_guard_and_a_hostile_folder(tmp_path, points_file):
    (tmp_path / "numpy.py").write_text("raise SystemExit('imported from the working folder')")
    script = tmp_path / "notebook.py"
    script.write_text(
        "import sys; sys.path.pop(0)\n"
        "from pathlib import Path\n"
        "from projects.formats import read_scans\n"
        "print([len(c.cloud) for s in read_scans(Path('a.xyz')) for c in s.chunks()])\n"
    )
    ran = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ran.stdout.strip(), ran.stderr) == ("[2]", "")


def test_scan_can_be_read_twice_and_out_of_turn(points_file):
    (first,) = read_scans(points_file)
    (second,) = read_scans(points_file)
    for stream in (second, first, second):
        (chunk,) = stream.chunks()
        np.testing.assert_array_equal(chunk.cloud.points, [[1, 2, 3], [4, 5, 6]])


def test_points_come_in_chunks_of_at_most_a_million_in_their_order(tmp_path):
    n = 2_300_000
    points = np.arange(3 * n, dtype="<f8").reshape(n, 3)
    points[1_100_000:1_100_050] = np.nan
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {n}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + points.tobytes())
    (stream,) = read_scans(tmp_path / "a.ply")
    chunks = list(stream.chunks())
    assert [len(chunk.cloud) for chunk in chunks] == [1_000_000, 1_000_000, 299_950]
    got = np.concatenate([chunk.cloud.points for chunk in chunks])
    np.testing.assert_array_equal(got, points[np.isfinite(points[:, 0])])
    assert sum(chunk.dropped.get("not finite", 0) for chunk in chunks) == 50
    assert stream.n_declared == n
