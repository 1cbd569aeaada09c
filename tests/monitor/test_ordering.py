import numba
import numpy as np
import pytest

from monitor import ordering
from monitor.ordering import stable_order


@pytest.mark.parametrize("largest", [3, 10**9, 2**62], ids=["many alike", "packed", "too large to pack"])
def test_order_of_keys_is_the_stable_one(rng, largest):
    keys = rng.integers(0, largest, 5000)
    keys[::7] = keys[0]
    assert np.array_equal(stable_order(keys), np.argsort(keys, kind="stable"))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_keys_have_an_order(n):
    assert stable_order(np.zeros(n, np.int64)).tolist() == list(range(n))


@pytest.mark.parametrize("largest", [1, 3, 2**9, 2**33], ids=["one value", "two bits", "a digit", "four digits"])
@pytest.mark.parametrize("n_threads", [1, 2])
def test_keys_sorted_by_their_digits_come_in_the_stable_order(rng, largest, n_threads, monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: n_threads)
    monkeypatch.setattr(ordering, "FEWEST", 10)
    keys = rng.integers(0, largest, 5003)
    keys[::7] = keys[0]
    before = keys.copy()
    assert np.array_equal(stable_order(keys), np.argsort(keys, kind="stable"))
    assert np.array_equal(keys, before)


def test_what_lies_below_the_digits_sorted_by_keeps_its_order():
    values = np.array([0b1010, 0b0111, 0b1001, 0b0100, 0b1011])
    assert ordering._sort_by_digits(values.copy(), 2, 4).tolist() == [0b0111, 0b0100, 0b1010, 0b1001, 0b1011]
