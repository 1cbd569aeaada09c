"""Tables out as CSV: UTF-8, commas, points for decimals, one line of names, `nan` for what is unknown."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from projects.formats.complete_file import complete_file


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table; numbers with as many digits as it takes to read the same number back."""
    with complete_file(path) as unfinished:
        table.to_csv(unfinished, index=False, na_rep="nan", lineterminator="\n", encoding="utf-8")
