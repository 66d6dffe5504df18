"""Content hashes of functions (code, closure, defaults, options), of objects, and of files."""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import types
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError

FAILED_RUNS = "failed_runs"
"""Subfolder of a study in which folders of failed runs of its solver are kept."""
SKIPPED = ("__pycache__", "results", "site-packages", "node_modules", FAILED_RUNS)
"""Subfolders of a study that hold no source of its model; hidden ones hold none either."""


def code_files(folder: Path) -> list[Path]:
    """Every Python file in a study's folder and below, sorted; studies nested within it are skipped."""
    found = []
    for here, below, names in os.walk(folder):
        below[:] = sorted(d for d in below if not _is_foreign(Path(here, d)))
        found += [Path(here, name) for name in names if name.endswith(".py") and not name.startswith(".")]
    return sorted(found)


def _is_foreign(folder: Path) -> bool:
    own = folder.name.startswith(".") or folder.name in SKIPPED
    return own or any((folder / sign).exists() for sign in ("study.toml", "pyvenv.cfg"))


def digest_of_files(files: Iterable[Path], folder: Path) -> str:
    """Hash over names (relative to a folder) and content of files; InputError for one that cannot be read."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"\0{os.path.relpath(file, folder)}\0".encode())
        try:
            digest.update(hashlib.sha256(file.read_bytes()).digest())
        except OSError as fault:
            raise InputError(f"it cannot be read ({fault.strerror})", place=file) from None
    return digest.hexdigest()


def digest_of(*things: Any) -> str:
    """Hash over the content of any objects: numbers, arrays, functions, objects with their state.

    It is the same in every process. A function is hashed by its source file, code, defaults and closure; an object
    without accessible state by the name of its type alone. Of calib's own functions and types only the name and what
    they hold count, not the code and not the module: other code of calib is told beside a result, see
    `calib.results.code_digest`, and makes no stored number invalid.
    """
    digest = hashlib.sha256()
    for part in _Walk().parts(tuple(things)):
        digest.update(part + b"\0")
    return digest.hexdigest()


class _Walk:
    """Walks through the contents of an object, visiting each part once."""

    def __init__(self) -> None:
        self._seen: dict[int, tuple[int, Any]] = {}  # kept alive, so that no number is given twice
        self._files: dict[Path, bytes] = {}

    def parts(self, thing: Any) -> Iterator[bytes]:
        if thing is None or isinstance(thing, bool | int | float | complex | str | bytes):
            yield f"{type(thing).__name__} {thing!r}".encode()
            return
        if getattr(type(thing), "is_transparent", False):  # a wrapper that changes no result
            yield from self.parts(thing.__wrapped__)
            return
        if not isinstance(thing, tuple | frozenset | types.CodeType):  # whether equal constants are one may differ
            if id(thing) in self._seen:
                yield f"again {self._seen[id(thing)][0]}".encode()
                return
            self._seen[id(thing)] = len(self._seen), thing
        yield _name(type(thing))
        if isinstance(thing, types.ModuleType):
            yield thing.__name__.encode()
        elif isinstance(thing, type):
            yield _name(thing)
            yield self._file(thing)
        elif isinstance(thing, np.ndarray) and thing.dtype != object:
            yield f"{thing.dtype.str} {thing.shape}".encode() + np.ascontiguousarray(thing).tobytes()
        elif sp.issparse(thing):
            yield from self._each(_entries(thing))
        elif isinstance(thing, types.CodeType):
            yield from self._code(thing)
        elif isinstance(thing, functools.partial):
            yield from self._each((thing.func, thing.args, thing.keywords))
        elif isinstance(thing, types.MethodType):
            yield from self._each((thing.__func__, thing.__self__))
        elif isinstance(thing, types.FunctionType):
            if _is_calibs(thing):
                yield thing.__qualname__.encode()
            else:
                yield self._file(thing)
                yield from self._each((thing.__code__, thing.__defaults__, thing.__kwdefaults__))
            yield from self._each([_content(cell) for cell in thing.__closure__ or ()])
            if hasattr(thing, "__wrapped__"):
                yield from self.parts(thing.__wrapped__)
        elif isinstance(thing, Mapping):
            yield from self._each([part for item in thing.items() for part in item])
        elif isinstance(thing, set | frozenset):
            yield from sorted(digest_of(part).encode() for part in thing)
        elif isinstance(thing, list | tuple):
            yield from self._each(thing)
        else:
            yield from self._object(thing)

    def _each(self, things: Iterable[Any]) -> Iterator[bytes]:
        for thing in things:
            yield from self.parts(thing)
        yield b"end"

    def _code(self, code: types.CodeType) -> Iterator[bytes]:
        yield code.co_code
        yield from self._each((code.co_names, code.co_consts))

    def _object(self, thing: Any) -> Iterator[bytes]:
        """An object by its class and state."""
        yield self._file(type(thing))
        if isinstance(thing, Path):
            yield str(thing).encode()
            return
        if hasattr(thing, "__wrapped__"):  # a cached function counts by its code, not by its cache
            yield from self.parts(thing.__wrapped__)
            return
        state = getattr(thing, "__dict__", None)
        if isinstance(state, dict):
            state = {name: value for name, value in state.items() if not _is_kept(type(thing), name)}
        if state is None:
            try:
                state = thing.__reduce_ex__(2)[1:3]
            except Exception:  # an open file or a lock; a library's own `__reduce__` may raise anything
                state = getattr(thing, "__qualname__", None)
        yield from self.parts(state)

    def _file(self, holder: Any) -> bytes:
        """Digest of the file that defines a function or class; empty where there is none, or one of calib."""
        if _is_calibs(holder):
            return b""
        try:
            path = Path(inspect.getfile(holder))
        except (TypeError, OSError):  # built-in or interactively defined
            return b""
        if path not in self._files:
            try:
                self._files[path] = hashlib.sha256(path.read_bytes()).digest()
            except OSError:
                self._files[path] = b""
        return self._files[path]


def _entries(matrix: Any) -> list[Any]:
    """Shape, indices and values of a sparse matrix, sorted and without duplicates.

    SciPy sorts and adds up in place where an operation needs that, and notes in the matrix that it has.
    """
    own = matrix.copy()
    if hasattr(own, "sum_duplicates"):  # of the format itself: another order of adding up would round differently
        own.sum_duplicates()
    entries = own.tocoo()
    entries.sum_duplicates()
    return [entries.shape, *(np.asarray(axis, dtype=np.int64) for axis in entries.coords), entries.data]


def _is_kept(kind: type, name: str) -> bool:
    """Whether an attribute is the value of a cached property: it follows from the others and may be absent."""
    return any(isinstance(vars(own).get(name), functools.cached_property) for own in kind.__mro__)


def _name(kind: type) -> bytes:
    # The module name of a file outside any package is derived from its path, which must not count; that of calib's own
    # types changes where a file of calib moves.
    module = "" if kind.__module__.startswith("calib_study_") or _is_calibs(kind) else kind.__module__
    return f"{module}.{kind.__qualname__}".encode()


def _is_calibs(holder: Any) -> bool:
    """Whether a function or type belongs to calib itself."""
    return str(getattr(holder, "__module__", "")).split(".")[0] == "calib"


def _content(cell: types.CellType) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not bound yet
        return None
