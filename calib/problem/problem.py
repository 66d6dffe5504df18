"""Problem: a model and its test as one residual over a parameter space, with solved points cached."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np

from calib.errors.errors import EvaluationError, raised_anew
from calib.execution.ahead import is_collecting, is_in_advance
from calib.execution.outcome import Outcome, failure, point_key
from calib.problem.labels import Label, Labelled, label_table
from calib.problem.space import ParameterSpace

if TYPE_CHECKING:
    import pandas as pd

REMEMBERED = 8
"""Number of cached solutions, so that a derivative does not solve its point again."""

AHEAD = 200
"""Number of solutions and slopes that are kept for requests that follow; see `calib.execution.ahead`."""


class Pair(Labelled, Protocol):
    """A model and a test of it: solution, responses, residual and derivatives.

    Such as `calib.correlation.modal.residual.ModalResidual` and `calib.correlation.response.residual.ResponseResidual`.
    The type of a solution is private to the pair.
    """

    @property
    def space(self) -> ParameterSpace:
        """Parameters of the model."""
        ...

    @property
    def relative_std(self) -> np.ndarray:
        """Relative standard deviation of every row, (n_rows,)."""
        ...

    @property
    def shared_errors(self) -> np.ndarray:
        """Change of the residual by one standard deviation of every error that rows share, (n_rows, n_errors)."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the residual or its derivatives at the same values could."""
        ...

    @property
    def problem(self) -> Any:
        """The problem solved; its ``fingerprint`` changes whenever the responses at the same values could."""
        ...

    @property
    def told_by_responses(self) -> bool:
        """Whether the solution can be restored from its responses, so that residuals need not be stored."""
        ...

    def solve(self, values: Mapping[str, float]) -> Any:
        """The solution at values of all parameters; EvaluationError where the model fails."""
        ...

    def responses(self, solution: Any) -> dict[str, float]:
        """Named responses of a solution."""
        ...

    def restored(self, responses: Mapping[str, float]) -> Any:
        """The solution from its responses; None where it cannot be restored."""
        ...

    def of(self, solution: Any) -> np.ndarray:
        """Whitened residual of a solution, (n_rows,)."""
        ...

    def slope(self, values: Mapping[str, float], names: Sequence[str], at: Callable[..., Any]) -> np.ndarray:
        """Derivative of the residual per unit of each parameter, (n_rows, n_params).

        ``at`` returns the solution at named values.
        """
        ...

    def frequencies(
        self, values: Mapping[str, float], names: Sequence[str], at: Callable[..., Any]
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Labels and natural frequencies of all model modes, Hz, and the derivatives of their logarithms."""
        ...


P = TypeVar("P", bound=Pair)


class Store(Protocol):
    """Persistent store of solved points, such as `calib.results.ledger.Ledger`."""

    def lookup(self, fingerprint: str, keys: Iterable[str]) -> Mapping[str, Outcome]:
        """Known outcomes by key."""
        ...

    def append(self, fingerprint: str, outcomes: Sequence[Outcome]) -> None:
        """Keep outcomes."""
        ...

    def first_use(self, fingerprint: str, key: str) -> bool:
        """Whether a point was evaluated ahead of this request; false from then on."""
        ...

    def vectors(self, fingerprint: str, key: str, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Known vectors of a point by name."""
        ...

    def keep_vectors(self, fingerprint: str, key: str, vectors: Mapping[str, np.ndarray]) -> None:
        """Keep vectors of a point."""
        ...


@dataclass(eq=False)
class Counts:
    """Number of points requested: solved, already known, and failed.

    A derivative requests points too: both ends of a difference, or the point itself for analytic derivatives.
    """

    solved: int = 0
    reused: int = 0
    failed: int = 0

    @contextmanager
    def apart(self) -> Iterator[Counts]:
        """Points requested within this context are counted apart."""
        before, within = replace(self), Counts()
        try:
            yield within
        finally:
            for name, number in asdict(before).items():
                setattr(within, name, getattr(self, name) - number)
                setattr(self, name, number)

    def add(self, more: Counts) -> None:
        """Count points that were counted apart."""
        self.solved += more.solved
        self.reused += more.reused
        self.failed += more.failed

    @property
    def asked(self) -> int:
        """All of them."""
        return self.solved + self.reused + self.failed


@dataclass(frozen=True, eq=False)
class PairProblem(Generic[P]):
    """A pair of a model and a test over a parameter space: responses, residual, Jacobian and row labels.

    A point is solved once while it is cached, and a failed point is not tried again. With a store this also holds
    between runs, and residuals and derivatives are stored too where responses do not determine them.

    Attributes
    ----------
    pair : Pair
    space : ParameterSpace
        Its free parameters are those that a fit changes. Parameters of the pair that it lacks keep their nominal
        values.
    store : Store or None
    remembered : int
        Number of cached solutions.
    counts : Counts
        Of the requested points; may be shared by several problems.
    """

    pair: P
    space: ParameterSpace
    store: Store | None = None
    remembered: int = REMEMBERED
    counts: Counts = field(default_factory=Counts, repr=False)
    _solved: dict[str, Any] = field(init=False, repr=False, default_factory=dict)
    _failed: dict[str, EvaluationError] = field(init=False, repr=False, default_factory=dict)
    _early: dict[Hashable, Any] = field(init=False, repr=False, default_factory=dict)
    _identity: str = field(init=False, repr=False, default="")
    _key: str = field(init=False, repr=False, default="")

    def __post_init__(self) -> None:
        if self.store is not None:  # once: a function may hold large matrices
            object.__setattr__(self, "_identity", self.pair.fingerprint)
            object.__setattr__(self, "_key", self.pair.problem.fingerprint)

    def __getstate__(self) -> dict[str, Any]:
        # Another process does not need the cached points, which are many.
        return {**self.__dict__, "_solved": {}, "_failed": {}, "_early": {}}

    def forget(self) -> None:
        """Drop all cached points, so that what is counted does not depend on earlier requests."""
        self._solved.clear()
        self._failed.clear()
        self._early.clear()

    @property
    def rows(self) -> Sequence[Label]:
        """Labels of the rows, length n_rows."""
        return self.pair.rows

    @property
    def labels(self) -> pd.DataFrame:
        """Labels of the rows as a table, n_rows; see `label_table`."""
        return label_table(self.rows)

    @property
    def relative_std(self) -> np.ndarray:
        """Relative standard deviation of every row, (n_rows,)."""
        return self.pair.relative_std

    @property
    def shared_errors(self) -> np.ndarray:
        """Change of the residual by one standard deviation of every error that rows share, (n_rows, n_errors)."""
        return self.pair.shared_errors

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Real numbers that the residual fits itself, by (mode, kind); they reduce the degrees of freedom."""
        return self.pair.fitted_factors

    @property
    def std_dof(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviations of each kind of row; infinite where they are known."""
        return self.pair.std_dof

    @property
    def by_differences(self) -> bool:
        """Whether derivatives cost further evaluations of the model."""
        return bool(getattr(getattr(self.pair.problem, "model", None), "by_differences", False))

    def responses(self, values: Mapping[str, float]) -> dict[str, float]:
        """Named responses; EvaluationError where the model cannot be solved."""
        return self.pair.responses(self.at(values))

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual, (n_rows,); EvaluationError where the model cannot be solved or has failed before."""
        complete = self.pair.space.complete(dict(values))
        if self.store is None or self.pair.told_by_responses or is_collecting():
            return self.pair.of(self.at(complete))
        key = point_key(complete)
        known = self.store.vectors(self._identity, key, [""])
        if "" in known:
            self.counts.reused += 1
        else:
            known = {"": self.pair.of(self.at(complete))}
            self.store.keep_vectors(self._identity, key, known)
        return known[""]

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the residual per unit of each parameter, (n_rows, n_params); EvaluationError for NaN in it."""
        complete = self.pair.space.complete(dict(values))
        if self.store is None or self.pair.told_by_responses:
            return self._slope(complete, names)
        key = point_key(complete)
        known = self.store.vectors(self._identity, key, names)
        new = [name for name in names if name not in known]
        if is_collecting():
            return self._slope(complete, new)
        if new:
            columns = dict(zip(new, self._slope(complete, new).T, strict=True))
            self.store.keep_vectors(self._identity, key, columns)
            known = known | columns
        elif names:
            self.counts.reused += 1
        return np.column_stack([known[name] for name in names]) if names else np.zeros((len(self.rows), 0))

    def _slope(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        key, points = (point_key(values), *names), list[Mapping[str, float]]()

        def at(point: Mapping[str, float]) -> Any:
            points.append(point)
            return self.at(point)

        if key in self._early:
            slope, requested = self._early[key] if is_collecting() else self._early.pop(key)
            for point in requested:  # they count, and are cached, as when the slope is evaluated now
                self.at(point)
            return np.asarray(slope)
        slope = self.pair.slope(values, names, at)
        wrong = np.argwhere(~np.isfinite(slope))
        if len(wrong):
            row, column = wrong[0].tolist()
            label = self.rows[row]
            of = " ".join(filter(None, [label.kind, label.mode, label.sensor]))
            raise EvaluationError(f"the derivative of {of} by {names[column]} is not finite")
        if is_in_advance() and not self.by_differences:  # those count the points of their differences
            self.keep_ahead(key, (slope, points))
        return slope

    def frequencies(
        self, values: Mapping[str, float], names: Sequence[str]
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Labels and natural frequencies of all model modes, Hz, and the derivatives of their logarithms; see `Pair`.

        Without modes all are empty.
        """
        return self.pair.frequencies(self.pair.space.complete(dict(values)), names, self.at)

    def at(self, values: Mapping[str, float]) -> Any:
        """The pair's solution at named values; EvaluationError where the model fails."""
        complete = self.pair.space.complete(dict(values))
        key = point_key(complete)
        if is_collecting():
            return self._noted(key, complete)
        if key in self._solved:
            self.counts.reused += 1
            return self._solved[key]
        try:
            found = self._found(key, complete)
        except EvaluationError as fault:
            self.counts.failed += 1
            self._failed[key] = fault
            raise
        while len(self._solved) >= self.remembered:
            del self._solved[next(iter(self._solved))]
        self._solved[key] = found
        return found

    def _noted(self, key: str, values: dict[str, float]) -> Any:
        """The solution while points are collected: kept for the request that follows, and not counted before it."""
        if key in self._failed:
            raise raised_anew(self._failed[key])
        if not self.is_known(key):
            try:
                self.keep_ahead(key, self.pair.solve(values))
            except EvaluationError as fault:
                if self.store is None:  # else the request that follows stores it
                    self.keep_ahead(key, fault)
                raise
        return self._solved[key] if key in self._solved else self._early[key]

    def is_known(self, key: str) -> bool:
        """Whether a point has been solved, or has failed."""
        return key in self._solved or key in self._early or key in self._failed

    @property
    def ahead(self) -> dict[Hashable, Any]:
        """Solutions, failures and slopes that are kept for requests that follow, by key; see `keep_ahead`."""
        kept: dict[Hashable, Any] = dict(self._early)
        kept.update(self._failed)
        return kept

    def keep_ahead(self, key: Hashable, found: Any) -> None:
        """Keep a solution, a slope, or the EvaluationError of a point without one, for the request that follows."""
        if isinstance(found, EvaluationError):
            self._failed[str(key)] = found
            return
        while key not in self._early and len(self._early) >= AHEAD:
            del self._early[next(iter(self._early))]
        self._early[key] = found

    def _found(self, key: str, values: dict[str, float]) -> Any:
        """The stored solution, or a new one."""
        if key in self._failed:
            raise raised_anew(self._failed[key])
        found = self._restored(key)
        if found is not None:
            ahead = self.store is not None and self.store.first_use(self._key, key)
            self.counts.add(Counts(solved=ahead, reused=not ahead))
            return found
        found = self._solve(key, values)
        self.counts.solved += 1
        return found

    def _restored(self, key: str) -> Any:
        """The solution from the store; None where the point must be solved."""
        known = None if self.store is None else self.store.lookup(self._key, [key]).get(key)
        if known is None or known.transient:
            return None
        if known.status == "failed":
            raise failure(known)
        return self.pair.restored(known.responses)

    def _solve(self, key: str, values: dict[str, float]) -> Any:
        started = time.perf_counter()
        try:
            found = self._early.pop(key) if key in self._early else self.pair.solve(values)
        except EvaluationError as fault:
            self._keep(Outcome(values, "failed", {}, str(fault), time.perf_counter() - started))
            raise
        if self.store is not None:
            self._keep(Outcome(values, "ok", self.pair.responses(found), "", time.perf_counter() - started))
        return found

    def _keep(self, outcome: Outcome) -> None:
        if self.store is not None:
            self.store.append(self._key, [outcome])
