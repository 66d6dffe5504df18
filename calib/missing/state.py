"""A model fitted to the measurement: its residual there, and what its parameters can absorb of any change."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg as la

from calib.errors import EvaluationError
from calib.inference.gauss_newton import FitSettings, Prior, fit
from calib.inference.identify import posterior
from calib.missing.hypotheses import Question
from calib.missing.rules import RULES

FINE = FitSettings(iterations=15, gain=2e-3, relative=1e-5, rejections=8, evaluations=40)
"""A thousandth of a unit of the sum of squares is far below anything that decides; fits that converge need about ten
residuals, with whole numbers moved up to 40."""
ROUGH = FitSettings(iterations=6, gain=0.05, relative=3e-4, rejections=4)
"""To rank candidates: a hopeless one is not followed to its end."""
_TURNS = 3
_ALL_AT_ONCE = 3
"""Up to so many whole-number parameters are moved together: 26 neighbours."""


@dataclass(frozen=True, eq=False)
class State:
    """Where a fit ended, with its linearisation.

    Prior knowledge is appended to the residual: ``r = [e; -(theta - c)/s]`` and ``A = [G; diag(1/s)]`` with
    ``G = -de/dtheta``.

    Attributes
    ----------
    effects : tuple of str
        Effects and atoms that the model has.
    question : Question
    names : tuple of str
        Fitted parameters, length p; whole-number ones are not among them.
    values : dict
        All parameters, each in its own unit.
    residual : ndarray (n_rows,)
    slope : ndarray (n_rows, p)
        G, per one of each parameter's own unit.
    prior_sd, shift : ndarray (p,)
        Prior standard deviation s, and how far the parameter moved in units of it.
    converged : bool
        Whether a fit ended here because it had converged; elsewhere a residual is what the search has left.
    """

    effects: tuple[str, ...]
    question: Question
    names: tuple[str, ...]
    values: dict[str, float]
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    shift: np.ndarray
    converged: bool = False

    @property
    def misfit(self) -> float:
        """Sum of squares, data and prior."""
        return float(self.residual @ self.residual + self.shift @ self.shift)

    @cached_property
    def augmented(self) -> np.ndarray:
        """r, (n_rows + p,)."""
        return np.concatenate([self.residual, -self.shift])

    @cached_property
    def _orthonormal(self) -> np.ndarray:
        # Columns scaled by the prior: the span is the same, the numbers do not depend on units.
        scaled = np.vstack([self.slope * self.prior_sd, np.eye(len(self.names))])
        return la.qr(scaled, mode="economic")[0]

    @cached_property
    def scaled_information(self) -> np.ndarray:
        """``S G^T G S + I`` with S the prior standard deviations, (p, p)."""
        g = self.slope * self.prior_sd
        return g.T @ g + np.eye(len(self.names))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Posterior covariance in the parameters' own units, (p, p); see `calib.inference.identify.posterior`."""
        return posterior(self.names, self.slope, self.prior_sd).covariance

    def outside(self, columns: np.ndarray) -> np.ndarray:
        """What of changes of the data, (n_rows, m), the parameters cannot absorb: ``P [g; 0]``, (n_rows + p, m)."""
        wide = np.vstack([columns, np.zeros((len(self.names), columns.shape[1]))])
        rest = wide - self._orthonormal @ (self._orthonormal.T @ wide)
        return rest - self._orthonormal @ (self._orthonormal.T @ rest)

    def follow(self, change: np.ndarray) -> np.ndarray:
        """Change of the fitted parameters (p,) after the residual has changed by ``change`` (n_rows,), own units."""
        right = (self.slope * self.prior_sd).T @ change
        return self.prior_sd * la.solve(self.scaled_information, right, assume_a="pos")

    def granting(self, names: Collection[str]) -> State:
        """The state with the priors of some parameters about the values they have.

        What a prior says against a magnitude that the data have found is no misfit that anything else should explain.
        """
        moved = np.where([name in names for name in self.names], 0.0, self.shift)
        return replace(self, shift=moved)

    def elsewhere(self, change: Mapping[str, float], residual: np.ndarray) -> State:
        """To first order, where a fit with other values of held parameters would end.

        ``residual`` (n_rows,) is that of the fitted values with those; the fitted parameters follow, and keep their
        slope.
        """
        right = (self.slope * self.prior_sd).T @ residual - self.shift
        step = la.solve(self.scaled_information, right, assume_a="pos")
        moved = {n: self.values[n] + d for n, d in zip(self.names, self.prior_sd * step, strict=True)}
        left = residual - self.slope @ (self.prior_sd * step)
        return replace(self, values={**self.values, **moved, **change}, residual=left, shift=self.shift + step)


