"""What a dataset 58 says of its axes: quantity and units by the types of data and by the labels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from calib.errors.errors import InputError
from calib.measurement.frf_units import FORCES, parse_unit
from calib.measurement.record import MOTION_OF, Motion, parse_motion_unit

TYPES: Mapping[int, str] = {
    0: "unknown", 1: "general", 2: "stress", 3: "strain", 5: "temperature", 6: "heat flux", 8: "displacement",
    9: "reaction force", 11: "velocity", 12: "acceleration", 13: "excitation force", 15: "pressure", 16: "mass",
    17: "time", 18: "frequency", 19: "rpm", 20: "order",
}  # fmt: skip
"""Types of data of an axis."""
MOTIONS: Mapping[int, Motion] = {8: "displacement", 11: "velocity", 12: "acceleration"}
_UNSTATED, _GENERAL = 0, 1
_FORCES = (9, 13)
_WORDS: Mapping[str, str] = {
    "displacement": "displacement", "velocity": "velocity", "acceleration": "acceleration", "force": "force",
    "pressure": "pressure", "strain": "strain", "voltage": "voltage",
}  # fmt: skip
_OTHERS: Mapping[str, str] = {
    "v": "voltage", "mv": "voltage", "volt": "voltage", "pa": "pressure", "ue": "strain", "µe": "strain",
    "ustrain": "strain", "strain": "strain", "um/m": "strain", "a": "current", "kg": "mass",
}  # fmt: skip
"""Units of what is neither motion nor force."""
_PER_FORCE = re.compile(r"\(?1/(?P<force>[A-Za-z]+)\)?[*·.]?(?P<motion>.+)")
_PER_SECOND: Mapping[str, float] = {"hz": 1.0, "khz": 1e3, "rad/s": 0.5 / math.pi, "rpm": 1 / 60, "1/min": 1 / 60}
"""Hz for each unit of an axis of frequencies."""


@dataclass(frozen=True)
class Axis:
    """One axis of a function.

    Attributes
    ----------
    typed : str or None
        What it is by its type of data: a motion, ``force``, or the name of another type; None where not stated.
    labelled : str or None
        The same by its label and unit; None where they say nothing.
    unit : float or None
        SI value of the unit on the label, of motion or force; None where it says nothing.
    text : str
        Its label and unit.
    """

    typed: str | None
    labelled: str | None
    unit: float | None
    text: str

    @property
    def contradicts(self) -> bool:
        """Whether type and label differ."""
        return self.typed is not None and self.labelled not in (None, self.typed)

    @property
    def kind(self) -> str | None:
        """What it is: by its type, or else by its label."""
        return self.typed or self.labelled


def motion_axis(data: Mapping[str, Any]) -> tuple[Axis, float | None]:
    """The ordinate of a dataset 58, and the SI value of the force over which its label states the unit, if it does."""
    code, words, unit = _entries(data, "ordinate")
    typed = None if code == _UNSTATED else MOTIONS.get(code, _name(code))
    labelled, metres, newtons = _unit_of_motion(unit)
    if labelled is None:
        labelled = _word(words)
    if code == _GENERAL:
        typed = labelled if labelled in MOTIONS.values() else _name(code)
    return Axis(typed, labelled, metres, f"{words} {unit}".strip()), newtons


def force_axis(data: Mapping[str, Any]) -> Axis:
    """The denominator of the ordinate."""
    code, words, unit = _entries(data, "orddenom")
    typed = None if code == _UNSTATED else "force" if code in _FORCES else MOTIONS.get(code, _name(code))
    bare = _bare(unit)
    newtons = FORCES.get(bare.removesuffix("m")) if bare else None  # a moment
    labelled = "force" if newtons is not None else _unit_of_motion(unit)[0] or _word(words)
    if code == _GENERAL and labelled == "force":
        typed = "force"
    return Axis(typed, labelled, newtons, f"{words} {unit}".strip())


def measures_force(data: Mapping[str, Any]) -> bool:
    """Whether the ordinate of a dataset 58 is a force by itself."""
    return motion_axis(data)[0].kind in ("force", *(TYPES[code] for code in _FORCES))


def force_unit(data: Mapping[str, Any]) -> float | None:
    """Newtons per unit of an ordinate that is a force, by its label; None where that says nothing."""
    return FORCES.get(_bare(_entries(data, "ordinate")[2]).removesuffix("m"))


def hertz_each(data: Mapping[str, Any]) -> float:
    """Hz for each unit of the abscissa by its label; 1 where that says nothing."""
    _, _, unit = _entries(data, "abscissa")
    return _PER_SECOND.get(unit.lower().replace(" ", ""), 1.0)


def _entries(data: Mapping[str, Any], axis: str) -> tuple[int, str, str]:
    """Type of data, label and unit of an axis; empty texts where they say nothing."""
    texts = (str(data.get(f"{axis}_axis{end}", "") or "").strip() for end in ("_lab", "_units_lab"))
    words, unit = ("" if text.upper() in ("NONE", "UNKNOWN", "-") else text for text in texts)
    return int(data[f"{axis}_spec_data_type"]), words, unit


def _name(code: int) -> str:
    return TYPES.get(code, f"of data type {code}")


def _word(words: str) -> str | None:
    """What a label names in its words."""
    found = {kind for word, kind in _WORDS.items() if word in words.lower()}
    return found.pop() if len(found) == 1 else None


def _bare(unit: str) -> str:
    # readers put U+FFFD for a byte that is no UTF-8: here the exponent of seconds in Latin-1
    bare = "".join(c for c in unit.replace("\N{REPLACEMENT CHARACTER}", "2").replace("²", "2") if c not in " ()^*·")
    return bare.replace("sec", "s").replace("/s/s", "/s2")


def _unit_of_motion(unit: str) -> tuple[str | None, float | None, float | None]:
    """What a unit is the unit of, its SI value, and the SI value of the force under it, if it states one."""
    bare = _bare(unit)
    if not bare:
        return None, None, None
    if (other := _OTHERS.get(bare.lower())) is not None:
        return other, None, None
    if bare in FORCES:
        return "force", None, None
    try:
        motion, metres = parse_motion_unit("m" + bare[3:] if bare.startswith("rad") else bare, "")
        return motion, metres, None
    except InputError:
        pass
    match = _PER_FORCE.fullmatch(unit.replace(" ", ""))
    try:
        if match is not None and _bare(match["force"]) in FORCES:
            motion, metres = parse_motion_unit(_bare(match["motion"]), "")
            return motion, metres, FORCES[_bare(match["force"])]
        quantity, units = parse_unit(bare, "")
    except InputError:
        return None, None, None
    return MOTION_OF[quantity], units.motion, units.force
