"""What is shown while work goes on: one line with a spinner and the time, on stderr, only where somebody looks."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

Notify = Callable[[str], None]


@contextlib.contextmanager
def show_progress() -> Iterator[Notify]:
    """Give a function that says what is being done now.

    On a terminal a line with a spinner and the elapsed time; elsewhere (a log) one plain line for each thing done.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda text: print(text, file=sys.stderr, flush=True)
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=None)
        yield lambda text: progress.update(task, description=text)
