import numpy as np
import pytest

from monitor.ordering import stable_order


@pytest.mark.parametrize("largest", [3, 10**9, 2**62], ids=["many alike", "packed", "too large to pack"])
def test_order_of_keys_is_the_stable_one(rng, largest):
    keys = rng.integers(0, largest, 5000)
    keys[::7] = keys[0]
    assert np.array_equal(stable_order(keys), np.argsort(keys, kind="stable"))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_keys_have_an_order(n):
    assert stable_order(np.zeros(n, np.int64)).tolist() == list(range(n))
