"""Lines of the user's own code: where an exception was raised, and where a function is defined."""

from __future__ import annotations

import functools
import inspect
import linecache
import os
import re
import sysconfig
import tokenize
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import calib
from calib.errors.place import Place

CALIB = Path(os.path.abspath(calib.__file__)).parent
"""Folder of calib's own files."""
_NOT_THE_USERS = (
    f"{CALIB}{os.sep}",
    *(sysconfig.get_path(kind) + os.sep for kind in ("stdlib", "purelib", "platlib")),
)
_INSTALLED = ("site-packages", "dist-packages")
_CELL = "<ipython-input"
"""Beginning of the name of what is typed into IPython; a notebook's cell has the name of a file that is not there."""
_LIBRARY = f"{CALIB.parent / 'models'}{os.sep}"
"""Models that come with calib: a library where the user's own code calls them, else the code that a study names."""
_HEAD_LINES = 30
"""Lines of decorators that may stand above a function's name."""


def raised_at(fault: BaseException) -> Place | None:
    """Line of the user's code that raised an exception, the innermost one; for a wrong syntax the line itself.

    The user's code is any that belongs neither to Python nor to calib nor to an installed package. Of code that calls
    the models that come with calib, it is the caller.
    """
    if isinstance(fault, SyntaxError) and fault.filename and fault.lineno and _is_own(fault.filename):
        return _place_of_syntax(fault)
    frames = _own_frames(traceback.extract_tb(fault.__traceback__))
    if not frames or (line := frames[-1].lineno) is None:
        return None
    frame = frames[-1]
    place = Place.in_lines(frame.filename, _lines(frame.filename), line)
    if frame.colno is None or frame.end_colno is None:
        return place
    begin = _characters(place.text, frame.colno)
    one_line = frame.end_lineno == frame.lineno
    end = _characters(place.text, frame.end_colno) if one_line else len(place.text.rstrip())
    return Place(place.file, place.line, place.text, begin + 1, max(end - begin, 1))


def refuses(fault: BaseException) -> bool:
    """Whether the code that a study names itself raised an exception, and not what it called."""
    frames = traceback.extract_tb(fault.__traceback__)
    own = _own_frames(frames)
    return bool(own) and (own[-1] is frames[-1] or own[-1].filename.startswith(_LIBRARY))


def _own_frames(frames: Sequence[traceback.FrameSummary]) -> list[traceback.FrameSummary]:
    own = [frame for frame in frames if _is_own(frame.filename)]
    return [frame for frame in own if not frame.filename.startswith(_LIBRARY)] or own


def defined_at(function: Any, values: Mapping[str, float] | None = None) -> Place | None:
    """Line on which a function of the user is defined; None for one of Python, of calib or of an installed package.

    Objects that call a function which they hold as ``function`` count as that function; those with a method
    ``function_at`` as the function that they call at these values.
    """
    code, name = None, ""
    for _ in range(_HEAD_LINES):
        inner = _wrapped(function, values)
        if inner is None:
            break
        function = inner
    for one in (function, inspect.getattr_static(type(function), "__call__", None)):
        code = getattr(one, "__code__", None)
        if code is not None:
            name = code.co_name
            break
    if code is None or not _is_own(code.co_filename):
        return None
    lines = _lines(code.co_filename)
    named = re.compile(rf"\s*(?:async\s+)?def\s+({re.escape(name)})\b")
    for line in range(code.co_firstlineno, min(code.co_firstlineno + _HEAD_LINES, len(lines) + 1)):
        if match := named.match(lines[line - 1]):
            return Place.in_lines(code.co_filename, lines, line, match.start(1) + 1, len(name))
    return Place.in_lines(code.co_filename, lines, code.co_firstlineno)


def _wrapped(function: Any, values: Mapping[str, float] | None) -> Any:
    """The function that another one calls; None where it is the innermost."""
    if isinstance(function, functools.partial):
        return function.func
    if values is not None and hasattr(function, "function_at"):
        return function.function_at(values)
    for name in ("__wrapped__", "__func__", "function"):
        inner = getattr(function, name, None)
        if callable(inner):
            return inner
    return None


def _place_of_syntax(fault: SyntaxError) -> Place:
    """The place that a wrong syntax states; its text is that of the file, whose columns it counts."""
    file, line = str(fault.filename), int(fault.lineno or 1)
    place = Place.in_lines(file, _lines(file), line)
    if not fault.offset or fault.offset < 1:
        return place
    last = fault.end_offset if fault.end_lineno == fault.lineno and fault.end_offset else None
    length = last - fault.offset if last and last > fault.offset else 1
    return Place(place.file, place.line, place.text, fault.offset, length)


def _is_own(file: str) -> bool:
    if file.startswith("<"):
        return file.startswith(_CELL)
    return not file.startswith(_NOT_THE_USERS) and not set(_INSTALLED) & set(Path(file).parts)


def _lines(file: str) -> Sequence[str]:
    """Lines of a file of Python, or of a notebook's cell; none where it cannot be read."""
    try:
        with tokenize.open(file) as stream:
            return stream.read().split("\n")
    except (OSError, SyntaxError, UnicodeError):
        return [line.rstrip("\r\n") for line in linecache.getlines(file)]


def _characters(text: str, n_bytes: int) -> int:
    """Characters in the first bytes of a line, in which Python counts columns."""
    return len(text.encode("utf-8")[:n_bytes].decode("utf-8", errors="replace"))
