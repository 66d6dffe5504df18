"""Modes as scalar responses: ``freq_1`` and ``damping_1`` are natural frequency (Hz) and damping ratio of mode 1."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.function import slope_entry
from calib.structure.derivatives import Analytic, beside_roots
from calib.structure.modal_model import ModalModel
from calib.structure.modes import Modes

_NAME = re.compile(r"(freq|damping)_([1-9]\d*)")


@dataclass(frozen=True, eq=False)
class ModalResponses:
    """Natural frequencies and damping ratios of a model, by the number of the mode, as a function of named values.

    Vibration modes count from 1 in ascending frequency; those of a mode that crosses another one change places with it.
    A model of matrices also tells exact derivatives, where it is asked for them (`calib.function.Asked`).

    Attributes
    ----------
    model : ModalModel
    count : int
        Modes that are solved.
    """

    model: ModalModel
    count: int

    @classmethod
    def of(cls, model: ModalModel, names: Iterable[str], place: str) -> ModalResponses:
        """The named responses of a model; InputError for one that it does not have."""
        numbers = [_number(model, name, place) for name in names]
        return cls(model, max(numbers))

    def with_model(self, model: ModalModel) -> ModalResponses:
        """The same responses of another model."""
        return replace(self, model=model)

    @property
    def derives(self) -> bool:
        """Whether it tells derivatives; see `calib.function.DERIVES`."""
        return isinstance(self.model, Analytic)

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


def _number(model: ModalModel, name: str, place: str) -> int:
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


def as_responses(function: Any, model: Any) -> Any:
    """The function of another model: its modes where ``function`` is one of modes, else its own function."""
    return function.with_model(model) if isinstance(function, ModalResponses) else model.function
