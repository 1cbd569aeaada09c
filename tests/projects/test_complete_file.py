"""A disk that is full, or a folder that takes nothing: one line, what was there stays, and nothing is left over."""

import errno
import os

import pandas as pd
import pytest

from projects.errors import ParameterError
from projects.formats import write_csv
from projects.formats.complete_file import complete_file


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


def test_a_name_that_a_folder_has_is_told(tmp_path):
    (tmp_path / "regions.csv").mkdir()
    with pytest.raises(ParameterError, match=r"regions\.csv: cannot be written"):
        write_csv(tmp_path / "regions.csv", pd.DataFrame({"x": [1.0]}))
    assert [p.name for p in tmp_path.iterdir()] == ["regions.csv"]
