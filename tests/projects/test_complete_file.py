"""A disk that is full, or a folder that takes nothing: one line, what was there stays, and nothing is left over."""

import errno
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from projects.errors import ParameterError
from projects.formats import write_csv, write_e57, write_las, write_ply_mesh
from projects.formats.complete_file import complete_file, complete_folder
from projects.model import PointCloud, Scan, Surface


def test_a_full_disk_is_one_line_and_what_was_there_stays(tmp_path):
    path = tmp_path / "regions.csv"
    path.write_text("before")

    def fill() -> None:
        with complete_file(path) as unfinished:
            unfinished.write_text("half a ta")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(ParameterError, match=r"regions\.csv: cannot be written \(No space left on device\)"):
        fill()
    assert [p.name for p in tmp_path.iterdir()] == ["regions.csv"]
    assert path.read_text() == "before"


def test_a_full_disk_names_the_folder_that_was_asked_for_and_not_the_unfinished_one(tmp_path):
    def fill() -> None:
        with complete_folder(tmp_path / "archive") as folder, complete_file(folder / "cloud.txt"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(ParameterError) as told:
        fill()
    assert str(told.value).startswith(f"{tmp_path / 'archive' / 'cloud.txt'}: cannot be written (No space left")
    assert list(tmp_path.iterdir()) == []


def cloud_on_a_full_disk(write, monkeypatch, tmp_path, suffix):
    """Write a cloud to /dev/full in place of a file in the folder."""
    monkeypatch.setattr(Path, "with_name", lambda path, name: Path("/dev/full"))
    monkeypatch.setattr(Path, "unlink", lambda path, missing_ok=False: None)
    cloud = PointCloud(np.random.default_rng(0).normal(size=(50_000, 3)))
    write(tmp_path / f"cloud{suffix}", cloud)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, which is a full disk")
@pytest.mark.parametrize(
    ("suffix", "write"),
    [
        (".laz", write_las),
        (".e57", lambda path, cloud: write_e57(path, [Scan("a", cloud, np.eye(4))])),
        (".ply", lambda path, cloud: write_ply_mesh(path, Surface(cloud.points, np.zeros((0, 3), int)))),
    ],
)
def test_each_writer_tells_of_a_full_disk_in_one_line(tmp_path, monkeypatch, suffix, write):
    with pytest.raises(ParameterError, match=rf"cloud{suffix}: cannot be written"):
        cloud_on_a_full_disk(write, monkeypatch, tmp_path, suffix)


def test_a_name_that_a_folder_has_is_told(tmp_path):
    (tmp_path / "regions.csv").mkdir()
    with pytest.raises(ParameterError, match=r"regions\.csv: cannot be written"):
        write_csv(tmp_path / "regions.csv", pd.DataFrame({"x": [1.0]}))
    assert [p.name for p in tmp_path.iterdir()] == ["regions.csv"]


def test_a_folder_where_a_disk_is_mounted_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    stick = tmp_path / "stick"
    stick.mkdir()
    monkeypatch.setattr(os.path, "ismount", lambda path: path == stick)
    told = f"{stick}: is where a disk is mounted; give a new folder on it, such as {stick}/new$"
    with pytest.raises(ParameterError, match=told), complete_folder(stick):
        pytest.fail("written")
    with complete_folder(stick / "new") as unfinished:
        (unfinished / "a").touch()
    assert [p.name for p in (stick / "new").iterdir()] == ["a"]
