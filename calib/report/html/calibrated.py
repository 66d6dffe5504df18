"""Section on the calibration: cases, identifiability of the parameters, and the calibrated model."""

from __future__ import annotations

import pandas as pd

from calib.report.calibration import search_runs
from calib.report.correlation import STRONG, others, strongest
from calib.report.html.compared import (
    error_picture,
    mac_picture,
    mode_table,
    orthogonality_blocks,
    plain_blocks,
    shapes_picture,
)
from calib.report.html.page import Block, Picture, Section, Table, Terms, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import counted, fixed, flag, percent, significant, with_unit, yes

TERMS = (
    ("case", "one search from its own random start; cases that end in different values have found no unique optimum"),
    (
        "misfit",
        "objective of the search: weighted relative frequency errors and 1 − MAC, or relative errors of responses",
    ),
    (
        "std",
        "posterior standard deviation of a parameter around the reported solution; where the model does not fit, with "
        "the measurement uncertainty scaled up to the misfit",
    ),
    (
        "identified",
        "the data give at least half of the information, std is at most 2.5 % of the search range, no search limit is "
        "active, and solutions that fit equally well do not differ in it",
    ),
    (
        "range, limit",
        "of a parameter: its search limits, between which the calibration varies it, and the range between them; the "
        "sensitivity may have others, see the table of the parameters of the model",
    ),
    (
        "seen",
        "one prior standard deviation of a combination of parameters changes the data by at least one of their stated "
        "standard deviations; a parameter can be seen and yet not be identified, with a wide std or a model that does "
        "not fit",
    ),
    ("spread", "largest difference of a parameter between the searches, before least squares, over its search range"),
)


def section(results: StudyResults) -> Section | None:
    """Cases, verdicts on the parameters, and the comparison after calibration."""
    table = results.table(
        "parameters",
        ["case", "parameter", "unit"],
        ["value", "lower", "upper", "ratio", "spread", "std", "search_value"],
        flags=["on_limit", "stable", "identified"],
    )
    if table is None:
        return None
    best = str(results.summary.get("best_case", table["case"].iloc[0]))
    cases = len(set(table["case"]))
    blocks: list[Block] = [
        Words(f"{counted(cases, 'case')} by {_method(results, table)}; the values of case {best} are reported."),
        *_of_all_tests(results),
        *_cases(results),
        *_points(results),
        *(Words(words, "reported") for words in results.sentences("calibrate")),
        Terms(TERMS),
        *_verdicts(results, best),
        *_by_test(results),
        *_parameter_picture(results, table, best),
        *_convergence(results),
        *_after(results, best),
        *_uncertainty(results),
    ]
    return Section("calibrated", "Calibration cases and identifiability", tuple(blocks))


def _method(results: StudyResults, parameters: pd.DataFrame) -> str:
    if not _searched(results):
        return "least squares from several starting points"
    refined = parameters["search_value"].notna().any()  # known where least squares followed
    return "a genetic algorithm, then least squares" if refined else "a genetic algorithm alone"


def _searched(results: StudyResults) -> bool:
    """Whether a genetic search ran."""
    return any(case.get("search_misfit") is not None for case in results.summary.get("cases", {}).values())


def _cases(results: StudyResults) -> list[Block]:
    cases = results.summary.get("cases", {})
    seeds = results.analyses.get("calibrate", {}).get("seeds", {})
    rows = tuple(
        (
            str(name),
            str(seeds.get(name, "–")),
            significant(_known(c.get("search_misfit"))),
            significant(_known(c.get("misfit"))),
            percent(_known(c.get("mean_freq_error_after"))),
            fixed(_known(c.get("mean_mac_after")), 4),
            *(str(c.get(count, "–")) for count in ("evaluations", "solved", "infeasible", "failed")),
            fixed(_known(c.get("seconds")), 0),
        )
        for name, c in cases.items()
    )
    criterion = "mean FRAC" if results.kind == "frf" else "mean MAC"
    heads = ("case", "seed", "misfit of the search", "misfit reported", "mean error, %", criterion, "requested",
             "solved", "infeasible", "failed", "time, s")  # fmt: skip
    return [Table("Calibration cases", heads, rows)] if rows else []


def _points(results: StudyResults) -> list[Block]:
    numbers = ["objective", "sum_of_squares", "prior", "total"]
    table = results.table("points", ["case", "point"], numbers)
    if table is None or table["point"].nunique() < 2:
        return []
    rows = tuple(
        (str(r["case"]), str(r["point"]), *(significant(r[name], 5) for name in numbers))
        for r in table.to_dict("records")
    )
    heads = ("case", "point", "objective of the search", "sum of squares", "prior term", "least-squares total")
    return [Table("Both criteria at the end of the search and of least squares, at full order", heads, rows, (1,))]


