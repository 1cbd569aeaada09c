"""Fixtures that every test may use, and what two processes that test side by side must not share."""

import os
from pathlib import Path

import numpy as np
import pytest

from monitor.kernel_cache import digest_of

ROOT = Path(__file__).resolve().parents[1]
REAL_DATA = ROOT / ".." / "shared" / "data"

if WORKER := os.environ.get("PYTEST_XDIST_WORKER"):
    # Numba's cache has no lock: of two processes that compile one kernel for two kinds of arguments at one time, each
    # may take the other's code for its own. Read when numba is imported, which nothing has done yet.
    os.environ["NUMBA_CACHE_DIR"] = str(ROOT / ".numba_cache" / f"{digest_of(ROOT / 'monitor')}-{WORKER}")
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # threads that wait leave the processor to the other process


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put short files last: at the end neither of two processes waits long for the other."""
    items.sort(key=lambda item: item.path.parent.name in ("projects", "reports"))


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
