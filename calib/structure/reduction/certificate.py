"""Errors of a reduced model against the full model, both solved at the same points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from calib.structure.modes import Modes
from calib.structure.reduction.reduced import ReducedModel

if TYPE_CHECKING:
    import pandas as pd

_CLUSTER = 0.01
"""Modes closer than this relative frequency difference are compared as one subspace: single shapes are ill-defined."""
_LOST = 0.1
"""A full-order mode is missed when no reduced mode near it has a squared projection error below this."""


@dataclass(frozen=True, eq=False)
class ModeErrors:
    """Errors of the modes of a reduced model at one point, for the full-order modes within its tolerance range.

    Attributes
    ----------
    mode : ndarray (n_checked,), int
        Index of the full-order mode.
    eigenvalue : ndarray (n_checked,)
        ``|lambda_reduced - lambda|/|lambda|``; NaN for a missed mode.
    shape : ndarray (n_checked,)
        1 - MAC of the reduced shape with the span of the full-order shapes within 1 % in frequency; NaN for a missed
        mode.
    indicator : ndarray (n_checked,)
        Estimate of `ReducedModel.indicator`; NaN for a missed mode.
    missed : ndarray (n_checked,), bool
        Full-order modes without a counterpart in the reduced model.
    """

    mode: np.ndarray
    eigenvalue: np.ndarray
    shape: np.ndarray
    indicator: np.ndarray
    missed: np.ndarray

    @property
    def worst(self) -> float:
        """Largest eigenvalue or shape error; infinite when a mode is missed, 0 when no mode is checked."""
        if self.missed.any():
            return float("inf")
        return float(max(np.max(self.eigenvalue, initial=0.0), np.max(self.shape, initial=0.0)))


def mode_errors(
    reduced: ReducedModel, values: Mapping[str, float], count: int, full: Modes | None = None
) -> ModeErrors:
    """Compare reduced modes with full-order ones at named values.

    Full-order modes below the frequency and damping ratio that the basis was trained for are checked. Each takes the
    nearest free eigenvalue of the reduced model; the comparison is as complete as the full-order list.

    Parameters
    ----------
    reduced : ReducedModel
    values : mapping
    count : int
        Number of modes.
    full : Modes, optional
        The full model's modes there, at least ``count`` and better a few more; solved when not given.

    Raises
    ------
    EvaluationError
        When the point cannot be solved.
    """
    modes = reduced.modes(values, count)
    extra = full if full is not None else reduced.model.modes(values, count + 4)
    estimate = reduced.indicator(values, modes)
    lifted = reduced.lift(modes.shapes)
    truth, found = _eigenvalues(extra), _eigenvalues(modes)
    basis = reduced.basis
    checked = np.flatnonzero(
        (extra.natural_freq <= basis.freq_max)
        & (extra.damping_ratio < basis.damping_max)
        & (np.arange(extra.n_modes) < count)
    )
    eigenvalue, shape, indicator = (np.full(len(checked), np.nan) for _ in range(3))
    missed = np.ones(len(checked), dtype=bool)
    free = np.ones(modes.n_modes, dtype=bool)
    for row, i in enumerate(checked):
        gap = np.abs(found - truth[i]) / abs(truth[i])
        near = np.abs(extra.natural_freq / extra.natural_freq[i] - 1) < _CLUSTER
        error = _projection_error(lifted, extra.shapes[:, near])
        candidates = np.flatnonzero(free & (error < _LOST))
        if not len(candidates):
            continue
        j = candidates[np.argmin(gap[candidates])]
        free[j], missed[row] = False, False
        eigenvalue[row], shape[row], indicator[row] = gap[j], error[j], estimate[j]
    return ModeErrors(checked, eigenvalue, shape, indicator, missed)


def certificate(
    reduced: ReducedModel, points: Sequence[Mapping[str, float]], count: int
) -> tuple[pd.DataFrame, list[ModeErrors]]:
    """Compare both models at many points: one row per quantity with its largest, 99 % and median value.

    Returns
    -------
    table : DataFrame
        Columns ``quantity, max, quantile_99, median, above_tolerance``; quantities ``eigenvalue``, ``shape`` (1 - MAC)
        and ``missed`` (number of missed modes in ``max`` and ``above_tolerance``).
    errors : list of ModeErrors
    """
    import pandas as pd

    errors = [mode_errors(reduced, point, count) for point in points]
    rows: list[tuple[str, float, float, float, int]] = []
    for name in ("eigenvalue", "shape"):
        numbers = np.concatenate([getattr(e, name) for e in errors])
        numbers = numbers[np.isfinite(numbers)]
        high, middle = np.quantile(numbers, [0.99, 0.5]) if len(numbers) else (np.nan, np.nan)
        above = int(np.count_nonzero(numbers > reduced.basis.tolerance))
        rows.append((name, float(np.max(numbers, initial=0.0)), float(high), float(middle), above))
    lost = int(sum(e.missed.sum() for e in errors))
    rows.append(("missed", float(lost), np.nan, np.nan, lost))
    return pd.DataFrame(rows, columns=["quantity", "max", "quantile_99", "median", "above_tolerance"]), errors


def _eigenvalues(modes: Modes) -> np.ndarray:
    return 2 * np.pi * (-modes.damping_ratio * modes.natural_freq + 1j * modes.damped_freq)


def _projection_error(shapes: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """1 - MAC of each shape with the span of others, (n_modes,)."""
    basis = np.linalg.qr(truth / np.linalg.norm(truth, axis=0))[0]
    unit = shapes / np.linalg.norm(shapes, axis=0)
    rest = unit - basis @ (basis.conj().T @ unit)
    return np.sum(np.abs(rest) ** 2, axis=0)
