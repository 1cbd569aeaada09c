"""Fixtures that every test may use."""

from pathlib import Path

import numpy as np
import pytest

REAL_DATA = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a seeded generator."""
    return np.random.default_rng(20261121)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Return the folder of scans made by others, or skip with the reason."""
    if not REAL_DATA.is_dir():
        pytest.skip(f"real scans are not beside this checkout ({REAL_DATA})")
    return REAL_DATA.resolve()
