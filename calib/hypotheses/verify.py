"""Verification: errors of a fitted model on used, left-out (one mode at a time) and held-out data."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.correlation.frf.problem import FRFProblem
from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.faults import ModalFault
from calib.correlation.modal.held_out import group_table, held_out_errors
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.whole_solution import WholeSolution
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.standard_deviations import Floors
from calib.experiment.held_out import HeldOutGroups
from calib.experiment.test import Residual
from calib.inference.identify import posterior, with_held
from calib.inference.joint_part import JointPart
from calib.inference.leave_one_out import leave_one_out
from calib.inference.other_rows import OtherRows, rows_beside
from calib.problem.degrees_of_freedom import KNOWN, behind, matched, p_value
from calib.problem.joint import expand_columns
from calib.problem.prior import Prior
from calib.problem.problem import Pair
from calib.problem.space import ParameterSpace
from calib.structure.modes import Modes

_NONE: Mapping[str, float] = MappingProxyType({})

ERROR_COLUMNS = ("group", "rows", "rms", "expected", "p", "unpaired")


def errors_of(
    pair: Residual,
    whole: ModalProblem | None,
    unseen: HeldOutGroups,
    space: ParameterSpace,
    values: Mapping[str, float],
    held_sd: Mapping[str, float] = _NONE,
    joint: JointPart | None = None,
    active: Collection[str] = (),
) -> pd.DataFrame:
    """Errors by group of data: used, left out in turn, and held out; see `modal_errors` and `group_errors`.

    Parameters
    ----------
    pair : ModalResidual, ResponseResidual or FRFResidual
        The model and the fitted data.
    whole : ModalProblem or None
        The same model with all modes and sensors; None where nothing is held out.
    unseen : mapping from group to HeldOutData
        Held-out scalar responses or FRFs.
    space : ParameterSpace
        Free are the fitted parameters.
    values : mapping from str to float
        Fitted values.
    held_sd : mapping from str to float
        Standard deviations of held parameters that are uncertain.
    joint : JointPart, optional
        The fit to several tests of which this is one.
    active : collection of str
        Parameters with an active limit.
    """
    names = tuple(p.name for p in space.free if not p.integer)
    prior_sd = Prior.of(space).widths(values, names)
    others: OtherRows | None = None
    if joint is not None:
        names, prior_sd, others, held_sd = joint
    if isinstance(pair, ModalResidual):  # whose modes are paired, and whose held-out ones are paired with what is left
        return modal_errors(
            pair.problem, whole, values, names, prior_sd, Floors(), pair.std_dof, held_sd=held_sd, others=others,
            active=active,
        )  # fmt: skip
    pair = pair.within(space)
    held_out = held_out_residuals(pair.problem, unseen, values, names, held_sd)
    e, g = whitened(pair, values, names, held_sd)
    labels = [row.sensor for row in pair.rows]
    return group_errors(e, g, names, prior_sd, labels, held_out, std_behind(pair), others, active)


def held_out_residuals(
    problem: FunctionProblem | FRFProblem,
    unseen: HeldOutGroups,
    values: Mapping[str, float],
    names: Sequence[str],
    held_sd: Mapping[str, float] = _NONE,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Held-out scalar responses or FRFs as in `whitened`, by group, for the model of the fitted problem.

    The last columns are changes by one standard deviation of what no fit determines, such as the gain of a held-out
    channel.
    """
    return {
        group: whitened(own.pair(problem), values, names, {**held_sd, **own.unfitted(values)})
        for group, own in unseen.items()
    }


