"""Cache of trained bases, shared by all studies of a user: studies of one model and its effects train once."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from calib.errors.errors import InputError
from calib.results.code_digest import code_digest
from calib.results.written import DRAFT
from calib.structure.eigenproblem.symmetric_factor import metis
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis

VARIABLE = "CALIB_CACHE"
"""Environment variable that names the folder of the cache."""
LIMIT = 2e9
"""Bytes beyond which the bases unused for longest are deleted."""
_ABANDONED = 600.0
"""Seconds after which a draft counts as abandoned."""

_in_use: ContextVar[tuple[Path, list[str]] | None] = ContextVar("cache", default=None)


@dataclass(frozen=True)
class BasisCache:
    """A folder of bases, each under the key of all it depends on.

    Several runs may use it at once: a file appears whole, and equal keys have equal contents. It may be deleted at any
    time.

    Attributes
    ----------
    folder : Path
    """

    folder: Path

    @property
    def files(self) -> list[Path]:
        """Its bases."""
        return sorted(self.folder.glob(f"basis_{'[0-9a-f]' * 16}.npz"))

    @property
    def size(self) -> int:
        """Their bytes."""
        return sum(_sizes(self.files))

    def find(self, key: str) -> Basis | None:
        """The basis of that key; None where there is none, or where its file is damaged, which is noted."""
        path = self._path(key)
        if not path.is_file():
            return None
        basis = _read(path)
        if basis is None or basis.key != key:
            _note(f"A damaged basis in the cache was ignored and trained again: {path}")
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # the age by which `LIMIT` deletes
        return basis

    def keep(self, basis: Basis) -> None:
        """Add a basis under its key. A cache that cannot be written is noted, and changes no result."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._clear()
            number, draft = tempfile.mkstemp(DRAFT, ".basis_", self.folder)  # of another name in every thread
            os.close(number)
            try:
                basis.write(Path(draft))
                os.replace(draft, self._path(basis.key))
            finally:
                Path(draft).unlink(missing_ok=True)
        except OSError as fault:
            _note(f"The cache cannot be written ({fault.strerror or fault}): {self.folder}")

    def _path(self, key: str) -> Path:
        return self.folder / f"basis_{key}.npz"

    def _clear(self) -> None:
        """Delete abandoned drafts, and the bases unused for longest beyond `LIMIT`."""
        old = [p for p in self.folder.glob(f".basis_*{DRAFT}") if _age(p) > _ABANDONED]
        files = sorted(self.files, key=_age)
        total = np.cumsum(_sizes(files))
        for path in (*old, *(f for f, size in zip(files, total, strict=True) if size > LIMIT)):
            with contextlib.suppress(OSError):  # another run may have deleted it, or read it
                path.unlink()


def basis_cache() -> BasisCache | None:
    """The cache in use: of `using`, else in the folder that `VARIABLE` names, else in the user's folder of caches.

    None where the user has no such folder.
    """
    if (used := _in_use.get()) is not None:
        return BasisCache(used[0])
    if named := os.environ.get(VARIABLE):
        return BasisCache(Path(named))
    return None if (folder := _users_folder()) is None else BasisCache(folder / "calib")


@contextlib.contextmanager
def using(folder: Path | None) -> Iterator[list[str]]:
    """Use the cache in a folder, or by default the present one, and yield a list that collects notes on it.

    InputError where a named folder cannot be written.
    """
    cache = basis_cache() if folder is None else BasisCache(folder)
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            writable = os.access(folder, os.W_OK)
        except OSError:
            writable = False
        if not writable:
            raise InputError(
                "the cache cannot be written there", place=folder, remedy="choose another folder with --cache DIR"
            )
    notes: list[str] = []
    if cache is None:
        yield notes
        return
    before = _in_use.set((cache.folder, notes))
    try:
        yield notes
    finally:
        _in_use.reset(before)


def kept_basis(path: Path | None, key: str, trained: Callable[[], Basis]) -> Basis:
    """The basis of a key: that in a file of results, else that in the cache, else one that is trained.

    It is written to both, so that the results hold what they were made with. Trained or read, it is the same to the
    last bit. A basis of the results that was trained by other code and equals the present one but for its key stays:
    evaluations that a ledger keeps under it are still those of this basis.

    Parameters
    ----------
    path : Path or None
        File in a folder of results; None where there is none.
    key : str
        Of `basis_key`.
    trained : callable
    """
    there = None if path is None else _read(path)
    if there is not None and there.key == key:
        return there
    cache = basis_cache()
    basis = None if cache is None else cache.find(key)
    if basis is None:
        basis = replace(trained(), key=key)
        if cache is not None:
            cache.keep(basis)
    if there is not None and replace(there, key=key).digest == basis.digest:
        return there
    if path is not None:
        basis.save(path)
    return basis


def basis_key(model: StructuralModel, *more: object) -> str:
    """Hash over a model, the code that trains, the libraries that it computes with, and what else a basis depends on.

    Everything in ``more`` must have a ``repr`` that states its content.
    """
    digest = hashlib.sha256((_code() + model.fingerprint).encode())
    digest.update(np.ascontiguousarray(model.dofs.direction, dtype=np.int64).tobytes())
    digest.update(repr(more).encode())
    return digest.hexdigest()[:16]


@functools.cache
def _code() -> str:
    """Digest over the code of `calib.structure`, whatever the folders in it, and versions of what it computes with."""
    libraries = f"{np.__version__} {scipy.__version__} {metis()}"
    return hashlib.sha256(f"{libraries} {code_digest('calib.structure')}".encode()).hexdigest()


def _read(path: Path) -> Basis | None:
    """The basis in a file; None where there is none or it cannot be read."""
    try:
        return Basis.load(path)
    except InputError:
        return None


def _note(words: str) -> None:
    if (used := _in_use.get()) is not None and words not in used[1]:
        used[1].append(words)


def _sizes(files: list[Path]) -> list[int]:
    """Bytes of each file; 0 for one that another run has just deleted."""
    found = []
    for file in files:
        try:
            found.append(file.stat().st_size)
        except OSError:
            found.append(0)
    return found


def _age(path: Path) -> float:
    """Seconds since a file was last used."""
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return 0.0


def _users_folder() -> Path | None:
    """The user's folder of caches, by the rules of each system; None for a user without a home."""
    try:
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches"
        named = os.environ.get("XDG_CACHE_HOME", "")
        return Path(named) if os.path.isabs(named) else Path.home() / ".cache"
    except RuntimeError:
        return None
