"""Units of frequency response functions: what an entry of a file is worth in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.frf import Quantity
from calib.measurement.frf_repeats import Key
from calib.problem.parameter import SI_FACTORS

GRAVITY = 9.80665
"""Standard gravity, m/s^2, by which accelerometers are calibrated in g."""

LENGTHS: Mapping[str, float] = {
    "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "inch": SI_FACTORS["in"], "in": SI_FACTORS["in"],
    "ft": SI_FACTORS["ft"],
}  # fmt: skip
"""Metres per unit of length."""
FORCES: Mapping[str, float] = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": SI_FACTORS["lbf"]}
"""Newtons per unit of force."""
_POWERS: Mapping[Quantity, tuple[str, ...]] = {"receptance": ("",), "mobility": ("s",), "accelerance": ("s2", "ss")}
SAME_UNIT = 1e-3
"""Largest relative difference of two statements of one unit; files round their factors."""


@dataclass(frozen=True)
class FRFUnits:
    """Units of the functions of one file.

    Attributes
    ----------
    motion : float
        SI value of one unit of translation, velocity or acceleration; rotations are in rad.
    length : float
        Metres per unit of length, for the arms of moments.
    force : float
        Newtons per unit of force.
    """

    motion: float = 1.0
    length: float = 1.0
    force: float = 1.0

    def factor(self, key: Key) -> float:
        """SI value of an entry of one function, by its response and reference."""
        (_, moved), (_, driven) = key
        load = self.force * self.length if driven.startswith("r") else self.force
        return (1.0 if moved.startswith("r") else self.motion) / load

    def agrees(self, other: FRFUnits) -> bool:
        """Whether motions and forces have the same units, to the digits of a file."""
        pairs = ((self.motion, other.motion), (self.force, other.force))
        return all(abs(own / given - 1) < SAME_UNIT for own, given in pairs)


def parse_unit(text: str, place: str | Path | Place) -> tuple[Quantity, FRFUnits]:
    """Quantity and units from a text such as ``m/N``, ``mm/(N s)``, ``(m/s^2)/N``, ``g/lbf`` or ``1/kg``.

    The unit is that of translations under forces. Rotations are in rad, a moment is in the unit of force times that of
    length; with accelerations in g, lengths are metres.

    Raises
    ------
    InputError
        For a text that is no such unit.
    """
    bare = "".join(c for c in text.replace("²", "2").replace("μ", "µ") if c not in " ()^*·")
    if bare == "1/kg":
        return "accelerance", FRFUnits()
    for force, newtons in FORCES.items():
        if bare == f"g/{force}":
            return "accelerance", FRFUnits(GRAVITY, 1.0, newtons)
        for length, metres in LENGTHS.items():
            for quantity, powers in _POWERS.items():
                for power in powers:
                    if bare in (f"{length}/{power}/{force}", f"{length}/{force}/{power}", f"{length}/{force}{power}"):
                        return quantity, FRFUnits(metres, metres, newtons)
    raise InputError(
        f"the unit {text[:40]!r} is unknown", place=place,
        remedy="write a motion over a force, such as m/N, mm/N, (m/s)/N, (m/s2)/N, g/N or g/lbf",
    )  # fmt: skip


def parse_length_unit(text: str | None, place: str | Path | Place = "length_unit") -> float | None:
    """Metres per unit of length, such as ``mm``; None for None. InputError for a text that is no such unit."""
    if text is None or text in LENGTHS:
        return None if text is None else LENGTHS[text]
    raise InputError(f"the unit of length {text!r:.40} is unknown", place=place, remedy=f"one of {', '.join(LENGTHS)}")