def whitened(
    pair: Pair, values: Mapping[str, float], names: Sequence[str], held_sd: Mapping[str, float] = _NONE
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residual (n_rows,) of a pair, and its derivative (n_rows, n_params + n_held).

    The columns of held parameters are its changes by one standard deviation of each. Parameters that the pair lacks,
    such as the gain of a channel that is not in its data, change nothing.
    """
    wanted = (*names, *held_sd)
    own = [name for name in wanted if name in pair.space]
    point = {name: value for name, value in values.items() if name in pair.space}
    unit = np.array([*np.ones(len(names)), *held_sd.values()])
    return pair.of(pair.solve(point)), expand_columns(pair.slope(point, own, pair.solve), own, wanted) * unit


def std_behind(pair: Pair) -> float:
    """Degrees of freedom behind the standard deviation of all rows together."""
    kinds = [row.kind for row in pair.rows]
    counts = {kind: float(kinds.count(kind)) for kind in dict.fromkeys(kinds)}
    return behind(counts, pair.std_dof)


def modal_errors(
    fitted: ModalProblem,
    whole: ModalProblem | None,
    values: Mapping[str, float],
    names: Sequence[str],
    prior_sd: np.ndarray,
    floors: Floors,
    std_dof: Mapping[str, float],
    scale: float = 1.0,
    held_sd: Mapping[str, float] = _NONE,
    others: OtherRows | None = None,
    active: Collection[str] = (),
    solved: Modes | None = None,
    faults: Sequence[ModalFault] = (),
) -> pd.DataFrame:
    """Errors of a fitted modal model by group of data, rms in standard deviations.

    Parameters
    ----------
    fitted : ModalProblem
        With the used data.
    whole : ModalProblem or None
        The same model with all data; None where nothing is held out.
    values : mapping
        Fitted values.
    names : sequence of str
        Fitted parameters, integer ones left out.
    prior_sd : ndarray (n_params,)
    floors : Floors
    std_dof : mapping from str to float
        By kind of response; infinite where the standard deviation is known.
    scale : float
        Factor on the standard deviation.
    held_sd : mapping from parameter name to float
        Standard deviations of held parameters that are uncertain; they add to the expected error of held-out data.
        Those that the model lacks add what they change in the fitted parameters through other tests.
    others : OtherRows, optional
        Rows of other tests in the same joint fit, in units of ``scale`` times the standard deviation. All posteriors
        are those of the joint fit: a row is predicted by all tests without its group, and the residual of these rows
        has the covariance ``I - G_a V G_a^T`` (see `calib.problem.degrees_of_freedom.matched`).
    active : collection of str
        Parameters with an active limit; they stay there when a mode is left out.
    solved : Modes, optional
        Of the model at these values, which is then not solved again.
    faults : sequence of ModalFault
        Faults of the used data whose magnitudes are among the values. Held-out data are compared as they were measured.

    Returns
    -------
    DataFrame
        ``group, rows, rms, expected, p, unpaired``; groups ``fit``, ``left_out`` (each mode predicted from all others),
        ``held_out_sensors``, ``held_out_modes``. ``expected`` is what a correctly specified model would show.
    """
    residual = ModalResidual(fitted, floors, faults=tuple(faults))
    found = residual.solve(values, solved)
    vector = residual.of(found) / scale
    known, slopes = None, None
    if whole is not None and not faults and not held_sd:
        known = WholeSolution.of(fitted, whole, values, names, floors, solved=found.modes)
        slopes = known.derivatives_of_used(residual, found)
    if faults:
        jacobian = residual.slope(values, names, lambda at: found if dict(at) == dict(values) else residual.solve(at))
    else:
        jacobian = residual.slope_of(found, names, residual.derivatives(found, names) if slopes is None else slopes)
    jacobian = jacobian / scale
    others = rows_beside(others, len(names), len(held_sd))
    modes = [row.mode for row in residual.rows]
    at_limit = [name in active for name in names]
    predicted = leave_one_out(vector, -jacobian, prior_sd, modes, others.slope, at_limit)
    own: dict[Hashable, int] = {mode: residual.n_fitted_factors_of({mode}) for mode in dict.fromkeys(modes)}
    finite = {kind: dof for kind, dof in std_dof.items() if np.isfinite(dof)}
    held_out = pd.DataFrame(columns=[*ERROR_COLUMNS, "chi2", "dof"])
    if whole is not None:
        uncertain, covariance = modal_covariance(residual, found, jacobian, names, prior_sd, scale, held_sd, others)
        own_faults = {fault.name for fault in faults}
        kept = [k for k, name in enumerate(uncertain) if name not in own_faults]
        uncertain, covariance = tuple(uncertain[k] for k in kept), covariance[np.ix_(kept, kept)]
        values = {name: value for name, value in values.items() if name not in own_faults}
        held_out = held_out_errors(
            fitted, whole, values, uncertain, covariance / scale**2, floors, finite or None, solved=found.modes,
            known=known,
        )  # fmt: skip
        if scale != 1.0:
            held_out = _scaled(held_out, scale, min(finite.values(), default=KNOWN))
    own_scale, dof = matched(jacobian, prior_sd, residual.n_fitted_factors, others.slope)
    return group_table(
        residual.rows,
        vector,
        dof,
        predicted.residual,
        predicted.variance,
        held_out,
        fitted_factors=residual.n_fitted_factors,
        left_out_p=predicted.p(own, min(finite.values(), default=np.inf)),
        unpaired=fitted.measured.n_modes - len(found.pairing.paired),
        std_dof=finite or None,
        scale=own_scale,
    )


def modal_covariance(
    residual: ModalResidual,
    found: Comparison,
    jacobian: np.ndarray,
    names: Sequence[str],
    prior_sd: np.ndarray,
    scale: float = 1.0,
    held_sd: Mapping[str, float] = _NONE,
    others: OtherRows | None = None,
) -> tuple[tuple[str, ...], np.ndarray]:
    """Uncertain parameters of a modal model with their posterior covariance, in their own units.

    Those that are fitted, then held ones that the model has.

    Parameters
    ----------
    residual : ModalResidual
        Of the used data.
    found : Comparison
        With them, at the fit.
    jacobian : ndarray (n_rows, n_params)
        In units of ``scale`` times the standard deviation.
    names, prior_sd, scale, held_sd, others
        As in `modal_errors`.
    """
    others = rows_beside(others, len(names), len(held_sd))
    every = np.vstack([jacobian, -others.slope])
    held, inside = None, tuple(name for name in held_sd if name in residual.problem.model.space)
    if held_sd:
        own_held = residual.slope_of(found, inside, residual.derivatives(found, inside))
        held = expand_columns(own_held, inside, tuple(held_sd)) * list(held_sd.values()) / scale
        held = np.vstack([held, -others.held])
    unit = np.array([*np.ones(len(names)), *held_sd.values()])
    covariance = with_held(posterior(names, every, prior_sd), every, held) * np.outer(unit, unit)
    kept = [k for k, name in enumerate((*names, *held_sd)) if k < len(names) or name in inside]
    return (*names, *inside), covariance[np.ix_(kept, kept)]


def _scaled(table: pd.DataFrame, scale: float, std: float) -> pd.DataFrame:
    """Errors in units of a larger standard deviation, with unchanged degrees of freedom."""
    table = table.assign(rms=table["rms"] / scale, chi2=table["chi2"] / scale**2)
    return table.assign(p=p_value(table["chi2"].to_numpy(float), table["dof"].to_numpy(float), std))


def group_errors(
    residual: np.ndarray,
    jacobian: np.ndarray,
    names: Sequence[str],
    prior_sd: np.ndarray,
    labels: Sequence[str],
    held_out: Mapping[str, tuple[np.ndarray, np.ndarray]],
    std: float = KNOWN,
    others: OtherRows | None = None,
    active: Collection[str] = (),
) -> pd.DataFrame:
    """The same for scalar responses or FRFs, each of which is left out in turn.

    Parameters
    ----------
    residual : ndarray (n_rows,)
        Whitened, of the used data.
    jacobian : ndarray (n_rows, n_params + n_held)
        Its derivative, and its changes by one standard deviation of each held parameter.
    names : sequence of str
    prior_sd : ndarray (n_params,)
    labels : sequence of str, length n_rows
        Name of the response or FRF of every row.
    held_out : mapping from group to (residual, jacobian)
        Whitened residuals of held-out data with derivatives of the same columns, then changes by one standard
        deviation of what no fit determines; empty groups are left out.
    std : float
        Degrees of freedom behind the standard deviations; see `std_behind`.
    others, active
        As in `modal_errors`.
    """
    unseen = {group: (e, predicted_spread(jacobian, names, prior_sd, g, others)) for group, (e, g) in held_out.items()}
    jacobian, held = jacobian[:, : len(names)], jacobian[:, len(names) :]
    others = rows_beside(others, len(names), held.shape[1])
    at_limit = [name in active for name in names]
    predicted = leave_one_out(residual, -jacobian, prior_sd, list(labels), others.slope, at_limit)
    scale, dof = matched(jacobian, prior_sd, others=others.slope)
    p, p_left_out = float(p_value(residual @ residual / scale, dof, std)), predicted.p({}, std)
    rows: list[tuple[str, int, float, float, float, int]] = [
        ("fit", len(residual), _rms(residual), float(np.sqrt(scale * dof / len(residual))), p, 0),
        ("left_out", len(residual), _rms(predicted.residual), _rms(np.sqrt(predicted.variance)), p_left_out, 0),
    ]
    for group, (e, u) in unseen.items():
        if len(e):
            # Covariance I + U U^T, by Woodbury's identity: FRFs have thousands of rows and few parameters.
            chi2 = float(e @ e - (u.T @ e) @ np.linalg.solve(np.eye(u.shape[1]) + u.T @ u, u.T @ e))
            expected = float(np.sqrt(1 + np.sum(u**2) / len(e)))
            rows.append((group, len(e), _rms(e), expected, float(p_value(chi2, len(e), std)), 0))
    return pd.DataFrame(rows, columns=list(ERROR_COLUMNS))


def predicted_spread(
    jacobian: np.ndarray, names: Sequence[str], prior_sd: np.ndarray, g: np.ndarray, others: OtherRows | None = None
) -> np.ndarray:
    """U with ``I + U U^T`` the covariance of whitened residuals of held-out data, (n_rows, n_columns).

    Parameters
    ----------
    jacobian, names, prior_sd, others
        As in `group_errors`.
    g : ndarray (n_rows, n_columns)
        Derivatives of the held-out data, as given there.
    """
    jacobian, held = jacobian[:, : len(names)], jacobian[:, len(names) :]
    others = rows_beside(others, len(names), held.shape[1])
    every = np.vstack([jacobian, -others.slope])
    known = with_held(posterior(names, every, prior_sd), every, np.vstack([held, -others.held]))
    return np.hstack([g[:, : len(known)] @ _root(known), g[:, len(known) :]])


def _root(covariance: np.ndarray) -> np.ndarray:
    """R with ``R R^T`` the covariance, which may be singular."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(eigenvalues, 0.0))


def _rms(e: np.ndarray) -> float:
    return float(np.sqrt(np.mean(e**2)))
