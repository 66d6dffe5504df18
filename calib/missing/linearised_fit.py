"""Linearised fit of a model to the measurement, and the projection off what its parameters absorb."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import scipy.linalg as la

from calib.errors.errors import EvaluationError
from calib.inference.gauss_newton import FitSettings, Step, unstepped
from calib.inference.gauss_newton import fit as gauss_newton
from calib.inference.identify import Posterior, posterior, with_held
from calib.inference.leave_one_out import LeaveOneOut, leave_one_out
from calib.inference.other_rows import OtherRows
from calib.inference.region import Region, active_limits
from calib.missing.hypotheses import FitProblem
from calib.missing.nearest_integers import other_whole
from calib.missing.rules import RULES
from calib.problem.prior import Prior

FINE = FitSettings(iterations=15, gain=2e-3, relative=1e-5, rejections=8, evaluations=40, near_end=True)
"""For the verdict. A decrease of the sum of squares by a few thousandths is negligible for it; a converging fit needs
about ten residuals, up to 40 when integer parameters move."""
ROUGH = FitSettings(iterations=6, gain=0.05, relative=3e-4, rejections=4, evaluated_end=False)
"""For ranking candidates, which need not converge."""
_TURNS = 3


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """End point of a fit, with its linearisation.

    The priors are appended to the residual: ``r = [e; -(theta - c)/s]`` and ``A = [G; diag(1/s)]`` with
    ``G = -de/dtheta``.

    Attributes
    ----------
    effects : tuple of str
        Effects and local perturbations of the model.
    fit_problem : FitProblem
    names : tuple of str
        Fitted parameters, length p; integer ones are not among them.
    values : dict
        All parameters, each in its own unit.
    residual : ndarray (n_rows,)
    slope : ndarray (n_rows, p)
        G, per one of each parameter's own unit.
    prior_sd, shift : ndarray (p,)
        Prior standard deviation s, and the pull ``(theta - c)/s``.
    converged : bool
        Whether the fit converged; otherwise the point is no optimum and its residual no minimum.
    others : OtherRows or None
        What correlated priors add (see `calib.problem.prior.Prior`) and, of the part of a joint fit that belongs to one
        test, what the other tests say about its parameters. They count as further rows of the data.
    active : frozenset of str
        Parameters with an active limit, see `calib.inference.region.active_limits`.
    shared : ndarray (n_rows + n_others, n_errors) or None
        Change of the rows by one standard deviation of every error that several of them share; see `std`.
    """

    effects: tuple[str, ...]
    fit_problem: FitProblem
    names: tuple[str, ...]
    values: dict[str, float]
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    shift: np.ndarray
    converged: bool = False
    others: OtherRows | None = None
    active: frozenset[str] = frozenset()
    shared: np.ndarray | None = None

    @property
    def misfit(self) -> float:
        """Sum of squares, data and prior."""
        return float(self._data @ self._data + self.shift @ self.shift)

    @property
    def _data(self) -> np.ndarray:
        """Residual of the rows and of the other ones, (n_rows + n_others,)."""
        return self.residual if self.others is None else np.concatenate([self.residual, self.others.residual])

    @property
    def data_slope(self) -> np.ndarray:
        """G of the rows and of the other ones, (n_rows + n_others, p)."""
        return self.slope if self.others is None else np.vstack([self.slope, self.others.slope])

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Columns of the slope by parameter, (n_rows,) each."""
        return dict(zip(self.names, self.slope.T, strict=True))

    @cached_property
    def augmented(self) -> np.ndarray:
        """r, (n_rows + n_others + p,)."""
        return np.concatenate([self._data, -self.shift])

    @cached_property
    def _orthonormal(self) -> np.ndarray:
        # Columns scaled by the prior: the span is the same, the numbers do not depend on units.
        scaled = np.vstack([self.data_slope * self.prior_sd, np.eye(len(self.names))])
        return la.qr(scaled, mode="economic")[0]

    @cached_property
    def scaled_information(self) -> np.ndarray:
        """``S G^T G S + I`` with S the prior standard deviations, (p, p)."""
        g = self.data_slope * self.prior_sd
        return g.T @ g + np.eye(len(self.names))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Posterior covariance in the parameters' own units, (p, p); see `calib.inference.identify.posterior`."""
        return self._posterior.covariance

    @cached_property
    def _posterior(self) -> Posterior:
        return posterior(self.names, self.data_slope, self.prior_sd)

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviations of the parameters in their own units, with the errors that rows share, (p,).

        The fit weights all rows as if their errors were independent. Errors that are not add to its covariance like
        held parameters of known standard deviation, see `calib.inference.identify.posterior`; scores and evidence are
        those of the fit.
        """
        with_shared = with_held(self._posterior, self.data_slope, self.shared)
        return np.sqrt(np.diag(with_shared)[: len(self.names)])

    def project_out(self, columns: np.ndarray) -> np.ndarray:
        """Part of changes of the rows (n_rows, m) that the parameters cannot absorb: ``P [g; 0]``.

        (n_rows + n_others + p, m).
        """
        rest = len(self.augmented) - len(columns)
        return self._projected(np.vstack([columns, np.zeros((rest, columns.shape[1]))]))

    def unabsorbed(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of changes of the rows g (n_rows, m): ``|g|``, ``|P g|`` and ``g^T P r``, (m,) each, without ``P g``."""
        rows = len(columns)
        whole = np.sum(columns**2, axis=0)
        lost = np.sum((self._orthonormal[:rows].T @ columns) ** 2, axis=0)
        return np.sqrt(whole), np.sqrt(np.maximum(whole - lost, 0.0)), columns.T @ self.projected[:rows]

    @cached_property
    def projected(self) -> np.ndarray:
        """Part of the residual that the parameters cannot absorb: ``P r``, (n_rows + n_others + p,)."""
        return self._projected(self.augmented)

    def _projected(self, wide: np.ndarray) -> np.ndarray:
        rest = wide - self._orthonormal @ (self._orthonormal.T @ wide)
        return rest - self._orthonormal @ (self._orthonormal.T @ rest)

    def update(self, change: np.ndarray) -> np.ndarray:
        """First-order change of the fitted parameters (p,), in their units, for a change of the residual (n_rows,)."""
        right = (self.slope * self.prior_sd).T @ change
        return self.prior_sd * la.solve(self.scaled_information, right, assume_a="pos")

    def left_out(self, groups: Sequence[Hashable]) -> LeaveOneOut:
        """Every group of rows predicted from all others; a parameter that a limit holds stays there."""
        others = None if self.others is None else self.others.slope
        held = [name in self.active for name in self.names]
        return leave_one_out(self.residual, self.slope, self.prior_sd, groups, others, held)

    def remaining(self, change: np.ndarray) -> np.ndarray:
        """What the parameters leave of the residual less a change of the data (n_rows,), (n_rows + n_others + p,).

        To first order. Where a limit holds a parameter, none may go beyond its limits: the projection `project_out`
        would absorb what no fit can.
        """
        rest = self.augmented - np.concatenate([change, np.zeros(len(self.augmented) - len(change))])
        if not self.active:
            return self._projected(rest[:, None])[:, 0]
        region = Region.of(self.fit_problem.space, dict(self.values))
        matrix = -np.vstack([self.data_slope, np.diag(1.0 / self.prior_sd)]) * region.span_at(region.start)
        return np.asarray(rest + matrix @ region.step(matrix, rest, 0.0, region.start))

    def without(self, name: str) -> LinearisedFit:
        """The end point without one parameter, to first order: what it explains is in the residual again."""
        k, others = self.names.index(name), self.others
        if others is not None:
            back = others.residual + others.slope[:, k] * self.values[name]
            others = others._replace(slope=np.delete(others.slope, k, axis=1), residual=back)
        return replace(
            self, names=tuple(n for n in self.names if n != name), others=others, active=self.active - {name},
            residual=self.residual + self.slope[:, k] * self.values[name], slope=np.delete(self.slope, k, axis=1),
            prior_sd=np.delete(self.prior_sd, k), shift=np.delete(self.shift, k),
        )  # fmt: skip

    def granting(self, names: Collection[str]) -> LinearisedFit:
        """The fit with the priors of some parameters centred on their fitted values.

        The pull of a fitted magnitude by its prior is not a misfit that another effect should explain.
        """
        if not any(name in names for name in self.names):
            return self
        moved = np.where([name in names for name in self.names], 0.0, self.shift)
        return replace(self, shift=moved)

    def relinearised(self, change: Mapping[str, float], residual: np.ndarray) -> LinearisedFit:
        """First-order end point of a fit with other values of held parameters.

        ``change`` holds these values, and ``residual`` (n_rows,) is evaluated with them at the fitted values of the
        others. The fitted parameters are updated; the slope is kept.
        """
        data = residual if self.others is None else np.concatenate([residual, self.others.residual])
        right = (self.data_slope * self.prior_sd).T @ data - self.shift
        step = la.solve(self.scaled_information, right, assume_a="pos")
        moved = {n: self.values[n] + d for n, d in zip(self.names, self.prior_sd * step, strict=True)}
        remainder = residual - self.slope @ (self.prior_sd * step)
        others = self.others
        if others is not None:
            others = others._replace(residual=others.residual - others.slope @ (self.prior_sd * step))
        values = {**self.values, **moved, **change}
        return replace(self, values=values, residual=remainder, shift=self.shift + step, others=others)


