"""Store of what tasks share with other processes: large arrays in files of their own, which these map into memory."""

from __future__ import annotations

import contextlib
import pickle
import weakref
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from calib.execution.outcome import NotSent
from calib.execution.temporary import TemporaryFolder

_LARGE = 1 << 15
"""Bytes from which an array has a file of its own, which other processes map into their memory."""
_SPARE = 2
"""An array that a part is of is stored for it where it is not this many times as large."""


class SharedStore:
    """Temporary folder of what a call shares; large arrays that the next call shares too are written once.

    It keeps none of them in memory: a large model would stay there after its call.
    """

    def __init__(self) -> None:
        self._folder = TemporaryFolder()
        self._kept: dict[int, tuple[weakref.ref[np.ndarray], Path]] = {}
        self._files: set[Path] = set()
        self._number = 0

    def close(self) -> None:
        """Delete the folder."""
        self._kept, self._files = {}, set()
        self._folder.close()

    def file(self, suffix: str) -> Path:
        """A file that does not exist yet."""
        self._number += 1
        return self._folder.path / f"{self._number}{suffix}"

    def written(self, content: object) -> Path:
        """File of a content, without its large arrays; files of the call before that are not needed are deleted."""
        arrays, files = dict[int, tuple[weakref.ref[np.ndarray], Path]](), set[Path]()

        def place(array: np.ndarray) -> Path:
            known, path = arrays.get(id(array)) or self._kept.get(id(array)) or (None, None)
            if known is None or path is None or known() is not array:  # another one may have had its number
                files.add(path := self.file(".npy"))
                np.save(path, array, allow_pickle=False)
                known = weakref.ref(array)
            arrays[id(array)] = known, path
            files.add(path)
            return path

        files.add(whole := self.file(".pickle"))
        try:
            with whole.open("wb") as file:  # not in memory: models have hundreds of thousands of small parts
                _Pickler(file, place).dump(content)
        except BaseException:  # a full disk must not stay full
            _deleted(files - self._files)
            raise
        before, self._kept, self._files = self._files, arrays, files
        _deleted(before - files)
        return whole


def _deleted(files: set[Path]) -> None:
    for path in files:
        with contextlib.suppress(OSError):
            path.unlink()


class _Stored(NamedTuple):
    """Where a large array is: in a file of its own, or as a part of another one, by shape, first byte and strides."""

    path: Path
    part: tuple[tuple[int, ...], int, tuple[int, ...]] | None = None


def can_be_sent(thing: object) -> bool:
    """Whether another process finds a function by its name: not one defined in another function, or without a name."""
    return not isinstance(thing, FunctionType) or "<" not in thing.__qualname__


class _StandIn:
    """What another process has in the place of a function that cannot be sent, such as one in another function."""

    def __init__(self, name: str):
        self.name = name

    def __call__(self, *arguments: object, **named: object) -> None:
        """NotSent, whatever is asked."""
        raise NotSent(self.name)


class _Pickler(pickle.Pickler):
    """Pickles an object with paths in place of its large arrays, and stand-ins for functions that cannot be sent.

    Most tasks call none of them: effects are built into the model before it is sent.
    """

    def __init__(self, file: BinaryIO, place: Callable[[np.ndarray], Path]):
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._place = place

    def reducer_override(self, obj: object) -> Any:
        """How to make an object again; NotImplemented for the usual way."""
        return NotImplemented if can_be_sent(obj) else (_StandIn, (getattr(obj, "__qualname__", ""),))

    def persistent_id(self, obj: object) -> _Stored | None:
        if type(obj) is not np.ndarray or obj.nbytes < _LARGE or obj.dtype.kind not in "fciub":
            return None
        if obj.flags.c_contiguous or obj.flags.f_contiguous:
            return _Stored(self._place(obj))
        whole = obj.base
        if type(whole) is not np.ndarray or not whole.flags.c_contiguous or whole.dtype != obj.dtype:
            return None
        if whole.nbytes > _SPARE * obj.nbytes:
            return None
        first = obj.__array_interface__["data"][0] - whole.__array_interface__["data"][0]
        return _Stored(self._place(whole), (obj.shape, first, obj.strides))


class _Unpickler(pickle.Unpickler):
    """Reads what `_Pickler` wrote, each array once."""

    def __init__(self, file: BinaryIO):
        super().__init__(file)
        self._arrays: dict[Path, np.ndarray] = {}

    def persistent_load(self, pid: Any) -> np.ndarray:
        path, part = pid
        if path not in self._arrays:  # private copies of pages that are written to
            self._arrays[path] = np.load(path, mmap_mode="c", allow_pickle=False).view(np.ndarray)
        whole = self._arrays[path]
        if part is None:
            return whole
        shape, first, strides = part
        return np.ndarray(shape, whole.dtype, whole, first, strides)


def read(path: Path) -> Any:
    """A content that a store has written."""
    with path.open("rb") as file:
        return _Unpickler(file).load()
