"""Modes as scalar responses: ``freq_1`` and ``damping_1`` are natural frequency (Hz) and damping ratio of mode 1."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calib.correlation.response.problem import FunctionProblem, Targets
from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.responses import MeasuredResponses
from calib.structure.eigenproblem.derivatives import beside_roots
from calib.structure.function_model import FunctionModel, slope_entry
from calib.structure.modal_model import ModalModel
from calib.structure.modes import Modes

_NAME = re.compile(r"(freq|damping)_([1-9]\d*)")


@dataclass(frozen=True, eq=False)
class ModalResponses:
    """Natural frequencies and damping ratios of a model, by the number of the mode, as a function of named values.

    Vibration modes count from 1 in ascending frequency; those of a mode that crosses another one change places with it.
    A model of matrices also tells exact derivatives, where it is asked for them
    (`calib.structure.function_model.DerivativesOnRequest`).

    Attributes
    ----------
    model : ModalModel
    count : int
        Modes that are solved.
    """

    model: ModalModel
    count: int

    @classmethod
    def of(cls, model: ModalModel, names: Iterable[str], place: Place | str) -> ModalResponses:
        """The named responses of a model; InputError for one that it does not have."""
        numbers = [_number(model, name, place) for name in names]
        return cls(model, max(numbers))

    def with_model(self, model: ModalModel) -> ModalResponses:
        """The same responses of another model."""
        return replace(self, model=model)

    @property
    def derives(self) -> bool:
        """Whether it tells derivatives; see `calib.structure.function_model.DERIVES`."""
        return self.model.numbers_function is None

    def __call__(self, values: Mapping[str, float]) -> dict[str, float]:
        """The responses; EvaluationError where the model cannot be solved."""
        return self._named(self.model.modes(values, self.count))

    def derivatives_by(self, values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
        """Derivatives of all responses, see `slope_entry`; none of a model without matrices."""
        if not (self.derives and names):
            return {}
        model = self.model
        point = beside_roots(model.space, model.roots, values, names)
        modes = model.modes(point, self.count)
        found = model.derivatives(point, modes, names, range(modes.n_modes), np.zeros((0, modes.shapes.shape[0])))
        return {
            slope_entry(f"{kind}_{k}", name): float(slope)
            for kind, slopes in (("freq", found.natural_freq), ("damping", found.damping_ratio))
            for name, row in zip(names, slopes, strict=True)
            for k, slope in enumerate(row, 1)
        }

    def _named(self, modes: Modes) -> dict[str, float]:
        kinds = (("freq", modes.natural_freq), ("damping", modes.damping_ratio))
        return {f"{kind}_{k}": float(x) for kind, own in kinds for k, x in enumerate(own, 1)}


def _number(model: ModalModel, name: str, place: Place | str) -> int:
    """Number of the mode of a response."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise InputError(
            f"the model {model.name} has no response {name!r}, only freq_1, damping_1, freq_2, ... of its modes",
            place=place, remedy="leave it out, or give a FunctionModel that returns it",
        )  # fmt: skip
    number = int(match[2])
    if number > model.n_modes:
        raise InputError(
            f"{name} is beyond the {model.n_modes} modes of the model {model.name}", place=place,
            remedy="leave it out, or give a model with more modes",
        )  # fmt: skip
    if match[1] == "damping" and not model.dissipates:
        raise InputError(
            f"the model {model.name} has no damping, and {name} was measured", place=place,
            remedy="leave it out, or give a model with damping",
        )  # fmt: skip
    return number


@dataclass(frozen=True, eq=False)
class ModalResponseProblem(FunctionProblem):
    """Targets for the natural frequencies and damping ratios of a model with modes.

    What the user's function of modes returns is kept by the model alone; a model of matrices runs no user code.

    Attributes
    ----------
    function : ModalResponses
    """

    function: ModalResponses

    @property
    def model(self) -> ModalModel:
        """The model whose modes are the responses."""
        return self.function.model

    def with_model(self, model: ModalModel) -> Self:
        """The same targets for the modes of another model."""
        return replace(self, space=model.space, function=self.function.with_model(model))

    @property
    def user_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]] | None:
        """That of the model's modes."""
        return self.numbers_function

    @property
    def numbers_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]] | None:
        """That of the model; None for a model of matrices."""
        return self.model.numbers_function

    def with_function(self, function: Callable[[Mapping[str, float]], Mapping[str, float]]) -> Self:
        """The same with another function of the numbers of modes."""
        return replace(self, function=self.function.with_model(self.model.with_function(function)))

    @property
    def ledger_key(self) -> str:
        """Fingerprint of the numbers in the ledger; that of a function's modes does not depend on the measurement."""
        return self.fingerprint if self.numbers_function is None else self.model.fingerprint


def response_problem(
    model: FunctionModel | ModalModel,
    measured: MeasuredResponses,
    used: Targets,
    repeats: float | None,
    place: Place | str,
) -> FunctionProblem:
    """The problem of a model against scalar responses: its function's, or frequencies and damping ratios of its modes.

    Parameters
    ----------
    model : FunctionModel, ModalFunctionModel or StructuralModel
    measured : MeasuredResponses
        All of them, so that as many modes are solved whatever is held out.
    used : mapping from str to (value, std or None)
        Those to fit.
    repeats : float or None
        Equivalent number of repeats behind the standard deviations.
    place : Place or str
        Where they are given.

    Raises
    ------
    InputError
        For a response that a model with modes does not have.
    """
    if isinstance(model, FunctionModel):
        errors = model.metamodels.errors if model.metamodels else {}
        return FunctionProblem(
            model.space, model.function, used, model.fingerprint, repeats, measured.shares, errors, measured.units
        )
    function = ModalResponses.of(model, measured.targets, place)
    mark = f"{model.fingerprint} {function.count} modes"
    return ModalResponseProblem(model.space, function, used, mark, repeats, measured.shares)
