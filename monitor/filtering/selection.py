"""The k-th smallest of numbers, by Hoare's selection: for kernels that ask it of few numbers, many times."""

from __future__ import annotations

from typing import Any

from numba import njit


@njit(cache=True, error_model="numpy")
def select(values: Any, n: int, k: int) -> float:
    """Return the k-th smallest (from 0) of the first n values, which are left in another order: none before place k is
    larger, none behind it smaller."""
    low, high = 0, n - 1
    while low < high:
        pivot = values[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]
