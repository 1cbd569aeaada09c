"""A disk that takes no more: one line, no crash, nothing left behind, and the project stays as it was."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from store_examples import example_project, example_step, example_stream, example_surface, later_epoch, snapshot

from projects.errors import StoreError
from projects.lock import LOCK_NAME


@pytest.fixture
def project(tmp_path, rng):
    return example_project(tmp_path, rng)


@pytest.mark.skipif(os.name == "nt", reason="needs limits on the size of files")
def test_full_disk_loses_nothing(project, tmp_path, rng):
    import resource

    stream = example_stream(tmp_path, rng, n=200_000)
    stream.step = 50_000
    before = snapshot(project.path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, limits[1]))
    try:
        with pytest.raises(StoreError, match=r"could not be written \(File too large\); nothing was entered$"):
            project.add_epoch(later_epoch(), [stream])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert snapshot(project.path) == before
    project.add_epoch(later_epoch(), [stream])
    assert project.verify().findings == ()


FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from projects import hdf5
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
for n in (30_000, 15_000, 6_000):
    try:
        with hdf5.create_file(Path(sys.argv[1])) as file:
            hdf5.write_array(file, "a", np.random.default_rng(0).random(n))
            hdf5.write_array(file, "b", np.arange(5))
    except OSError as error:
        print(n, hdf5.in_one_line(error))
    else:
        print(n, "written")
"""


def test_a_full_disk_is_an_error_and_no_crash(tmp_path):
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path / "x.h5")]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (0, "")
    assert found.stdout.splitlines() == ["30000 File too large", "15000 File too large", "6000 written"]


def test_a_product_is_taken_back_where_the_index_cannot_be_written(project, rng, monkeypatch):
    before = snapshot(project.path)

    def full(path, index):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("projects.store.write_index", full)
    with pytest.raises(StoreError, match=r"index could not be written \(No space left on device\)"):
        project.put("stove", "E1", example_step(), example_surface(rng))
    assert snapshot(project.path) == before


def test_a_full_disk_leaves_no_lock(project, monkeypatch):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def open_full(path, mode, encoding):
        Path(path).touch(exist_ok=False)
        return Full()

    monkeypatch.setattr("projects.lock.open", open_full, raising=False)
    with pytest.raises(StoreError, match=r"No space left on device.*make room"), project.writing():
        pass
    monkeypatch.undo()
    assert not list(project.path.glob(f"{LOCK_NAME}*"))
    with project.writing():
        pass
