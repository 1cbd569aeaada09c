"""Fixtures that every test may use, and how two processes that test side by side share the work."""

import os
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).resolve().parents[1]
REAL_DATA = ROOT / ".." / "shared" / "data"

if "PYTEST_XDIST_WORKER" in os.environ:
    # Threads that wait leave the processor to the other process. Those of linear algebra wait in busy loops: a third of
    # the time of a comparison of small surfaces. Plugins have loaded numpy by now; numba and scipy come later and read
    # what is set here, and so does each process that a test starts.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    threadpool_limits(1, user_api="blas")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Have two processes compile other kernels at first, and short files last: neither waits long for the other."""
    items.sort(key=_rank)


def _rank(item: pytest.Item) -> int:
    """Return when a file's turn comes: the whole job from its begin, and beside it what stands at the job's end."""
    if item.path.name == "test_demo.py":
        return 0
    if "comparison" in item.path.parts:
        return 1
    return 3 if item.path.parent.name in ("projects", "reports") else 2


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
