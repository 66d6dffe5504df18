"""Numeric variables of MATLAB files of version 5, and of 7.3 where h5py is installed.

Native code reads them, which a damaged file can end together with its process: that is another one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.execution.worker import EndedError, apart


def matlab_variables(path: Path, names: tuple[str, ...], remedy: str) -> dict[str, np.ndarray]:
    """Numeric variables of a file by their names, with the axes as MATLAB has them.

    Parameters
    ----------
    path : Path
    names : tuple of str
    remedy : str
        What to do where the file has no such variable.

    Raises
    ------
    InputError
        For a file that is none of MATLAB's, and a name that it does not hold.
    """
    try:
        found, others = apart(_read, path, names)
    except EndedError as ended:
        raise _no_matlab_file(path, f"it ended the process that read it, {ended}") from None
    for name in names:
        if name not in found:
            held = f"; it holds {', '.join(others)}" if others else ""
            raise InputError(f"it holds no numeric variable {name!r}", place=path, remedy=remedy + held)
    return found


def _read(path: Path, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], list[str]]:
    """The named numeric variables, and the names of all variables where one is missing."""
    from scipy.io import loadmat, whosmat

    try:
        found = {name: np.asarray(one) for name, one in loadmat(path, variable_names=list(names)).items()}
        read = {name: one for name, one in found.items() if one.dtype.kind in "iufc"}
        return read, [] if set(names) <= set(read) else [name for name, _, _ in whosmat(path)]
    except NotImplementedError:  # version 7.3 is HDF5
        return _read_hdf5(path, names)
    except Exception as fault:  # a damaged file raises what its parts raise
        raise _no_matlab_file(path, fault) from None


def _read_hdf5(path: Path, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], list[str]]:
    try:
        import h5py
    except ImportError:
        remedy = "pip install 'calib[files]', or save it with '-v7'"
        raise InputError("it is of version 7.3, which h5py reads", place=path, remedy=remedy) from None
    out = {}
    try:
        with h5py.File(path) as file:
            held = [name for name in file if isinstance(file[name], h5py.Dataset)]
            for name in set(names) & set(held):
                one = np.asarray(file[name])
                if one.dtype.names == ("real", "imag"):
                    one = one["real"] + 1j * one["imag"]
                if one.dtype.kind in "iufc":
                    out[name] = one.T  # MATLAB stores columns
    except Exception as fault:  # a damaged file raises what its parts raise
        raise _no_matlab_file(path, fault) from None
    return out, held


def _no_matlab_file(path: Path, fault: object) -> InputError:
    words = str(fault).splitlines()[0] if str(fault).strip() else type(fault).__name__
    return InputError(f"it is no MATLAB file ({words[:80]})", place=path, remedy="save it again")
