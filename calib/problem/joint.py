"""Joint problem: several problems over one space, where parameters of the same name are shared."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import scipy.linalg as la

from calib.errors.errors import EvaluationError, InputError, raised_anew
from calib.problem.degrees_of_freedom import behind
from calib.problem.labels import Label, label_table
from calib.problem.problem import Counts
from calib.problem.space import Parameter, ParameterSpace

if TYPE_CHECKING:
    import pandas as pd

_Result = TypeVar("_Result")


class JointRow(NamedTuple):
    """Label of one row of a joint residual.

    Attributes
    ----------
    test : str
        Name of its problem.
    mode, kind, sensor : str
        As in that problem; mode and sensor are prefixed with the test's name, since tests may share names.
    own : Label
        The label in that problem, with every column that the test brings.
    """

    test: str
    mode: str
    kind: str
    sensor: str
    own: Label


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows of several tests, stacked, with modes and sensors prefixed by the test's name.

    Attributes
    ----------
    parts : mapping from str to object with rows
        By name of the test; such as `calib.problem.problem.PairProblem` or `calib.missing.hypotheses.Hypotheses`.
    """

    parts: Mapping[str, Any]

    @cached_property
    def rows(self) -> tuple[JointRow, ...]:
        """Labels of the rows, length n_rows."""
        return tuple(
            JointRow(test, of_test(test, row.mode), row.kind, of_test(test, row.sensor), row)
            for test, problem in self.parts.items()
            for row in problem.rows
        )

    @property
    def labels(self) -> pd.DataFrame:
        """Labels of all tests, n_rows, with a column `TEST` and every column that a test brings; see `label_table`."""
        import pandas as pd

        shared = pd.DataFrame(self.rows)[[TEST, "mode", "kind", "sensor"]]
        return label_table([row.own for row in self.rows]).assign(**shared)

    @property
    def relative_std(self) -> np.ndarray:
        """Relative standard deviation of every row, (n_rows,)."""
        return np.concatenate([problem.relative_std for problem in self.parts.values()])

    @cached_property
    def shared_errors(self) -> np.ndarray:
        """Change of the residual by one standard deviation of every error that rows share, (n_rows, n_errors).

        Each test has its own.
        """
        return np.asarray(la.block_diag(*(problem.shared_errors for problem in self.parts.values())))

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Real numbers that the residuals fit themselves, by (mode, kind); they reduce the degrees of freedom."""
        return {
            (of_test(test, mode), kind): number
            for test, problem in self.parts.items()
            for (mode, kind), number in problem.fitted_factors.items()
        }

    @cached_property
    def std_dof(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviations of each kind of row, over all tests; see `behind`."""
        return {
            kind: behind(
                {test: float(sum(row.kind == kind for row in p.rows)) for test, p in self.parts.items()},
                {test: p.std_dof.get(kind, math.inf) for test, p in self.parts.items()},
            )
            for kind in dict.fromkeys(row.kind for row in self.rows)
        }


