"""OpenSees, an independent finite-element code, where it is installed."""

from __future__ import annotations

import atexit
import ctypes
import importlib.util
import os
from pathlib import Path
from types import ModuleType


def load() -> ModuleType:
    """Its commands; ImportError where it cannot be loaded."""
    found = importlib.util.find_spec("openseespylinux")
    if found and found.origin:
        # The package carries its libblas but does not tell its liblapack where, so the loader needs to have it already.
        for name in ("libquadmath.so.0", "libgfortran.so.4", "libblas.so.3"):
            library = Path(found.origin).parent / "lib" / name
            if library.exists():
                ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    try:
        import openseespy.opensees as code
    except (ImportError, RuntimeError, OSError) as problem:  # it raises RuntimeError for a missing system library
        raise ImportError(f"OpenSees cannot be loaded: {problem}") from problem
    # When Python ends it prints a farewell, which would follow the closing line of a test run or a table.
    atexit.register(lambda: os.dup2(os.open(os.devnull, os.O_WRONLY), 2))
    return code
