"""What one case of a calibration found for a test: its values, their statistics, and the model there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import pandas as pd

from calib.analyses.compare import ComparisonResult, comparison_at
from calib.analyses.fit_statistics import FitStatistics
from calib.analyses.joint_responses import objective_for, own_values
from calib.execution.outcome import named_responses
from calib.inference.cases import CaseResult
from calib.study.study import LoadedStudy

SEARCH, FITTED = "search", "least squares"
"""Names of the points of a case."""


@dataclass(frozen=True, eq=False)
class CaseFound:
    """Result of one case, from its search to the reported values.

    Attributes
    ----------
    result : CaseResult
        Reported values, with the misfit of the objective there; counts and time of the search, or of least squares
        where nothing was searched.
    search : CaseResult or None
        Where the genetic algorithm ended; None without one.
    statistics : FitStatistics
        Fit statistics at the reported values.
    answer : ComparisonResult
        Model against measurement there.
    points : DataFrame
        Both criteria at the ends of the search and of least squares, at full order: ``case, point, objective,
        sum_of_squares, prior, total``. The search minimises ``objective``, least squares minimise ``total``. One row
        for each of the two that ran; ``mean_error`` and ``mean_mac`` are what the objective weighs, of this test.
    errors : DataFrame
        What the objective weighs, datum by datum, at the same points: ``case, point, what, measured, model, error,
        mac``. It has neither damping nor what is held out.
    """

    result: CaseResult
    search: CaseResult | None
    statistics: FitStatistics
    answer: ComparisonResult
    points: pd.DataFrame
    errors: pd.DataFrame

    @property
    def name(self) -> str:
        """Name of the case."""
        return self.result.name

    @property
    def search_full_order(self) -> float:
        """Misfit of the objective where the search ended, at full order whatever it worked on; NaN without a search."""
        own = self.points.loc[self.points["point"] == SEARCH, "objective"]
        return float(own.iloc[0]) if len(own) else math.nan

    @property
    def worsened(self) -> bool:
        """Whether least squares raised the misfit that the search minimised by more than one percent."""
        return self.result.misfit > 1.01 * self.search_full_order  # NaN without a search


def reported(
    study: LoadedStudy,
    result: CaseResult,
    statistics: FitStatistics,
    search: CaseResult | None = None,
    before: tuple[float, float, float] = (math.nan, math.nan, math.nan),
    at_search: Mapping[str, float] | None = None,
) -> CaseFound:
    """The case at its final values for one test, solved at full order even if the search was reduced.

    ``before`` holds the objective and the sums of squares of data and priors at the end of a search, ``at_search`` the
    responses of the only test there, where they are known.
    """
    values = own_values(study, statistics.values)
    responses = named_responses(study.problem.evaluate, values)
    objective = objective_for(study.problem, study.settings.calibration)
    final = replace(result, values=statistics.values, misfit=objective(responses), responses=responses)
    points, errors = [], []
    if search is not None:
        points.append((SEARCH, *before))
        there = at_search or named_responses(study.problem.evaluate, own_values(study, search.values))
        errors.append(objective.errors(there).assign(point=SEARCH))
    if statistics.fit is not None:
        points.append((FITTED, final.misfit, statistics.misfit, statistics.prior_misfit))
        errors.append(objective.errors(responses).assign(point=FITTED))
    table = pd.DataFrame(points, columns=["point", "objective", "sum_of_squares", "prior"])
    table["total"] = table["sum_of_squares"] + table["prior"]
    columns = ["case", "point", "what", "measured", "model", "error", "mac"]
    each = pd.concat(errors or [pd.DataFrame(columns=columns)], ignore_index=True).assign(case=final.name)[columns]
    table.insert(0, "case", final.name)
    return CaseFound(
        final, search, statistics, comparison_at(study, values), table.join(_means(each), on="point"), each
    )


def _means(errors: pd.DataFrame) -> pd.DataFrame:
    """Mean error and MAC at each point; as in the objective, what is unpaired is wrong by 100 % and has a MAC of 0."""
    mac = errors["mac"].fillna(0.0) if errors["mac"].notna().any() else errors["mac"]
    means = pd.DataFrame({"mean_error": errors["error"].abs().fillna(1.0), "mean_mac": mac})
    return means.groupby(errors["point"], sort=False).mean()
