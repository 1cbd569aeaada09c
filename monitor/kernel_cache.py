"""Where compiled kernels are kept: in a folder of their own for each state of the sources, one writer at a time.

Numba takes a kernel for current as long as the file that it stands in is unchanged, though it holds the code of all
kernels that it calls. After an update of some files the others would go on computing by the old code. And of a kernel
that two processes compile at once, for other types each, it keeps both under one name: either would run the other's.

That copy of a called kernel was optimised once more with its caller and may round otherwise than the kernel by itself.
Of both a process runs what it has first: the kernel where it compiles it, the copy where it finds the caller compiled.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

VARIABLE = "NUMBA_CACHE_DIR"
UNUSED = 30 * 86400.0  # s, after which a folder for other sources is removed


def use_own_folder(package: Path) -> None:
    """Have numba keep the kernels of a package in a folder for its sources as they are; one that is set stays.

    To be called before numba is imported. Where no folder can be made numba keeps to its own rule.
    """
    if VARIABLE in os.environ:
        return
    name = f"kernels-{digest_of(package)}"
    for parent in (lambda: package / "__pycache__", user_folder):
        try:
            folder = parent() / name
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)
            remove_unused(folder)
        except (OSError, RuntimeError):  # no such folder can be made; no home is known
            continue
        if os.access(folder, os.W_OK):
            os.environ[VARIABLE] = str(folder)
            return


def prepare_cache() -> None:
    """Have numba save one at a time and load what a kernel calls before it; once more does nothing."""
    save_one_at_a_time()
    load_called_first()


def save_one_at_a_time() -> None:
    """Have processes that compile the same kernels at once write to numba's cache one after the other.

    Numba reads which names are taken, then writes under the next one; between both nothing keeps others out.
    """
    from numba.core.caching import IndexDataCacheFile

    save = IndexDataCacheFile.save
    if hasattr(save, "__wrapped__"):
        return

    @functools.wraps(save)
    def save_alone(self: Any, key: Any, data: Any) -> None:
        """Save as numba does, while no other process writes to the folder."""
        with alone_in(Path(self._cache_path)):
            save(self, key, data)

    IndexDataCacheFile.save = save_alone


def load_called_first() -> None:
    """Have a kernel that is found compiled run the kernels it calls, as where it is compiled, not copies of them."""
    from numba.core.caching import FunctionCache

    load = FunctionCache.load_overload
    if hasattr(load, "__wrapped__"):
        return

    @functools.wraps(load)
    def load_after_called(self: Any, signature: Any, target: Any) -> Any:
        """Load as numba does, after what is kept of each kernel that this one names."""
        for kernel in called_kernels(self._py_func):
            load_kept(kernel, target)
        return load(self, signature, target)

    FunctionCache.load_overload = load_after_called


def called_kernels(function: Any) -> list[Any]:
    """Return the kernels that are kept and that a kernel's function names, other than itself."""
    from numba.core.caching import FunctionCache

    named = (function.__globals__.get(name) for name in function.__code__.co_names)
    return [k for k in named if isinstance(getattr(k, "_cache", None), FunctionCache) and k.py_func is not function]


def load_kept(kernel: Any, target: Any) -> None:
    """Load every signature of a kernel that is kept for this machine and not loaded yet."""
    cache, codegen = kernel._cache, target.codegen()
    for key in cache._cache_file._load_index():
        signature = key[0]
        if signature not in kernel.overloads and key == cache._index_key(signature, codegen):
            kernel.compile(signature)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Wait until no other process is in the folder; where a system (Windows) or a file system has no such locks, or the
    folder is another user's, there is no waiting."""
    with ExitStack() as held:
        with suppress(ImportError, OSError):
            import fcntl

            file = held.enter_context((folder / "writing.lock").open("ab"))
            fcntl.flock(file, fcntl.LOCK_EX)  # let go when the file is closed, or the process ends
        yield


def user_folder() -> Path:
    """Return where a user's own caches lie, for packages that are installed where he may not write."""
    home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(home) / "heritage-monitor"


def digest_of(package: Path) -> str:
    """Return what tells one state of a package's sources from another: names, sizes and times of change."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        state = path.stat()
        digest.update(f"{path.relative_to(package)} {state.st_size} {state.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:16]


def remove_unused(current: Path) -> None:
    """Remove the folders beside the current one that nothing has used for `UNUSED` seconds."""
    for folder in current.parent.glob("kernels-*"):
        with suppress(OSError):  # another process may have removed it meanwhile
            if folder != current and time.time() - folder.stat().st_mtime > UNUSED:
                shutil.rmtree(folder, ignore_errors=True)
