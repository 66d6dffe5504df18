"""Prediction errors of a fitted model on held-out data, in standard deviations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.rows import ModalRow
from calib.correlation.modal.whole_solution import WholeSolution, used_data
from calib.correlation.standard_deviations import Floors
from calib.errors.errors import InputError
from calib.problem.degrees_of_freedom import behind, p_value
from calib.structure.modes import Modes

COLUMNS = ("group", "rows", "rms", "expected", "chi2", "dof", "p", "unpaired")

_FLOORS = Floors()

StdDof = Mapping[str, float]
"""Degrees of freedom behind the standard deviation of each kind of row; a missing kind is known exactly."""


@dataclass(frozen=True, eq=False)
class HeldOutRows:
    """Held-out rows of one group beside what a fitted model predicts, whitened.

    Attributes
    ----------
    labels : tuple of Row
        Length n.
    residual : ndarray (n,)
    slope : ndarray (n, n_params)
        Derivative of the residual per unit of each parameter.
    factor_spread : ndarray (n, n_factors)
        Its change by one standard deviation of every factor that was fitted to used sensors.
    factors : int
        Factors that are fitted to these rows themselves.
    lost : ndarray (n,), bool
        Rows of measured modes without a partner.
    value : ndarray (n,)
        What was measured: Hz, ratio, or part of a shape of largest entry 1.
    std : ndarray (n,)
        Standard deviation: relative of frequencies and damping, else in the unit of the value.
    """

    labels: tuple[ModalRow, ...]
    residual: np.ndarray
    slope: np.ndarray
    factor_spread: np.ndarray
    factors: int
    lost: np.ndarray
    value: np.ndarray
    std: np.ndarray


def held_out_errors(
    fitted: ModalProblem,
    whole: ModalProblem,
    values: Mapping[str, float],
    names: Sequence[str],
    covariance: np.ndarray,
    floors: Floors = _FLOORS,
    std_dof: StdDof | None = None,
    pool: bool | None = None,
    solved: Modes | None = None,
    known: WholeSolution | None = None,
) -> pd.DataFrame:
    """Errors of a fitted model at held-out sensors and in held-out modes, with the expectation if correctly specified.

    - ``held_out_sensors``: shapes of used modes at the held-out sensors, ``(u - a v)/std`` with the factor a fitted on
      the used sensors alone. The covariance for a correctly specified model is ``C = I + F F^T + G V G^T``: the noise
      of the held-out sensors, of the factors, and of the fitted parameters (V) through the derivative G of these rows
      with the factors refitted.
    - ``held_out_modes``: frequency, damping and shape of held-out modes, the factor fitted on all sensors of the mode,
      so that ``C = P + G V G^T`` with P the projection across the model shape.

    Used modes keep their partners from the used data; held-out modes are paired with the remaining model modes, and an
    unpaired one counts as in `ModalResidual`. All rows have the scale and standard deviation of the whole measurement,
    whatever the scaling of the used shapes. A shape without a derivative (see
    `calib.structure.eigenproblem.derivatives`) is omitted from ``G V G^T``.

    Parameters
    ----------
    fitted : ModalProblem
        With the used data only.
    whole : ModalProblem
        The same model with the whole measurement.
    values : mapping
        Fitted values.
    names : sequence of str
        Uncertain parameters, length n_params: fitted ones except integers, and held ones.
    covariance : ndarray (n_params, n_params)
        Posterior covariance given the used data, in their own units.
    floors, pool
        As in `ModalResidual`.
    std_dof : mapping from str to float, optional
        Degrees of freedom behind the standard deviation of ``frequency``, ``damping`` and ``shape``, where it was
        estimated from few repeats.
    solved : Modes, optional
        Of the model at these values, which is then not solved again.
    known : WholeSolution, optional
        At these values, with derivatives by these parameters.

    Returns
    -------
    DataFrame
        ``group, rows, rms, expected, chi2, dof, p, unpaired``, one row for each nonempty group. ``rms`` is in units of
        the standard deviation and ``expected`` the square root of the mean diagonal of C; ``chi2 = e^T C^-1 e`` with
        ``dof`` rows less fitted factors; ``p`` the probability of an equal or larger chi2 for a correctly specified
        model (chi-square, or F where the standard deviation was estimated); ``unpaired`` counts the measured modes
        without a partner.

    Raises
    ------
    InputError
        When the used data are not part of the whole, or the covariance is not finite or of the wrong size.
    EvaluationError
        When the model cannot be solved.
    """
    spread = covariance_root(covariance, names)
    parts = []
    for group, own in held_out_rows(fitted, whole, values, names, floors, pool, solved, known).items():
        parts.append(_errors(group, own, np.hstack([own.slope @ spread, own.factor_spread]), std_dof))
    return pd.DataFrame(parts, columns=list(COLUMNS))


def held_out_rows(
    fitted: ModalProblem,
    whole: ModalProblem,
    values: Mapping[str, float],
    names: Sequence[str],
    floors: Floors = _FLOORS,
    pool: bool | None = None,
    solved: Modes | None = None,
    known: WholeSolution | None = None,
) -> dict[str, HeldOutRows]:
    """Rows of the held-out data by group, those that hold something; see `held_out_errors`.

    Raises
    ------
    InputError
        When the used data are not part of the whole.
    EvaluationError
        When the model cannot be solved.
    """
    used_modes, used_sensors = used_data(fitted, whole)
    measured = whole.measured
    hidden = {s.name for s in measured.sensors} - set(used_sensors)
    if set(measured.names) == set(used_modes) and not hidden:
        return {}
    known = known or WholeSolution.of(fitted, whole, values, names, floors, pool, solved)
    found, slopes = known.found, known.slopes
    lost = {measured.names[i] for i in found.pairing.unpaired_measured}
    at_used = np.array([s.name in used_sensors for s in measured.sensors], dtype=bool)
    seen = {
        m for m, shown in zip(measured.names, np.isfinite(measured.shapes)[at_used].any(axis=0), strict=True) if shown
    }

    own = ModalResidual(whole, floors, pool)
    value = measured_values(own)

    def taken(rows: np.ndarray, predicted: ModalResidual, spread: np.ndarray, factors: int) -> HeldOutRows:
        labels = tuple(r for r, wanted in zip(own.rows, rows, strict=True) if wanted)
        return HeldOutRows(
            labels, predicted.of(found)[rows], predicted.slope_of(found, names, slopes)[rows], spread[rows], factors,
            np.array([r.mode in lost for r in labels], dtype=bool), value[rows], own.relative_std[rows],
        )  # fmt: skip

    out = {}
    rows = np.array([r.mode in used_modes and r.mode in seen and r.sensor in hidden for r in own.rows], dtype=bool)
    if rows.any():
        predicted = replace(own, factor_sensors=used_sensors)
        out["held_out_sensors"] = taken(rows, predicted, predicted.factor_spread(found), 0)
    rows = np.array([r.mode not in used_modes for r in own.rows], dtype=bool)
    if rows.any():
        factors = own.n_fitted_factors_of({r.mode for r, wanted in zip(own.rows, rows, strict=True) if wanted})
        out["held_out_modes"] = taken(rows, own, np.zeros((len(rows), 0)), factors)
    return out


def measured_values(residual: ModalResidual) -> np.ndarray:
    """What was measured in every row of a residual, (n_rows,); a shape that is compared as real at its main phase."""
    measured = residual.problem.measured
    index = {name: k for k, name in enumerate(measured.names)}
    complex_modes = {row.mode for row in residual.rows if row.part == "im"}
    shapes = np.array(measured.shapes, dtype=complex)
    for name in set(measured.names) - complex_modes:
        own = shapes[:, index[name]]
        shapes[:, index[name]] = own * np.exp(-0.5j * np.angle(np.nansum(own**2)))
    at = {sensor.name: k for k, sensor in enumerate(measured.sensors)}
    out = []
    for row in residual.rows:
        i = index[row.mode]
        if row.kind == "shape":
            entry = shapes[at[row.sensor], i]
            out.append(entry.imag if row.part == "im" else entry.real)
        else:
            out.append(measured.natural_freq[i] if row.kind == "frequency" else measured.damping_ratio[i])
    return np.array(out, dtype=float)


def group_table(
    rows: Sequence[ModalRow],
    used: np.ndarray,
    dof: float,
    left_out: np.ndarray,
    left_out_variance: np.ndarray,
    held_out: pd.DataFrame,
    fitted_factors: int = 0,
    left_out_p: float = math.nan,
    unpaired: int = 0,
    std_dof: StdDof | None = None,
    scale: float = 1.0,
) -> pd.DataFrame:
    """Errors of one model on used, left-out and held-out data, in one table.

    Parameters
    ----------
    rows : sequence of Row
        Of the residual of the used data, length n_rows.
    used : ndarray (n_rows,)
        Whitened residual at the fit.
    dof : float
        Degrees of freedom of its sum of squares, see `calib.problem.degrees_of_freedom.matched`.
    left_out : ndarray (n_rows,)
        Leave-one-out residual: that of every row if its group had not been used.
    left_out_variance : ndarray (n_rows,)
        Its variance for a correctly specified model, without fitted factors.
    held_out : DataFrame
        From `held_out_errors`.
    fitted_factors : int
        Real numbers fitted to the scale and phase of the used shapes.
    left_out_p : float
        p-value of the left-out errors for a correctly specified model.
    unpaired : int
        Used modes without a partner.
    std_dof : mapping from str to float, optional
        As in `held_out_errors`.
    scale : float
        Scale of the chi-square variate of those degrees of freedom.

    Returns
    -------
    DataFrame
        ``group, rows, rms, expected, p, unpaired`` of the groups ``fit``, ``left_out`` and those of ``held_out``.
    """
    e, out, variance = (np.asarray(a, dtype=float) for a in (used, left_out, left_out_variance))
    n = len(rows)
    if not (n and e.shape == out.shape == variance.shape == (n,)):
        raise InputError(f"{n} rows, but residuals {e.shape}, {out.shape}, {variance.shape}", place="errors by group")
    counts = pd.Series([row.kind for row in rows]).value_counts()
    behind_std = behind({str(kind): float(count) for kind, count in counts.items()}, std_dof)
    expected = math.sqrt(max(float(variance.sum()) - fitted_factors, 0.0) / n)
    p = float(p_value(float(e @ e) / scale, dof, behind_std))
    table = pd.DataFrame(
        [
            ("fit", n, _rms(e), math.sqrt(max(scale * dof, 0.0) / n), p, unpaired),
            ("left_out", n, _rms(out), expected, left_out_p, unpaired),
        ],
        columns=["group", "rows", "rms", "expected", "p", "unpaired"],
    )
    return table if held_out.empty else pd.concat([table, held_out[list(table.columns)]], ignore_index=True)


def covariance_root(covariance: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Matrix B with ``B B^T`` the covariance, (n_params, n_params)."""
    v = np.asarray(covariance, dtype=float)
    if v.shape != (len(names), len(names)):
        raise InputError(f"{len(names)} parameters, but a covariance {v.shape}", place="validation data")
    if not np.all(np.isfinite(v)):
        raise InputError(
            "the covariance of the fitted parameters is not finite",
            place="validation data",
            remedy="give every fitted parameter a prior",
        )
    std = np.sqrt(np.diag(v))
    size = np.where(std > 0, std, 1.0)
    value, vector = np.linalg.eigh(v / np.outer(size, size))
    return size[:, None] * vector * np.sqrt(np.maximum(value, 0.0))


