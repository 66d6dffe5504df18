"""Matrices from files of several variables and from Matrix Market: .npz, MATLAB's .mat, .mtx."""

from __future__ import annotations

import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.execution.worker import EndedError, apart
from calib.imports.stored import Stored

_HDF5 = b"\x89HDF\r\n\x1a\n"
_ROWS = ("dofs", "dof", "mdof", "labels")
"""Names of variables that hold node and direction of each row, as pairs or as numbers such as 11.03."""


def read_container(file: Path, raw: bytes) -> list[Stored] | None:
    """Square matrices of a file by their names; None for a file of another form.

    A variable ``dofs`` with a row for each of theirs, pairs or numbers such as 11.03, names their rows.

    Raises
    ------
    InputError
        For a damaged file, and one without a square matrix.
    """
    if raw[:2] == b"PK" and file.suffix.lower() == ".npz":
        held = _npz(file)
    elif raw[:6] == b"MATLAB" or raw[:8] == _HDF5 or raw[512:520] == _HDF5 or file.suffix.lower() == ".mat":
        held = _mat(file)
    elif raw[:14].lower() == b"%%matrixmarket":
        held = {file.stem: _market(file, raw)}
    else:
        return None
    square = {name: one for name, one in held.items() if one.ndim == 2 and one.shape[0] == one.shape[1] > 1}
    if not square:
        raise InputError(f"it holds no square matrix, but {', '.join(held) or 'nothing'}", place=file,
                         remedy="store stiffness and mass, (n, n) each")  # fmt: skip
    rows = next((one for name, one in held.items() if name.lower() in _ROWS and not sp.issparse(one)), None)
    return [Stored(name, _coo(one), _labels(rows, one.shape[0], file)) for name, one in square.items()]


def _coo(matrix: Any) -> sp.coo_array:
    coo = sp.coo_array(matrix)
    return coo if np.iscomplexobj(coo.data) else sp.coo_array((coo.data.astype(float), coo.coords), shape=coo.shape)


def _labels(rows: Any, count: int, file: Path) -> np.ndarray | None:
    """Node and direction of each row from a variable; None without one."""
    if rows is None:
        return None
    array = np.asarray(rows, dtype=float)
    array = array.T if array.ndim == 2 and array.shape[0] != count == array.shape[1] else array
    flat = array.reshape(len(array), -1)
    if len(flat) != count or flat.shape[1] not in (1, 2):
        raise InputError(f"its rows are named in an array of shape {np.shape(rows)}, for {count} rows", place=file,
                         remedy="give node and direction of each row")  # fmt: skip
    if flat.shape[1] == 1:
        node = np.floor(flat[:, 0])
        for form in (10, 100):
            direction = form * (flat[:, 0] - node)
            if np.all(np.abs(direction - np.round(direction)) < 0.01) and np.all((direction > 0.5) & (direction < 6.5)):
                return np.column_stack([node, np.round(direction)]).astype(int)
        raise InputError("its rows are named by numbers without a direction", place=file,
                         remedy="write 12.3 or 12.03 for direction 3 of node 12")  # fmt: skip
    return np.round(flat).astype(int)


def _npz(file: Path) -> dict[str, Any]:
    try:
        with np.load(file, allow_pickle=False) as held:
            names = set(held.files)
            if {"indices", "indptr", "data"} <= names or {"row", "col", "data"} <= names:
                found = sp.load_npz(file)
                if hasattr(found, "check_format"):  # native code follows these indices
                    found.check_format(full_check=True)
                return {file.stem: found}
            return {name: held[name] for name in held.files}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, EOFError) as fault:
        raise InputError(f"it cannot be read ({_words(fault)})", place=file, remedy="save it again") from None


def _market(file: Path, raw: bytes) -> Any:
    from scipy.io import mmread

    try:
        return mmread(io.BytesIO(raw))
    except Exception as fault:  # a damaged file raises what its parts raise
        raise InputError(
            f"it is no Matrix Market file ({_words(fault)})", place=file, remedy="write it again"
        ) from None


def _mat(file: Path) -> dict[str, Any]:
    """Numeric variables, read by another process: native code, which a damaged file can end, reads them."""
    try:
        return apart(_variables, file)
    except EndedError as ended:
        raise InputError(
            f"it is no MATLAB file (it ended the process that read it, {ended})", place=file, remedy="save it again"
        ) from None


def _variables(file: Path) -> dict[str, Any]:
    """Arrays, and sparse matrices by coordinates."""
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            held = loadmat(file)
    except NotImplementedError:  # version 7.3 is HDF5
        return _hdf5(file)
    except Exception as fault:  # a damaged file raises what its parts raise
        raise InputError(f"it is no MATLAB file ({_words(fault)})", place=file, remedy="save it again") from None
    own: dict[str, Any] = {name: one for name, one in held.items() if name[:2] != "__"}
    sparse = [name for name, one in own.items() if sp.issparse(one)]
    out = {name: one.tocoo() if name in sparse else np.asarray(one) for name, one in own.items()}
    return {name: one for name, one in out.items() if one.dtype.kind in "iufc"}


def _hdf5(file: Path) -> dict[str, Any]:
    """Variables of a MATLAB file of version 7.3: columns are its inmost axis, and sparse ones are groups."""
    try:
        import h5py
    except ImportError:
        remedy = "pip install 'calib[files]', or save it with '-v7'"
        raise InputError("it is of version 7.3, which h5py reads", place=file, remedy=remedy) from None
    out: dict[str, Any] = {}
    try:
        with h5py.File(file) as held:
            for name, one in held.items():
                if isinstance(one, h5py.Dataset) and one.dtype.kind in "iuf":
                    out[name] = np.asarray(one).T
                elif isinstance(one, h5py.Group) and "MATLAB_sparse" in one.attrs:
                    starts = np.asarray(one["jc"]).astype(int)
                    rows = np.asarray(one["ir"] if "ir" in one else []).astype(int)
                    data = np.asarray(one["data"] if "data" in one else []).astype(float)
                    shape = (int(one.attrs["MATLAB_sparse"]), len(starts) - 1)
                    out[name] = sp.coo_array(sp.csc_array((data, rows, starts), shape=shape))
    except Exception as fault:  # a damaged file raises what its parts raise
        raise InputError(f"it is no MATLAB file ({_words(fault)})", place=file, remedy="save it again") from None
    return out


def _words(fault: Exception) -> str:
    return (str(fault).splitlines() or [type(fault).__name__])[0][:80] or type(fault).__name__
