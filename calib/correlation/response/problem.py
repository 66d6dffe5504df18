"""A function against measured scalar responses: named parameter values in, named responses out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import numpy as np

from calib.correlation.rules import RULES
from calib.errors.errors import EvaluationError, InputError
from calib.errors.own_code import defined_at
from calib.measurement.responses import response_kinds
from calib.problem.degrees_of_freedom import repeats_dof
from calib.problem.space import ParameterSpace
from calib.structure.function_model import responses_of
from calib.structure.model import Assumption

Targets = Mapping[str, tuple[float, float | None]]
"""Measured value of each scalar response and its standard deviation, None where it is unknown."""


@dataclass(frozen=True, eq=False)
class FunctionProblem:
    """Targets for any function from named parameters to named responses: a tire, an external solver, user code.

    Attributes
    ----------
    space : ParameterSpace
    function : callable
        Takes the values of all parameters by name, each in its own unit, and returns named responses.
    targets : mapping from str to (value, std or None)
        Measured value of each response and its standard deviation, where known.
    fingerprint : str
        Of the function; it must change whenever its results could.
    repeats : float or None
        Number of repeats behind the standard deviations, pooled over the responses of each kind; None for known
        standard deviations.
    shares : mapping from str to float
        Part of the variance of each target that the repeats estimate; default 1.
    errors : mapping from str to float
        Standard deviation with which the function predicts each response, where it does not compute it.
    units : mapping from str to str
        Unit of each response that has one, as text for tables and figures.
    """

    space: ParameterSpace
    function: Callable[[Mapping[str, float]], Mapping[str, float]]
    targets: Targets
    fingerprint: str
    repeats: float | None = None
    shares: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.targets:
            raise InputError("no target is given", place="targets", remedy="name at least one measured response")
        for name, (value, std) in self.targets.items():
            if not math.isfinite(value):
                raise InputError(f"the target {name!r} is {value}", place="targets", remedy="give a finite number")
            if std is not None and not (math.isfinite(std) and std > 0):
                raise InputError(
                    f"the standard deviation of {name!r} is {std}",
                    place="targets",
                    remedy="give a positive one or none",
                )

    @property
    def compared(self) -> Targets:
        """The targets with the standard deviation of their difference from the function, where it has an error."""
        return {name: (value, self._wide(name)) for name, (value, _) in self.targets.items()}

    def _wide(self, name: str) -> float | None:
        """Standard deviation of a target, measured or assumed, and of the function together."""
        (value, std), error = self.targets[name], self.errors.get(name, 0.0)
        return math.hypot(std or RULES.unknown_response_std * abs(value), error) if error else std

    def with_model(self, model: Any) -> Self:
        """The same targets for another function; see `calib.correlation.modal.responses.ModalResponseProblem`."""
        return replace(self, space=model.space, function=model.function)

    @property
    def user_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]] | None:
        """The user's function; None where no user code is run."""
        return self.function

    def with_function(self, function: Callable[[Mapping[str, float]], Mapping[str, float]]) -> Self:
        """The same targets for another form of the user's function."""
        return replace(self, function=function)

    @property
    def numbers_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]] | None:
        """The user's function of the numbers of modes; None: this one returns the responses themselves."""
        return None

    @property
    def reducible(self) -> None:
        """None: no basis serves scalar responses; a model of matrices is solved at full order."""
        return

    @property
    def ledger_key(self) -> str:
        """Fingerprint of the responses in the ledger."""
        return self.fingerprint

    @property
    def model_fingerprint(self) -> str:
        """Hash that changes whenever a result of the function could."""
        return self.fingerprint

    @property
    def assumed_std(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is known."""
        return assumed_responses(self.targets)

    @property
    def relative_std(self) -> np.ndarray:
        """Relative standard deviation of every target, (n_targets,); NaN where it would be assumed."""
        return np.array([std / abs(value) if std else np.nan for value, std in self.compared.values()])

    @property
    def sensitivity_responses(self) -> list[str]:
        """The measured responses."""
        return list(self.targets)

    @property
    def search_targets(self) -> dict[str, float]:
        """Measured values of the responses that a search compares."""
        return {name: value for name, (value, _) in self.targets.items()}

    @property
    def n_measured(self) -> int:
        """Number of measured responses."""
        return len(self.targets)

    @property
    def std_dof(self) -> dict[str, float]:
        """Degrees of freedom behind the standard deviations of each kind; infinite where they are known."""
        parts = {name: ((std or 0.0) / (self._wide(name) or 1.0)) ** 2 for name, (_, std) in self.targets.items()}
        own = {
            name: self.shares.get(name, 1.0) * (parts[name] if name in self.errors else 1.0) for name in self.targets
        }
        return response_dof(self.targets, self.repeats, own)

    def evaluate(self, values: Mapping[str, float]) -> dict[str, float]:
        """Responses at named values; missing parameters take their nominal value.

        Raises
        ------
        EvaluationError
            When a target is missing from the result or a response is not a finite number.
        """
        given = self.space.complete(values)
        result = self.function(given)

        def wrong(words: str) -> EvaluationError:
            return EvaluationError(words, at=defined_at(self.function, given))

        if not hasattr(result, "keys"):
            raise wrong(f"the function gave {type(result).__name__}, not responses by name")
        missing = [name for name in self.targets if name not in result]
        if missing:
            returned = ", ".join(responses_of(result)) or "nothing"
            raise wrong(f"the function gave no {', '.join(missing)} (it gave {returned})")
        out = {}
        for name, value in result.items():
            try:
                out[name] = float(value)
            except (TypeError, ValueError) as fault:
                raise wrong(f"the response {name!r} is {value!r}, not a number") from fault
            if not math.isfinite(out[name]):
                raise wrong(f"the response {name!r} is {out[name]}")
        return out


_LISTED = 4
"""Responses that are listed by name."""


class ResponseRow(NamedTuple):
    """What one entry of the residual compares.

    Attributes
    ----------
    mode : str
        Empty.
    kind : str
        See `calib.measurement.responses.response_kinds`.
    sensor : str
        Name of the response.
    """

    mode: str
    kind: str
    sensor: str


def response_rows(names: Iterable[str]) -> tuple[ResponseRow, ...]:
    """Rows of the residual of some scalar responses, in their order."""
    return tuple(ResponseRow("", kind, name) for name, kind in response_kinds(names).items())


def response_dof(names: Iterable[str], repeats: float | None, shares: Mapping[str, float]) -> dict[str, float]:
    """Degrees of freedom behind the standard deviations of scalar responses, by kind.

    Parameters
    ----------
    names : iterable of str
    repeats : float or None
        Number behind the standard deviations; None for known ones.
    shares : mapping from response name to float
        Part of each variance that the repeats estimate; default 1.
    """
    rows = response_rows(names)
    return repeats_dof((row.kind for row in rows), repeats, [shares.get(row.sensor, 1.0) for row in rows])


def assumed_responses(targets: Mapping[str, tuple[float, float | None]]) -> tuple[Assumption, ...]:
    """Assumed standard deviations of scalar responses, each a value with its standard deviation or None."""
    unknown = [name for name, (_, std) in targets.items() if not std]
    if not unknown:
        return ()
    value = f"{100 * RULES.unknown_response_std:g}"
    reason = "no standard deviation and no accuracy is stated"
    listed = ", ".join(unknown) if len(unknown) <= _LISTED else f"{unknown[0]} and {len(unknown) - 1} more responses"
    return (Assumption(f"standard deviation of {listed}", value, "% of each", reason),)
