"""A fit as it would be with its held parameters free under their priors, which is what is tested."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg as la

from calib.inference.considered import MESH_ERROR, At
from calib.inference.constraints import ConstraintRows, constraint_rows
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.problem.prior import Prior
from calib.problem.space import Parameter, ParameterSpace


class Freed(NamedTuple):
    """A fit with held parameters free under their priors, to first order.

    Attributes
    ----------
    residual : ndarray (n_rows,)
        Whitened. Its sum of squares tests the model with the covariance ``H H^T`` added to that of the data.
    slope : ndarray (n_rows, n_params + n_held)
        Per unit of each fitted parameter, and per standard deviation of each held one.
        Where constraints count as data, of combinations whose priors are independent with these constraints.
    prior_sd : ndarray (n_params + n_held,)
        In the same units.
    converged : bool
        Whether a fit ended here.
    """

    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    converged: bool

    def with_data(self, constraints: ConstraintRows) -> Freed:
        """The same in parameters whose priors are independent where constraints count as data beside them."""
        if not len(constraints.slope):
            return self
        beside = np.hstack([constraints.slope, constraints.held]) * self.prior_sd
        root = la.qr(np.vstack([beside, np.eye(len(self.prior_sd))]), mode="r")[0][: len(self.prior_sd)]
        own = la.solve_triangular(root, (self.slope * self.prior_sd).T, trans="T").T
        return self._replace(slope=own, prior_sd=np.ones(len(self.prior_sd)))


def beside_data(
    space: ParameterSpace, names: Sequence[str], values: Mapping[str, float], slope: np.ndarray,
    held_sd: Mapping[str, float],
) -> ConstraintRows:  # fmt: skip
    """Correlated priors and constraints that count as data, beside rows of the slope (n_rows, n_params)."""
    prior = Prior.of(space)
    own, correlated = prior.beside(values, names)
    known = posterior(names, np.vstack([slope, correlated]), prior.widths(values, names))
    found = constraint_rows(space, names, known.covariance, held_sd)
    held = np.vstack([np.zeros((len(own), len(held_sd))), found.held])
    return ConstraintRows(np.vstack([correlated, found.slope]), held, found.constraints, own)


def freed(
    space: ParameterSpace, at: At, held: np.ndarray, held_sd: Mapping[str, float], constraints: ConstraintRows
) -> Freed:
    """Fit again with held parameters free under their priors, linearised, within the limits and constraints.

    A sum may be on its limit only because one of its parameters is held. Where nothing was fitted the parameters move
    with the held ones alone.

    Parameters
    ----------
    space : ParameterSpace
    at : At
    held : ndarray (n_rows, n_held + n_meshes)
        Changes of the rows, see `calib.inference.considered.HeldChanges`, and those by one standard deviation of the
        errors of meshes.
    held_sd : mapping from str to float
        Standard deviations of the held parameters.
    constraints : ConstraintRows
        With as many held quantities.
    """
    n, rows = len(at.names), len(at.residual)
    slope, prior_sd = np.hstack([at.slope, held]), np.concatenate([at.prior_sd, np.ones(held.shape[1])])
    if not held.shape[1]:
        return Freed(at.residual, slope, prior_sd, at.fitted).with_data(constraints)
    spread = {**held_sd, **{f"{MESH_ERROR} {k}": 1.0 for k in range(held.shape[1] - len(held_sd))}}
    values, names = {**dict.fromkeys(spread, 0.0), **at.values}, (*at.names, *spread)
    wide = _widened(_with_linear_priors(space, at), values, spread, names)
    prior = Prior.of(wide)
    beside = np.hstack([constraints.slope, constraints.held])
    pull = np.concatenate([at.residual, constraints.residual, prior.residual(values, at.names)])
    if not at.fitted and n:  # what would move the parameters by itself is left out
        own = np.vstack([at.slope, constraints.slope, np.diag(1.0 / at.prior_sd)])
        pull = pull - own @ np.linalg.lstsq(own, pull, rcond=None)[0]
        centre = np.array([values[name] for name in at.names]) - at.prior_sd * pull[-n:]
        moved = {name: replace(wide[name], value=c) for name, c in zip(at.names, centre.tolist(), strict=True)}
        prior = Prior({**prior.of_parameter, **moved})
    unit = np.concatenate([np.ones(n), 1.0 / np.array(list(spread.values()))])
    start = pull[: rows + len(beside)]
    linear = _Linear(names, np.array([values[name] for name in names]), start, np.vstack([slope, beside]) * unit)
    end = fit(linear, wide, values, prior)
    residual = at.residual + (end.residual - start)[:rows]
    return Freed(residual, slope, prior_sd, at.fitted).with_data(constraints)


def unabsorbed(at: At, held: np.ndarray, constraints: ConstraintRows) -> np.ndarray:
    """What one standard deviation of each held quantity leaves in the residual of a fit, (n_rows, n_held)."""
    if not held.shape[1]:
        return held
    rows, changes = np.vstack([at.slope, constraints.slope]), np.vstack([held, constraints.held])
    covariance = posterior(at.names, rows, at.prior_sd).covariance
    return np.asarray(held - at.slope @ (covariance @ (rows.T @ changes)))


def _with_linear_priors(space: ParameterSpace, at: At) -> ParameterSpace:
    """The space with the independent priors of fitted parameters as they are to first order, on linear scales."""
    for name, sd in zip(at.names, at.prior_sd.tolist(), strict=True):
        p = space[name]
        if p.is_log or p.prior_kind != "normal" or p.prior_correlation:
            centre = at.values[name] - p.prior_width_at(at.values[name]) * p.pull(at.values[name])
            own = {"prior_sd": sd, "prior": None, "prior_correlation": ()}
            space = space.replace(name, value=centre, scale="linear", **own)
    return space


_FAR = 10.0
"""Limits of a held parameter that is freed, in its standard deviations: as good as none."""


def _widened(
    space: ParameterSpace, values: Mapping[str, float], spread: Mapping[str, float], names: Sequence[str]
) -> ParameterSpace:
    """The space with held parameters free about their values, and with one for every error of a mesh."""
    new = [Parameter(name, 0.0, -_FAR, _FAR) for name in spread if name not in space]
    space = replace(space, parameters=(*space.parameters, *new))
    for name, sd in spread.items():
        ends = {"lower": values[name] - _FAR * sd, "upper": values[name] + _FAR * sd}
        own = {"prior_sd": sd, "prior": None, "scale": "linear"}
        space = space.replace(name, value=values[name], distribution="uniform", **own, **ends)
    return space.freeze({p.name: values[p.name] for p in space.free if p.name not in names})


@dataclass(frozen=True, eq=False)
class _Linear:
    """A residual that is linear in the named parameters about some values."""

    names: tuple[str, ...]
    centre: np.ndarray
    start: np.ndarray
    slope: np.ndarray

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        return np.asarray(self.start + self.slope @ (np.array([values[name] for name in self.names]) - self.centre))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        return np.asarray(self.slope[:, [self.names.index(name) for name in names]])
