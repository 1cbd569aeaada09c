"""Scanner formats: scans and meshes stream in, results are written out.

The names are loaded when first asked for, so that the child process that parses a file starts in a tenth of a second.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from projects.formats.e57_writer import write_e57 as write_e57
    from projects.formats.ptx_writer import write_ptx as write_ptx

_HOME = {
    "write_e57": "e57_writer",
    "write_ptx": "ptx_writer",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
