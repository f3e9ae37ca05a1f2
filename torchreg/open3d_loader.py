"""The one place that imports Open3D.

Open3D's Linux wheels link against ``libusb-1.0.so.0``, which they do not carry and a bare machine does not
have; the package ``libusb-package`` carries it. Loaded first, the linker finds it under its name.
"""

from __future__ import annotations

import ctypes
import sys
from functools import lru_cache
from types import ModuleType

_SYSTEM_LIBUSB = "libusb-1.0.so.0"
_INSTALL = "pip install 'open3d>=0.19' 'libusb-package>=1.0.26'"


@lru_cache(maxsize=1)
def load_open3d() -> ModuleType:
    """Import Open3D where it is first used and return the module; later calls return the same one.

    Raises:
        ImportError: Open3D, or a library that it needs, is not there; the message says what to install.

    Example:
        >>> o3d = load_open3d()
        >>> len(o3d.geometry.PointCloud().points)
        0
    """
    problem = "" if "open3d" in sys.modules else _load_libusb()
    try:
        import open3d
    except (ImportError, OSError) as error:
        message = f"Open3D could not be imported ({error}{problem}); install it with: {_INSTALL}"
        raise ImportError(message) from error
    return open3d


def _load_libusb() -> str:
    """Load libusb on Linux, the system's own before the packaged one; return what went wrong, if anything."""
    if not sys.platform.startswith("linux"):
        return ""
    try:
        ctypes.CDLL(_SYSTEM_LIBUSB, mode=ctypes.RTLD_GLOBAL)
        return ""
    except OSError:
        pass
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError) as error:
        return f"; no {_SYSTEM_LIBUSB} on this system, and the packaged one failed: {error}"
    return ""
