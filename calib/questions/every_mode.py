"""Every measured mode before and after a calibration, those among them that no fit has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from calib.correlation.compare import Comparison
from calib.correlation.problem import ModalProblem
from calib.study import Study


def all_stages(study: Study, before: Comparison, after: Comparison) -> dict[str, Comparison]:
    """Compare all measured modes, withheld ones included, at every stage of the calibration.

    Parameters
    ----------
    study : Study
    before, after : Comparison
        With the data that were used.

    Returns
    -------
    dict from str to Comparison
        ``before`` and ``after`` and, for a study that takes values over, ``initial`` ahead of them: the model before
        the earlier study too. Used modes keep the partners that the used data gave them, withheld ones find theirs
        among the other model modes.

    Raises
    ------
    EvaluationError
        When a point cannot be solved.
    InputError
        When a withheld mode has an impossible pair.
    """
    stages = {"before": before, "after": after}
    if study.settings.adopted is not None:
        assert isinstance(study.problem, ModalProblem)
        stages = {"initial": study.problem.compare(study.initial), **stages}
    return {stage: _whole(study, used) for stage, used in stages.items()}


def every_mode(study: Study, stages: Mapping[str, Comparison]) -> pd.DataFrame:
    """Damped frequencies of all measured modes from stage to stage.

    Parameters
    ----------
    study : Study
    stages : mapping from str to Comparison
        As from `all_stages`.

    Returns
    -------
    DataFrame
        ``mode, withheld, damped_freq_measured`` and, for each stage, ``damped_freq_``, ``error_`` and ``mac_``. Hz;
        errors are signed fractions of the damped frequency; NaN where a mode found no partner.
    """
    columns: dict[str, pd.Series] = {}
    for stage, found in stages.items():
        told = found.comparison_table()
        columns |= {
            "mode": told["mode"],
            "withheld": told["mode"].isin(study.settings.withheld.modes),
            "damped_freq_measured": told["damped_freq_measured"],
            f"damped_freq_{stage}": told["damped_freq_model"],
            f"error_{stage}": told["damped_freq_model"] / told["damped_freq_measured"] - 1.0,
            f"mac_{stage}": told["mac"],
        }
    return pd.DataFrame(columns)


def _whole(study: Study, used: Comparison) -> Comparison:
    whole = study.whole_problem()
    if whole is None or not study.settings.withheld.modes:
        return used
    solved = used.modes if used.model is whole.model else None
    return replace(whole, override={**whole.override, **_partners(used)}).compare(used.values, solved)


def _partners(used: Comparison) -> Mapping[str, int]:
    index = used.pairing.model_index
    return {used.measured.names[i]: int(index[i]) + 1 for i in used.pairing.paired}
