"""Fit of a library's effect to the modes of a model rebuilt with that change: magnitude and remaining misfit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calib import Effect, MeasuredModes, StructuralModel
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import Floors
from calib.structure import extend


@dataclass(frozen=True)
class Rediscovery:
    """An effect fitted to a rebuilt model's modes.

    Attributes
    ----------
    values : mapping from str to float
        Magnitude and nuisance parameters of the best fit.
    std : float
        Standard deviation of the magnitude due to measurement uncertainty.
    before, after : float
        Length of the change of the modes by the rebuilt model, and of what the effect leaves of it, in standard
        deviations.
    """

    values: Mapping[str, float]
    std: float
    before: float
    after: float


def rediscovered(
    base: StructuralModel,
    effect: Effect,
    plain: MeasuredModes,
    changed: MeasuredModes,
    start: Mapping[str, float],
    mode_count: int,
) -> Rediscovery:
    """Fit magnitude and nuisance parameters to ``changed``, less the difference of the meshes without the change.

    That difference follows from ``plain``, the modes of the rebuilt mesh without the change. Modes are noise-free, with
    the standard deviations of a test; the start is off the true values.
    """
    model = extend(base, [effect])
    count = mode_count + model.n_dof - base.n_dof
    floors = Floors(freq=0.0, damping=0.0, shape=0.0)

    def residual(own: StructuralModel, measured: MeasuredModes, solved: int) -> ModalResidual:
        return ModalResidual(ModalProblem(own, measured, mode_count=solved, threshold=0.1), floors)

    without = residual(base, plain, mode_count).residual({})
    with_effect = residual(model, changed, count)
    names: Sequence[str] = effect.names
    low, high = (np.array([getattr(p, side) for p in effect.parameters]) for side in ("lower", "upper"))
    scale = np.array([abs(start[n]) for n in names])

    def left(x: np.ndarray) -> np.ndarray:
        off: np.ndarray = with_effect.residual(dict(zip(names, x * scale, strict=True))) - without
        return off

    first = np.array([start[n] for n in names]) / scale
    fit = least_squares(
        left, first, bounds=(low / scale, high / scale), diff_step=1e-4, x_scale="jac", ftol=1e-4, xtol=1e-3
    )
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    before = residual(base, changed, mode_count).residual({}) - without
    return Rediscovery(
        dict(zip(names, (fit.x * scale).tolist(), strict=True)),
        float(np.sqrt(covariance[0, 0]) * scale[0]),
        float(np.linalg.norm(before)),
        float(np.linalg.norm(fit.fun)),
    )
