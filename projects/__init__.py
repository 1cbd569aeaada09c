"""What is kept: the nouns, the project store, scan formats, provenance. Imports nothing else of this toolkit.

The names are loaded when first asked for, so that the child process that parses a scan file starts at once.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from projects.model import Comparison as Comparison
    from projects.model import PointCloud as PointCloud
    from projects.model import Registration as Registration
    from projects.model import Scan as Scan
    from projects.model import Surface as Surface
    from projects.store import Project as Project

_HOME = {
    "Comparison": "model",
    "PointCloud": "model",
    "Project": "store",
    "Registration": "model",
    "Scan": "model",
    "Surface": "model",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
