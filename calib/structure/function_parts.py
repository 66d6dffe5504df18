"""Part of a model without matrices: its function scales it where it is asked to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

from calib.errors.errors import InputError
from calib.structure.model import PartKind


@dataclass(frozen=True)
class ScaledPart:
    """Part of a model given by a function, which may be wrong by itself.

    The function scales the part by one plus the value named `parameter`, where that is among its values; without it the
    part is as the other parameters have it.

    Attributes
    ----------
    name : str
        Such as ``the sidewalls``.
    kind : {"stiffness", "damping", "mass"}

    Raises
    ------
    InputError
        For another kind, or without a name.

    Examples
    --------
    >>> from calib.structure.function_parts import ScaledPart
    >>> ScaledPart("the sidewalls", "stiffness").parameter
    'stiffness of the sidewalls'
    """

    name: str
    kind: PartKind

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("a part has no name", remedy="name it as an engineer would, such as 'the sidewalls'")
        if self.kind not in get_args(PartKind):
            raise InputError(
                f"part {self.name!r} is of kind {self.kind!r}", remedy=f"give one of {', '.join(get_args(PartKind))}"
            )

    @property
    def parameter(self) -> str:
        """Name of its relative change among the values that the function receives."""
        return f"{self.kind} of {self.name}"


def scaled_parts(given: Sequence[ScaledPart], place: str) -> tuple[ScaledPart, ...]:
    """The parts of a model, each once."""
    parts = tuple(given)
    for part in parts:
        if not isinstance(part, ScaledPart):
            raise InputError(f"{part!r:.40} is no part", place=place, remedy="give objects of ScaledPart")
        if parts.count(part) > 1:
            raise InputError(f"part {part.parameter!r} is given twice", place=place)
    return parts
