"""Through the front door: files of a campaign in, by the command line alone; what came of them, from the project."""

from __future__ import annotations

import contextlib
import datetime
import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from monitor.cli import run as run_monitor
from monitor.simulation import INSTRUMENTS, Scene
from monitor.simulation.campaign import SurveyedEpoch, write_campaign
from monitor.simulation.stations import Station
from projects import Project
from projects.model import Comparison, Floats, Surface

OBJECT = "object"


class Epoch(NamedTuple):
    """One epoch as `add-epoch` is told of it."""

    name: str
    date: str
    files: Sequence[Path]
    options: Sequence[str] = ()


class Refused(RuntimeError):
    """What `monitor` said where it would not."""


def tell(*words: str | Path) -> None:
    """Run one command of `monitor`; `Refused` with what it said where it fails."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        code = run_monitor([str(word) for word in words])
    if code != 0:
        raise Refused(f"`monitor {words[0]}`: {said.getvalue().strip().splitlines()[-1].removeprefix('monitor: ')}")


def process(folder: Path, epochs: Sequence[Epoch], *, extent: Path | None = None, settings: str = "") -> Path:
    """Make a project of the epochs and their surfaces; return its path. `settings` is the text of a TOML file."""
    project = folder / "project"
    tell("init", project)
    tell("add-object", project, OBJECT, *(("--extent", extent) if extent else ()))
    for epoch in epochs:
        _add(project, epoch)
    tell("process", project, *_settings(folder, settings))
    return project


def add(project: Path, epoch: Epoch) -> None:
    """Add one more epoch to a project and make its surface."""
    _add(project, epoch)
    tell("process", project)


def _add(project: Path, epoch: Epoch) -> None:
    tell("add-epoch", project, OBJECT, epoch.name, "--date", epoch.date, *epoch.options, *epoch.files)


def compare(project: Path, reference: str, compared: str, *, mode: str | None = None, settings: str = "") -> Comparison:
    """Compare two epochs by the command line and return the comparison kept in the project."""
    options = ("--mode", mode) if mode else ()
    tell("compare", project, OBJECT, reference, compared, *options, *_settings(project.parent, settings))
    found: Comparison = product(project, compared, f"comparison-{reference}")
    return found


def compare_states(states: Sequence[tuple[Scene, tuple[Station, ...]]], box: Floats, seed: int) -> list[Comparison]:
    """Return the comparisons of the first of some states with each later one: scanned a year apart, each scene by its
    stations, with the phase scanner of 2020; `box` (2, 3) m is what is monitored."""
    dates = [f"{2020 + k}-05-01" for k in range(len(states))]
    with tempfile.TemporaryDirectory() as name:
        surveyed = [SurveyedEpoch(*state, datetime.date.fromisoformat(date))
                    for state, date in zip(states, dates, strict=True)]  # fmt: skip
        written = write_campaign(Path(name) / "scans", surveyed, INSTRUMENTS["phase-2020"], box=box, seed=seed)
        epochs = [Epoch(f"e{k}", date, [path])
                  for k, (date, path) in enumerate(zip(dates, written.epochs, strict=True))]  # fmt: skip
        project = process(Path(name), epochs, extent=written.extent)
        return [compare(project, "e0", epoch.name) for epoch in epochs[1:]]


def surface(project: Path, epoch: str) -> Surface:
    """Return the surface of an epoch."""
    found: Surface = product(project, epoch, "surface")
    return found


def product(project: Path, epoch: str, name: str) -> Any:
    """Return a product kept in the project."""
    return Project.open(project).get(OBJECT, epoch, name)


def _settings(folder: Path, text: str) -> tuple[str, ...]:
    if not text:
        return ()
    path = folder / "settings.toml"
    path.write_text(text)
    return ("--settings", str(path))
