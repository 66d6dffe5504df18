"""What the page tells of the misfit: its limits, its worst comparisons, kinds, sensors and responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

from calib.report.explanation import LEAST_BAYES_FACTOR, only_predicted, threshold
from calib.report.html.cells import flagged
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, p_in_words
from calib.report.where import sensor_rms

TESTS = {
    "p_family": "all causes and local stiffness or mass changes, jointly",
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


class Limit(NamedTuple):
    """A number of the page with its limit: what the limit is, and what lies beyond it."""

    number: str
    limit: str
    meaning: str
    beyond: str


def limits(results: StudyResults) -> list[Limit]:
    """The key to p-values and limits, for the first section with such numbers; none without an explanation."""
    if not results.explanation:
        return []
    parts = (_p(results), _limit_of_comparisons(results), _pulls(results), _evidence(results), _scores(results))
    return [limit for limit in parts if limit is not None]


def _p(results: StudyResults) -> Limit | None:
    alpha = results.explanation.get("alpha")
    if alpha is None:
        return None
    known = {words: results.explanation.get(name) for name, words in TESTS.items()}
    below = [words for words, p in known.items() if p is not None and float(p) <= float(alpha)]
    meaning = (
        "p is the probability that noise alone takes data of a correct model at least this far off; at or "
        "below the limit the model is rejected. Of the worst kind of data or mode shape it is corrected for their "
        "number (Bonferroni); of a group of data, in the table of errors, it is that of the whole sum of squares, in "
        f"which one bad kind may not show. Validation data contradict the model below {CONTRADICTED:g}"
    )
    return Limit("p-value", f"{alpha:g}", meaning, "; ".join(below) or NONE)


def _limit_of_comparisons(results: StudyResults) -> Limit | None:
    tables = results.of_stages("where_it_fails")
    if not tables:
        return None
    counts = [
        f"{int((table['verdict'] == BEYOND).sum())} of {len(table)}, {results.in_words(stage)}"
        for stage, table in tables.items()
    ]
    meaning = (
        f"{100 * WITHIN:g} % of the comparisons of a correct model lie within it. It is about 2 for a "
        "single number, and nearer to 1 for a shape or a sensor, of which the rms of many numbers counts; the table of "
        "every comparison tells the limit of each"
    )
    return Limit("comparison, in standard deviations σ", "about 2 σ", meaning, "; ".join(counts))


def _pulls(results: StudyResults) -> Limit | None:
    table = results.table("pulls")
    if table is None:
        return None
    sizes = sorted({fixed(limit, 1) for limit in table["limit"].astype(float).dropna()})
    pulled = [f"{r['parameter']} ({r['model']})" for r in flagged(table, "pulled").to_dict("records")]
    count = int((table["model"] == table["model"].iloc[0]).sum())
    meaning = (
        f"noise alone shifts any of the {count} parameters further in {100 * BY_CHANCE:g} % of all cases; a parameter "
        "beyond it stands in for something that the model lacks"
    )
    return Limit(
        "shift of a parameter over its expected deviation",
        f"± {' or '.join(sizes)}",
        meaning,
        ", ".join(pulled) or NONE,
    )


def _evidence(results: StudyResults) -> Limit | None:
    table = results.table("effects")
    if table is None:
        return None
    limit, count = threshold(len(table)), len(table)
    beyond = table[table["ln_bayes"] > limit].sort_values("ln_bayes", ascending=False, kind="stable")
    credible, predicted = beyond["credible"].map(flag).astype(bool), only_predicted(table)[beyond.index]
    groups = {
        "": credible,
        "ruled out: ": ~credible & ~predicted,
        "ruled out, linear prediction only: ": predicted,
    }
    named = [f"{words}{', '.join(map(str, beyond.loc[some, 'name']))}" for words, some in groups.items() if some.any()]
    meaning = (
        f"an effect is named only above it: {LEAST_BAYES_FACTOR:g} for odds of 20 to 1, and ln {count} for the choice "
        f"among {count}, the best of which fits noise too"
    )
    return Limit("evidence of an effect", fixed(limit, 1), meaning, "; ".join(named) or NONE)


def _scores(results: StudyResults) -> Limit | None:
    table = results.table("perturbations")
    if table is None:
        return None
    limit, known = float(table["limit"].iloc[0]), int(table["score"].notna().sum())
    count = int((table["score"].abs() > limit).sum())
    meaning = (
        f"noise alone takes any of the {known} scores further in at most {100 * BY_CHANCE:g} % of all cases; one "
        "beyond it is a place to inspect"
    )
    beyond = f"{count} of {len(table)}" if count else NONE
    return Limit("score z of a local stiffness or mass change", f"± {fixed(limit, 1)}", meaning, beyond)


@dataclass(frozen=True, eq=False)
class Comparisons:
    """Comparisons over their standard deviations.

    Attributes
    ----------
    table : DataFrame
        Those of the last stage.
    stages : list of (heading, cells)
        Columns of the page, one for each stage.
    newest : str
        The last stage in words.
    first : str
        The worst comparison of the first stage in words; empty where none has a standard deviation.
    """

    table: pd.DataFrame
    stages: list[tuple[str, list[str]]]
    newest: str
    first: str


def comparisons(results: StudyResults) -> Comparisons | None:
    """Comparisons of every stage, those of the last one in their order; None where there are none."""
    tables = results.of_stages("where_it_fails")
    if not tables:
        return None
    newest = list(tables)[-1]
    in_std = pd.concat({stage: t.set_index(["kind", "what"])["in_std"] for stage, t in tables.items()}, axis=1)
    in_std = in_std.loc[list(tables[newest][["kind", "what"]].itertuples(index=False, name=None))]
    stages = [(f"{results.in_words(stage)}, σ", [fixed(value, 2) for value in in_std[stage]]) for stage in tables]
    known, first = next(iter(tables.values())).dropna(subset=["in_std"]), ""
    if not known.empty:
        worst = known.sort_values("in_std", ascending=False, kind="stable").iloc[0]
        first = f"{worst['kind']} {worst['what']}, {fixed(worst['in_std'], 1)} times its standard deviation"
    return Comparisons(tables[newest], stages, results.in_words(newest), first)


def least_likely(results: StudyResults) -> str | None:
    """The three kinds of data that the base model fits worst, in words."""
    table = results.table("misfit_kinds")
    if table is None:
        return None
    base = table[table["stage"] == "base"].replace({"kind": {"freq": "frequency"}}).sort_values("p")
    return ", ".join(f"{r['kind']} of {r['mode']} (p {p_in_words(r['p'])})" for r in base.head(3).to_dict("records"))


def sensors(results: StudyResults) -> list[str] | None:
    """The misfit at every sensor in words, the worst first."""
    table = results.table("sensor_misfit")
    if table is None or not (table["stage"] == "base").any():
        return None
    found = sensor_rms(table[table["stage"] == "base"]).dropna()
    return [f"{r['sensor']}: {fixed(r['rms'], 2)} times its standard deviation" for r in found.to_dict("records")]


def worst_response(results: StudyResults) -> str | None:
    """The response of the largest residual, in words."""
    table = results.table("response_misfit")
    if table is None:
        return None
    base = table[table["stage"] == "base"].set_index("response")["residual"].abs()
    return f"{base.idxmax()}, {fixed(base.max(), 1)} σ" if len(base) else "unknown"


def worst_function(results: StudyResults) -> str | None:
    """The FRF of the largest residuals at the last stage, in words."""
    table = results.table("frf_misfit")
    if table is None:
        return None
    size = (table["re"] ** 2 + table["im"] ** 2).groupby([table["stage"], table["function"]], sort=False).mean() / 2
    latest = size[str(table["stage"].iloc[-1])]
    return f"{latest.idxmax()}, {fixed(float(latest.max()) ** 0.5, 2)}"


def suspect_data(results: StudyResults) -> pd.DataFrame | None:
    """Suspect data, without any one of which all other data fit; None where there are none.

    Calibration and explanation both fit the base model to the same data: a suspect of both is told once.
    """
    tables = [
        flagged(table, "explains")
        for name in ("suspects_explained", "suspects_calibrated")
        if (table := results.table(name)) is not None
    ]
    return pd.concat(tables).drop_duplicates("what") if tables else None
