"""Where work runs: one piece after another on this machine, in local worker processes, or on a Dask cluster.

In come a function and the pieces; out come the results in the order of the pieces, so nothing depends on how many
workers there are. Without workers the kernels of each piece use all cores by themselves.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol, TypeVar

from projects.errors import ParameterError

Piece = TypeVar("Piece")
Result = TypeVar("Result")


class Engine(Protocol):
    """Runs a function over pieces; `is_here`: in this process, where what a function holds need not be sent."""

    is_here: bool

    def map(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Yield `function(piece)` for each piece, in order."""
        ...


class _Inline:
    """One piece after another in this process."""

    is_here = True

    def map(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Yield the results in the order of the pieces, one made after the other."""
        return map(function, pieces)


class _Cluster:
    """The pieces on the workers of a Dask client, at most twice as many at a time as there are workers."""

    is_here = False

    def __init__(self, client: Any) -> None:
        self._client = client

    def map(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Yield the results in the order of the pieces; no more than two a worker are under way."""
        limit = 2 * max(1, len(self._client.scheduler_info()["workers"]))
        waiting: list[Any] = []
        for piece in pieces:
            waiting.append(self._client.submit(function, piece, pure=False))
            if len(waiting) >= limit:
                yield waiting.pop(0).result()
        for future in waiting:
            yield future.result()


def require_where(workers: int | None, scheduler: str | None) -> None:
    """Raise `ParameterError` for fewer than one worker, or for workers and a scheduler at once."""
    if workers is not None and scheduler is not None:
        raise ParameterError("--workers and --scheduler were both given; a cluster brings its own workers: give one")
    if workers is not None and workers < 1:
        raise ParameterError(f"--workers {workers}: at least 1 worker is needed")


@contextlib.contextmanager
def open_engine(workers: int | None = None, scheduler: str | None = None) -> Iterator[Engine]:
    """Give an engine: this process by default and for one worker, `workers` local processes, or an existing cluster at
    `scheduler`.

    Raises
    ------
    ParameterError
        For fewer than one worker, both at once, or a scheduler that does not answer.
    """
    require_where(workers, scheduler)
    if scheduler is None and workers in (None, 1):
        yield _Inline()
        return
    with _connect(workers, scheduler) as client:
        yield _Cluster(client)


def _connect(workers: int | None, scheduler: str | None) -> Any:
    """Return a Dask client of a cluster of local processes or of the one at `scheduler`."""
    from distributed import Client

    if scheduler is None:
        return Client(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=logging.ERROR
        )  # that a worker was slow to end is not the user's concern
    try:
        return Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise ParameterError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
