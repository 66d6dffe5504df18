"""What data that no fit has seen say against a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.missing.held_out import contradicting
from calib.missing.verdict import GROUPS
from calib.outcome import answered
from calib.study import Study

_NAMED = {"withheld_modes": "mode", "withheld_responses": "response"}
"""Groups whose data are told one by one, and the column that names them."""


def contradictions(errors: pd.DataFrame, each: pd.DataFrame | None, assumed: str = "") -> tuple[str, ...]:
    """One sentence for every group of withheld data that contradicts a calibrated model.

    A group does when ``p < CONTRADICTED``, one in a thousand (`calib.missing.held_out`): p is the chance that the sum
    of squares of its errors is as large for a right model, whose errors have the covariance of the scatter and of the
    parameters as the fit leaves them (chi square; an F test where the scatter itself is estimated from few repeats,
    see `calib.correlation.unused`). A study has at most two groups: fewer than 1 in 500 right models are accused.

    Parameters
    ----------
    errors : DataFrame
        ``group, rms, expected, p`` of the calibrated model, rms in units of the scatter.
    each : DataFrame or None
        ``modes.csv`` or ``responses.csv``, which tell what of it is predicted no better than before the calibration.
    assumed : str
        Standard deviations that nobody stated and this rests on; see `calib.questions.scatter.assumed_words`.
    """
    out = []
    for row in errors[errors["group"].isin(contradicting(errors.assign(stage="after"), "after"))].to_dict("records"):
        group = str(row["group"])
        words = (
            f"{GROUPS[group].capitalize()} contradict the calibrated model: they err by {row['rms']:.2f} times the "
            f"scatter, in a right model by {row['expected']:.2f} (p = {row['p']:.1g}); it is over-fitted "
            "or of the wrong class"
        )
        words += f"; the scatter behind it is assumed: {assumed}" if assumed else ""
        worse = [] if each is None else _no_better(each, _NAMED.get(group, ""))
        out.append(f"{words}. No better than before the calibration: {', '.join(worse)}." if worse else f"{words}.")
    return tuple(out)


def _no_better(each: pd.DataFrame, name: str) -> list[str]:
    if name not in each:
        return []
    unseen = each[each["withheld"]]
    return unseen.loc[unseen["error_after"].abs() >= unseen["error_before"].abs(), name].astype(str).tolist()


def every_response(study: Study, before: Mapping[str, float], after: Mapping[str, float]) -> pd.DataFrame:
    """All measured plain responses before and after a calibration, withheld ones included.

    Returns
    -------
    DataFrame
        ``response, withheld, measured, before, after, error_before, error_after``; errors are signed fractions of what
        was measured, NaN where that is 0.

    Raises
    ------
    EvaluationError
        When the model fails there.
    """
    assert isinstance(study.problem, FunctionProblem)
    whole = replace(study.problem, targets=study.whole_targets)
    measured = pd.Series({name: value for name, (value, _) in study.whole_targets.items()})
    table = pd.DataFrame({"withheld": measured.index.isin(study.settings.withheld.responses), "measured": measured})
    for stage, values in {"before": before, "after": after}.items():
        table[stage] = pd.Series(answered(whole.evaluate, values))
    for stage in ("before", "after"):
        table[f"error_{stage}"] = (table[stage] - measured) / measured.abs().where(measured != 0)
    return table.rename_axis("response").reset_index()
