"""Ranges of tasks in threads: each task once, whatever the number of threads; errors come back."""

import numba
import pytest

from monitor.threads import run_tasks


@pytest.mark.parametrize("n_tasks", [0, 1, 5, 1000])
@pytest.mark.parametrize("n_threads", [1, 2])
def test_each_task_is_worked_on_once(n_tasks, n_threads, monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: n_threads)
    times = [0] * n_tasks

    def work(first, last, by):
        for k in range(first, last):
            times[k] += by

    run_tasks(work, n_tasks, 3)
    assert times == [3] * n_tasks


def test_error_in_a_range_is_raised(monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)

    def work(first, last):
        if first <= 7 < last:
            raise ValueError("seven")

    with pytest.raises(ValueError, match="seven"):
        run_tasks(work, 100)
