"""How well a fitted model does on data that were used, left out one mode at a time, and withheld."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.response_residual import ResponseResidual
from calib.correlation.responses import response_rows
from calib.correlation.scatter import Floors
from calib.correlation.unused import group_table, withheld_errors
from calib.forward import ForwardProblem, Targets
from calib.freedom import KNOWN, behind, chance, effective_freedom
from calib.inference.identify import posterior, with_held
from calib.inference.left_out import left_out
from calib.space import ParameterSpace
from calib.study import Study

_NONE: Mapping[str, float] = MappingProxyType({})

WITHHELD_RESPONSES = "withheld_responses"
"""Group of responses that no fit sees, as tables name it."""
ERROR_COLUMNS = ("group", "rows", "rms", "expected", "p", "unpaired")


def errors_at(study: Study, values: Mapping[str, float]) -> pd.DataFrame:
    """Errors of a study's model by group of data, at fitted values of the selected parameters; see `errors_of`."""
    whole, unseen = study.whole_problem(), withheld_targets(study)
    return errors_of(study.problem, whole, unseen, study.search_space, values, study.held_sd)


def errors_of(
    problem: ForwardProblem,
    whole: ModalProblem | None,
    unseen: Mapping[str, Targets],
    space: ParameterSpace,
    values: Mapping[str, float],
    held_sd: Mapping[str, float] = _NONE,
) -> pd.DataFrame:
    """Errors by group of data used, left out in turn, and withheld; see `modal_errors` and `plain_errors`.

    Parameters
    ----------
    problem : ModalProblem or FunctionProblem
        What the fit saw.
    whole : ModalProblem or None
        The same model with all modes and sensors.
    unseen : mapping from group to targets
        Plain responses that the fit did not see.
    space : ParameterSpace
        Free are the fitted parameters.
    values : mapping from str to float
        Fitted values.
    held_sd : mapping from str to float
        Standard deviations of held parameters that are known with a scatter only.
    """
    names = tuple(p.name for p in space.free if not p.integer)
    prior_sd = np.array([space[n].prior_width for n in names])
    if isinstance(problem, ModalProblem):
        freedom = ModalResidual(problem).scatter_freedom
        return modal_errors(problem, whole, values, names, prior_sd, Floors(), freedom, held_sd=held_sd)
    problem = replace(problem, space=space)
    withheld = {group: whitened(problem, own, values, names, held_sd) for group, own in unseen.items()}
    e, g = whitened(problem, problem.targets, values, names, held_sd)
    return plain_errors(e, g, names, prior_sd, list(problem.targets), withheld, plain_scatter(problem))


def withheld_targets(study: Study) -> dict[str, Targets]:
    """Plain responses that enter no fit, by the group they are told in."""
    return {WITHHELD_RESPONSES: {n: study.whole_targets[n] for n in study.settings.withheld.responses}}


