"""Whether two comparisons are the same to the last bit."""

import numpy as np

from projects.model import Comparison


def assert_same_bits(one: Comparison, other: Comparison) -> None:
    """Check both sides and the regions, of which there must be some."""
    for name in ("distances", "lod95", "assessment", "region", "reasons"):
        for side in ("on_reference", "on_compared"):
            np.testing.assert_array_equal(getattr(getattr(one, side), name), getattr(getattr(other, side), name))
    assert one.regions.equals(other.regions)
    assert len(one.regions)
