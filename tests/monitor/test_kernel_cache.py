"""Kernels are compiled anew when any source has changed, and only then."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import IndexDataCacheFile

from monitor import kernel_cache
from monitor.kernel_cache import UNUSED, VARIABLE, digest_of, remove_unused, use_own_folder

INNER = """from numba import jit

@jit(nopython=True, cache=True)
def inner(x):
    return {}
"""
OUTER = """from numba import jit
from kernels.inner import inner

@jit(nopython=True, cache=True)
def outer(x):
    return inner(x)
"""
RUN = "import sys; sys.path[:0] = [{root!r}, {here!r}]; {first}; from kernels.outer import outer; print(outer(1.0))"
BY_SOURCES = "from pathlib import Path; from kernel_cache import use_own_folder; use_own_folder(Path({package!r}))"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package of two kernels in two files, one of which calls the other."""
    package = tmp_path / "kernels"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "inner.py").write_text(INNER.format("x + 1.0"))
    (package / "outer.py").write_text(OUTER)
    return package


def computed(package: Path, first: str) -> float:
    """Return what the outer kernel computes in a process of its own, which runs `first` before it."""
    here = str(Path(kernel_cache.__file__).parent)
    command = RUN.format(root=str(package.parent), here=here, first=first)
    environment = {k: v for k, v in os.environ.items() if k != VARIABLE}
    return float(subprocess.run([sys.executable, "-c", command], env=environment, capture_output=True, text=True,
                                check=True).stdout)  # fmt: skip


def test_a_kernel_follows_what_it_calls_in_another_file(package: Path) -> None:
    first = BY_SOURCES.format(package=str(package))
    assert [computed(package, first), computed(package, "pass")] == [2.0, 2.0]
    (package / "inner.py").write_text(INNER.format("x + 10.0"))
    assert computed(package, first) == 11.0
    assert computed(package, "pass") == 2.0  # by numba's own rule: should this fail one day, the module may go


def test_the_same_sources_have_the_same_folder(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = []
    for _ in range(2):
        monkeypatch.delenv(VARIABLE, raising=False)
        use_own_folder(package)
        folders.append(Path(os.environ[VARIABLE]))
    assert folders[0] == folders[1] == package / "__pycache__" / f"kernels-{digest_of(package)}"
    assert folders[0].is_dir()
    before = digest_of(package)
    os.utime(package / "inner.py", ns=(1, 1))
    assert digest_of(package) != before


def test_where_nothing_can_be_written_beside_the_sources_it_is_the_users_cache_or_numbas_own_rule(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    (package / "__pycache__").write_text("a file: nothing can be made in it, whoever asks")
    monkeypatch.setenv("XDG_CACHE_HOME", str(package / "__pycache__"))
    use_own_folder(package)
    assert VARIABLE not in os.environ
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    use_own_folder(package)
    assert Path(os.environ[VARIABLE]) == tmp_path / "cache" / "heritage-monitor" / f"kernels-{digest_of(package)}"


def test_where_no_home_is_known_either_it_is_numbas_own_rule(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless(_path: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in (VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    (package / "__pycache__").write_text("a file: nothing can be made in it, whoever asks")
    monkeypatch.setattr(Path, "expanduser", homeless)
    use_own_folder(package)
    assert VARIABLE not in os.environ


def test_a_folder_that_is_set_stays(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "/somewhere")
    use_own_folder(package)
    assert os.environ[VARIABLE] == "/somewhere"


def test_folders_that_nothing_uses_are_removed(tmp_path: Path) -> None:
    current, recent, unused, other = (tmp_path / name for name in ("kernels-a", "kernels-b", "kernels-c", "other"))
    for folder in (current, recent, unused, other):
        folder.mkdir()
    for folder in (current, unused, other):
        os.utime(folder, (folder.stat().st_mtime - UNUSED - 60.0,) * 2)
    remove_unused(current)
    assert [folder.exists() for folder in (current, recent, unused, other)] == [True, True, False, True]


SAVE = """
import sys, time
from numba.core.caching import IndexDataCacheFile
{first}
take = IndexDataCacheFile._load_index
def slowly(self):
    found = take(self)
    time.sleep(1.0)  # long enough for the other process to read the same
    return found
IndexDataCacheFile._load_index = slowly
IndexDataCacheFile({folder!r}, "kernel", "stamp").save(sys.argv[1], f"code for {{sys.argv[1]}}")
"""


@pytest.mark.parametrize(("first", "is_sound"), [
    ("sys.path[:0] = [{here!r}]; from kernel_cache import save_one_at_a_time; save_one_at_a_time()", True),
    ("", False),  # numba's own way: should this fail one day, the lock may go
])  # fmt: skip
def test_kernels_that_two_processes_compile_at_once_are_both_kept(tmp_path: Path, first: str, is_sound: bool) -> None:
    command = SAVE.format(first=first.format(here=str(Path(kernel_cache.__file__).parent)), folder=str(tmp_path))
    names = ("float32", "float64")
    started = [subprocess.Popen([sys.executable, "-c", command, name]) for name in names]
    assert [process.wait(60) for process in started] == [0, 0]
    file = IndexDataCacheFile(str(tmp_path), "kernel", "stamp")
    assert all(file.load(name) == f"code for {name}" for name in names) == is_sound


@pytest.mark.parametrize("name", ["filtering", "reconstruction", "registration", "comparison", "simulation"])
def test_whichever_package_is_loaded_saves_one_at_a_time(name: str) -> None:
    command = f"""
import monitor.{name}
from numba.core.caching import IndexDataCacheFile
assert hasattr(IndexDataCacheFile.save, "__wrapped__")
"""
    subprocess.run([sys.executable, "-c", command], check=True)


def test_the_command_line_starts_without_numba() -> None:
    command = "import sys, monitor.cli; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", command], check=True)
