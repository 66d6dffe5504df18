"""Model updating from FRFs by cross-model cross-FRF equations (Li and Hong 2012), with reduction to measured places.

With the dynamic stiffness ``Z(omega) = K + i omega C + i D - omega^2 M`` of the model, reduced to the measured degrees
of freedom as ``Z_s = T^T Z T``, and the measured receptance H* at omega*_j, every residual is

    R_j = W_i [I_Q - Z_s(omega*_j) H*_j],   W_i = H_s(omega_i)^T,

which vanishes for the right model whatever the frequency omega_i: the left factor W_i weights equations and adds none
(at most n_masters x n_references x n_lines of them are independent). The residual is linear in the changes of K, D, C
and M but for the change of T. Both iterations of the article solve

    A (theta_{k+1} - theta_k) = R(theta_k)   by least squares,

and differ in one place, the point at which A and W are evaluated. The proposed iteration keeps them at the initial
model, which is a chord (frozen Jacobian) iteration; the article's term G_k is the difference of R(theta_k) from
R(theta_0) - A theta_k. The traditional one evaluates them at every step. Without noise both have the same limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.errors.errors import EvaluationError, InputError
from calib.inference.cmcf_equations import (
    DEFAULT,
    Change,
    CmcfSettings,
    Equations,
    InitialModel,
    MeasuredReceptance,
    Reduced,
    complex_with,
)


@dataclass(frozen=True, eq=False)
class CmcfResult:
    """The iterates.

    Attributes
    ----------
    names : tuple of str
    changes : ndarray (n_steps + 1, n_changes)
        theta after each step, from 0.
    freq : ndarray (n_steps + 1, orders)
        Natural frequencies of the reduced updated model, Hz.
    converged : bool
    builds : int
        How often the matrix A of the equations was built.
    slope : ndarray (n_changes, n_lines, n_masters, n_references)
        Derivative of theta by the receptance, see `calib.inference.cmcf_equations.Equations.slope`: to first order, the
        changes being small.
    prior_slope : ndarray (n_changes, n_prior)
        Derivative of theta by the mean of the prior; no columns without one.
    """

    names: tuple[str, ...]
    changes: np.ndarray
    freq: np.ndarray
    converged: bool
    builds: int
    slope: np.ndarray
    prior_slope: np.ndarray

    @property
    def values(self) -> dict[str, float]:
        """Each change at the end."""
        return {name: float(v) for name, v in zip(self.names, self.changes[-1], strict=True)}


def cmcf(
    model: InitialModel,
    measured: MeasuredReceptance,
    settings: CmcfSettings = DEFAULT,
    prior_sd: np.ndarray | None = None,
    prior_mean: np.ndarray | None = None,
) -> CmcfResult:
    """Changes of the model with which it has the measured receptance.

    Parameters
    ----------
    model : InitialModel
    measured : MeasuredReceptance
    settings : CmcfSettings
    prior_sd : ndarray (n_changes,), optional
        Standard deviation of the prior of each change, over the relative error of the receptance; it needs the
        weighting ``white``, whose equations have that error. Without it the equations alone decide.
    prior_mean : ndarray (n_changes,), optional
        Its mean; 0 by default.

    Raises
    ------
    InputError
        When there are fewer equations than unknowns, the equations do not determine some changes, or a prior is given
        with another weighting.
    EvaluationError
        When a dynamic stiffness is inverted too close to a resonance, or a stiffness or mass would not stay positive.
    """
    if prior_sd is not None and settings.weighting != "white":
        raise InputError(
            f"a prior is given with the weighting {settings.weighting!r}", place="cross-model equations",
            remedy="weight them 'white', so that their errors have a known size",
        )  # fmt: skip
    n_changes = len(model.changes)
    theta, path = np.zeros(n_changes), [np.zeros(n_changes)]
    mean = np.zeros(n_changes) if prior_mean is None else prior_mean
    reduced = Reduced.of(model, theta)
    independent = measured.receptance.size * (2 if complex_with(reduced, measured) else 1)
    if independent < n_changes and prior_sd is None:
        raise InputError(
            f"{independent} independent equations do not determine {n_changes} changes",
            place="cross-model equations",
            remedy="measure at more places or lines, or free fewer parameters",
        )
    freq = [reduced.freq(settings.orders)]
    equations, builds, converged = Equations.at(reduced, measured, settings, prior_sd), 1, False
    for step in range(settings.steps):
        if step and settings.iteration != "proposed":
            base = reduced if settings.iteration == "traditional" else reduced.with_changes(np.zeros(n_changes))
            equations, builds = Equations.at(base, measured, settings, prior_sd), builds + 1
        theta = theta + equations.solve(reduced.imbalance(measured), theta - mean)
        require_positive_factors(model.changes, theta)
        reduced = Reduced.of(model, theta)
        path.append(theta)
        freq.append(reduced.freq(settings.orders))
        if np.all(np.abs(freq[-1] - freq[-2]) <= settings.tolerance * freq[-2]):
            converged = True
            break
    slope = equations.slope(reduced.dynamic(measured.freq), len(measured.references))
    return CmcfResult(
        tuple(c.name for c in model.changes), np.array(path), np.array(freq), converged, builds, slope,
        equations.prior_slope,
    )  # fmt: skip


def require_positive_factors(changes: Sequence[Change], theta: np.ndarray) -> None:
    """EvaluationError when a stiffness or mass factor 1 + theta is not positive, so that the model makes no sense."""
    for change, value in zip(changes, theta, strict=True):
        if change.is_factor and change.kind in ("stiffness", "mass") and not 1 + value > 0:
            raise EvaluationError(
                f"the factor of {change.name} becomes {1 + value:.3g}: the FRFs do not determine it, or do not fit"
            )
