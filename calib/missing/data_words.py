"""What data that no fit has seen say of a verdict, and what these data cannot show; in words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import pandas as pd

from calib.missing.adequacy import UNSEEN, contradicting
from calib.missing.goodness import p_words
from calib.missing.recommendation import rounded
from calib.missing.rules import RULES
from calib.missing.tables import UNTESTED
from calib.problem.parameter import unit_words
from calib.results.answer import hertz, in_prose

GROUPS = {"left_out": "data left out in turn", **UNSEEN}
"""Groups of data that a fit has not seen, in words."""
_OF_A_MODE = ("frequency", "damping", "shape")
"""What a sentence names of a mode."""


def for_readers(words: str, effects: Iterable[str], freqs: Mapping[str, float]) -> str:
    """A text as somebody reads it who does not know the tables.

    Parameters
    ----------
    words : str
    effects : iterable of str
        Identifiers of effects, which become words.
    freqs : mapping from str to float
        Measured frequency of each mode, Hz, which is added where the text first names the mode.
    """
    for name in effects:
        words = re.sub(rf"\b{re.escape(name)}\b", in_prose(name), words) if "_" in name else words
    for mode, freq in freqs.items():
        named = rf"((?<!model )\b(?:mode|(?:{'|'.join(_OF_A_MODE)}) of) {re.escape(mode)})(?![\w-]|[.]\w)(?! \()"
        words = re.sub(named, rf"\1 ({hertz(freq)})", words, count=1)
    return words


def contradicted_words(errors: pd.DataFrame) -> list[str]:
    """Held-out data that contradict the best attempt, in words."""
    numbers = {(str(r["group"]), str(r["stage"])): r for r in errors.to_dict("records")}
    against = contradicting(errors, "attempt")
    if not against:
        return []
    phrases = []
    for group in against:
        before, after = numbers[group, "before"], numbers[group, "attempt"]
        phrases.append(
            f"{GROUPS[group]} {float(before['rms']):.2f} -> {float(after['rms']):.2f} (noise floor "
            f"{float(after['expected']):.2f}, {p_words(float(after['p']))})"
        )
    return [
        f"Error in standard deviations: {', '.join(phrases)}. Either it stands in for something else, or these data "
        "are themselves in error: check them before it is added."
    ]


def error_words(errors: pd.DataFrame) -> list[str]:
    """Errors before and after in standard deviations, in words, and whether data left out are predicted worse."""
    numbers = {(str(r["group"]), str(r["stage"])): r for r in errors.to_dict("records")}
    phrases, worse = [], []
    for group, label in GROUPS.items():
        if (group, "before") not in numbers or (group, "after") not in numbers:
            continue
        before, after = float(numbers[group, "before"]["rms"]), float(numbers[group, "after"]["rms"])
        floor = float(numbers[group, "after"]["expected"])
        phrases.append(f"{label} {before:.2f} -> {after:.2f} (noise floor {floor:.2f})")
        # The error must be significantly larger: a correctly specified model must rarely predict as badly.
        if after > before and float(numbers[group, "after"]["p"]) < RULES.contradicted:
            worse.append(label)
    if not phrases:
        return []
    out = ["Error in standard deviations, of the fits behind this answer: " + ", ".join(phrases) + "."]
    if worse:
        out.append(f"It fits better but predicts no better: {', '.join(worse)} got worse.")
    return out


def unseen_words(effects: pd.DataFrame, chosen: Sequence[str]) -> list[str]:
    """Effects that these data would not show and those not tested, without the chosen ones; in words."""
    phrases, blind = [], ~effects["visible"].astype(bool) & ~effects["name"].isin(chosen)
    untested = effects["implausible"] == UNTESTED
    for row in effects[blind & ~untested & effects["magnitude_min"].notna()].to_dict("records"):
        unit, least = unit_words(str(row["unit"])), float(row["magnitude_min"])
        possible = least <= float(row["largest"])
        phrases.append(
            f"{row['name']} below {rounded(least)}{unit}" if possible else f"{row['name']} of any possible magnitude"
        )
    out = ["Not visible with these data: " + ", ".join(phrases) + "."] if phrases else []
    failing = effects.loc[blind & ~untested & effects["magnitude_min"].isna(), "name"]
    if len(failing):
        out.append("Not visible as far as the model can be evaluated with them: " + ", ".join(failing) + ".")
    if untested.any():
        out.append("Not tested, since the model fails with it: " + ", ".join(effects.loc[untested, "name"]) + ".")
    return out
