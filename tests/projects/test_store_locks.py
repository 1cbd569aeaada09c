"""One writer at a time: others wait or are refused with its name, and what a dead one left is taken over."""

from __future__ import annotations

import dataclasses
import errno
import json
import multiprocessing
import os
import signal
import socket
import time

import pytest
from store_examples import example_project, example_step, example_stream, example_surface, findings, later_epoch

from projects.atomic import ABANDONED, PARTIAL
from projects.errors import StoreError
from projects.lock import LOCK_NAME, Lock, read_owner, this_process
from projects.model import ObjectRecord
from projects.store import Project


@pytest.fixture
def project(tmp_path, rng):
    return example_project(tmp_path, rng)


def hold_lock(path: str, ready: multiprocessing.Event, done: multiprocessing.Event) -> None:
    with Project.open(path).writing():
        ready.set()
        done.wait(60)


def test_second_writer_is_refused_with_the_owner_and_readers_go_on(project, rng):
    context = multiprocessing.get_context("fork")
    ready, done = context.Event(), context.Event()
    writer = context.Process(target=hold_lock, args=(str(project.path), ready, done))
    writer.start()
    assert ready.wait(60)
    with (
        pytest.raises(StoreError, match=rf"process {writer.pid} on {socket.gethostname()} since 20\d\d"),
        project.writing(wait=0.05),
    ):
        pass
    assert Project.open(project.path).object("stove").object_id == "stove"
    done.set()
    writer.join()
    project.put("stove", "E1", example_step(), example_surface(rng))


def test_lock_of_another_host_is_respected_and_that_of_a_dead_process_taken_over(project):
    path = project.path / LOCK_NAME
    owner = this_process().__dict__
    for lock, message in (
        ({**owner, "host": "archive-server[4026531836]", "pid": 1}, "process 1 on archive-server since"),
        ("", "on unknown since unknown"),
        ([1], "on unknown since unknown"),
        ({**owner, "pid": "x"}, "on unknown since unknown"),
        ({**owner, "pid": 2**70}, "on unknown since unknown"),
    ):
        path.write_text(json.dumps(lock) if lock else "")
        with pytest.raises(StoreError, match=message) as caught, project.writing(wait=0):
            pass
        assert "remove project.lock" in str(caught.value)
        path.unlink()
    for lock in ({**owner, "pid": 2**22 + 1}, {**owner, "started": owner["started"] - 3600}):
        path.write_text(json.dumps(lock))
        assert any("is gone" in message for _, message in findings(project))
        project.add_object(ObjectRecord(f"later-{lock['pid']}"))
        assert not path.exists()


def test_lock_is_reentrant_and_released_after_an_error(project):
    def add_twice() -> None:
        with project.writing():
            project.add_object(ObjectRecord("later"))
            assert (project.path / LOCK_NAME).exists()
            project.add_object(ObjectRecord("later"))

    with pytest.raises(StoreError, match="exists already"):
        add_twice()
    assert not (project.path / LOCK_NAME).exists()
    project.add_object(ObjectRecord("last"))


def test_writer_whose_lock_was_taken_enters_nothing(project):
    before = repr(project.index())
    with project.writing():
        (project.path / LOCK_NAME).write_text(json.dumps({**this_process().__dict__, "pid": 7}))
        with pytest.raises(StoreError, match="was taken by process 7"):
            project.add_object(ObjectRecord("later"))
    assert repr(Project.open(project.path).index()) == before
    assert (project.path / LOCK_NAME).exists(), "the other's lock is not ours to remove"


def add_objects(path: str, names: list[str]) -> None:
    for name in names:
        Project.open(path).add_object(ObjectRecord(name))


def test_many_writers_at_once_lose_no_change(project):
    context = multiprocessing.get_context("fork")
    names = [[f"w{k}.{i}" for i in range(8)] for k in range(4)]
    writers = [context.Process(target=add_objects, args=(str(project.path), n)) for n in names]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
        assert writer.exitcode == 0
    found = {o.object_id for o in Project.open(project.path).objects()}
    assert found == {"stove", *(n for several in names for n in several)}
    assert project.verify().findings == ()


def test_the_lock_of_another_stays_where_ours_cannot_be_made(project, monkeypatch):
    lock = project.path / LOCK_NAME
    lock.touch()

    def refuse(path, mode, encoding):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr("projects.lock.open", refuse, raising=False)
    with pytest.raises(StoreError, match="Too many open files"):
        Lock(project.path)._place_without_links(this_process())
    assert lock.exists()
    monkeypatch.undo()
    os.utime(lock, (time.time() - 100.0,) * 2)
    stale = read_owner(lock)
    lock.unlink()
    lock.touch()  # another writer took it over meanwhile, and is about to write it
    Lock(project.path)._remove_stale(stale)
    assert lock.exists()


