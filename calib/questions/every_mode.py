"""Every measured mode before and after a calibration, those among them that no fit has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from calib.correlation.compare import Comparison
from calib.study import Study

COLUMNS = (
    "mode", "withheld", "damped_freq_measured", "damped_freq_before", "damped_freq_after", "error_before",
    "error_after", "mac_before", "mac_after",
)  # fmt: skip


def every_mode(study: Study, before: Comparison, after: Comparison) -> pd.DataFrame:
    """Damped frequencies of all measured modes, withheld ones included, before and after.

    Parameters
    ----------
    study : Study
    before, after : Comparison
        With the data that were used.

    Returns
    -------
    DataFrame
        Hz; errors are signed fractions of the damped frequency; NaN where a mode found no partner. Used modes keep the
        partners that the used data gave them, withheld ones find theirs among the other model modes.

    Raises
    ------
    EvaluationError
        When a point cannot be solved.
    InputError
        When a withheld mode has an impossible pair.
    """
    stages = {"before": _whole(study, before), "after": _whole(study, after)}
    table = pd.DataFrame(columns=list(COLUMNS))
    for stage, found in stages.items():
        told = found.comparison_table()
        table["mode"], table["damped_freq_measured"] = told["mode"], told["damped_freq_measured"]
        table["withheld"] = table["mode"].isin(study.settings.withheld.modes)
        table[f"damped_freq_{stage}"], table[f"mac_{stage}"] = told["damped_freq_model"], told["mac"]
        table[f"error_{stage}"] = told["damped_freq_model"] / told["damped_freq_measured"] - 1.0
    return table


def _whole(study: Study, used: Comparison) -> Comparison:
    whole = study.whole_problem()
    if whole is None or not study.settings.withheld.modes:
        return used
    return replace(whole, override={**whole.override, **_partners(used)}).compare(used.values)


def _partners(used: Comparison) -> Mapping[str, int]:
    index = used.pairing.model_index
    return {used.measured.names[i]: int(index[i]) + 1 for i in used.pairing.paired}
