"""Held-out data that contradict a calibrated model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from calib.execution.outcome import answered
from calib.missing.held_out import contradicting
from calib.missing.verdict import GROUPS
from calib.study.study import Study

_NAMED = {"held_out_modes": "mode", "held_out_responses": "response"}
"""Groups whose data are listed one by one, and the column that names them."""


def contradictions(errors: pd.DataFrame, each: pd.DataFrame | None, assumed: str = "") -> tuple[str, ...]:
    """One sentence for every group of held-out data that contradicts a calibrated model.

    A group contradicts the model when its p-value is below one in a thousand (see `calib.missing.held_out`): p is the
    probability that a correctly specified model gives so large a sum of squares, its errors having the covariance of
    the measurement and of the fitted parameters (chi-square test; an F test where the standard deviation is estimated
    from few repeats, see `calib.correlation.modal.held_out`). A study has at most three groups, so fewer than 1 in 300
    correctly specified models are rejected.

    Parameters
    ----------
    errors : DataFrame
        ``group, rms, expected, p`` of the calibrated model, rms in standard deviations.
    each : DataFrame or None
        ``modes.csv`` or ``responses.csv``, from which data predicted no better than before the calibration are named.
    assumed : str
        Assumed standard deviations that this rests on; see `calib.analyses.uncertainty.assumed_words`.
    """
    out = []
    for row in errors[errors["group"].isin(contradicting(errors.assign(stage="after"), "after"))].to_dict("records"):
        group = str(row["group"])
        words = (
            f"{GROUPS[group].capitalize()} contradict the calibrated model: their rms error is {row['rms']:.2f} "
            f"standard deviations, where a correctly specified model would show {row['expected']:.2f} "
            f"(p = {row['p']:.1g}); the model is over-fitted or misspecified"
        )
        words += f"; this rests on an assumed standard deviation: {assumed}" if assumed else ""
        worse = [] if each is None else _no_better(each, _NAMED.get(group, ""))
        out.append(
            f"{words}. Predicted no better than before the calibration: {', '.join(worse)}." if worse else f"{words}."
        )
    return tuple(out)


def _no_better(each: pd.DataFrame, name: str) -> list[str]:
    if name not in each:
        return []
    unseen = each[each["held_out"]]
    return unseen.loc[unseen["error_after"].abs() >= unseen["error_before"].abs(), name].astype(str).tolist()


def every_response(study: Study, before: Mapping[str, float], after: Mapping[str, float]) -> pd.DataFrame:
    """All measured scalar responses before and after a calibration, held-out ones included.

    Returns
    -------
    DataFrame
        ``response, held_out, measured, before, after, error_before, error_after``; errors are signed fractions of the
        measured value, NaN where that is 0.

    Raises
    ------
    EvaluationError
        When the model cannot be evaluated at either point.
    """
    experiment: Any = study.experiment
    whole, targets = experiment.every_response(study.problem), experiment.measured.targets
    measured = pd.Series({name: value for name, (value, _) in targets.items()})
    table = pd.DataFrame({"held_out": measured.index.isin(experiment.held_out), "measured": measured})
    for stage, values in {"before": before, "after": after}.items():
        table[stage] = pd.Series(answered(whole.evaluate, values))
    for stage in ("before", "after"):
        table[f"error_{stage}"] = (table[stage] - measured) / measured.abs().where(measured != 0)
    return table.rename_axis("response").reset_index()