def _errors(
    group: str, own: HeldOutRows, wide: np.ndarray, std_dof: StdDof | None
) -> tuple[str, int, float, float, float, float, float, int]:
    """One row of the table, for ``C = I + A A^T`` with A = ``wide``, less the directions of the own factors."""
    # Residual and A are orthogonal to those directions, so I can replace the projection orthogonal to them.
    e = own.residual
    u, s, _ = np.linalg.svd(wide, full_matrices=False)
    inside = u.T @ e
    outside = e - u @ inside
    chi2 = float(outside @ outside + np.sum(inside**2 / (1.0 + s**2)))
    n = len(e)
    dof = float(n - own.factors)
    expected = math.sqrt((dof + float(np.sum(s**2))) / n)
    unpaired = len({row.mode for row, lost in zip(own.labels, own.lost, strict=True) if lost})
    p = float(p_value(chi2, dof, behind(kinds_of(own), std_dof)))
    return group, n, _rms(e), expected, chi2, dof, p, unpaired


def kinds_of(own: HeldOutRows) -> dict[str, float]:
    """Number of rows of each kind, of shapes less the factors fitted to them."""
    counts: dict[str, float] = {}
    for row in own.labels:
        counts[row.kind] = counts.get(row.kind, 0.0) + 1.0
    if own.factors:
        counts["shape"] -= own.factors
    return counts


def _rms(e: np.ndarray) -> float:
    return math.sqrt(float(np.mean(e**2)))
