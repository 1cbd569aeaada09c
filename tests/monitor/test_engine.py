"""The engine: results come in order and do not depend on the number of workers."""

import pytest

from monitor.engine import open_engine
from projects.errors import ParameterError


def square(piece: int) -> int:
    return piece * piece


def test_results_come_in_the_order_of_the_pieces_for_any_number_of_workers() -> None:
    wanted = [k * k for k in range(7)]
    with open_engine() as engine:
        assert list(engine.map(square, range(7))) == wanted
    with open_engine(workers=2) as engine:
        assert list(engine.map(square, range(7))) == wanted


def test_workers_and_scheduler_together_are_refused() -> None:
    with pytest.raises(ParameterError, match="give one"), open_engine(workers=2, scheduler="tcp://127.0.0.1:1"):
        pass


def test_no_worker_is_refused() -> None:
    with pytest.raises(ParameterError, match="at least 1"), open_engine(workers=0):
        pass


def test_a_scheduler_that_does_not_answer_is_one_clear_line() -> None:
    with pytest.raises(ParameterError, match="no Dask scheduler answers"), open_engine(scheduler="nonsense://nowhere"):
        pass
