"""Verdict that the measurement is what does not fit, in words."""

from __future__ import annotations

import pandas as pd

from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.local import fault_words
from calib.missing.recommendation import as_ratio
from calib.missing.verdict_words import (
    WORST,
    Words,
    counted_faults,
    ended,
    fit_in_short,
    lowered,
    without,
    without_in_short,
)
from calib.missing.worst_misfit import p_words


def on_measurement(found: Explanation, effects: pd.DataFrame) -> Words:
    """A fault of the measurement is named: which, how sure that is, what to check."""
    assert found.fault is not None and found.fault_adequacy is not None
    (e,) = found.fault.effects
    first, *others = [fault_words(t) for t in found.blamed] or [fault_words(found.fault)]
    also = f" As well explained by: {'; '.join(others)}." if others else ""
    best = found.singles[0] if found.singles else None
    against = f" The best effect, {best.names[0]}, is {_behind(found, best)}." if best is not None else ""
    after = found.fault_adequacy
    return Words(
        f"The measurement is what does not fit: {first}: {lowered(ended(e.look_for))}{also}",
        f"Its log Bayes factor is {found.ln_bayes(found.fault):.1f} against the model without any fault or effect, "
        f"chosen among {counted_faults(found)}.{against} {without_in_short(found)} "
        f"{fit_in_short(after, found.alpha)}",
        "Correct the measurement, or take it out, before the model is changed; nothing is added to the model.",
        (
            without(found),
            f"With it no effect or place stands out ({p_words(after.p_family)}), and {WORST} has "
            f"{p_words(after.p_fit)}.",
            f"It takes for granted: {ended(e.lacks)}",
        ),
    )


def _behind(found: Explanation, best: CandidateFit) -> str:
    """How much worse the best effect is than the named fault, in words."""
    assert found.fault is not None
    ln = found.fault.ln_evidence - best.ln_evidence
    return f"behind it by odds of {as_ratio(ln)}" if ln > 0 else "no better once the number of candidates is counted"