def fitted(
    question: Question,
    effects: tuple[str, ...],
    start: Mapping[str, float],
    whole: int = 0,
    settings: FitSettings = FINE,
) -> State:
    """Fit a question from a start.

    Parameters
    ----------
    question : Question
    effects : tuple of str
    start : mapping
        Moved inside the limits where it is outside.
    whole : int
        How far whole-number parameters may be from the start's: 0 leaves them, 1 tries their neighbours, and so on.
        Another number is judged by the sum of squares left once the other parameters have followed to first order, and
        fitted when that promises a decrease.

    settings : FitSettings
        Its ``evaluations`` hold for the fits with all whole numbers together.

    Raises
    ------
    EvaluationError
        When the start cannot be evaluated.
    """
    state, asked = _fitted(question, effects, start, settings)
    for turn in range(_TURNS if whole else 0):
        if asked >= settings.evaluations:
            break
        better = _better_whole(state, whole if turn == 0 else min(whole, 2))
        if better is None:
            break
        there, more = _fitted(question, effects, better, replace(settings, evaluations=settings.evaluations - asked))
        asked += more
        if there.misfit >= state.misfit:
            break
        state = there
    return state


def linearised(question: Question, effects: tuple[str, ...], values: Mapping[str, float]) -> State:
    """A question at a point that is no fit: what one step from there promises.

    Raises
    ------
    EvaluationError
        When the point cannot be evaluated.
    """
    space = question.space
    names = tuple(p.name for p in space.free if not p.integer)
    prior, complete = Prior.of(space), space.complete(dict(values))
    return State(
        effects=effects,
        question=question,
        names=names,
        values=complete,
        residual=question.residual(complete),
        slope=-question.jacobian(complete, names),
        prior_sd=prior.widths(names),
        shift=prior.residual(complete, names),
    )


def grown(state: State, question: Question, effects: tuple[str, ...]) -> State:
    """A fit as one of a model with further effects, none of which has any magnitude: its sum of squares is the same.

    Only their derivatives are asked of the larger model; a strength that cannot be differentiated there has none.
    """
    space = question.space
    further = tuple(p.name for p in space.free if not p.integer and p.name not in state.values)
    values = {**{p.name: p.value for p in space.parameters}, **state.values}
    try:
        slope = -question.jacobian(values, further)
    except EvaluationError:
        slope = np.zeros((len(state.residual), len(further)))
    return replace(
        state,
        effects=effects,
        question=question,
        names=(*state.names, *further),
        values=values,
        slope=np.hstack([state.slope, slope]),
        prior_sd=np.concatenate([state.prior_sd, Prior.of(space).widths(further)]),
        shift=np.concatenate([state.shift, np.zeros(len(further))]),
        converged=False,
    )


