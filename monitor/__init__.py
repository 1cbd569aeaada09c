"""Scans to surfaces, surfaces to change: what heritage-monitor computes."""

from pathlib import Path

from monitor.kernel_cache import use_own_folder

use_own_folder(Path(__file__).parent)
