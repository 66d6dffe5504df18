"""Validation that all kinds of test share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.errors.arguments import names, number, values
from calib.errors.errors import InputError
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel

Model = StructuralModel | ModalFunctionModel | FunctionModel

UNNAMED = "test"
"""Name of a test that was given none."""
Claimed = str | float | Mapping[str, str | float] | None


def named(test: Any) -> str:
    """Validate the fields that all kinds of test share; returns the place for error messages."""
    if not isinstance(test.name, str) or not test.name:
        raise InputError(f"its name is {test.name!r}", place="test", remedy='give one, such as name="loaded"')
    place = place_of(test)
    object.__setattr__(test, "held_out", names(test.held_out, f"{place}, held_out"))
    object.__setattr__(test, "condition", values(test.condition, f"{place}, condition"))
    return place


def place_of(test: Any) -> str:
    """The test as an error names it; one that was given no name is "the test"."""
    return f"test {test.name}" if test.name != UNNAMED else "the test"


def band(given: object, place: str) -> tuple[float, float]:
    """Two frequencies, Hz."""
    ends = tuple(number(f, place) for f in given) if isinstance(given, Sequence | np.ndarray) else ()
    if isinstance(given, str) or len(ends) != 2:
        raise InputError(f"it is {given!r:.40}", place=place, remedy="give (low, high) in Hz")
    return ends[0], ends[1]
