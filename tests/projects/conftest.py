"""Fixtures of the tests on formats."""

from collections import Counter

import numpy as np
import pytest

from projects.formats import read_scans
from projects.model import PointCloud, Scan


def _merged(stream):
    """Return all chunks of a stream as one scan."""
    chunks = list(stream.chunks())
    joined = {}
    for name in ("points", "normals", "intensity", "colors"):
        values = [getattr(chunk.cloud, name) for chunk in chunks]
        joined[name] = None if values[0] is None else np.concatenate(values)
    grid = {
        name: None if getattr(chunks[0], name) is None else np.concatenate([getattr(c, name) for c in chunks])
        for name in ("rows", "columns")
    }
    dropped = sum((Counter(chunk.dropped) for chunk in chunks), Counter())
    first = chunks[0]
    return Scan(stream.name, PointCloud(**joined), first.pose, first.origin, **grid, dropped=dict(dropped))


@pytest.fixture(scope="session")
def read_whole():
    """Return what reads every scan of a file through the child process, each as one `Scan`."""

    def read(path, **options):
        return [_merged(stream) for stream in read_scans(path, **options)]

    return read
