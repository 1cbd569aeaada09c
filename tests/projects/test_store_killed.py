"""A process that dies at any step of a change leaves the state before or the state after it, never a third."""

from __future__ import annotations

import datetime
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from store_examples import example_project, example_step, example_stream, example_surface

from projects import atomic
from projects.errors import StoreError
from projects.model import EpochRecord, ObjectRecord
from projects.store import Project

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

KILLED, DONE = 9, 0


def put(project: Project, k: int) -> None:
    project.put("stove", "E1", example_step(k=k), example_surface(np.random.default_rng(k)))


def add_epoch(project: Project) -> None:
    rng = np.random.default_rng(5)
    stream = example_stream(project.path.parent, rng, name="s2.ptx")
    project.add_epoch(EpochRecord("stove", "E2", datetime.date(2025, 1, 1)), [stream])


CHANGES: dict[str, Callable[[Project], object]] = {
    "add_object": lambda project: project.add_object(ObjectRecord("statue")),
    "add_epoch": add_epoch,
    "put": lambda project: put(project, 1),
    "put over a damaged file": lambda project: put(project, 0),
    "remove_epoch": lambda project: project.remove_epoch("stove", "E1", purge=True),
}


def run_killed(work: Callable[[], object], kill_at: float) -> int:
    """Run `work` in a child that dies just before its k-th call to the disk, or just after it (k + 0.5)."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        kill_on_call(kill_at)
        work()
        os._exit(DONE)
    finally:
        os._exit(1)


def kill_on_call(kill_at: float) -> None:
    calls = 0

    def dying(function: Callable) -> Callable:
        def called(*args: object, **kwargs: object) -> object:
            nonlocal calls
            calls += 1
            mine = calls
            if mine == kill_at:
                os._exit(KILLED)
            result = function(*args, **kwargs)
            if mine + 0.5 == kill_at:
                os._exit(KILLED)
            return result

        return called

    for name in ("fsync", "replace", "link", "unlink", "mkdir"):
        setattr(os, name, dying(getattr(os, name)))
    h5py.File.close = dying(h5py.File.close)
    h5py.Group.create_dataset = dying(h5py.Group.create_dataset)


def state_of(folder: Path) -> list[str]:
    """Return what a project holds, as text, every scan and surface read."""
    project = Project.open(folder)
    held = [project.name]
    for record in project.objects():
        held.append(record.object_id)
        for epoch in project.epochs(record.object_id):
            points = sum(len(c.cloud) for c in project.iterate_scan(record.object_id, epoch.epoch_id, 0))
            held.append(f"{epoch.epoch_id} of {points} points")
            for step in project.steps(record.object_id, epoch.epoch_id):
                held.append(f"{step.product} {step.step_id}")
                if step.product == "surface":
                    project.get(record.object_id, epoch.epoch_id, "surface")
    return held


def damage(project: Project) -> None:
    """Change one byte in the middle of the stored surface."""
    path = next(project.path.glob("objects/stove/E1/surface-*.h5"))
    octets = bytearray(path.read_bytes())
    octets[len(octets) // 2] ^= 1
    path.write_bytes(octets)


@pytest.mark.parametrize("change", CHANGES)
def test_change_killed_at_any_step_leaves_the_state_before_or_after(tmp_path, rng, change):
    project = example_project(tmp_path, rng)
    put(project, 0)
    without_surface = [s for s in state_of(project.path) if not s.startswith("surface")]
    allowed = [state_of(project.path)]
    if change == "put over a damaged file":
        damage(project)
        allowed.append(without_surface)  # the damaged file is given up before its name is used again
    original = tmp_path / "original"
    project.path.rename(original)

    work = tmp_path / "work"
    shutil.copytree(original, work)
    CHANGES[change](Project.open(work))
    allowed.append(state_of(work))
    seen = set()
    for k in range(2, 400):
        shutil.rmtree(work)
        shutil.copytree(original, work)
        ended = run_killed(lambda: CHANGES[change](Project.open(work)), k / 2)
        assert ended in (KILLED, DONE)
        if ended == DONE and k % 2 == 0:  # at k + 0.5 also where that call raised
            break
        ok = Project.open(work).verify().ok
        assert ok or change == "put over a damaged file"
        if ok:
            state = state_of(work)
            assert state in allowed
            seen.add(allowed.index(state))
        later = Project.open(work)
        later.add_object(ObjectRecord("later"))
        left = {f.path.split("/")[0] for f in later.verify().findings}
        assert not left & {"partial", "project.lock"}
    assert k > 15
    assert len(seen) >= 2, "the kills must fall on both sides of the commit"


def test_creation_killed_at_any_step_leaves_a_project_or_can_be_repeated(tmp_path):
    for k in range(2, 200):
        folder = tmp_path / f"p{k}"
        ended = run_killed(lambda: Project.create(folder, name="new"), k / 2)  # noqa: B023
        assert ended in (KILLED, DONE)
        if ended == DONE and k % 2 == 0:
            break
        try:
            project = Project.open(folder)
        except StoreError:
            project = Project.create(folder, name="new")
        project.add_object(ObjectRecord("stove"))
        assert Project.open(folder).name == "new"
        assert project.verify().findings == ()
    assert k > 10


def test_writer_killed_by_the_system_at_any_time_loses_nothing_that_was_entered(tmp_path, rng):
    project = example_project(tmp_path, rng)
    for turn in range(12):
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            for k in range(100_000):
                put(Project.open(project.path), 1000 * turn + k)
                os.write(writing, f"{1000 * turn + k}\n".encode())
        time.sleep(0.1 + 0.02 * turn + rng.random() * 0.05)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(writing)
        with os.fdopen(reading) as entered:
            last = [int(line) for line in entered.read().split()]
        again = Project.open(project.path)
        if last:
            step = again.latest("stove", "E1", "surface")
            assert step is not None
            assert step.parameters["k"] in (last[-1], last[-1] + 1)
            again.get("stove", "E1", "surface")
        assert again.verify().ok


def test_bytes_reach_the_disk_before_the_name_and_the_name_before_the_index(tmp_path, rng, monkeypatch):
    project = example_project(tmp_path, rng)
    events: list[str] = []
    names: dict[int, str] = {}

    def recording(name: str, function: Callable) -> Callable:
        def called(*args: object, **kwargs: object) -> object:
            if name == "open":
                descriptor = function(*args, **kwargs)
                names[descriptor] = Path(str(args[0])).parent.name if Path(str(args[0])).is_file() else "folder"
                return descriptor
            if name == "fsync":
                events.append(f"fsync {names[args[0]]}")
            else:
                events.append(f"replace {Path(str(args[1])).suffix} {Path(str(args[1])).name[:7]}")
            return function(*args, **kwargs)

        return called

    for name in ("open", "fsync", "replace"):
        monkeypatch.setattr(atomic.os, name, recording(name, getattr(os, name)))
    put(project, 3)
    assert events == ["fsync partial", "replace .h5 surface", "fsync folder",
                      "fsync partial", "replace .h5 project", "fsync folder"]  # fmt: skip