def least_squares_fit(
    fit_problem: FitProblem,
    effects: tuple[str, ...],
    start: Mapping[str, float],
    whole: int = 0,
    settings: FitSettings = FINE,
    step: Step = unstepped,
    columns: Mapping[str, np.ndarray] = MappingProxyType({}),
    exact: bool = False,
) -> LinearisedFit:
    """Fit a problem from a start.

    Parameters
    ----------
    fit_problem : FitProblem
    effects : tuple of str
    start : mapping
        Moved inside the limits where it is outside.
    whole : int
        How far integer parameters may move from the start: 0 keeps them, 1 tries their neighbours, and so on.
        Other integers are ranked by the sum of squares after a first-order update of the other parameters, and fitted
        when it predicts a decrease.
    settings : FitSettings
        Its ``evaluations`` limit all these fits together.
    step : callable
        Called before every step; see `calib.inference.gauss_newton.fit`.
    columns : mapping from str to ndarray (n_rows,)
        About the columns of its slope at the start, or with ``exact`` those; see `calib.inference.gauss_newton.fit`.
        Used where all are given.

    Raises
    ------
    EvaluationError
        When the start cannot be evaluated.
    """
    fit, used = _fitted(fit_problem, effects, start, settings, step, columns, exact)
    for turn in range(_TURNS if whole else 0):
        if used >= settings.evaluations:
            break
        better = _better_whole(fit, whole if turn == 0 else min(whole, 2))
        if better is None:
            break
        rest = replace(settings, evaluations=settings.evaluations - used)
        there, more = _fitted(fit_problem, effects, better, rest, step)
        used += more
        if there.misfit >= fit.misfit:
            break
        fit = there
    return fit


