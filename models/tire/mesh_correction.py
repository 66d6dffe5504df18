"""A coarse mesh corrected by a finer one at the nominal values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from calib import FunctionModel, InputError
from calib.structure import response_of

PRESSURE = "pressure"


def mesh_factors(coarse: FunctionModel, fine: FunctionModel, pressures: tuple[float, ...]) -> pd.DataFrame:
    """Responses of the finer mesh over those of the coarse one at the nominal values, one row a pressure (kPa)."""
    rows = {}
    for pressure in pressures:
        at = {**coarse.space.values, PRESSURE: pressure}
        low, high = coarse.function(at), fine.function(at)
        rows[pressure] = {name: high[name] / value for name, value in low.items() if name in high and value}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(PRESSURE)


def mesh_corrected(model: FunctionModel, factors: pd.DataFrame) -> FunctionModel:
    """The model with each response, and its derivatives, times its factor at the pressure.

    The error of a coarse mesh depends little on parameters: a load that is 11 % too large stays within 1 % of that
    while cords and plies change by a standard deviation, within 4 % when a belt is added. Between pressures factors
    are interpolated, beyond them kept.

    Parameters
    ----------
    model : FunctionModel
    factors : DataFrame
        From `mesh_factors`. Responses without one stay as they are.
    """
    return replace(model, function=_Corrected(model.function, factors.sort_index()))


def read_factors(file: Path) -> pd.DataFrame:
    """Factors from a table with a column of pressures in kPa and one of each response.

    Raises
    ------
    InputError
        Where the table has no such columns, or a factor is not positive.
    """
    table = pd.read_csv(file, comment="#")
    if PRESSURE not in table or table.select_dtypes("number").shape[1] != table.shape[1] or not len(table):
        raise InputError("it needs numbers in a column 'pressure' and one for each response", place=str(file))
    if not (table.to_numpy() > 0).all():
        raise InputError("it has an entry that is not positive", place=str(file))
    return table.set_index(PRESSURE)


@dataclass(frozen=True)
class _Corrected:
    function: Callable[[Mapping[str, float]], Mapping[str, float]]
    factors: pd.DataFrame

    def __call__(self, values: Mapping[str, float]) -> dict[str, float]:
        at = self.factors.index.to_numpy(float)
        factor = {n: float(np.interp(values[PRESSURE], at, column)) for n, column in self.factors.items()}
        return {name: value * factor.get(response_of(name), 1.0) for name, value in self.function(values).items()}
