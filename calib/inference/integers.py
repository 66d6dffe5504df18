"""Mixed-integer least squares: coordinate search over the integers around continuous fits, from several starts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Generator, Mapping, Sequence, Sized
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, InputError, raised_anew
from calib.execution.ahead import evaluated_together, in_advance
from calib.inference.even_weights import EvenWeights
from calib.inference.gauss_newton import (
    DEFAULT,
    FitResult,
    FitSettings,
    LeastSquares,
    Request,
    Step,
    finished,
    fit_steps,
    requested,
    unstepped,
)
from calib.inference.region import InfeasibleError, Region
from calib.inference.starts import Enough, never
from calib.problem.prior import Prior
from calib.problem.space import ParameterSpace

_FIRST = FitSettings(iterations=10, gain=1.0, relative=1e-3, rejections=8)
"""Of a first fit, which only has to come near."""
_ROUNDS = 5
"""First fits, at most."""


@dataclass(frozen=True, eq=False)
class MixedResult:
    """Best fit over integer parameters and starts.

    Attributes
    ----------
    best : FitResult
    by_start : tuple of FitResult
        The best fit of every start.
    combinations : DataFrame
        One row per fit: ``start``, every integer parameter, ``misfit``, ``converged``.
    exhausted : tuple of int
        Starts that used up their refits before all neighbours were tried.
    """

    best: FitResult
    by_start: tuple[FitResult, ...]
    combinations: pd.DataFrame
    exhausted: tuple[int, ...]

    def joined(self, other: MixedResult, tolerance: float | None = None) -> MixedResult:
        """The result merged with one from other starts of the same problem; their start numbers follow on.

        The best fit is the one with the lower misfit. With a ``tolerance``, the other's best must also lower the sum
        of squares of the data by more than that: a fit that only the prior prefers does not replace the own best.
        """
        n = int(self.combinations["start"].max()) + 1
        more = other.combinations.assign(start=other.combinations["start"] + n)
        data_prefer = tolerance is None or other.best.data_misfit < self.best.data_misfit - tolerance
        return MixedResult(
            min((self.best, other.best), key=lambda r: r.misfit) if data_prefer else self.best,
            (*self.by_start, *other.by_start),
            pd.concat([self.combinations, more], ignore_index=True),
            (*self.exhausted, *(k + n for k in other.exhausted)),
        )

    @property
    def complete(self) -> bool:
        """Whether all neighbours of the best integers were tried."""
        nearest = int((self.combinations["misfit"] - self.best.misfit).abs().to_numpy().argmin())
        return int(self.combinations["start"].to_numpy()[nearest]) not in self.exhausted

    def profile(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Integers tried and the lowest misfit of each, the other integers being free, both (n,)."""
        lowest = self.combinations.groupby(name)["misfit"].min()
        return lowest.index.to_numpy(dtype=float), lowest.to_numpy(dtype=float)


def combinations(space: ParameterSpace) -> int:
    """Combinations of the free integer parameters within their limits; 1 without any."""
    return math.prod(math.floor(p.upper) - math.ceil(p.lower) + 1 for p in space.free if p.integer)


def fit_mixed(
    problem: LeastSquares,
    space: ParameterSpace,
    starts: Sequence[Mapping[str, float]] = ({},),
    prior: Prior | None = None,
    settings: FitSettings = DEFAULT,
    refits: int = 40,
    progress: Callable[[int, int, float], None] = lambda start, fits, misfit: None,
    step: Step = unstepped,
    enough: Enough = never,
    first: EvenWeights | None = None,
) -> MixedResult:
    """Fit from several starts, integer parameters by coordinate search around each continuous optimum.

    From the start's integers the search goes to the best neighbour (one parameter up or down by one), refitting
    the others from where they are, until no neighbour is better; then to neighbours that differ in two parameters.
    Failed combinations count as infinitely bad; those that break a constraint are skipped. All neighbours of the
    result have been tried unless its start is listed in `MixedResult.exhausted`.

    Parameters
    ----------
    problem, space, prior, settings
        As in `fit`.
    starts : sequence of mapping
        Named values, such as Latin hypercube points; a parameter without one takes its nominal value.
    refits : int
        Largest number of fits for every start.
    progress : callable
        Called after every fit with start, number of fits of this start and lowest misfit so far.
    step : callable
        Called before every step of a fit with the share of all fits that is behind, as if every start used its refits.
    enough : callable
        Called after every start with the ends of all so far; the others are left out where it says so.
    first : EvenWeights, optional
        The same problem in the weights by which a start that does not fit is improved before its fit.

    Raises
    ------
    EvaluationError
        When no start can be evaluated.
    """
    if not starts:
        raise InputError("no start is given", place="fit", remedy="give at least one point")
    whole = tuple(p.name for p in space.free if p.integer)
    rows: list[dict[str, float | bool]] = []
    every: list[FitResult | None] = []
    exhausted, fault = [], EvaluationError()
    lowest = math.inf
    least = getattr(enough, "least", len(starts))
    walks = [_Walk(problem, space, prior, settings, refits, whole, first) for _ in starts[:least]]
    scouted = _scout(walks, starts, step)
    for k, start in enumerate(starts):
        walk = _Walk(problem, space, prior, replace(settings, beaten=lowest), refits, whole, first)
        # not the walk itself: a cycle would keep its problem, and the basis of that, until Python collects garbage
        told = partial(_tell, step, walk.tried, refits if whole else 1, k, len(starts))
        walk.step = unstepped if k < scouted else told
        here = finished(walk.begin(start))
        if here is not None:
            lowest = min(lowest, here.misfit)
        while here is not None:
            progress(k, len(walk.tried), lowest)
            better = finished(walk.better(here))
            if better is None:
                break
            here = better
            lowest = min(lowest, here.misfit)
        fault = walk.fault or fault
        rows += [{"start": k, **dict(zip(whole, key, strict=True)), "misfit": m, "converged": c}
                 for key, (m, c) in walk.tried.items()]  # fmt: skip
        every.append(here)
        if here is not None and walk.exhausted:
            exhausted.append(k)
        if enough(every):
            break
    ends = [end for end in every if end is not None]
    if not ends:
        raise raised_anew(fault)
    table = pd.DataFrame(rows, columns=["start", *whole, "misfit", "converged"])
    return MixedResult(min(ends, key=lambda r: r.misfit), tuple(ends), table, tuple(exhausted))


