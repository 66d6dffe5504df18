"""Validation of user arguments: names, numbers, paths, and objects of given types."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from calib.errors.errors import InputError

_Kind = TypeVar("_Kind")


def names(given: Any, place: str) -> tuple[str, ...]:
    """A sequence of names; InputError for a single string, which would be split into letters."""
    remedy = 'give a list of names, such as ["a", "b"]'
    if isinstance(given, str | bytes | Mapping) or not isinstance(given, Iterable):
        raise InputError(f"it is {_told(given)}", place=place, remedy=remedy)
    found = tuple(given)
    for name in found:
        if not isinstance(name, str):
            raise InputError(f"it holds {_told(name)}, which is not a name", place=place, remedy=remedy)
    return tuple(str(name) for name in found)


def parts_once(given: Any, effect: str, kind: str = "stiffness") -> tuple[str, ...]:
    """Names of the parts of an effect; InputError for none, or one that occurs twice, which would count double."""
    place = f"effect {effect}, parts"
    found = names(given, place)
    if not found:
        raise InputError("it names no part", place=f"effect {effect}", remedy=f"name parts of {kind} of the model")
    twice = next((name for k, name in enumerate(found) if name in found[:k]), None)
    if twice is not None:
        raise InputError(f"{twice!r} occurs twice", place=place, remedy="name each part once")
    return found


def number(given: Any, place: str) -> float:
    """A number; InputError for text, None and arrays."""
    try:
        if not isinstance(given, str | bytes):
            return float(given)
    except (TypeError, ValueError):
        pass
    raise InputError(f"it is {_told(given)}", place=place, remedy="give a number")


def numbers(given: Any, place: str) -> np.ndarray:
    """An array of numbers, as it is or from a list; InputError for anything else."""
    try:
        found = np.asarray(given)
    except ValueError:  # rows of different lengths
        found = np.array(None)
    if found.dtype.kind not in "biufc":
        raise InputError("it holds an entry that is not a number", place=place, remedy="give an array of numbers")
    return found


def integer(given: Any, least: int, place: str) -> int:
    """An integer of at least ``least``; InputError for anything else."""
    found = number(given, place)
    if not (found >= least and found == found // 1 and found < float("inf")):
        raise InputError(f"it is {_told(given)}", place=place, remedy=f"give an integer from {least}")
    return int(found)


def path(given: Any, place: str) -> Path:
    """A path; InputError for anything else."""
    if not isinstance(given, str | PathLike):
        raise InputError(f"it is {_told(given)}", place=place, remedy="give a path")
    return Path(given)


def by_name(given: Any, place: str) -> dict[str, Any]:
    """Values by name, from a mapping or a pandas Series; InputError for anything else."""
    if not isinstance(given, Mapping):
        import pandas as pd

        if not isinstance(given, pd.Series):
            raise InputError(f"it is {_told(given)}", place=place, remedy='give values by name, such as {"a": 1.0}')
    found = dict(given)
    for name in found:
        if not isinstance(name, str):
            raise InputError(f"it holds {_told(name)}, which is not a name", place=place, remedy="give names as text")
    return found


def values(given: Any, place: str) -> dict[str, float]:
    """Numbers by name; InputError for anything else."""
    return {name: number(value, f"{place}, {name}") for name, value in by_name(given, place).items()}


def objects(
    given: Any,
    kinds: type[_Kind] | tuple[type[_Kind], ...],
    place: str,
    such_as: Sequence[type[_Kind]] = (),
) -> tuple[_Kind, ...]:
    """One object or several of the given types, as a tuple; InputError for anything else.

    ``such_as`` are the types that the error names; by default the same.
    """
    if isinstance(given, kinds):
        return (given,)
    wanted = " or ".join(k.__name__ for k in such_as or (kinds if isinstance(kinds, tuple) else (kinds,)))
    if isinstance(given, str | Mapping) or not isinstance(given, Iterable):
        raise InputError(f"it is {_told(given)}", place=place, remedy=f"give {wanted}, or a list of them")
    found = tuple(given)
    for one in found:
        if not isinstance(one, kinds):
            raise InputError(f"it holds {_told(one)}", place=place, remedy=f"give {wanted}")
    return found


def _told(given: Any) -> str:
    """A wrong value or its type, on one line."""
    if given is None:
        return "None"
    if isinstance(given, type):
        return f"the class {given.__name__}"
    if isinstance(given, str | int | float):
        return f"{given!r:.40}"
    return f"a value of type {type(given).__name__}"
