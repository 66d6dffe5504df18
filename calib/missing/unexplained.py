"""What a misfit that nothing explains does to parameters and to predictions of held-out data: tables and sentences."""

from __future__ import annotations

import pandas as pd

from calib.missing.discrepancy import TABLE as PARAMETERS
from calib.missing.discrepancy import discrepancy_of, parameter_intervals
from calib.missing.discrepancy import sentence as parameters_sentence
from calib.missing.explanation import Explanation
from calib.missing.predictions import ERRORS
from calib.missing.predictions import TABLE as PREDICTIONS
from calib.missing.predictions import sentence as predictions_sentence
from calib.missing.test import Adapter


def unexplained(adapter: Adapter, found: Explanation) -> tuple[dict[str, pd.DataFrame], tuple[str, str]]:
    """Tables by name, those that have rows, and a sentence on parameters and on held-out data; empty without a misfit.

    Parameters
    ----------
    adapter : Adapter
    found : Explanation
    """
    wide = discrepancy_of(found)
    if wide is None:
        return {}, ("", "")
    parameters = parameter_intervals(found, wide)
    predicted, errors = adapter.predictions(found.base, wide, found.noise_scale)
    tables = {PARAMETERS: parameters, PREDICTIONS: predicted, ERRORS: errors}
    words = (parameters_sentence(parameters), predictions_sentence(predicted, errors))
    return {name: table for name, table in tables.items() if len(table)}, words
