"""What one case of a calibration found for a test: its values, their statistics, and the model there."""

from __future__ import annotations

import math
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
        for each of the two that ran.
    """

    result: CaseResult
    search: CaseResult | None
    statistics: FitStatistics
    answer: ComparisonResult
    points: pd.DataFrame

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
) -> CaseFound:
    """The case at its final values for one test, solved at full order even if the search was reduced.

    ``before`` holds the objective and the sums of squares of data and priors at the end of a search.
    """
    values = own_values(study, statistics.values)
    responses = named_responses(study.problem.evaluate, values)
    objective = objective_for(study.problem, study.settings.calibration)
    final = replace(result, values=statistics.values, misfit=objective(responses), responses=responses)
    points = [] if search is None else [(final.name, SEARCH, *before)]
    if statistics.fit is not None:
        points.append((final.name, FITTED, final.misfit, statistics.misfit, statistics.prior_misfit))
    table = pd.DataFrame(points, columns=["case", "point", "objective", "sum_of_squares", "prior"])
    table["total"] = table["sum_of_squares"] + table["prior"]
    return CaseFound(final, search, statistics, comparison_at(study, values), table)
