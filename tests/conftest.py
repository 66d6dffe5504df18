"""What every test needs before numerical libraries are imported, and the independent codes some compare with."""

import atexit
import ctypes
import importlib.util
import os
from pathlib import Path
from types import ModuleType

# Small matrices are slower on several BLAS threads, and sums then depend on how many there are.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
os.environ["MPLBACKEND"] = "Agg"

import pytest
from hypothesis import settings

# A busy machine makes any deadline fail; a submitted change must not fail by the luck of one draw.
settings.register_profile("calib", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("calib")


@pytest.fixture(scope="session")
def opensees() -> ModuleType:
    """OpenSees, an independent finite-element code; the test is skipped where it cannot be loaded."""
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
        pytest.skip(f"OpenSees cannot be loaded: {problem}")
    # When Python ends it prints a farewell, which would follow the closing line of the test run.
    atexit.register(lambda: os.dup2(os.open(os.devnull, os.O_WRONLY), 2))
    return code
