"""Rows of the transducers of measured FRFs: which motion each measures or drives, and how errors of a test change it.

A transducer whose row over the degrees of freedom is r has ``r + sum (w r + v q)`` with its errors, each with another
row q and two weights of its value:

- a place wrong by d: w = 0, v = d, q the change of the motion over the distance;
- an axis turned by a: w = cos a - 1, v = sin a, q the motion along the other axis;
- a share s of another channel: w = 0, v = s, q the motion at that channel's sensor;
- two channels exchanged: w = -s, v = s of both, by one parameter.

Errors of one transducer add up, so that products of two of them are left out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel

Side = Literal["response", "reference"]
"""Channels of a test of FRFs: those of its responses, and those of the forces."""


def in_test(test: str) -> str:
    """End of the name of a parameter that belongs to one of several tests."""
    return f" in test {test}" if test else ""


def require_positive_std(prior_sd: float | None, place: str) -> None:
    """InputError for a standard deviation that is given and not positive."""
    if prior_sd is not None and not 0 < prior_sd < np.inf:
        raise InputError(f"its standard deviation is {prior_sd:g}", place=place, remedy="give a positive number")


class RowError(ABC):
    """An error by which a transducer has another row than stated; 0 without it.

    Attributes
    ----------
    sensor : Sensor
        The transducer.
    """

    sensor: Sensor

    @property
    def name(self) -> str:
        """Of its transducer."""
        return self.sensor.name

    @property
    @abstractmethod
    def place(self) -> str:
        """As messages name it."""

    @property
    @abstractmethod
    def parameter(self) -> Parameter:
        """Its value."""

    @property
    def of_channel(self) -> tuple[()]:
        """None: it is no factor of measured functions."""
        return ()

    @property
    def of_rows(self) -> tuple[RowError, ...]:
        """Itself."""
        return (self,)

    def loads(self, model: StructuralModel) -> tuple[()]:
        """None: it changes no matrix."""
        return ()

    @property
    def side_words(self) -> str:
        """Its side, as a message names it before the transducer; empty where it has none."""
        return ""

    def concerns(self, measured: MeasuredFRFs) -> bool:
        """Whether its transducer is among those that may have it."""
        return self.name in self.among(measured)

    @abstractmethod
    def changed(self, measured: MeasuredFRFs) -> tuple[tuple[Sensor, ...], tuple[Sensor, ...]]:
        """Responses and references among which its transducer is sought."""

    @abstractmethod
    def other(self, model: StructuralModel | ReducedModel) -> np.ndarray:
        """The other row, (n_dof,); InputError where the model has none."""

    def weights(self, value: float) -> tuple[float, float]:
        """Weights of the transducer's own row, beside 1, and of the other one, at a value in SI."""
        return 0.0, value

    def slopes(self, value: float) -> tuple[float, float]:
        """Their derivatives at a value in SI."""
        return 0.0, 1.0

    def among(self, measured: MeasuredFRFs) -> tuple[str, ...]:
        """Names of all transducers that may have it."""
        responses, references = self.changed(measured)
        return tuple(dict.fromkeys(sensor.name for sensor in (*responses, *references)))

    def at(self, measured: MeasuredFRFs) -> tuple[int | None, int | None]:
        """Indices of the response and of the reference that it changes."""
        response, reference = (_index(sensors, self.name) for sensors in self.changed(measured))
        return response, reference


