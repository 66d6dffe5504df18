"""Section on recommended measurements and their expected gain."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from calib.report.html.page import Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, significant
from calib.report.verification import best_candidates

_OF_NAMED = 5
"""Rows of the table for the named effects: the recommended measurement and what else was looked at."""


def section(results: StudyResults) -> Section | None:
    """Candidate measurements by expected gain."""
    gains = [f"{name}{end}" for name in ("gain", "ln_bayes") for end in ("", "_low", "_high")]
    numbers = [*gains, "magnitude_min"]
    table = results.table(
        "next_measurement", ["measurement", "kind"], [*numbers, "chance"], unbounded=numbers, blank=["effect"]
    )
    if table is None:
        return None
    best = best_candidates(table)
    competing = table["ln_bayes"].notna().any()
    heads = (
        "measurement",
        "kind",
        "for the effect",
        "score",
        "smallest visible then",
        *(["expected ln Bayes factor of the true effect", "probability of more than 20:1"] if competing else []),
    )
    first = best.to_dict("records")[0]
    largest = f"Largest gain: {first['measurement']} (× {fixed(first['gain'], 1)} in the score of {first['effect']})."
    intro = (
        "Expected gain of each candidate measurement, computed with the model and averaged over the uncertainty of "
        "parameters and magnitudes; ranges in brackets hold in 8 of 10 cases. Held-out data that the fit uses no "
        "longer verify the result."
    )
    caption = f"The {len(best)} best candidate measurements, each for the effect whose score it raises most."
    return Section(
        "next",
        "Recommended measurements",
        (
            Words(f"{intro} {largest}"),
            *results.picture("next_measurement", caption, f"Bars. {largest}"),
            *_of_named(table, results.explanation.get("chosen", []), heads, bool(competing)),
            Table("Candidate measurements, best first", heads, _rows(best, bool(competing)), (1, 2)),
        ),
    )


def _of_named(table: pd.DataFrame, named: Sequence[str], heads: tuple[str, ...], competing: bool) -> list[Table]:
    """What narrows the magnitude of the named effects most; with competing models the other table tells it."""
    own = table[table["effect"].isin(list(named))].sort_values("gain", ascending=False, kind="stable").head(_OF_NAMED)
    if own.empty or competing:
        return []
    caption = f"Candidate measurements for {' and '.join(map(str, named))}, best first"
    return [Table(caption, heads, _rows(own, competing), (1, 2), unfolded=True)]


def _rows(table: pd.DataFrame, competing: bool) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            str(r["measurement"]),
            str(r["kind"]),
            str(r["effect"]),
            f"× {fixed(r['gain'], 2)} ({fixed(r['gain_low'], 2)} to {fixed(r['gain_high'], 2)})",
            "never" if np.isinf(r["magnitude_min"]) else significant(r["magnitude_min"], 2),
            *([_bayes_factor(r), f"{fixed(100 * r['chance'], 0)} %"] if competing else []),
        )
        for r in table.to_dict("records")
    )


def _bayes_factor(row: Mapping[Hashable, Any]) -> str:
    """Bayes factor (natural logarithm) with its range."""
    return f"{fixed(row['ln_bayes'], 1)} ({fixed(row['ln_bayes_low'], 1)} to {fixed(row['ln_bayes_high'], 1)})"
