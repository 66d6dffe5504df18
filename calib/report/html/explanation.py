"""What the page tells of an explanation: tests, steps, faults of the measurement, proposals, what to measure."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from calib.report.html.cells import TextCells, arrows, flagged
from calib.report.html.fails import TESTS
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, significant, with_unit
from calib.report.proposals import placed_proposals
from calib.report.verification import GROUPS, best_candidates

_HEAVIEST = 0.5
"""Mass in kg that no accelerometer with its mount and cable exceeds."""
_OF_NAMED = 5
"""Rows of the table for the named effects: the recommended measurement and what else was looked at."""


def tests(results: StudyResults) -> dict[str, float]:
    """The p-values of the explanation that are known, by what was tested."""
    known = {words: results.explanation.get(name) for name, words in TESTS.items()}
    return {words: float(p) for words, p in known.items() if p is not None}


def sentences(results: StudyResults) -> list[str]:
    """The verdict and what supports it, less the sentence that stands at the top of the page."""
    explanation = results.explanation
    first, *more = explanation.get("sentences", [explanation.get("sentence", "")])
    at_top = arrows(results.answer("explain").get("sure", ""))
    return [arrows(str(first)), *(words for sentence in more if (words := arrows(str(sentence))) != at_top)]


def errors_of_steps(table: pd.DataFrame) -> str:
    """The error of every group of data, step by step."""
    by_group = {group: table[table["group"] == group].sort_values("step")["rms"] for group in GROUPS}
    known = {group: rms for group, rms in by_group.items() if len(rms)}
    return "; ".join(f"{GROUPS[group]} {' → '.join(fixed(value, 2) for value in rms)}" for group, rms in known.items())


def named_faults(table: pd.DataFrame) -> str:
    """Which faults the verdict names, and how many scores are beyond their limit."""
    blamed = flagged(table, "blamed")["told"]
    beyond = int((table["score"].abs() > table["limit"]).sum())
    if len(blamed):
        return f"The verdict names {'; or '.join(blamed)}."
    if beyond:
        scores = f"{beyond} of {len(table)} scores lie beyond their limit"
        return f"No measurement error is named; {scores}: what the model lacks takes some of them along."
    return "No measurement error is named, and none stands out."


def faults_in_words(table: pd.DataFrame) -> list[str]:
    """What the fit of each fault means, and which magnitudes no measurement can have."""
    heavy = f"impossible: an accelerometer with its mount weighs less than {with_unit(_HEAVIEST, 'kg')}"
    known = zip(table["kind"], table["magnitude"], table["told"].fillna(""), strict=True)
    return TextCells(heavy if kind == "mass" and size > _HEAVIEST else str(told) for kind, size, told in known)


def places_of_proposals(results: StudyResults) -> str:
    """Rank and place of the proposals in the figure."""
    table = results.table("proposal_places")
    assert table is not None
    named = flagged(placed_proposals(table), "fitted").drop_duplicates("rank")
    return "; ".join(f"{r['rank']:.0f}: {r['kind']}, {r['at']}" for r in named.to_dict("records"))


def magnitudes_of_proposals(table: pd.DataFrame) -> list[str]:
    """Fitted magnitudes with their intervals, and natural frequencies of hung masses."""
    return [_magnitude(r) for r in table.to_dict("records")]


def _magnitude(r: Mapping[Hashable, Any]) -> str:
    size = f"{with_unit(r['magnitude'], str(r['unit']))} ({significant(r['lower'], 3)} to {significant(r['upper'], 3)})"
    return size if r["freq"] != r["freq"] else f"{size}, at {with_unit(r['freq'], 'Hz')}"


def first_alike(alike: pd.Series) -> list[str]:
    """The first three of each list of effects that the data cannot discriminate."""
    every = [str(names).split("; ") for names in alike]
    return ["; ".join(names[:3]) + (" …" if len(names) > 3 else "") for names in every]


@dataclass(frozen=True, eq=False)
class CandidateMeasurements:
    """Candidate measurements by expected gain.

    Attributes
    ----------
    best : DataFrame
        The best of all.
    competing : bool
        Whether several models compete, so that a Bayes factor is expected.
    named : str
        The named effects.
    of_named : DataFrame
        What narrows their magnitudes most; empty with competing models, of which the other table tells it.
    widths : list of str
        For each row of it, how wide the interval of the magnitude is and would be; empty where that is not known.
    """

    best: pd.DataFrame
    competing: bool
    named: str
    of_named: pd.DataFrame
    widths: list[str]


def candidate_measurements(results: StudyResults) -> CandidateMeasurements | None:
    """The candidate measurements; None where there are none."""
    table = results.table("next_measurement")
    if table is None:
        return None
    competing = bool(table["ln_bayes"].notna().any())
    named = list(map(str, results.explanation.get("chosen", [])))
    own = table[table["effect"].isin([] if competing else named)]
    own = own.sort_values("gain", ascending=False, kind="stable").head(_OF_NAMED)
    return CandidateMeasurements(best_candidates(table), competing, " and ".join(named), own, _widths(results, own))


def _widths(results: StudyResults, own: pd.DataFrame) -> list[str]:
    effects = results.table("effects")
    if effects is None:
        return []
    rows = effects.set_index("name")
    now = (rows["magnitude_high"] - rows["magnitude_low"]).reindex(own["effect"])
    units = rows["unit"].reindex(own["effect"])
    return [
        f"{with_unit(width, unit, 2)} wide, then about {with_unit(width / gain, unit, 2)}"
        for width, unit, gain in zip(now, units, own["gain"], strict=True)
    ]
