"""Where a result comes from: hashes of files, ids of steps, versions of programs."""

from __future__ import annotations

import datetime
import hashlib
import importlib.metadata
import platform
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from projects.errors import StoreError
from projects.records import canonical_json

RECORDED = ("numpy", "scipy", "numba", "h5py", "open3d", "open3d-cpu", "pandas")


def hash_file(path: Path | str) -> str:
    """Return the SHA-256 of a file's bytes, 64 hexadecimal digits; memory stays constant."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror})") from error


def step_id(product: str, parameters: Any, inputs: Iterable[str], method_version: int | str = 1) -> str:
    """Return the id of what was asked of which inputs: 16 hexadecimal digits.

    Parameters
    ----------
    product : the product's name.
    parameters : settings, as a dataclass or mapping; None (automatic) counts as such. The order of keys and 5 or
        5.0 make no difference.
    inputs : step ids or file hashes it is made from; their order counts.
    method_version : raised by whoever changes what the step computes from the same parameters.
    """
    asked = {"product": product, "parameters": parameters, "inputs": list(inputs), "version": str(method_version)}
    return hashlib.sha256(canonical_json(asked).encode("utf-8", "backslashreplace")).hexdigest()[:16]


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    """Return the versions of what computed, and the platform."""
    found = {"heritage-monitor": _version("heritage-monitor"), "python": platform.python_version()}
    found |= {name: _version(name) for name in RECORDED}
    found["platform"] = f"{platform.system()} {platform.release()} {platform.machine()}"
    return tuple((name, version) for name, version in found.items() if version)


def versions() -> Mapping[str, str]:
    """Return the versions of this package, Python, the libraries that compute, and the platform (none is imported)."""
    return dict(_versions())


def _version(distribution: str) -> str:
    """Return the version of a distribution, empty where it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return ""


def now() -> str:
    """Return the present time, UTC, ISO 8601 to the second."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
