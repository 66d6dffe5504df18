"""Numbers for readers: rounded, with a true minus sign, and a dash for unknown values."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from calib.results.answer import signed

UNKNOWN = "–"


def fixed(value: float, digits: int, sign: bool = False) -> str:
    """Format with so many digits after the decimal point."""
    if value is None or math.isnan(value):
        return UNKNOWN
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    value = round(value, digits) + 0.0  # no negative zero
    words = signed(value, digits) if sign else f"{value:.{digits}f}"
    return words.replace("-", "−")


def percent(share: float | None, digits: int = 2, sign: bool = False) -> str:
    """Format a fraction in percent, without the unit."""
    return fixed(math.nan if share is None else 100.0 * share, digits, sign)


def significant(value: float, digits: int = 4) -> str:
    """Format with so many significant digits; with an exponent only for very small and very large numbers."""
    if value is None or math.isnan(value):
        return UNKNOWN
    if math.isinf(value) or value == 0:
        return fixed(value, 0)
    if float(value).is_integer() and abs(value) < 1e7:
        return fixed(value, 0)
    size = math.floor(math.log10(abs(value)))
    if -4 <= size < 7:
        return fixed(round(value, digits - 1 - size), max(0, digits - 1 - size))
    return f"{value:.{digits - 1}e}".replace("-", "−")


def short(value: float) -> str:
    """Format with three significant digits and without zeros at the end, for a number in a figure."""
    words = significant(value, 3)
    return f"{value:.3g}".replace("-", "−") if math.isfinite(value) and 1e-4 <= abs(value) < 1e3 else words


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """Format a number with its unit, if it has one."""
    words = significant(value, digits)
    return words if unit in ("", "-", UNKNOWN) or words == UNKNOWN else f"{words} {unit}"


def labels_with_units(units: Mapping[str, str]) -> dict[str, str]:
    """Labels of axes, such as ``k1, MN/m``, for the names that have a unit."""
    return {name: f"{name}, {unit}" for name, unit in units.items() if unit not in ("", "-")}


def magnitude_in_words(r: Mapping[Hashable, Any], level: str = "") -> str:
    """Format a fitted magnitude with its interval of 95 %, which ``level`` may say, such as ``64.1 kg (54.0 to 74.2)``.

    ``r`` has ``magnitude, magnitude_low, magnitude_high, unit``.
    """
    low, high = (significant(r[f"magnitude_{end}"], 3) for end in ("low", "high"))
    return f"{with_unit(r['magnitude'], str(r['unit']))} ({level}{low} to {high})"


def p_in_words(p: float) -> str:
    """Format a probability."""
    if p is None or math.isnan(p):
        return UNKNOWN
    return "< 0.001" if p < 1e-3 else "> 0.99" if p > 0.99 else f"{p:.2g}"


def probability(share: float) -> str:
    """A probability as a verdict states it, which claims no certainty: in whole percent, within 1 and 99."""
    if math.isnan(share):
        return UNKNOWN
    return "> 99 %" if share > 0.99 else "< 1 %" if share < 0.01 else f"{100 * share:.0f} %"


def counted(number: int, thing: str) -> str:
    """Format a count with its noun in singular or plural."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def flag(value: Any) -> bool:
    """A flag; unknown counts as no."""
    return bool(value) if value is not None and value == value else False


def yes(value: Any, words: tuple[str, str] = ("yes", "no")) -> str:
    """Format a flag; a dash where it is unknown."""
    if value is None or value != value:
        return UNKNOWN
    return words[0] if value else words[1]


def place(coordinates: Sequence[float]) -> str:
    """Format x, y, z in m as ``(+1.11, 0.00, −0.43)``; a dash where one is unknown.

    Signs stand in any case: beside words such as left and front they say which way these point.
    """
    if not all(map(math.isfinite, coordinates)):
        return UNKNOWN
    return f"({', '.join(fixed(x, 2, sign=True) for x in coordinates)})"


def places(several: Sequence[Sequence[float]], most: int, between: str = " and ") -> str:
    """Format the first places, and tell how many more there are."""
    more = f" and {len(several) - most} more" if len(several) > most else ""
    return between.join(map(place, several[:most])) + more
