"""Function models: any function from named parameters to named responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar, runtime_checkable

from calib.errors.arguments import objects
from calib.errors.errors import InputError
from calib.errors.own_code import defined_at
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of
from calib.results.in_short import Short
from calib.structure.function_parts import ScaledPart, scaled_parts
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import Assumption


class Predicted(Protocol):
    """Responses that are predicted with an error."""

    @property
    def errors(self) -> Mapping[str, float]:
        """Standard deviation of each response, in its unit."""
        ...


@dataclass(frozen=True)
class FunctionModel(Short):
    """Anything that maps named parameters to named responses.

    Attributes
    ----------
    name : str
    space : ParameterSpace
    function : callable
        Takes ``{parameter: value}``, every value in its parameter's unit, and returns ``{response: value}``. It may
        also return derivatives, see `slope_entry`.
    assumptions : tuple of Assumption
    parts : tuple of ScaledPart
        Parts that the function scales where it is asked to; an explanation asks whether one of them is wrong.
    identity : str
        Identifies the function where its code and the objects it holds are not enough.
    metamodels : Predicted, optional
        What predicts the responses, where they are not computed: of a table of runs.

    Examples
    --------
    >>> import calib
    >>> space = calib.ParameterSpace((calib.Parameter("EI", 200.0, 100.0, 300.0, "Nm2"),))
    >>> model = calib.FunctionModel("cantilever", space, lambda v: {"deflection": 10.0 * 0.5**3 / (3 * v["EI"])})
    >>> problem = calib.Problem(model, calib.ResponseTest({"deflection": (1.6e-3, 1e-5)}))
    >>> round(problem.calibrate().values["EI"])
    260
    """

    name: str
    space: ParameterSpace
    function: Callable[[Mapping[str, float]], Mapping[str, float]]
    assumptions: tuple[Assumption, ...] = ()
    parts: tuple[ScaledPart, ...] = ()
    identity: str = ""
    metamodels: Predicted | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        objects([self.space], ParameterSpace, f"model {self.name}, space")
        if not callable(self.function):
            raise InputError(
                f"its function is {self.function!r:.40}", place=f"model {self.name}",
                remedy="give a function of named values",
            )  # fmt: skip
        object.__setattr__(self, "parts", scaled_parts(self.parts, f"model {self.name}, parts"))

    def __str__(self) -> str:
        return f"{self.name}: a function of {len(self.space.parameters)} parameters"

    @property
    def reducible(self) -> None:
        """None: there are no matrices to reduce."""
        return

    @property
    def fingerprint(self) -> str:
        """Hash over the function: its file, its code and the objects it holds (closure, defaults)."""
        return self.identity or digest_of(self.name, self.function)[:16]

    def with_function(self, function: Callable[[Mapping[str, float]], Mapping[str, float]]) -> FunctionModel:
        """The model with another function."""
        return replace(self, function=function)


def slope_entry(response: str, parameter: str) -> str:
    """Name under which a function may return a derivative beside its responses: ``d(load)/d(stiffness)``.

    It is per one of the parameter's own unit. An entry that is missing is found by differences.
    """
    return f"d({response})/d({parameter})"


def response_of(entry: str) -> str:
    """The response that an entry of a function's result is, or whose derivative it is; see `slope_entry`."""
    name = str(entry)  # a function may return anything until its result is checked
    inner, found, _ = name.removeprefix("d(").partition(")/d(")
    return inner if found and name.startswith("d(") else name


def responses_of(result: Mapping[str, float]) -> dict[str, float]:
    """The result of a function without the derivatives."""
    return {name: value for name, value in result.items() if response_of(name) == str(name)}


@runtime_checkable
class DerivativesOnRequest(Protocol):
    """A function that returns only part of the derivatives it knows, and the others where it is asked for them."""

    def derivatives_by(self, values: Mapping[str, float], names: Sequence[str]) -> Mapping[str, float]:
        """Further derivatives by named parameters, see `slope_entry`; as many as it knows."""
        ...


DERIVES = "derives"
"""Attribute of a function built by an effect: true where the derivatives that it returns are its own."""


@dataclass(frozen=True)
class _WithoutSlopes:
    """A function that an effect built upon another: derivatives of the other one are not its own.

    Attributes
    ----------
    function : callable
    """

    function: Callable[[Mapping[str, float]], Mapping[str, float]]

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        result = self.function(values)
        return responses_of(result) if isinstance(result, Mapping) else result


F = TypeVar("F", bound=FunctionModel | ModalFunctionModel)


def extend_function(model: F, effects: Sequence[Effect]) -> F:
    """The model with effects, their magnitudes and nuisance parameters after its own parameters.

    An effect on a function model builds a function of all values, its own included, that returns the same as the
    model's; None when the model's function accepts the effect's parameters itself (optional ones, absent from the base
    model's space). Each effect is built on the result of the previous one. Derivatives that a built function passes on
    are those of the model before it, and are dropped unless it says by an attribute `DERIVES` that they are its own.

    Raises
    ------
    InputError
        When an effect is in the model already, or does not build a function.
    """
    for effect in effects:
        effect.require_new(model.space, model.name)
        built = effect.build(model)
        if built is not None and not callable(built):
            raise InputError(
                f"it builds {type(built).__name__}", place=f"effect {effect.name}",
                remedy="return a function of named values, or None", at=defined_at(effect.build),
            )  # fmt: skip
        space = ParameterSpace(model.space.parameters + effect.parameters, model.space.constraints)
        if built is not None and isinstance(model, FunctionModel) and not getattr(built, DERIVES, False):
            built = _WithoutSlopes(built)
        model = replace(model, space=space, function=built or model.function)
    return model
