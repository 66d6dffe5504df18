"""Strict reader of JSON files that calib has written: a value of the wrong type is refused."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calib.errors.errors import InputError
from calib.results.cell import shortened

ANY = None
"""Key that stands for every name that is not listed."""
_WORDS = {str: "text", float: "a number", bool: "true or false"}


def read_json(
    path: Path, kinds: Mapping[Any, Any], required: Sequence[str] = (), remedy: str = "run the analysis again"
) -> dict[str, Any]:
    """Read named values and check the types of those that are listed; others are left as they are.

    Parameters
    ----------
    path : Path
    kinds : mapping from name to kind
        ``str``, ``float`` or ``bool``, each of which may be unknown (null); ``[kind]`` for a list; a mapping of the
        same form for named values, with `ANY` for all other names.
    required : sequence of str
        Names that must be there.
    remedy : str

    Raises
    ------
    InputError
        Naming the file, the name and the value.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as fault:
        raise InputError(f"it cannot be read: {fault}", place=path, remedy=remedy) from None
    if not isinstance(content, dict):
        raise InputError("it holds no named values", place=path, remedy=remedy)
    if missing := [name for name in required if name not in content]:
        raise InputError(f"{missing[0]!r} is missing", place=path, remedy=remedy)
    if wrong := _fault(content, kinds, ""):
        raise InputError(wrong, place=path, remedy=remedy)
    return content


def _fault(value: Any, kind: Any, name: str) -> str:
    """What is wrong with a value; empty when nothing is."""
    if isinstance(kind, Mapping):
        if not isinstance(value, dict):
            return _told(name, value, "named values")
        parts = [(k, v, kind[k] if k in kind else kind.get(ANY)) for k, v in value.items()]
        faults = (_fault(v, own, f"{name}.{k}" if name else k) for k, v, own in parts if own is not None)
    elif isinstance(kind, list):
        if not isinstance(value, list):
            return _told(name, value, "a list")
        faults = (_fault(v, kind[0], f"{name}[{i}]") for i, v in enumerate(value))
    else:
        number = kind is float and isinstance(value, int | float) and not isinstance(value, bool)
        return "" if value is None or number or isinstance(value, kind) else _told(name, value, _WORDS[kind])
    return next((fault for fault in faults if fault), "")


def _told(name: str, value: Any, expected: str) -> str:
    return f"{name!r} is {shortened(json.dumps(value))}, which is not {expected}"
