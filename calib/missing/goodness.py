"""Goodness of fit by kind of response and by mode."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Protocol, TypeVar

import numpy as np
import pandas as pd
from scipy import stats

from calib.freedom import KNOWN, chance, row_freedom
from calib.missing.hypotheses import Label

_Name = TypeVar("_Name", bound=Hashable)

_ALIKE = 0.01
"""Level at which modes differ by more than a common factor."""
_FOLLOWED = 0.02
"""Part of a row's variance left by the parameters below which it says nothing."""


class Fit(Protocol):
    """A fit at its end, of an explanation (`calib.missing.state.State`) or of a calibration."""

    @property
    def residual(self) -> np.ndarray:
        """Whitened, (n_rows,)."""
        ...

    @property
    def slope(self) -> np.ndarray:
        """Derivative of the residual of either sign, (n_rows, n_params)."""
        ...

    @property
    def prior_sd(self) -> np.ndarray:
        """Prior standard deviations, (n_params,)."""
        ...


def goodness(
    state: Fit,
    rows: Sequence[Label],
    fitted_factors: Mapping[tuple[str, str], int],
    scatter_freedom: Mapping[str, float],
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sum of squares of every kind, and of every mode and kind, against what the scatter allows.

    The degrees of freedom of a block b are ``n_b - tr(G_b V G_b^T)`` (see `calib.freedom`) less the factors fitted to
    its shapes. The scatter was itself estimated, so that the ratio is an F variate. A single row is studentised,
    ``e^2/(1 - h)`` with one degree of freedom (Cook and Weisberg 1982), unless the parameters follow it nearly
    everywhere.

    Returns
    -------
    kinds : DataFrame
        ``kind, chi2, freedom, p``.
    modes : DataFrame
        ``mode, kind, chi2, freedom, p``.
    """
    freedom = row_freedom(state.slope, state.prior_sd)
    blocks, which = _numbered([(row.mode, row.kind) for row in rows])
    modes = pd.DataFrame(blocks, columns=["mode", "kind"])
    modes["chi2"], modes["freedom"] = np.bincount(which, state.residual**2), np.bincount(which, freedom)
    modes["freedom"] -= [fitted_factors.get(block, 0) for block in blocks]
    names, of = _numbered(modes["kind"].tolist())
    sums = {column: np.bincount(of, modes[column]) for column in ("chi2", "freedom")}
    kinds = pd.DataFrame({"kind": names, **sums})
    single = np.bincount(which) == 1
    studied = single & (modes["freedom"] > _FOLLOWED)
    modes.loc[studied, "chi2"] /= modes.loc[studied, "freedom"]
    modes.loc[studied, "freedom"] = 1.0
    for table in (kinds, modes):
        scatter = np.array([min(scatter_freedom.get(kind, np.inf), KNOWN) for kind in table["kind"]])
        table["p"] = chance(table["chi2"].to_numpy(), table["freedom"].to_numpy(), scatter)
    return kinds, modes


def _numbered(names: Sequence[_Name]) -> tuple[list[_Name], np.ndarray]:
    """Different names in the order of their first appearance, and the number of each name among them, (n,)."""
    numbers = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return list(numbers), np.array([numbers[name] for name in names], dtype=int)


def by_sensor(
    state: Fit,
    rows: Sequence[Label],
    fitted_factors: Mapping[tuple[str, str], int],
    scatter_freedom: Mapping[str, float],
) -> pd.DataFrame:
    """Sum of squares of every sensor, or plain response, over all modes: ``sensor, chi2, freedom, p``, worst first.

    Factors fitted to a shape are shared by its rows. ``p`` is that of one sensor; among n it counts n times.
    """
    blocks, which = _numbered([(row.mode, row.kind) for row in rows])
    share = np.array([fitted_factors.get(block, 0) for block in blocks]) / np.bincount(which)
    freedom = row_freedom(state.slope, state.prior_sd) - share[which]
    names, of = _numbered([(row.sensor, row.kind) for row in rows])
    table = pd.DataFrame(names, columns=["sensor", "kind"])
    table["chi2"], table["freedom"] = np.bincount(of, state.residual**2), np.bincount(of, freedom)
    scatter = np.array([min(scatter_freedom.get(kind, np.inf), KNOWN) for kind in table["kind"]])
    table["p"] = chance(table["chi2"].to_numpy(), table["freedom"].to_numpy(), scatter)
    table = table[table["sensor"] != ""].drop(columns="kind")
    return table.sort_values(["p", "chi2"], ascending=[True, False], ignore_index=True, kind="stable")


def overall(kinds: pd.DataFrame, modes: pd.DataFrame) -> float:
    """Chance of the worst kind or the worst single-mode shape being as bad as found (Bonferroni)."""
    shapes = modes.loc[modes["kind"] == "shape", "p"]
    tests = [*kinds["p"].tolist(), float(shapes.min()) * len(shapes) if len(shapes) else 1.0]
    return float(min(1.0, len(tests) * min(tests)))


def misfit_factor(kinds: pd.DataFrame, modes: pd.DataFrame, level: float) -> float:
    """Factor on the scatter with which the worst of what fails the test of `overall` would be as a right model has it.

    The largest root of chi2 over the degrees of freedom (Birge 1932), of kinds and of shapes of single modes; 1 where
    nothing fails.
    """
    shapes = modes[modes["kind"] == "shape"]
    parts = ((kinds, len(kinds) + 1), (shapes, (len(kinds) + 1) * len(shapes)))
    failing = [table[table["p"] * among <= level] for table, among in parts]
    squares = [(t["chi2"] / np.maximum(t["freedom"], 1.0)).max() for t in failing if len(t)]
    return float(np.sqrt(max(squares, default=1.0)))


def noise_scale(modes: pd.DataFrame) -> float:
    """Common factor on the scatter that the shapes of all modes ask for: root of the median of chi2 over freedom.

    What a model lacks spoils a few modes; a scatter that is stated too small spoils all of them alike. The factor is 1
    when the modes differ by more than chance once it is taken out, and NaN without shapes of at least 4 modes. The
    median of chi-square variates lies 1.5 % below their mean. For many modes it is as uncertain as the mean of 2/pi
    times as many (Cramer 1946), so that the ratio of a mode to it is about an F variate; modes that share a factor then
    look different in 0.4 to 0.7 % of the cases, for a level of 1 %.
    """
    shapes = modes[(modes["kind"] == "shape") & (modes["freedom"] >= 5)]
    if len(shapes) < 4:
        return float("nan")
    chi2, freedom = shapes["chi2"].to_numpy(dtype=float), shapes["freedom"].to_numpy(dtype=float)
    square = float(np.median(chi2 / freedom) / 0.985)
    ratio = stats.f(freedom, 2 / np.pi * freedom.sum())
    tail = 2 * np.minimum(ratio.sf(chi2 / freedom / square), ratio.cdf(chi2 / freedom / square))
    alike = float(tail.min()) * len(shapes) > _ALIKE
    return float(np.sqrt(square)) if alike or square < 1 else 1.0