@dataclass(frozen=True, eq=False)
class TransducerRows:
    """Rows of the transducers of measured FRFs, as functions of errors.

    Attributes
    ----------
    errors : tuple of RowError
        Of transducers that were measured.
    responses, references : ndarray (n_responses, n_dof), (n_references, n_dof)
        Rows without errors.
    others : ndarray (n_errors, n_dof)
        The other row of each error.
    at : tuple of (int or None, int or None)
        Response and reference that each error changes.
    """

    errors: tuple[RowError, ...]
    responses: np.ndarray
    references: np.ndarray
    others: np.ndarray
    at: tuple[tuple[int | None, int | None], ...]

    @classmethod
    def of(
        cls, errors: Sequence[RowError], measured: MeasuredFRFs, model: StructuralModel | ReducedModel
    ) -> TransducerRows:
        """Those of measured FRFs on a model; InputError for a transducer or an error that the model cannot place."""
        responses, references = (model.sensor_rows(sensors) for sensors in (measured.responses, measured.references))
        others = np.array([error.other(model) for error in errors]).reshape(len(errors), responses.shape[1])
        return cls(tuple(errors), responses, references, others, tuple(error.at(measured) for error in errors))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters of the errors."""
        return tuple(error.parameter.name for error in self.errors)

    @property
    def content(self) -> tuple[str | bytes, ...]:
        """All that the rows depend on, for a fingerprint."""
        arrays = (self.responses, self.references, self.others)
        return (*(array.tobytes() for array in arrays if array.size), *self.names)

    def rows(self, si: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of responses and references at values in SI."""
        weights = {k: self.errors[k].weights(si[name]) for k, name in enumerate(self.names) if si[name]}
        if not weights:
            return self.responses, self.references
        responses, references = self.responses.copy(), self.references.copy()
        for k, (response, reference) in self._changed(weights):
            if response is not None:
                responses[response] += self._sum(k, weights[k], self.responses[response])
            if reference is not None:
                references[reference] += self._sum(k, weights[k], self.references[reference])
        return responses, references

    def asked(self, names: Sequence[str]) -> list[int]:
        """Errors whose parameters are named, in their order."""
        wanted = set(names)
        return [k for k, name in enumerate(self.names) if name in wanted]

    def beside(self, asked: Sequence[int], si: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the rows of responses and of references at values in SI, for `derivatives`.

        Shapes are (n_asked_responses, n_dof) and (n_asked_references, n_dof): one row for each of both that an asked
        error changes, in the order of the errors.
        """
        slopes = {k: self.errors[k].slopes(si[self.names[k]]) for k in asked}
        at = list(self._changed(asked))
        responses = [self._sum(k, slopes[k], self.responses[own]) for k, (own, _) in at if own is not None]
        references = [self._sum(k, slopes[k], self.references[own]) for k, (_, own) in at if own is not None]
        width = self.responses.shape[1]
        return np.reshape(responses, (len(responses), width)), np.reshape(references, (len(references), width))

    @property
    def moved(self) -> np.ndarray:
        """Derivatives of the rows of references at value 0, (n_moved, n_dof): forces that a basis must know."""
        return self.beside(range(len(self.errors)), dict.fromkeys(self.names, 0.0))[1]

    def derivatives(self, asked: Sequence[int], felt: np.ndarray, driven: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives per unit of the parameters, each (n_freq, n_responses, n_references).

        Parameters
        ----------
        asked : sequence of int
        felt : ndarray (n_freq, n_asked_responses, n_references)
            Functions between the rows of responses that `beside` gives and the references.
        driven : ndarray (n_freq, n_responses, n_asked_references)
            Functions between the responses and the rows of references that it gives.
        """
        found: dict[str, np.ndarray] = {}
        shape = len(felt), len(self.responses), len(self.references)
        at_responses, at_references = iter(range(felt.shape[1])), iter(range(driven.shape[2]))
        for k, (response, reference) in self._changed(asked):
            slope = np.zeros(shape, dtype=complex)
            if response is not None:
                slope[:, response] += felt[:, next(at_responses)]
            if reference is not None:
                slope[:, :, reference] += driven[:, :, next(at_references)]
            name = self.names[k]
            found[name] = found.get(name, 0.0) + slope * self.errors[k].parameter.si_factor
        return found

    def _changed(self, asked: Iterable[int]) -> list[tuple[int, tuple[int | None, int | None]]]:
        return [(k, self.at[k]) for k in asked]

    def _sum(self, k: int, weights: tuple[float, float], own: np.ndarray) -> np.ndarray:
        return np.asarray(weights[0] * own + weights[1] * self.others[k])


def _index(sensors: Sequence[Sensor], name: str) -> int | None:
    return next((k for k, sensor in enumerate(sensors) if sensor.name == name), None)