def test_a_lock_left_over_that_may_not_be_removed_is_refused_with_its_owner(project, monkeypatch):
    """As in a folder with the sticky bit, where each user may remove only files of their own."""
    lock = project.path / LOCK_NAME
    gone = dataclasses.replace(this_process(), pid=2**22 + 1)
    lock.write_text(json.dumps(dataclasses.asdict(gone)))

    def refuse(source, target):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr("projects.lock.os.replace", refuse)
    told = rf"left by a program that has ended \(process {gone.pid} .*belongs to {lock.owner()}"
    with pytest.raises(StoreError, match=told), project.writing(wait=0.1):
        pass
    monkeypatch.undo()
    with project.writing(wait=0.1):
        pass


def test_an_empty_lock_is_taken_over_once_it_is_old(project, monkeypatch):
    lock = project.path / LOCK_NAME
    lock.touch()
    monkeypatch.setattr("projects.store.LOCK_WAIT", 0.1)
    with pytest.raises(StoreError, match="is being written"), project.writing():
        pass
    os.utime(lock, (time.time() - 100.0,) * 2)
    assert {(f.severity, f.path) for f in project.verify().findings} == {("warning", LOCK_NAME)}
    with project.writing():
        pass
    assert not lock.exists()


class SlowStream:
    """A scan that says when its first points were read, and gives the others when it is told to."""

    def __init__(self, stream, reading, more):
        self.stream, self.reading, self.more = stream, reading, more

    def __getattr__(self, name):
        return getattr(self.stream, name)

    def chunks(self):
        for scan in self.stream.chunks():
            yield scan
            self.reading.set()
            assert self.more.wait(60)


def start_adding(project, stream):
    """Begin to add an epoch in another process; return it and the event that lets it go on."""
    context = multiprocessing.get_context("fork")
    reading, more = context.Event(), context.Event()
    slow = SlowStream(stream, reading, more)
    writer = context.Process(target=lambda: Project.open(project.path).add_epoch(later_epoch(), [slow]))
    writer.start()
    assert reading.wait(60)
    return writer, more


def test_what_was_computed_is_entered_while_another_program_reads_its_scans(project, tmp_path, rng, monkeypatch):
    monkeypatch.setattr("projects.store.LOCK_WAIT", 0.5)
    writer, more = start_adding(project, example_stream(tmp_path, rng, name="s2.ptx"))
    project.put("stove", "E1", example_step(), example_surface(rng))
    assert [(severity, told) for severity, told in findings(project)] == [("note", "is being written now")]
    assert more.is_set() is False
    more.set()
    writer.join()
    assert writer.exitcode == 0
    assert [e.epoch_id for e in project.epochs("stove")] == ["E1", "E2"]
    assert project.latest("stove", "E1", "surface") is not None
    assert findings(project) == []


def test_an_epoch_that_another_added_meanwhile_is_not_entered_twice(project, tmp_path, rng):
    stream = example_stream(tmp_path, rng, name="s2.ptx")
    writer, more = start_adding(project, stream)
    project.add_epoch(later_epoch(), [example_stream(tmp_path, rng, n=8, name="s3.ptx")])
    more.set()
    writer.join()
    assert writer.exitcode == 1
    assert [h.n_points for h in project.scan_headers("stove", "E2")] == [8]
    assert findings(project) == []


def test_the_draft_of_a_process_that_was_killed_goes_with_the_next_change(project, tmp_path, rng):
    writer, _ = start_adding(project, example_stream(tmp_path, rng, name="s2.ptx"))
    os.kill(writer.pid, signal.SIGKILL)
    writer.join()
    assert findings(project) == [("warning", "was left by an interrupted writer; the next writer removes it")]
    project.add_object(ObjectRecord("later"))
    assert findings(project) == []


def test_a_draft_of_another_machine_is_left_alone_for_a_day(project):
    draft = project.path / PARTIAL / f"{16 * 'a'}-7-1700000000-{32 * 'b'}"
    draft.touch()
    (draft.parent / (32 * "c")).touch()  # of an older version, which wrote drafts under the lock alone
    project.add_object(ObjectRecord("later"))
    assert [p.name for p in draft.parent.iterdir()] == [draft.name]
    os.utime(draft, (time.time() - ABANDONED - 60.0,) * 2)
    project.add_object(ObjectRecord("last"))
    assert list(draft.parent.iterdir()) == []
