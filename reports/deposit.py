"""What is put into an archive: files in the folder of its payload, each with what it is, and which came of which."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import pandas as pd

from projects.formats import write_csv
from projects.identifiers import epoch_folder
from projects.model import Step
from reports.crate import Action
from reports.exports import write_json


@dataclass
class Deposit:
    """The payload's folder, what each file in it is (by its name there), the computations that made them, what a reader
    should mind, and which files a step made, by the step's id."""

    payload: Path
    contents: dict[str, str] = field(default_factory=dict)
    actions: list[Action] = field(default_factory=list)
    made_by: dict[str, tuple[str, ...]] = field(default_factory=dict)
    minds: list[str] = field(default_factory=list)

    def add(self, paths: Path | Iterable[Path], what: str) -> tuple[str, ...]:
        """Enter files that were written, with what they are; return their names in the payload."""
        listed = [paths] if isinstance(paths, Path) else paths
        names = tuple(path.relative_to(self.payload).as_posix() for path in listed)
        self.contents |= dict.fromkeys(names, what)
        return names

    def add_table(self, path: Path, table: pd.DataFrame, what: str) -> tuple[str, ...]:
        """Write a table and enter it."""
        write_csv(path, table)
        return self.add(path, what)

    def add_provenance(self, path: Path, steps: Sequence[Step]) -> None:
        """Write the whole record of steps and enter it."""
        write_json(path, {"steps": [dataclasses.asdict(step) for step in sorted(steps, key=lambda s: s.created)]})
        self.add(path, "Record of every step: settings, inputs by hash, what was found and counted, versions, times")

    def folder_of(self, object_id: str, epoch_id: str) -> Path:
        """Return the folder of an epoch, made where it is missing."""
        folder = self.payload / PurePosixPath(*epoch_folder(object_id, epoch_id).parts[1:])
        folder.mkdir(parents=True, exist_ok=True)
        return folder
