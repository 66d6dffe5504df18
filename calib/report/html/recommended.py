"""Section on recommended measurements and their expected gain."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from calib.report.html.page import Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, with_unit
from calib.report.verification import best_candidates

_OF_NAMED = 5
"""Rows of the table for the named effects: the recommended measurement and what else was looked at."""


def section(results: StudyResults) -> Section | None:
    """Candidate measurements by expected gain."""
    gains = [f"{name}{end}" for name in ("gain", "ln_bayes") for end in ("", "_low", "_high")]
    table = results.table(
        "next_measurement", ["measurement", "kind"], [*gains, "chance"], unbounded=gains, blank=["effect"]
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
            *([] if competing else _of_named(table, results, heads)),
            Table("Candidate measurements, best first", heads, _rows(best, bool(competing)), (1, 2)),
        ),
    )


def _of_named(table: pd.DataFrame, results: StudyResults, heads: tuple[str, ...]) -> list[Table]:
    """What narrows the magnitude of the named effects most; with competing models the other table tells it."""
    named = list(map(str, results.explanation.get("chosen", [])))
    own = table[table["effect"].isin(named)].sort_values("gain", ascending=False, kind="stable").head(_OF_NAMED)
    if own.empty:
        return []
    caption = f"Candidate measurements for {' and '.join(named)}, best first"
    now = results.table("effects", ["name"], ["magnitude_low", "magnitude_high"], blank=["unit"])
    if now is None:
        return [Table(caption, heads, _rows(own, False), (1, 2), unfolded=True)]
    widths = {r["name"]: (r["magnitude_high"] - r["magnitude_low"], str(r["unit"])) for r in now.to_dict("records")}
    told = [
        (*row, f"{with_unit(width, unit, 2)} wide, then about {with_unit(width / gain, unit, 2)}")
        for row, (width, unit), gain in zip(_rows(own, False), own["effect"].map(widths), own["gain"], strict=True)
    ]
    return [Table(caption, (*heads, "95 % interval"), tuple(told), (1, 2), unfolded=True)]


def _rows(table: pd.DataFrame, competing: bool) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            str(r["measurement"]),
            str(r["kind"]),
            str(r["effect"]),
            f"× {fixed(r['gain'], 2)} ({fixed(r['gain_low'], 2)} to {fixed(r['gain_high'], 2)})",
            *([_bayes_factor(r), f"{fixed(100 * r['chance'], 0)} %"] if competing else []),
        )
        for r in table.to_dict("records")
    )


def _bayes_factor(row: Mapping[Hashable, Any]) -> str:
    """Bayes factor (natural logarithm) with its range."""
    return f"{fixed(row['ln_bayes'], 1)} ({fixed(row['ln_bayes_low'], 1)} to {fixed(row['ln_bayes_high'], 1)})"
