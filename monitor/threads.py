"""Kernels run over ranges of tasks in threads, and small matrices in one.

In: a compiled kernel that releases the interpreter's lock and works on the tasks `first` to `last`, each of which
writes what is its own; its other arguments. Numba's `parallel=True` does the same, but compiles a large kernel, with
all that it calls, twice more: 3 to 4 s each time.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, ParamSpec, TypeVar

import numba
from threadpoolctl import threadpool_limits

from monitor.kernel_cache import prepare_cache

prepare_cache()  # numba is loaded here anyway; packages with kernels that do not come by call it themselves

Given = ParamSpec("Given")
Made = TypeVar("Made")

RANGES_PER_THREAD = 8  # so that threads end at nearly one time though tasks differ


def run_tasks(kernel: Callable[..., Any], n_tasks: int, *arguments: Any) -> None:
    """Call `kernel(first, last, *arguments)` for ranges that make up `n_tasks`, on as many threads as numba's.

    Which thread has which range, and how many there are, is nothing a task can see: results have the same bits.
    """
    n_threads = min(numba.get_num_threads(), n_tasks)
    if n_threads <= 1:
        kernel(0, n_tasks, *arguments)
        return
    n_ranges = min(RANGES_PER_THREAD * n_threads, n_tasks)
    bounds = [n_tasks * k // n_ranges for k in range(n_ranges + 1)]
    ranges = iter(list(pairwise(bounds)))  # of a list: threads may take from it side by side

    def work() -> None:
        """Do ranges until none is left."""
        for first, last in ranges:
            kernel(first, last, *arguments)

    with ThreadPoolExecutor(n_threads - 1) as pool:  # this thread is one of them
        waiting = [pool.submit(work) for _ in range(n_threads - 1)]
        work()
        for one in waiting:
            one.result()


def map_threads(function: Callable[[Any], Made], items: Iterable[Any]) -> list[Made]:
    """Return what `function` makes of each item, on as many threads as numba's; what runs in threads within has a share
    of them."""
    pending, n_threads = list(items), numba.get_num_threads()
    share = min(max(n_threads // max(len(pending), 1), 1), numba.config.NUMBA_NUM_THREADS)
    with ThreadPoolExecutor(n_threads, initializer=numba.set_num_threads, initargs=(share,)) as pool:
        return list(pool.map(function, pending))


def with_one_blas_thread(function: Callable[Given, Made]) -> Callable[Given, Made]:
    """Return a function during which numpy's linear algebra keeps to one thread.

    Its threads wait for each other in busy loops: matrices of 6 to 600 rows take as long with two, and ten times as
    long where other work wants a processor. The last bit of their results depends on how many there are, too.
    """

    @functools.wraps(function)
    def held(*args: Given.args, **kwargs: Given.kwargs) -> Made:
        """Call the function with one thread for linear algebra."""
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return held