def linearised(fit_problem: FitProblem, effects: tuple[str, ...], values: Mapping[str, float]) -> LinearisedFit:
    """Linearise a fit problem at any point.

    Raises
    ------
    EvaluationError
        When the point cannot be evaluated.
    """
    space = fit_problem.space
    names = tuple(p.name for p in space.free if not p.integer)
    prior, complete = Prior.of(space), space.complete(dict(values))
    return LinearisedFit(
        effects=effects,
        fit_problem=fit_problem,
        names=names,
        values=complete,
        residual=fit_problem.residual(complete),
        slope=-fit_problem.jacobian(complete, names),
        prior_sd=prior.widths(complete, names),
        shift=prior.residual(complete, names),
        others=_correlated(prior, complete, names),
    )


def grown(fit: LinearisedFit, fit_problem: FitProblem, effects: tuple[str, ...]) -> LinearisedFit:
    """A fit extended by further effects of zero magnitude; its sum of squares is the same.

    Only the derivatives by their magnitudes are evaluated; they are set to zero where the model fails.
    """
    space = fit_problem.space
    further = tuple(p.name for p in space.free if not p.integer and p.name not in fit.values)
    values = {**{p.name: p.value for p in space.parameters}, **fit.values}
    try:
        slope = -fit_problem.jacobian(values, further)
    except EvaluationError:
        slope = np.zeros((len(fit.residual), len(further)))
    others = fit.others
    if others is not None:
        wider = np.zeros((len(others.slope), len(further)))
        others = others._replace(slope=np.hstack([others.slope, wider]))
    return replace(
        fit,
        effects=effects,
        fit_problem=fit_problem,
        names=(*fit.names, *further),
        values=values,
        slope=np.hstack([fit.slope, slope]),
        prior_sd=np.concatenate([fit.prior_sd, Prior.of(space).widths(values, further)]),
        shift=np.concatenate([fit.shift, np.zeros(len(further))]),
        others=others,
        converged=False,
    )


