"""Tables of a calibration: its parameters, and what the data determine of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from calib.analyses.fit_statistics import FitStatistics
from calib.inference.cases import CaseResult, parameters_table
from calib.problem.space import ParameterSpace


def tables_of(
    space: ParameterSpace,
    found: Sequence[tuple[CaseResult, FitStatistics]],
    best: FitStatistics,
    searched: Sequence[CaseResult] = (),
    differing: Mapping[str, float] | None = None,
) -> dict[str, pd.DataFrame]:
    """Tables on the parameters and their identifiability after some cases, by file name.

    ``differing`` are the parameters by which equally good solutions differ; see `calib.inference.agreement.Agreement`.
    """
    parameters = _parameters(space, found, searched, differing)
    spread = dict(zip(parameters["parameter"], parameters["spread"], strict=True))
    return {
        "parameters": parameters,
        "verdicts": _without_whole(best.verdicts(space, spread, differing), space),
        "suspects_calibrated": best.suspects,
        "posterior_correlation": best.identification.correlation.rename_axis("parameter").reset_index(),
        "confounded": best.identification.confounded,
        "unseen_directions": best.identification.directions,
        "predictions": best.predictions.assign(std_from=best.rests_on),
        **({"std_by_test": best.by_test.assign(std_from=best.rests_on)} if len(best.by_test) else {}),
    }


def _parameters(
    space: ParameterSpace,
    found: Sequence[tuple[CaseResult, FitStatistics]],
    searched: Sequence[CaseResult],
    differing: Mapping[str, float] | None,
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
    each = [statistics.verdicts(space, {}, differing).assign(case=result.name) for result, statistics in found]
    known = _without_whole(pd.concat(each), space)
    columns = ["case", "parameter", "on_limit", "std", "identified", "std_from"]
    table = table.drop(columns="on_limit").merge(known[columns], on=columns[:2], how="left")
    order = ["value", "unit", "lower", "upper", "ratio", "on_limit", "spread", "stable", "std", "identified"]
    return table[["case", "parameter", *order, "search_value", "search_on_limit", "std_from"]]


def _without_whole(table: pd.DataFrame, space: ParameterSpace) -> pd.DataFrame:
    """The table with the standard deviations of integer parameters blanked: only whole steps are meaningful."""
    whole = table["parameter"].isin([p.name for p in space.free if p.integer])
    std = [column for column in ("std", "std_of_range") if column in table]
    return table.assign(**{column: table[column].mask(whole) for column in std})