def nearest_whole(question: Question, start: Mapping[str, float]) -> dict[str, float]:
    """A start with the whole numbers from which one Gauss-Newton step promises the lowest sum of squares.

    Every combination is linearised by itself, at the start's other values: a derivative does not know what another
    place of a support does to all other parameters. From the start's own numbers the best neighbour is taken, each
    number at most one off, until no neighbour promises less.
    """
    space = question.space
    whole = [p for p in space.free if p.integer]
    complete = space.complete(dict(start))
    names = [p.name for p in space.free if not p.integer]
    prior = Prior.of(space)
    sd, shift = prior.widths(names), prior.residual(complete, names)
    promised: dict[tuple[int, ...], float] = {}

    def promise(numbers: tuple[int, ...]) -> float:
        if numbers not in promised:
            here = {**complete, **{p.name: float(n) for p, n in zip(whole, numbers, strict=True)}}
            try:
                slope, residual = question.jacobian(here, names) * sd, question.residual(here)
            except EvaluationError:
                promised[numbers] = math.inf
                return math.inf
            matrix = np.vstack([slope, np.eye(len(names))])
            right = np.concatenate([residual, shift])
            basis = la.qr(matrix, mode="economic")[0]
            promised[numbers] = float(right @ right - np.sum((basis.T @ right) ** 2))
        return promised[numbers]

    if not whole:
        return complete
    here = tuple(round(complete[p.name]) for p in whole)
    moves = list(itertools.product((-1, 0, 1), repeat=len(whole))) if len(whole) <= _ALL_AT_ONCE else _axes(len(whole))
    while True:
        near = [tuple(n + d for n, d in zip(here, move, strict=True)) for move in moves]
        inside = [n for n in near if all(p.lower <= k <= p.upper for k, p in zip(n, whole, strict=True))]
        best = min([here, *inside], key=promise)
        if best == here:
            return {**complete, **{p.name: float(n) for p, n in zip(whole, here, strict=True)}}
        here = best


def _axes(count: int) -> list[tuple[int, ...]]:
    """One number at a time."""
    return [tuple(d if j == k else 0 for j in range(count)) for k in range(count) for d in (-1, 1)]


def _fitted(
    question: Question, effects: tuple[str, ...], start: Mapping[str, float], settings: FitSettings
) -> tuple[State, int]:
    """The fit with the start's whole numbers, and the residuals it asked for."""
    space = question.space
    inside = {n: min(max(v, space[n].lower), space[n].upper) for n, v in start.items() if n in space.free_names}
    prior = Prior.of(space)
    result = fit(question, space, {**start, **inside}, prior, settings)
    state = State(
        effects=effects,
        question=question,
        names=result.names,
        values=result.values,
        residual=result.residual,
        slope=-result.jacobian,
        prior_sd=prior.widths(result.names),
        shift=prior.residual(result.values, result.names),
        converged=result.converged,
    )
    return state, result.evaluations


def neighbours(state: State) -> list[State]:
    """Where fits with other whole numbers, each at most one off, would end to first order; see `State.elsewhere`."""
    whole = [p for p in state.question.space.free if p.integer]
    moves = itertools.product((-1, 0, 1), repeat=len(whole)) if len(whole) <= _ALL_AT_ONCE else _axes(len(whole))
    out = []
    for move in moves:
        change = {p.name: round(state.values[p.name]) + d for p, d in zip(whole, move, strict=True)}
        if any(move) and all(p.lower <= change[p.name] <= p.upper for p in whole):
            there = _elsewhere(state, change)
            out += [] if there is None else [there]
    return out


def _better_whole(state: State, reach: int) -> dict[str, float] | None:
    """More promising whole numbers, each parameter by itself and all together; None when there are none."""
    tried: list[State] = []
    favourites: dict[str, float] = {}
    for p in state.question.space.free:
        if not p.integer:
            continue
        here = round(state.values[p.name])
        lowest = state.misfit - RULES.worth
        for number in range(max(here - reach, round(p.lower)), min(here + reach, round(p.upper)) + 1):
            there = None if number == here else _elsewhere(state, {p.name: number})
            if there is None:
                continue
            tried.append(there)
            if there.misfit < lowest:
                favourites[p.name], lowest = number, there.misfit
    if len(favourites) > 1:
        together = _elsewhere(state, favourites)
        tried += [] if together is None else [together]
    return min(tried, key=lambda there: there.misfit).values if favourites else None


def _elsewhere(state: State, change: Mapping[str, float]) -> State | None:
    """None where the model cannot be solved."""
    held = {name: float(value) for name, value in change.items()}
    try:
        return state.elsewhere(held, state.question.residual({**state.values, **held}))
    except EvaluationError:
        return None
