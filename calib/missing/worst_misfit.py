"""Where a fit is worst: sensor, mode, kind of data, and the repeats that disagree there."""

from __future__ import annotations

import math

import pandas as pd

from calib.missing.candidate_fit import AdequacyTests
from calib.missing.rules import RULES

_LEAST = 3 / RULES.samples
"""Smallest p-value that is stated: that of the samples, for the smallest of three tests (`AdequacyTests.p_family`)."""


def p_number(p: float) -> str:
    """A p-value as a number, down to the resolution of the samples."""
    return f"< {_LEAST:.1g}" if p < _LEAST else f"{p:.2g}"


def p_words(p: float) -> str:
    """A p-value, such as ``p = 0.03`` or ``p < 0.0004``."""
    return f"p {p_number(p)}" if p < _LEAST else f"p = {p_number(p)}"


def misfit_at(adequacy: AdequacyTests, disagreements: pd.DataFrame) -> dict[str, object]:
    """Where a fit is worst: ``sensor`` or scalar response, ``mode`` with its ``kind``; ``repeats`` that disagree."""
    sensor, mode = _worst(adequacy)
    return {
        "sensor": None if sensor is None else str(sensor["sensor"]),
        "mode": None if mode is None else str(mode["mode"]),
        "kind": None if mode is None else str(mode["kind"]),
        "repeats": worst_repeats(adequacy, disagreements),
    }


def worst_repeats(adequacy: AdequacyTests, disagreements: pd.DataFrame) -> list[str]:
    """Repeats that disagree with the others; first those that do where the fit is worst, then by how much."""
    sensor, mode = _worst(adequacy)
    places = {str(row[name]) for row, name in ((sensor, "sensor"), (mode, "mode")) if row is not None}
    here = disagreements[["sensor", "mode"]].isin(places).any(axis=1)
    order = disagreements.assign(here=here).sort_values(["here", "times"], ascending=False, kind="stable")
    return list(dict.fromkeys(order["repeat"].astype(str)))


def _worst(adequacy: AdequacyTests) -> tuple[pd.Series | None, pd.Series | None]:
    """Rows of the worst sensor and of the worst mode of a fit; None where it has none."""
    modes = adequacy.modes[adequacy.modes["mode"] != ""].sort_values("p", kind="stable")
    return (adequacy.sensors.iloc[0] if len(adequacy.sensors) else None, modes.iloc[0] if len(modes) else None)


def where(adequacy: AdequacyTests) -> str:
    """The worst sensor and the worst mode of a fit, each with its p-value, in words."""
    phrases = []
    worst, last = _worst(adequacy)
    if worst is not None:
        times = math.sqrt(float(worst["chi2"]) / max(float(worst["dof"]), 1.0))
        phrases.append(
            f"at {worst['sensor']} ({times:.1f} times its standard deviation, "
            f"{_of_many(worst['p'], len(adequacy.sensors))})"
        )
    if last is not None:
        count = int((adequacy.modes["mode"] != "").sum())
        phrases.append(f"in the {last['kind']} of mode {last['mode']} ({_of_many(last['p'], count)})")
    return " and ".join(phrases)


def _of_many(p: float, count: int) -> str:
    """p-value of the worst one of several, in words (Bonferroni)."""
    return f"{p_words(min(1.0, float(p) * count))} as the worst of {count}"