def _fitted(
    fit_problem: FitProblem,
    effects: tuple[str, ...],
    start: Mapping[str, float],
    settings: FitSettings,
    step: Step,
    columns: Mapping[str, np.ndarray] = MappingProxyType({}),
    exact: bool = False,
) -> tuple[LinearisedFit, int]:
    """The fit with the integers of the start, and the number of residuals evaluated."""
    space = fit_problem.space
    inside = {n: min(max(v, space[n].lower), space[n].upper) for n, v in start.items() if n in space.free_names}
    prior = Prior.of(space)
    names = [p.name for p in space.free if not p.integer]
    known = [columns[name] for name in names if name in columns]
    slope = -np.column_stack(known) if known and len(known) == len(names) else None
    result = gauss_newton(fit_problem, space, {**start, **inside}, prior, settings, step, slope, exact)
    sd, shift = prior.widths(result.values, result.names), prior.residual(result.values, result.names)
    others = _correlated(prior, result.values, result.names)
    descent = -result.jacobian.T @ result.residual - shift / sd
    descent += 0.0 if others is None else others.slope.T @ others.residual
    fit = LinearisedFit(
        effects=effects, fit_problem=fit_problem, names=result.names, values=result.values, residual=result.residual,
        slope=-result.jacobian, prior_sd=sd, shift=shift, converged=result.converged and result.evaluated,
        others=others, active=active_limits(space, result.names, result.values, descent),
    )  # fmt: skip
    return fit, result.evaluations


def _correlated(prior: Prior, values: Mapping[str, float], names: Sequence[str]) -> OtherRows | None:
    residual, slope = prior.beside(values, names)
    return OtherRows(-slope, np.zeros((len(residual), 0)), residual) if len(residual) else None


def neighbouring_integers(fit: LinearisedFit) -> list[LinearisedFit]:
    """First-order fits with other integers, each at most one off; see `LinearisedFit.relinearised`."""
    found = (_relinearised(fit, change) for change in other_whole(fit.fit_problem, fit.values))
    return [there for there in found if there is not None]


def _better_whole(fit: LinearisedFit, reach: int) -> dict[str, float] | None:
    """Start with more promising integers, tried one by one and all together; None when there are none."""
    tried: list[LinearisedFit] = []
    favourites: dict[str, float] = {}
    for p in fit.fit_problem.space.free:
        if not p.integer:
            continue
        here = round(fit.values[p.name])
        lowest = fit.misfit - RULES.worth
        for number in range(max(here - reach, round(p.lower)), min(here + reach, round(p.upper)) + 1):
            there = None if number == here else _relinearised(fit, {p.name: number})
            if there is None:
                continue
            tried.append(there)
            if there.misfit < lowest:
                favourites[p.name], lowest = number, there.misfit
    if len(favourites) > 1:
        together = _relinearised(fit, favourites)
        tried += [] if together is None else [together]
    return min(tried, key=lambda there: there.misfit).values if favourites else None


def _relinearised(fit: LinearisedFit, change: Mapping[str, float]) -> LinearisedFit | None:
    """The fit with other values of held parameters; None where the model cannot be solved."""
    held = {name: float(value) for name, value in change.items()}
    try:
        return fit.relinearised(held, fit.fit_problem.residual({**fit.values, **held}))
    except EvaluationError:
        return None
