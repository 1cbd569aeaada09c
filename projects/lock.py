"""One writer at a time: `project.lock` says who writes, where, and since when. Readers never need it.

The lock is a file because shared folders know files; a lock whose process is gone from this machine is taken over.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil  # type: ignore[import-untyped]

from projects.errors import StoreError
from projects.provenance import now

LOCK_NAME = "project.lock"
CLOCK_TOLERANCE = 5.0  # s; a process's start is computed from the boot time, which a clock correction moves
UNFINISHED = 60.0  # s, after which a lock that is still empty is of a process that ended while it made it


@dataclass(frozen=True)
class Owner:
    """Who holds a lock: host (with its process namespace, since containers share host names), process and start."""

    host: str
    pid: int
    started: float
    since: str
    token: str


def this_process() -> Owner:
    """Return this process as a new owner."""
    started = psutil.Process().create_time()
    return Owner(host=_host(), pid=os.getpid(), started=started, since=now(), token=uuid.uuid4().hex)


def _host() -> str:
    """Return the name of this host, with the process namespace where there is one."""
    namespace = ""
    with suppress(OSError):
        namespace = os.readlink("/proc/self/ns/pid").removeprefix("pid:")
    return socket.gethostname() + namespace


def read_owner(path: Path) -> Owner | None:
    """Return who holds the lock, None where nobody does; an unreadable lock is held by an unknown owner."""
    unknown = Owner(host="unknown", pid=0, started=0.0, since="unknown", token="")
    try:
        owner = Owner(**json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, RecursionError):
        return unknown
    texts = all(isinstance(text, str) for text in (owner.host, owner.since, owner.token))
    numbers = type(owner.pid) is int and 0 < owner.pid < 2**31 and isinstance(owner.started, int | float)
    return owner if texts and numbers else unknown


def is_stale(owner: Owner) -> bool:
    """Return whether the owner ran on this machine and is gone (or its number is another process's now)."""
    if owner.host != _host():
        return False
    try:
        process = psutil.Process(owner.pid)
        started, ended = process.create_time(), process.status() == psutil.STATUS_ZOMBIE
        return ended or abs(started - owner.started) > CLOCK_TOLERANCE
    except psutil.NoSuchProcess:
        return True
    except psutil.AccessDenied:
        return False


def is_unfinished(path: Path) -> bool:
    """Return whether a lock has long been empty: its process ended between making and writing it."""
    try:
        found = path.stat()
    except OSError:
        return False
    return found.st_size == 0 and time.time() - found.st_mtime > UNFINISHED


class Lock:
    """The lock of one open project: re-entrant for its thread, waiting a little for another."""

    def __init__(self, root: Path) -> None:
        self.path = root / LOCK_NAME
        self.owner: Owner | None = None
        self._depth = 0
        self._threads = threading.RLock()

    @contextmanager
    def held(self, wait: float) -> Iterator[bool]:
        """Hold the lock; yields whether it was taken just now (False inside of an outer hold)."""
        with self._threads:
            first = self._depth == 0
            if first:
                self.owner = self._take(time.monotonic() + wait)
            self._depth += 1
            try:
                yield first
            finally:
                self._depth -= 1
                if first:
                    self._release()

    def require_mine(self) -> None:
        """Raise `StoreError` where another took the lock meanwhile; called just before anything is committed."""
        found = read_owner(self.path)
        if self.owner is None or found != self.owner:
            raise StoreError(f"{self.path}: the lock was taken by {_describe(found)} meanwhile; nothing was entered")

    def _take(self, deadline: float) -> Owner:
        """Place the lock, waiting until the deadline for its owner, or refuse naming him."""
        me = this_process()
        while True:
            if self._place(me):
                return me
            found = read_owner(self.path)
            if found is not None and (is_stale(found) or is_unfinished(self.path)):
                if not self._remove_stale(found) and time.monotonic() >= deadline:
                    raise StoreError(
                        f"{self.path} was left by a program that has ended ({_describe(found)}) and may not be removed "
                        f"by this user; it belongs to {_user_of(self.path)}: have it removed by them"
                    )
            elif found is not None and time.monotonic() >= deadline:
                raise StoreError(
                    f"{self.path.parent} is being written by {_describe(found)}; wait for it to end, or, if that "
                    f"program no longer runs, remove {self.path.name} there"
                )
            else:
                time.sleep(0.02)

    def _place(self, me: Owner) -> bool:
        """Return whether the lock file could be made; it appears whole, by a hard link, where links exist."""
        draft = self.path.with_name(f"{LOCK_NAME}.{me.token}")
        try:
            self._write(draft, me)
            os.link(draft, self.path)
        except FileExistsError:
            return False
        except FileNotFoundError:  # a new owner cleared our draft away as left over; try again
            if self.path.parent.is_dir():
                return False
            raise StoreError(f"{self.path.parent}: the project folder is gone") from None
        except OSError:
            return self._place_without_links(me)
        finally:
            with suppress(OSError):
                draft.unlink(missing_ok=True)
        return True

    def _place_without_links(self, me: Owner) -> bool:
        """Place the lock where the file system makes no hard links; return whether it was free."""
        try:
            self._write(self.path, me)
        except FileExistsError:
            return False
        return True

    def _write(self, path: Path, me: Owner) -> None:
        """Write who holds the lock to a new file; none is left, and `StoreError` raised, where that is not possible."""
        is_ours = False
        try:
            with open(path, "x", encoding="utf-8") as stream:
                is_ours = True
                stream.write(json.dumps(asdict(me)))
        except (FileExistsError, FileNotFoundError):
            raise
        except OSError as error:
            with suppress(OSError):
                if is_ours:
                    path.unlink()
            is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            advice = "make room on its disk" if is_full else "check its permissions"
            raise StoreError(f"{path.parent} cannot be written ({error.strerror}); {advice}") from error

    def _remove_stale(self, stale: Owner) -> bool:
        """Remove the lock of a process that is gone, unless another has replaced it in the meantime; return whether
        that was allowed."""
        aside = self.path.with_name(f"{LOCK_NAME}.{uuid.uuid4().hex}")
        try:
            with suppress(FileNotFoundError), _alone(self.path.parent):
                if read_owner(self.path) == stale and (is_stale(stale) or is_unfinished(self.path)):
                    os.replace(self.path, aside)
                    aside.unlink()
        except PermissionError:
            time.sleep(0.02)
            return False
        return True

    def clear_drafts(self) -> None:
        """Remove lock drafts that killed processes left; a living one whose draft goes too makes it again."""
        for draft in self.path.parent.glob(f"{LOCK_NAME}.*"):
            with suppress(OSError):
                draft.unlink()

    def _release(self) -> None:
        """Remove the lock where it is still our own."""
        owner, self.owner = self.owner, None
        if owner is not None and owner.pid == os.getpid() and read_owner(self.path) == owner:
            with suppress(OSError):
                self.path.unlink()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Let one process of this machine at a time remove a stale lock (two could both see it, and the second remove
    the first one's new lock); where the system has no such lock, `require_mine` still guards every commit."""
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _user_of(path: Path) -> str:
    """Return the name of the user to whom a file belongs."""
    try:
        return path.owner()
    except (OSError, KeyError, NotImplementedError):
        return "a user without a name here"


def _describe(owner: Owner | None) -> str:
    """Return the owner in words."""
    if owner is None:
        return "nobody known"
    return f"process {owner.pid} on {owner.host.split('[')[0]} since {owner.since}"