def whitened(
    problem: FunctionProblem,
    targets: Targets,
    values: Mapping[str, float],
    names: Sequence[str],
    held_sd: Mapping[str, float] = _NONE,
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residual (n_targets,) of a function on some targets, and its derivative (n_targets, n_params + n_held).

    The last columns are its changes by one standard deviation of each held parameter.
    """
    if not targets:
        return np.zeros(0), np.zeros((0, len(names) + len(held_sd)))
    asked = ResponseResidual(replace(problem, targets=targets))
    unit = np.array([*np.ones(len(names)), *held_sd.values()])
    return asked.residual(values), asked.jacobian(values, (*names, *held_sd)) * unit


def plain_scatter(problem: FunctionProblem) -> float:
    """Degrees of freedom behind the scatter of all responses of a function together."""
    kinds = [row.kind for row in response_rows(problem.targets)]
    counts = {kind: float(kinds.count(kind)) for kind in kinds}
    return behind(counts, problem.scatter_freedom)


def modal_errors(
    fitted: ModalProblem,
    whole: ModalProblem | None,
    values: Mapping[str, float],
    names: Sequence[str],
    prior_sd: np.ndarray,
    floors: Floors,
    scatter_freedom: Mapping[str, float],
    scale: float = 1.0,
    held_sd: Mapping[str, float] = _NONE,
) -> pd.DataFrame:
    """Errors of a fitted modal model by group of data, rms in units of the scatter.

    Parameters
    ----------
    fitted : ModalProblem
        With the data that were used.
    whole : ModalProblem or None
        The same model with all data.
    values : mapping
        Fitted values.
    names : sequence of str
        Fitted parameters, whole-number ones left out.
    prior_sd : ndarray (n_params,)
    floors : Floors
    scatter_freedom : mapping from str to float
        By kind of response; infinite where the scatter is known.
    scale : float
        Factor on the scatter.
    held_sd : mapping from parameter name to float
        Standard deviations of held parameters that are known with a scatter only; withheld data err by them too.

    Returns
    -------
    DataFrame
        ``group, rows, rms, expected, p, unpaired``; groups ``fit``, ``left_out`` (each mode predicted from all others),
        ``withheld_sensors``, ``withheld_modes``. ``expected`` is what a right model would show.
    """
    residual = ModalResidual(fitted, floors)
    found = fitted.compare(values)
    vector = residual.of(found) / scale
    jacobian = residual.slope_of(found, names, residual.derivatives(found, names)) / scale
    known = posterior(names, jacobian, prior_sd)
    modes = [row.mode for row in residual.rows]
    predicted = left_out(vector, -jacobian, prior_sd, modes)
    own: dict[Hashable, int] = {mode: residual.n_fitted_factors_of({mode}) for mode in dict.fromkeys(modes)}
    finite = {kind: freedom for kind, freedom in scatter_freedom.items() if np.isfinite(freedom)}
    withheld = pd.DataFrame(columns=[*ERROR_COLUMNS, "chi2", "freedom"])
    if whole is not None and (whole.measured.n_modes, len(whole.measured.sensors)) != (
        fitted.measured.n_modes, len(fitted.measured.sensors),
    ):  # fmt: skip
        held = None
        if held_sd:
            held = residual.slope_of(found, tuple(held_sd), residual.derivatives(found, tuple(held_sd)))
            held = held * list(held_sd.values()) / scale
        unit = np.array([*np.ones(len(names)), *held_sd.values()])
        covariance = with_held(known, jacobian, held) * np.outer(unit, unit) / scale**2
        withheld = withheld_errors(fitted, whole, values, (*names, *held_sd), covariance, floors, finite or None)
        if scale != 1.0:
            withheld = _scaled(withheld, scale, min(finite.values(), default=KNOWN))
    freedom = effective_freedom(jacobian, prior_sd, residual.n_fitted_factors)
    return group_table(
        residual.rows,
        vector,
        freedom,
        predicted.residual,
        predicted.variance,
        withheld,
        fitted_factors=residual.n_fitted_factors,
        left_out_p=predicted.p(own, min(finite.values(), default=np.inf)),
        unpaired=fitted.measured.n_modes - len(found.pairing.paired),
        scatter_freedom=finite or None,
    )


def _scaled(table: pd.DataFrame, scale: float, scatter: float) -> pd.DataFrame:
    """Errors in units of a larger scatter, which rests on no more degrees of freedom than before."""
    table = table.assign(rms=table["rms"] / scale, chi2=table["chi2"] / scale**2)
    return table.assign(p=chance(table["chi2"].to_numpy(float), table["freedom"].to_numpy(float), scatter))


def plain_errors(
    residual: np.ndarray,
    jacobian: np.ndarray,
    names: Sequence[str],
    prior_sd: np.ndarray,
    labels: Sequence[str],
    withheld: Mapping[str, tuple[np.ndarray, np.ndarray]],
    scatter: float = KNOWN,
) -> pd.DataFrame:
    """The same for plain responses, each of which is left out by itself.

    Parameters
    ----------
    residual : ndarray (n_rows,)
        Whitened, of the responses that were used.
    jacobian : ndarray (n_rows, n_params + n_held)
        Its derivative, and its changes by one standard deviation of each held parameter.
    names : sequence of str
    prior_sd : ndarray (n_params,)
    labels : sequence of str, length n_rows
        Names of the responses.
    withheld : mapping from group to (residual, jacobian)
        Whitened residuals of withheld responses with derivatives of the same columns; empty groups are left out.
    scatter : float
        Degrees of freedom behind the standard deviations; see `plain_scatter`.
    """
    jacobian, held = jacobian[:, : len(names)], jacobian[:, len(names) :]
    known = with_held(posterior(names, jacobian, prior_sd), jacobian, held)
    predicted = left_out(residual, -jacobian, prior_sd, list(labels))
    freedom = effective_freedom(jacobian, prior_sd)
    p, p_left_out = float(chance(residual @ residual, freedom, scatter)), predicted.p({}, scatter)
    rows: list[tuple[str, int, float, float, float, int]] = [
        ("fit", len(residual), _rms(residual), float(np.sqrt(freedom / len(residual))), p, 0),
        ("left_out", len(residual), _rms(predicted.residual), _rms(np.sqrt(predicted.variance)), p_left_out, 0),
    ]
    for group, (e, g) in withheld.items():
        if len(e):
            covariance = np.eye(len(e)) + g @ known @ g.T
            chi2 = float(e @ np.linalg.solve(covariance, e))
            expected = float(np.sqrt(np.trace(covariance) / len(e)))
            rows.append((group, len(e), _rms(e), expected, float(chance(chi2, len(e), scatter)), 0))
    return pd.DataFrame(rows, columns=list(ERROR_COLUMNS))


def _rms(e: np.ndarray) -> float:
    return float(np.sqrt(np.mean(e**2)))
