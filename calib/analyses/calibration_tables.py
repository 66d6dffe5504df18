"""Tables of a calibration: its parameters, what the data determine of them, and the model before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from calib.analyses.compare import ComparisonResult, write_comparison, write_model_modes
from calib.analyses.fit_statistics import FitStatistics
from calib.analyses.provenance.record import begin_analysis
from calib.analyses.provenance.state import ADDED, INTERVALS, PARETO, ROBUSTNESS
from calib.analyses.uncertainty import accuracy_words
from calib.inference.cases import CaseResult, convergence_table, parameters_table
from calib.problem.joint import stacked
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

if TYPE_CHECKING:
    from calib.analyses.calibration import Calibration, JointCalibration
    from calib.analyses.case_found import CaseFound


RUNS = "searches"
"""Key of ``summary.json``: the name in the ledger of the search of each case."""


def tables_of(
    space: ParameterSpace,
    found: Sequence[tuple[CaseResult, FitStatistics]],
    best: FitStatistics,
    searched: Sequence[CaseResult] = (),
    differing: Mapping[str, float] | None = None,
    contradicted: bool = False,
) -> dict[str, pd.DataFrame]:
    """Tables on the parameters and their identifiability after some cases, by file name.

    ``differing`` are the parameters by which equally good solutions differ; see `calib.inference.agreement.Agreement`;
    ``contradicted`` tells whether held-out data contradict the best fit.
    """
    parameters = _parameters(space, found, searched, differing, contradicted)
    spread = dict(zip(parameters["parameter"], parameters["spread"], strict=True))
    return {
        "parameters": parameters,
        "verdicts": _without_whole(best.verdicts(space, spread, differing, contradicted), space),
        "suspects_calibrated": best.suspects,
        "posterior_correlation": best.identification.correlation.rename_axis("parameter").reset_index(),
        "confounded": best.identification.confounded,
        "unseen_directions": best.identification.directions,
        "predictions": best.predictions.assign(std_from=best.rests_on),
        **({"considered": best.considered.assign(std_from=best.rests_on)} if len(best.considered) else {}),
        **({"between_tests": best.between.table} if best.between is not None else {}),
        **({"std_by_test": best.by_test.assign(std_from=best.rests_on)} if len(best.by_test) else {}),
    }


def _parameters(
    space: ParameterSpace,
    found: Sequence[tuple[CaseResult, FitStatistics]],
    searched: Sequence[CaseResult],
    differing: Mapping[str, float] | None,
    contradicted: bool,
) -> pd.DataFrame:
    """``parameters.csv``: reported values, how far the searches spread, and what the data determine.

    ``spread`` and ``stable`` are those of the genetic searches before least squares, or of the fits where nothing was
    searched; ``search_value`` and ``search_on_limit`` are given where least squares followed a search.
    """
    table = parameters_table([result for result, _ in found], space)
    table["search_value"], table["search_on_limit"] = np.nan, None
    if searched:
        raw = parameters_table(searched, space)
        table["spread"], table["stable"] = raw["spread"], raw["stable"]
        if any(statistics.fit is not None for _, statistics in found):
            table["search_value"], table["search_on_limit"] = raw["value"], raw["on_limit"]
    each = [
        statistics.verdicts(space, {}, differing, contradicted).assign(case=result.name) for result, statistics in found
    ]
    known = _without_whole(pd.concat(each), space)
    columns = ["case", "parameter", "on_limit", "std", "low", "high", "identified", "std_from"]
    table = table.drop(columns="on_limit").merge(known[columns], on=columns[:2], how="left")
    order = ["value", "unit", "lower", "upper", "scale", "ratio", "on_limit", "spread", "stable", *columns[3:7]]
    return table[["case", "parameter", *order, "search_value", "search_on_limit", "std_from"]]


def _without_whole(table: pd.DataFrame, space: ParameterSpace) -> pd.DataFrame:
    """The table with the standard deviations of integer parameters blanked: only whole steps are meaningful."""
    whole = table["parameter"].isin([p.name for p in space.free if p.integer])
    return table.assign(std=table["std"].mask(whole))


def write_calibration(study: LoadedStudy, results: Results, answer: Calibration, method: str, seconds: float) -> None:
    """Write all tables on one test and ``summary.json``."""
    begin_analysis(results, "calibrate")
    gone = ("considered", "unexplained_calibrated", "std_by_test", "between_tests", "modes", "data_errors", "responses")
    results.remove(*(f"{name}.csv" for name in gone), *ADDED, *INTERVALS, *ROBUSTNESS, *PARETO)
    write_comparison(results, answer.best.answer, "after")
    for name, table in answer.tables.items():
        results.write_table(name, table)
    results.write_table("points", pd.concat([case.points for case in answer.cases], ignore_index=True))
    results.write_table("errors_by_case", pd.concat([case.errors for case in answer.cases], ignore_index=True))
    results.write_table("convergence", convergence_table([case.result for case in answer.cases]))
    if answer.modes is not None:
        results.write_table("modes", answer.modes)
        for stage, comparison in answer.stages.items():
            write_model_modes(results, comparison, stage, answer.best.answer.comparison)
    if answer.errors is not None:
        results.write_table("data_errors", answer.errors.assign(std_from=answer.best.statistics.rests_on))
    if answer.responses is not None:
        results.write_table("responses", answer.responses)
    results.write_json("summary", _summary(study, method, answer, seconds))


def write_jointly(study: AnyStudy, results: Results, answer: JointCalibration, method: str, seconds: float) -> None:
    """Write the parameters and the tables on all tests together; those on one test are in its own folder."""
    best = answer.any.best
    begin_analysis(results, "calibrate")
    gone = ("considered.csv", "unexplained_calibrated.csv", "data_errors.csv", "between_tests.csv")
    results.remove(*gone, *INTERVALS, *ROBUSTNESS, *PARETO)
    for name, table in answer.any.tables.items():
        results.write_table(name, table)
    errors = {test: one.errors for test, one in answer.tests.items() if one.errors is not None}
    if errors:
        results.write_table("data_errors", stacked(errors).assign(std_from=best.statistics.rests_on))
    results.write_json("summary", {
        "study": study.name,
        "synthetic": study.synthetic,
        "method": method,
        "best_case": best.name,
        **best.statistics.figures,
        "seconds": seconds,
        RUNS: _runs(answer.any.cases),
        "tests": {test: before_and_after(one.before, one.best.answer) for test, one in answer.tests.items()},
    })  # fmt: skip


def before_and_after(before: ComparisonResult, after: ComparisonResult) -> dict[str, float]:
    """Mean errors and MAC of two comparisons, as in ``summary.json``."""
    return {
        "mean_freq_error_before": before.mean_freq_error,
        "mean_freq_error_after": after.mean_freq_error,
        "mean_mac_before": before.mean_mac,
        "mean_mac_after": after.mean_mac,
    }


def _summary(study: LoadedStudy, method: str, answer: Calibration, seconds: float) -> dict[str, object]:
    found, best, before = answer.cases, answer.best, answer.before
    counts = {"evaluations": "asked", **{name: name for name in ("solved", "reused", "infeasible", "failed")}}

    def figures(case: CaseFound) -> dict[str, object]:
        return {
            "misfit": case.result.misfit,
            "search_misfit": None if case.search is None else case.search.misfit,
            "search_misfit_full_order": case.search_full_order,
            **before_and_after(before, case.answer),
            **{key: getattr(case.result, name) for key, name in counts.items()},
            "seconds": case.result.seconds,
        }

    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "method": method,
        "best_case": best.name,
        **before_and_after(before, best.answer),
        "noise_freq_error": float(np.mean(noise_errors(study))),
        "noise_mac": best.answer.noise_mac,
        **best.statistics.figures,
        "accuracy": accuracy_words(study) or "none",
        **{key: sum(getattr(case.result, name) for case in found) for key, name in counts.items()},
        "seconds": seconds,
        **{f"held_out_{kind}": list(names) for kind, names in study.settings.held_out.model_dump().items()},
        "cases": {case.name: figures(case) for case in found},
        RUNS: _runs(found),
        "contradictions": list(answer.contradictions),
    }


def _runs(cases: Sequence[CaseFound]) -> dict[str, str]:
    return {case.name: case.search.run for case in cases if case.search is not None}


_MEAN_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean absolute value of a standard normal variate."""


def noise_errors(study: LoadedStudy) -> np.ndarray:
    """Mean relative error of each frequency or scalar response of a perfect model, due to the standard deviation alone.

    The standard deviation is the one that calibration weights by, accuracy and floors included; NaN where it would be
    assumed.
    """
    return _MEAN_ABSOLUTE * study.problem.relative_std
