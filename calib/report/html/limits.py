"""Key to the p-values and limits of an explanation's page: what each limit is, and what lies beyond it."""

from __future__ import annotations

import pandas as pd

from calib.report.explanation import LEAST_BAYES_FACTOR, only_predicted, threshold
from calib.report.html.page import Table
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag

TESTS = {
    "p_family": "all effects and local perturbations, jointly",
    "p_fit": "worst kind of data or mode shape of the base model",
    "adequacy_p_family": "all others jointly, after adding the named or attempted effects",
    "adequacy_p_fit": "worst kind of data or mode shape after adding them",
}
"""The tests of an explanation, in words."""
BEYOND = "beyond measurement uncertainty"
"""Verdict of such a comparison in ``where_it_fails_*.csv``."""
WITHIN = 0.95
"""Share of the comparisons of a correctly specified model that lie within their limit."""
BY_CHANCE = 0.01
"""Probability that noise alone takes any pull, or any score, beyond its limit."""
CONTRADICTED = 0.001
"""p-value below which held-out data contradict a model."""
NONE = "none"


def key(results: StudyResults) -> list[Table]:
    """The key, for the first section with such numbers; none without an explanation."""
    if not results.explanation:
        return []
    rows = (*_p(results), *_comparisons(results), *_pulls(results), *_evidence(results), *_scores(results))
    heads = ("number", "limit", "what the limit is", "beyond it")
    return [Table("Key to p-values and limits", heads, rows, (1, 2, 3), unfolded=True)]


def _p(results: StudyResults) -> list[tuple[str, ...]]:
    alpha = results.explanation.get("alpha")
    if alpha is None:
        return []
    known = {words: results.explanation.get(name) for name, words in TESTS.items()}
    below = [words for words, p in known.items() if p is not None and float(p) <= float(alpha)]
    meaning = (
        "p is the probability that noise alone takes data of a correctly specified model at least this far off; at or "
        "below the limit the model is rejected. Of the worst kind of data or mode shape it is corrected for their "
        "number (Bonferroni); of a group of data, in the table of errors, it is that of the whole sum of squares, in "
        f"which one bad kind may not show. Held-out data contradict the model below {CONTRADICTED:g}"
    )
    return [("p-value", f"{alpha:g}", meaning, "; ".join(below) or NONE)]


def _comparisons(results: StudyResults) -> list[tuple[str, ...]]:
    tables = {
        stage: table
        for stage in results.stages
        if (table := results.table(f"where_it_fails_{stage}", ["kind", "what", "verdict"], ["in_std"])) is not None
    }
    if not tables:
        return []
    counts = [
        f"{int((table['verdict'] == BEYOND).sum())} of {len(table)}, {results.in_words(stage)}"
        for stage, table in tables.items()
    ]
    meaning = (
        f"{100 * WITHIN:g} % of the comparisons of a correctly specified model lie within it. It is about 2 for a "
        "single number, and nearer to 1 for a shape or a sensor, of which the rms of many numbers counts; the table of "
        "every comparison tells the limit of each"
    )
    return [("comparison, in standard deviations σ", "about 2 σ", meaning, "; ".join(counts))]


def _pulls(results: StudyResults) -> list[tuple[str, ...]]:
    table = results.table("pulls", ["model", "parameter"], ["limit"], flags=["pulled"])
    if table is None:
        return []
    limits = sorted({fixed(limit, 1) for limit in table["limit"].astype(float).dropna()})
    pulled = [f"{r['parameter']} ({r['model']})" for r in table.to_dict("records") if flag(r["pulled"])]
    count = int((table["model"] == table["model"].iloc[0]).sum())
    meaning = (
        f"noise alone pulls any of the {count} parameters further in {100 * BY_CHANCE:g} % of all cases; a parameter "
        "beyond it stands in for something that the model lacks"
    )
    return [("pull of a parameter", f"± {' or '.join(limits)}", meaning, ", ".join(pulled) or NONE)]


def _evidence(results: StudyResults) -> list[tuple[str, ...]]:
    flags, blank = ["credible", "refitted"], ["stands_for"]
    table = results.table("effects", ["name"], ["ln_bayes"], flags=flags, blank=blank)
    if table is None:
        return []
    limit, count = threshold(len(table)), len(table)
    beyond = table[table["ln_bayes"] > limit].sort_values("ln_bayes", ascending=False, kind="stable")
    credible, predicted = beyond["credible"].map(flag).astype(bool), only_predicted(table)[beyond.index]
    groups = {
        "": credible,
        "not credible: ": ~credible & ~predicted,
        "not credible, linear prediction only: ": predicted,
    }
    told = [f"{words}{', '.join(map(str, beyond.loc[some, 'name']))}" for words, some in groups.items() if some.any()]
    meaning = (
        f"an effect is named only above it: {LEAST_BAYES_FACTOR:g} for odds of 20 to 1, and ln {count} for the choice "
        f"among {count}, the best of which fits noise too"
    )
    return [("ln Bayes of an effect", fixed(limit, 1), meaning, "; ".join(told) or NONE)]


def _scores(results: StudyResults) -> list[tuple[str, ...]]:
    table = results.perturbations
    if table is None:
        return []
    limit, known = float(table["limit"].iloc[0]), int(table["score"].notna().sum())
    meaning = (
        f"noise alone takes any of the {known} scores further in at most {100 * BY_CHANCE:g} % of all cases; one "
        "beyond it is a place to inspect"
    )
    return [("score z of a local perturbation", f"± {fixed(limit, 1)}", meaning, _counted(table, limit))]


def _counted(table: pd.DataFrame, limit: float) -> str:
    count = int((table["score"].abs() > limit).sum())
    return f"{count} of {len(table)}" if count else NONE