def _scout(walks: Sequence[_Walk], starts: Sequence[Mapping[str, float]], step: Step) -> int:
    """Walk from several starts side by side, so that what they ask of a function is evaluated together.

    Returns how many starts were walked; their points are known then, and the fits that follow find them. None are where
    no function is shared, or only one start is given.
    """
    if len(walks) < 2:
        return 0
    running = {k: walk.whole_walk(starts[k]) for k, walk in enumerate(walks)}
    share = dict.fromkeys(running, 0.0)
    for k, walk in enumerate(walks):
        walk.step = partial(share.__setitem__, k)
    while running:
        requests = dict[int, Request]()
        with in_advance():
            for k, steps in list(running.items()):
                request = next(steps, None)
                if request is None:
                    share[k] = 1.0
                    del running[k]
                else:
                    requests[k] = request
        asked = [partial(requested, walks[k].problem, request) for k, request in requests.items()]
        if asked and not evaluated_together(asked):
            return 0
        step(0.99 * sum(share.values()) / len(share))
    return len(walks)


def _tell(step: Step, tried: Sized, expected: int, start: int, starts: int, share: float) -> None:
    """Tell the share of all fits that is behind."""
    step((start + min((len(tried) + share) / expected, 1.0)) / starts)


@dataclass(eq=False)
class _Walk:
    """Coordinate search over integers from one start."""

    problem: LeastSquares
    space: ParameterSpace
    prior: Prior | None
    settings: FitSettings
    refits: int
    whole: tuple[str, ...]
    first: EvenWeights | None = None
    tried: dict[tuple[int, ...], tuple[float, bool]] = field(default_factory=dict)
    fault: EvaluationError | None = None
    exhausted: bool = False
    step: Step = unstepped

    def whole_walk(self, start: Mapping[str, float]) -> Generator[Request, None, None]:
        """Fits from a start to the best integers; stops before every evaluation, as `fit_steps` does."""
        with suppress(InfeasibleError):
            here = yield from self.begin(start)
            while here is not None:
                here = yield from self.better(here)

    def begin(self, start: Mapping[str, float]) -> Generator[Request, None, FitResult | None]:
        """The fit from a start, or from the end of a fit in the weights of `first` where that is closer to the data."""
        values = self.space.complete(dict(start))
        if self.first is not None:
            region = Region.of(self.space, values)
            values = region.values(region.nearest(region.start))
            with suppress(EvaluationError):
                yield values, ()
                here = self.problem.residual(values)
                if here @ here > len(here):
                    values = yield from self._nearer(self.first, values, here)
        return (yield from self.fit(values))

    def _nearer(
        self, first: EvenWeights, start: dict[str, float], residual: np.ndarray
    ) -> Generator[Request, None, dict[str, float]]:
        """Where ``first`` leaps, or the end of fits in its weights, each limited by the rows at the end of the last."""
        with suppress(EvaluationError):
            region = Region.of(self.space, start if first.leap is None else first.leap(start))
            values = region.values(region.nearest(region.start))
            yield values, ()
            rows = self.problem.residual(values)
            if rows @ rows < residual @ residual:
                return values
        values, rows = start, residual
        for _ in range(_ROUNDS):
            end = yield from fit_steps(first.limited(rows), self.space, values, self.prior, _FIRST)
            if not end.iterations:
                break
            values, rows = end.values, self.problem.residual(end.values)
        return values if rows @ rows < residual @ residual else start

    def fit(self, values: Mapping[str, float]) -> Generator[Request, None, FitResult | None]:
        key = tuple(round(values[n]) for n in self.whole)
        try:
            found = yield from fit_steps(self.problem, self.space, values, self.prior, self.settings, self.step)
        except EvaluationError as fault:
            self.fault = raised_anew(fault)
            self.tried[key] = (math.inf, False)
            return None
        self.tried[key] = (found.misfit, found.converged)
        return found

    def better(self, here: FitResult) -> Generator[Request, None, FitResult | None]:
        """The best untried neighbour if it is better, single changes first; None at the optimum."""
        for changed in (1, 2):
            best = None
            for names in itertools.combinations(self.whole, min(changed, len(self.whole))):
                if len(names) < changed:
                    return None
                for signs in itertools.product((-1, 1), repeat=changed):
                    values = dict(here.values)
                    for name, sign in zip(names, signs, strict=True):
                        values[name] += sign
                    if not all(self.space[n].lower <= values[n] <= self.space[n].upper for n in names):
                        continue
                    if tuple(round(values[n]) for n in self.whole) in self.tried:
                        continue
                    if len(self.tried) >= self.refits:
                        self.exhausted = True
                        return best
                    try:
                        found = yield from self.fit(values)
                    except InfeasibleError:
                        continue
                    if found is not None and found.misfit < (here if best is None else best).misfit:
                        best = found
            if best is not None:
                return best
        return None