def _known(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _verdicts(results: StudyResults, best: str) -> list[Block]:
    numbers = ["value", "lower", "upper", "ratio", "std", "spread"]
    table = results.table("verdicts", ["parameter", "unit", "sentence"], numbers, flags=["identified"])
    if table is None:
        return []
    rows = tuple(
        (
            str(r["parameter"]),
            with_unit(r["value"], str(r["unit"]), 5),
            with_unit(r["std"], str(r["unit"]), 3),
            f"{significant(r['lower'])} to {significant(r['upper'])}",
            percent(r["ratio"], 0),
            percent(r["spread"], 0),
            yes(r["identified"]),
            str(r["sentence"]),
        )
        for r in table.to_dict("records")
    )
    heads = ("parameter", f"value in {best}", "std", "search limits", "position between them, %", "spread, %",
             "identified", "verdict")  # fmt: skip
    return [Table("Identifiability of the parameters", heads, rows, (6, 7))]


def _of_all_tests(results: StudyResults) -> list[Block]:
    """Says that the parameters are those of a joint fit: the page is that of one test."""
    joint = "All parameters below are fitted to all tests together; comparisons and errors are those of this test."
    return [Words(joint)] if results.has("std_by_test") else []


def _by_test(results: StudyResults) -> list[Block]:
    """What each of several tests alone would determine."""
    table = results.table("std_by_test", ["parameter", "unit", "test"], ["std", "prior_sd"])
    if table is None:
        return []
    tests = list(dict.fromkeys(table["test"]))
    rows = tuple(
        (
            str(name),
            with_unit(own["prior_sd"].iloc[0], str(own["unit"].iloc[0]), 3),
            *(significant(std) for std in own.set_index("test")["std"].reindex(tests)),
        )
        for name, own in table.groupby("parameter", sort=False)
    )
    caption = (
        "Standard deviations of the parameters from the data of each test alone, and from all tests, at the joint fit. "
        "Errors of different rows count as independent: where lines of FRFs share errors, such as places of sensors, "
        "the true standard deviations are larger."
    )
    return [Table(caption, ("parameter", "prior", *tests), rows)]


def _parameter_picture(results: StudyResults, table: pd.DataFrame, best: str) -> list[Picture]:
    bound = table[(table["case"] == best) & table["on_limit"].map(flag)]["parameter"].tolist()
    note = f"At a search limit: {', '.join(bound)}." if bound else "None is at a search limit."
    rows = table[table["case"] == best]
    positions = ", ".join(f"{n} {fixed(v, 2)}" for n, v in zip(rows["parameter"], rows["ratio"], strict=True))
    caption = (
        f"Calibrated parameters between their search limits: prior, value and 95 % interval of case {best}. {note}"
    )
    ends = "Ends of the searches, before least squares. Hatched: they differ by more than a tenth of the search range."
    return [
        *results.picture("parameters", caption, f"Dots. Positions in case {best}: {positions}. {note}"),
        *results.picture("searches", ends, f"Bars, {counted(table['case'].nunique(), 'case')}."),
    ]


def _convergence(results: StudyResults) -> list[Picture]:
    misfit = ["best", "mean"]
    table = results.table("convergence", ["case"], ["generation", *misfit], complete=["generation"], unbounded=misfit)
    if table is None:
        return []
    runs = search_runs(table).groupby("case", sort=False)
    ends = "; ".join(f"{case} {significant(rows['best'].iloc[-1])}" for case, rows in runs)
    caption = "Lowest misfit so far over the generations of every search."
    return results.picture("convergence", caption, f"Falling lines. They end at: {ends}.")


def _after(results: StudyResults, best: str) -> list[Block]:
    words = results.in_words("after")
    if results.kind != "modes":
        return [Words(f"The model {words}, case {best}:"), *plain_blocks(results, "after")]
    stages = {s: table for s in results.stages if (table := results.compared(s)) is not None}
    if "after" not in stages:
        return []
    return [
        mode_table(stages["after"], f"The model {words} (case {best})"),
        *error_picture(results, stages),
        *mac_picture(results, "after"),
        *orthogonality_blocks(results, "after"),
        *shapes_picture(results, "after"),
    ]


def _uncertainty(results: StudyResults) -> list[Block]:
    return [*_correlation(results), *_pairs(results), *_directions(results), *_predictions(results)]


def _correlation(results: StudyResults) -> list[Picture]:
    table = results.table("posterior_correlation", ["parameter"], others_are_numbers=True)
    if table is None or len(table) < 2:
        return []
    strong, rest = strongest(table, STRONG), others(table, STRONG)
    told = [f"{r['parameter_a']}, {r['parameter_b']} {fixed(r['value'], 2)}" for r in strong.to_dict("records")]
    alt = "; ".join([*told, *([rest] if rest else [])])
    caption = (
        "Posterior correlation of the parameters. Near ±1 the data determine a combination of the two, not each; the "
        "sign tells whether they may change in the same direction or in opposite ones."
    )
    return results.picture("posterior_correlation", caption, f"Correlations: {alt}.")


def _pairs(results: StudyResults) -> list[Block]:
    table = results.table("confounded", ["parameter_a", "parameter_b", "words"], ["correlation"])
    if table is None:
        return []
    rows = tuple(
        (f"{r['parameter_a']}, {r['parameter_b']}", fixed(r["correlation"], 2, sign=True), str(r["words"]))
        for r in table.to_dict("records")
    )
    return [Table("Confounded parameters", ("pair", "correlation", ""), rows, (2,))]


def _directions(results: StudyResults) -> list[Block]:
    table = results.table("unseen_directions", ["words"], ["signal"], flags=["seen"])
    if table is None:
        return []
    rows = tuple((str(r["words"]), yes(r["seen"])) for r in table.to_dict("records"))
    caption = "Combinations of parameters, the least visible in the data first"
    return [Table(caption, ("combination", "seen"), rows, (1,))]


def _predictions(results: StudyResults) -> list[Block]:
    numbers = ["natural_freq", "std", "lower", "upper"]
    table = results.table("predictions", ["mode"], numbers)
    if table is None:
        return []
    rows = tuple((str(r["mode"]), *(fixed(r[n], 3) for n in numbers)) for r in table.to_dict("records"))
    heads = ("mode", "natural frequency, Hz", "std, Hz", "lower, Hz", "upper, Hz")
    return [Table("Frequencies of the calibrated model with 95 % intervals", heads, rows)]
