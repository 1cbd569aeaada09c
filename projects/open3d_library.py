"""The one way to Open3D: its Linux wheel links libusb-1.0, which a fresh machine lacks; a wheel brings it.

Every use of Open3D goes through `load_open3d`, so nothing needs a system package.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from types import ModuleType


@functools.cache
def load_open3d() -> ModuleType:
    """Return the module `open3d`, quiet, with libusb found."""
    if sys.platform == "linux":
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d
