"""Where scans made by others lie: beside the checkout, or where MONITOR_REAL_DATA says."""

from __future__ import annotations

import os
from pathlib import Path


def data_folder() -> Path:
    """Return the folder of scans made by others."""
    return Path(os.environ.get("MONITOR_REAL_DATA", str(Path(__file__).resolve().parents[3] / "shared" / "data")))
