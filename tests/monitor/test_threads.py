"""Ranges of tasks in threads: each task once, whatever the number of threads; errors come back."""

import numba
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from monitor.comparison import compare
from monitor.registration.motion.icp import register_sides
from monitor.threads import map_threads, run_tasks, with_one_blas_thread


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


@pytest.mark.parametrize(("n_items", "share"), [(1, 2), (2, 1), (5, 1)])
def test_what_runs_within_a_thread_has_its_share_of_them(n_items, share):
    threads = numba.get_num_threads()
    if threads < 2:
        pytest.skip("one thread only")
    try:
        numba.set_num_threads(2)
        assert map_threads(lambda k: (k, numba.get_num_threads()), range(n_items)) == [
            (k, share) for k in range(n_items)
        ]
        assert numba.get_num_threads() == 2
    finally:
        numba.set_num_threads(threads)


def test_error_in_a_range_is_raised(monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)

    def work(first, last):
        if first <= 7 < last:
            raise ValueError("seven")

    with pytest.raises(ValueError, match="seven"):
        run_tasks(work, 100)


def test_linear_algebra_keeps_to_one_thread_while_a_function_runs_and_is_let_go_after_an_error():
    def blas_threads():
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    @with_one_blas_thread
    def fail():
        raise ValueError(str(blas_threads()))

    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(ValueError, match=r"^\{1\}$"):
            fail()
        assert blas_threads() == {2}
    assert hasattr(register_sides, "__wrapped__")  # registration is one of them
    assert hasattr(compare, "__wrapped__")
