"""What the page tells of a calibration: its cases, its method, and what each test alone would determine."""

from __future__ import annotations

import pandas as pd

from calib.report.calibration import search_runs
from calib.report.correlation import STRONG, others, strongest
from calib.report.html.study_results import StudyResults
from calib.report.numbers import UNKNOWN, fixed, significant, with_unit

_NUMBERS = ("search_misfit", "misfit", "mean_freq_error_after", "mean_mac_after", "seconds")
_COUNTS = ("evaluations", "solved", "infeasible", "failed")

_STILL = 1e-6
"""Standard deviation over the frequency below which no fitted parameter moves a mode."""


def best_case(results: StudyResults) -> str:
    """The case whose values are reported."""
    table = results.table("parameters")
    assert table is not None
    return str(results.summary.get("best_case", table["case"].iloc[0]))


def method(results: StudyResults) -> str:
    """How the parameters were searched, in words."""
    cases, table = results.summary.get("cases", {}), results.table("parameters")
    if all(case.get("search_misfit") is None for case in cases.values()):
        return "least squares from several starting points"
    refined = table is not None and table["search_value"].notna().any()  # known where least squares followed
    return "a genetic algorithm, then least squares" if refined else "a genetic algorithm alone"


def cases(results: StudyResults) -> pd.DataFrame | None:
    """Seed, misfit, errors and evaluations of every case; None where they are not recorded."""
    seeds = results.analyses.get("calibrate", {}).get("seeds", {})
    rows = [
        {
            "case": name,
            "seed": str(seeds.get(name, UNKNOWN)),
            **{number: float("nan") if (value := case.get(number)) is None else value for number in _NUMBERS},
            **{count: str(case.get(count, UNKNOWN)) for count in _COUNTS},
        }
        for name, case in results.summary.get("cases", {}).items()
    ]
    return pd.DataFrame(rows) if rows else None


def columns_by_test(results: StudyResults) -> list[tuple[str, list[str]]] | None:
    """Columns of what each of several tests alone would determine."""
    table = results.table("std_by_test")
    if table is None:
        return None
    prior = table.drop_duplicates("parameter").set_index("parameter")
    std = table.pivot(index="parameter", columns="test", values="std").reindex(prior.index)
    units = zip(prior["prior_sd"], prior["unit"], strict=True)
    return [
        ("parameter", list(map(str, prior.index))),
        ("prior", [with_unit(value, str(unit), 3) for value, unit in units]),
        *((str(test), [significant(value) for value in std[test]]) for test in dict.fromkeys(table["test"])),
    ]


def ends_of_searches(results: StudyResults) -> str:
    """The lowest misfit of every search."""
    table = results.table("convergence")
    assert table is not None
    runs = search_runs(table).groupby("case", sort=False)
    return "; ".join(f"{case} {significant(rows['best'].iloc[-1])}" for case, rows in runs)


def correlation_words(table: pd.DataFrame) -> str:
    """The strong correlations of parameters, and how large the others are."""
    strong = strongest(table, STRONG).to_dict("records")
    words = [f"{r['parameter_a']}, {r['parameter_b']} {fixed(r['value'], 2)}" for r in strong]
    return "; ".join(filter(None, [*words, others(table, STRONG)]))


def moved(predictions: pd.DataFrame, column: str) -> pd.Series:
    """A column of the predicted frequencies; NaN for a mode that no fitted parameter moves, which has none."""
    return predictions[column].where(predictions["std"] > _STILL * predictions["natural_freq"])