@dataclass(frozen=True, eq=False)
class JointProblem(JointRows):
    """Problems that share parameters by name, as one problem with stacked residuals.

    Attributes
    ----------
    parts : mapping from str to Problem
        By name of the test; a fit needs only a space, a residual and its derivative.
    known : mapping from str to collection of str
        Further names by which the residual of a test can be differentiated, such as effects that its model lacks.
    space : ParameterSpace
        See `joined`.
    """

    known: Mapping[str, Collection[str]] = field(default_factory=dict, repr=False)
    space: ParameterSpace = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "space", joined({test: p.space for test, p in self.parts.items()}))

    @property
    def counts(self) -> Counts:
        """Points requested from all tests together."""
        own = {id(p.counts): p.counts for p in self.parts.values()}.values()
        return Counts(sum(c.solved for c in own), sum(c.reused for c in own), sum(c.failed for c in own))

    @property
    def by_differences(self) -> bool:
        """Whether derivatives of any test cost further evaluations of its model."""
        return any(getattr(problem, "by_differences", False) for problem in self.parts.values())

    def responses(self, values: Mapping[str, float]) -> dict[str, float]:
        """Named responses of all tests; EvaluationError where a model cannot be solved."""
        found = {test: self._evaluated(test, p.responses, values) for test, p in self.parts.items()}
        return {of_test(test, name): value for test, own in found.items() for name, value in own.items()}

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual, (n_rows,); EvaluationError where a model cannot be solved."""
        return np.concatenate([self._evaluated(test, p.residual, values) for test, p in self.parts.items()])

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the residual per unit of each parameter, (n_rows, n_params).

        It is 0 in the rows of a test without that parameter.
        """
        blocks = []
        for test, problem in self.parts.items():
            own = [name for name in names if name in problem.space or name in self.known.get(test, ())]
            blocks.append(expand_columns(self._evaluated(test, problem.jacobian, values, own), own, names))
        return np.vstack(blocks)

    def frequencies(
        self, values: Mapping[str, float], names: Sequence[str]
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Labels and natural frequencies of all models' modes, Hz, and the derivatives of their logarithms."""
        labels: list[str] = []
        blocks: list[tuple[np.ndarray, np.ndarray]] = []
        for test, problem in self.parts.items():
            own = [name for name in names if name in problem.space]
            found, freq, slope = self._evaluated(test, problem.frequencies, values, own)
            labels += [of_test(test, label) for label in found]
            blocks.append((freq, expand_columns(slope, own, names)))
        return tuple(labels), np.concatenate([f for f, _ in blocks]), np.vstack([s for _, s in blocks])

    def inner_points(self, values: Mapping[str, float]) -> Iterator[tuple[Any, dict[str, float]]]:
        """The problem of each test and its values; see `calib.problem.shared_points`."""
        complete = self.space.complete(values)
        return ((problem, self.own(test, complete)) for test, problem in self.parts.items())

    def own(self, test: str, values: Mapping[str, float]) -> dict[str, float]:
        """Values of the parameters of one test."""
        return {name: value for name, value in values.items() if name in self.parts[test].space}

    def _evaluated(self, test: str, method: Callable[..., _Result], values: Mapping[str, float], *more: Any) -> _Result:
        """Result of one test at the joint values; an error names the test."""
        try:
            return method(self.own(test, self.space.complete(values)), *more)
        except EvaluationError as fault:
            raise raised_anew(fault, of_test(test, str(fault))) from fault


def joined(spaces: Mapping[str, ParameterSpace]) -> ParameterSpace:
    """Union of several spaces: parameters of the same name are shared, free where any space leaves them free.

    Limits are the intersection over the spaces in which a parameter is free. Value, prior and description come from the
    first such space; all constraints hold.

    Parameters
    ----------
    spaces : mapping from str to ParameterSpace
        By name of the test.

    Raises
    ------
    InputError
        Without a space, or where parameters of the same name differ in unit, type (integer) or fixed value, or have no
        value in common.
    """
    if not spaces:
        raise InputError("no problem is given", place="joint problem", remedy="give at least one")
    names = dict.fromkeys(name for space in spaces.values() for name in space.names)
    constraints = dict.fromkeys(c for space in spaces.values() for c in space.constraints)
    shared = (_one({t: s[name] for t, s in spaces.items() if name in s}) for name in names)
    return ParameterSpace(tuple(shared), tuple(constraints))


def _one(shared: Mapping[str, Parameter]) -> Parameter:
    """The shared parameter of several tests."""
    free = {test: p for test, p in shared.items() if p.distribution != "fixed"}
    (first, kept), *others = shared.items()
    for test, p in others:
        for attribute, one, other in (
            ("unit", kept.unit, p.unit),
            ("integer", kept.integer, p.integer),
            ("scale", kept.scale, p.scale),
            ("fixed value", *((None, None) if free else (kept.value, p.value))),
        ):
            if one != other:
                raise InputError(
                    f"{kept.name} has {attribute} {one} in {first} and {other} in {test}", place="joint problem",
                    remedy="give it in the same way, or another name in one of them",
                )  # fmt: skip
    if not free:
        return kept
    chosen = next(iter(free.values()))
    lower, upper = max(p.lower for p in free.values()), min(p.upper for p in free.values())
    if lower >= upper:
        raise InputError(
            f"no value of {kept.name} is within the limits of {' and '.join(free)}", place="joint problem",
            remedy="widen one of them",
        )  # fmt: skip
    value = min(max(chosen.value, lower), upper)
    return chosen.within(lower, upper, value=value)


def expand_columns(slope: np.ndarray, own: Sequence[str], names: Sequence[str]) -> np.ndarray:
    """Columns for some parameters expanded to all parameters, 0 for the others."""
    out = np.zeros((len(slope), len(names)))
    out[:, [list(names).index(name) for name in own]] = slope
    return out


TEST = "test"
"""Column of stacked tables that names the test."""


def stacked(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Stacked tables of several tests, with a column `TEST`."""
    import pandas as pd

    return pd.concat([table.assign(**{TEST: test}) for test, table in tables.items()], ignore_index=True)


def prefixed(words: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """Sentences on tests, prefixed with the name of the test where there are several."""
    if len(words) == 1:
        return tuple(*words.values())
    return tuple(of_test(test, sentence) for test, sentences in words.items() for sentence in sentences)


def of_test(test: str, what: str) -> str:
    """A mode, sensor or sentence, prefixed with its test's name; an empty one stays empty."""
    return f"{test}: {what}" if what else ""
