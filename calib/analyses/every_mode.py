"""All measured data before and after a calibration, held-out ones included: modes one by one, errors by group."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import pandas as pd

from calib.correlation.modal.comparison import Comparison
from calib.hypotheses.verify import errors_of
from calib.inference.joint_part import JointPart
from calib.study.study import Study


def all_stages(study: Study, before: Comparison, after: Comparison) -> dict[str, Comparison]:
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


def every_mode(study: Study, stages: Mapping[str, Comparison]) -> pd.DataFrame:
    """Damped frequencies of all measured modes at every stage.

    Parameters
    ----------
    study : Study
    stages : mapping from str to Comparison
        As from `all_stages`.

    Returns
    -------
    DataFrame
        ``mode, held_out, damped_freq_measured`` and, for each stage, ``damped_freq_``, ``error_`` and ``mac_``. Hz;
        errors are signed fractions of the damped frequency; NaN where a mode found no partner.
    """
    columns: dict[str, pd.Series] = {}
    for stage, found in stages.items():
        table = found.comparison_table()
        columns |= {
            "mode": table["mode"],
            "held_out": table["mode"].isin(study.settings.held_out.modes),
            "damped_freq_measured": table["damped_freq_measured"],
            f"damped_freq_{stage}": table["damped_freq_model"],
            f"error_{stage}": table["damped_freq_model"] / table["damped_freq_measured"] - 1.0,
            f"mac_{stage}": table["mac"],
        }
    return pd.DataFrame(columns)


def with_held_out(study: Study, used: Comparison) -> Comparison:
    """A comparison of the used data, with held-out modes paired with the remaining model modes; see `all_stages`."""
    whole = study.whole_problem()
    if whole is None or not study.settings.held_out.modes:
        return used
    solved = used.modes if used.model is whole.model else None
    return replace(whole, override={**whole.override, **_partners(used)}).compare(used.values, solved)


def _partners(used: Comparison) -> Mapping[str, int]:
    index = used.pairing.model_index
    return {used.measured.names[i]: int(index[i]) + 1 for i in used.pairing.paired}


def errors_at(
    study: Study, values: Mapping[str, float], joint: JointPart | None = None, active: Collection[str] = ()
) -> pd.DataFrame:
    """Errors of a study's model by group of data, at fitted values of the selected parameters; see `errors_of`."""
    space, held_sd = study.search_space, study.held_sd
    return errors_of(study.pair, study.whole_problem(), study.unseen, space, values, held_sd, joint, active)
