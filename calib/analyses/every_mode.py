"""All measured data before and after a calibration, held-out ones included: modes one by one, errors by group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from calib.analyses.fit_statistics import FitStatistics
from calib.correlation.modal.comparison import Comparison
from calib.execution.outcome import named_responses
from calib.hypotheses.verify import errors_of, std_behind
from calib.inference.considered import EQUATION_ERRORS
from calib.missing.adequacy import contradicting
from calib.missing.data_words import GROUPS
from calib.problem.degrees_of_freedom import p_value
from calib.study.study import LoadedStudy


def all_stages(study: LoadedStudy, before: Comparison, after: Comparison) -> dict[str, Comparison]:
    """Compare all measured modes, held-out ones included, at every stage of the calibration.

    Parameters
    ----------
    study : Study
    before, after : Comparison
        Of the used data.

    Returns
    -------
    dict from str to Comparison
        ``before`` and ``after`` and, for a study that adopts values, ``initial`` ahead of them: the model before the
        earlier study. Used modes keep the partners found with the used data; held-out modes are paired with the
        remaining model modes.

    Raises
    ------
    EvaluationError
        When a point cannot be solved.
    InputError
        When a held-out mode has an impossible pair.
    """
    stages = {"before": before, "after": after}
    if study.settings.adopted is not None:
        problem: Any = study.problem
        stages = {"initial": problem.compare(study.initial), **stages}
    return {stage: with_held_out(study, used) for stage, used in stages.items()}


def every_mode(study: LoadedStudy, stages: Mapping[str, Comparison]) -> pd.DataFrame:
    """Frequencies of all measured modes at every stage, and their errors.

    Natural ones, or damped ones where the study asks for them (``freq_kind``). The mean frequency error of a
    calibration is of natural frequencies.

    Parameters
    ----------
    study : Study
    stages : mapping from str to Comparison
        As from `all_stages`.

    Returns
    -------
    DataFrame
        ``mode, held_out, freq_kind, freq_measured`` and, for each stage, ``freq_``, ``error_`` and ``mac_``. Hz; errors
        are signed fractions of the frequency; NaN where a mode found no partner.
    """
    columns: dict[str, Any] = {}
    kind = study.settings.calibration.freq_kind
    for stage, found in stages.items():
        table = found.comparison_table()
        columns |= {
            "mode": table["mode"],
            "held_out": table["mode"].isin(study.settings.held_out.modes),
            "freq_kind": kind,
            "freq_measured": table[f"{kind}_freq_measured"],
            f"freq_{stage}": table[f"{kind}_freq_model"],
            f"error_{stage}": table[f"{kind}_freq_model"] / table[f"{kind}_freq_measured"] - 1.0,
            f"mac_{stage}": table["mac"],
        }
    return pd.DataFrame(columns)


def with_held_out(study: LoadedStudy, used: Comparison) -> Comparison:
    """A comparison of the used data, with held-out modes paired with the remaining model modes; see `all_stages`.

    MAC, EMAC and margin of used modes stay those of the used sensors, as they are told elsewhere; of held-out modes
    they are over all sensors.
    """
    whole = study.whole_problem()
    if whole is None or not study.settings.held_out.modes:
        return used
    solved = used.modes if used.model is whole.model else None
    found = replace(whole, override={**whole.override, **_partners(used)}).compare(used.values, solved)
    own = [found.measured.names.index(name) for name in used.measured.names]
    criteria = {name: getattr(found.pairing, name).copy() for name in ("mac", "emac", "margin")}
    for name, values in criteria.items():
        values[own] = getattr(used.pairing, name)
    return replace(found, pairing=replace(found.pairing, **criteria))


def _partners(used: Comparison) -> Mapping[str, int]:
    index = used.pairing.model_index
    return {used.measured.names[i]: int(index[i]) + 1 for i in used.pairing.paired}


def errors_at(study: LoadedStudy, values: Mapping[str, float], ended: FitStatistics | None = None) -> pd.DataFrame:
    """Errors of a study's model by group of data, at fitted values of the selected parameters; see `errors_of`.

    ``ended`` is the fit, of this test or of several. The used data of one test are tested as the fit is: with the
    errors of held parameters. Values of the cross-model equations err more than these groups count, so that no other
    group is tested.
    """
    joint, active = (None, frozenset[str]()) if ended is None else (ended.part(study.test), ended.active)
    pair, whole, space = study.pair, study.whole_problem(), study.search_space
    table = errors_of(pair, whole, study.unseen, space, values, study.held_sd, joint, active)
    used = table["group"] == "fit"
    if ended is not None and (ended.considered["parameter"] == EQUATION_ERRORS).any():
        table = table.assign(p=table["p"].where(used))
    if ended is None or not ended.held_squares or len(ended.by_test):
        return table
    expected = np.sqrt(table.loc[used, "expected"] ** 2 + ended.held_squares / table.loc[used, "rows"])
    p = p_value(ended.considered_misfit, ended.dof, std_behind(pair))
    return table.assign(expected=table["expected"].where(~used, expected), p=table["p"].where(~used, float(p)))


_NAMED = {"held_out_modes": "mode", "held_out_responses": "response"}
"""Groups whose data are listed one by one, and the column that names them."""


def contradictions(errors: pd.DataFrame, each: pd.DataFrame | None, assumed: str = "") -> tuple[str, ...]:
    """One sentence for every group of held-out data that contradicts a calibrated model.

    A group contradicts the model when its p-value is below one in a thousand (see `calib.missing.adequacy`): p is the
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
            f"standard deviations, where a correct model would show {row['expected']:.2f} "
            f"(p = {row['p']:.1g}); the model is over-fitted or wrong"
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


def every_response(study: LoadedStudy, before: Mapping[str, float], after: Mapping[str, float]) -> pd.DataFrame | None:
    """All measured scalar responses before and after a calibration, held-out ones included; None if none are held out.

    Returns
    -------
    DataFrame or None
        ``response, held_out, measured, before, after, error_before, error_after``; errors are signed fractions of the
        measured value, NaN where that is 0.

    Raises
    ------
    EvaluationError
        When the model cannot be evaluated at either point.
    """
    experiment: Any = study.experiment
    whole = experiment.whole_responses(study.problem)
    if whole is None:
        return None
    targets = experiment.measured.targets
    measured = pd.Series({name: value for name, (value, _) in targets.items()})
    table = pd.DataFrame({"held_out": measured.index.isin(experiment.held_out), "measured": measured})
    for stage, values in {"before": before, "after": after}.items():
        table[stage] = pd.Series(named_responses(whole.evaluate, values))
    for stage in ("before", "after"):
        table[f"error_{stage}"] = (table[stage] - measured) / measured.abs().where(measured != 0)
    return table.rename_axis("response").reset_index()
