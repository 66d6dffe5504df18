"""Measured FRFs of transducers that do not sit where they are said to.

A transducer at a distance d from its stated place measures, or drives, the motion ``r + d dr`` instead of r, with r its
row over the degrees of freedom. In a beam or plate dr holds rotations, in a rigid part ``theta x d``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.correlation.frf_nuisance import PlaceError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.structure.model import StructuralModel
from calib.structure.reduced import ReducedModel


@dataclass(frozen=True, eq=False)
class Places:
    """Rows of the transducers of measured FRFs, as functions of the errors of their places.

    Attributes
    ----------
    errors : tuple of PlaceError
        Of transducers that were measured.
    responses, references : ndarray (n_responses, n_dof), (n_references, n_dof)
        Rows at the stated places.
    slopes : ndarray (n_errors, n_dof)
        Change of the row of its transducer with each distance, 1/m.
    at : tuple of (int or None, int or None)
        Response and reference of each error.
    """

    errors: tuple[PlaceError, ...]
    responses: np.ndarray
    references: np.ndarray
    slopes: np.ndarray
    at: tuple[tuple[int | None, int | None], ...]

    @classmethod
    def of(cls, errors: Sequence[PlaceError], measured: MeasuredFRFs, model: StructuralModel | ReducedModel) -> Places:
        """Those of measured FRFs on a model; InputError for a transducer that the model cannot place."""
        responses, references = (model.sensor_rows(sensors) for sensors in (measured.responses, measured.references))
        slopes = np.array([error.slope(model) for error in errors]).reshape(len(errors), responses.shape[1])
        at = [(_index(measured.responses, e.sensor.name), _index(measured.references, e.sensor.name)) for e in errors]
        return cls(tuple(errors), responses, references, slopes, tuple(at))

    def rows(self, si: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of responses and references at values in SI."""
        out = self.responses, self.references
        moved = [(k, si[error.parameter.name]) for k, error in enumerate(self.errors)]
        if not any(distance for _, distance in moved):
            return out
        out = out[0].copy(), out[1].copy()
        for k, distance in moved:
            for rows, index in zip(out, self.at[k], strict=True):
                if index is not None:
                    rows[index] += distance * self.slopes[k]
        return out

    def asked(self, names: Sequence[str]) -> list[int]:
        """Errors whose parameters are named, in their order."""
        return [k for k, error in enumerate(self.errors) if error.parameter.name in names]

    def beside(self, asked: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of changes beside those of responses and of references, for `derivatives`."""
        return self.slopes[list(asked)], self.slopes[[k for k in asked if self.at[k][1] is not None]]

    def derivatives(self, asked: Sequence[int], functions: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives per unit of the parameters, each (n_freq, n_responses, n_references).

        Parameters
        ----------
        asked : sequence of int
        functions : ndarray (n_freq, n_responses + n_asked, n_references + n_asked_references)
            Of the rows at the values and, after them, those of `beside`.
        """
        n, m = len(self.responses), len(self.references)
        found, driven = {}, m
        for position, k in enumerate(asked):
            response, reference = self.at[k]
            slope = np.zeros((len(functions), n, m), dtype=complex)
            if response is not None:
                slope[:, response] += functions[:, n + position, :m]
            if reference is not None:
                slope[:, :, reference] += functions[:, :n, driven]
                driven += 1
            parameter = self.errors[k].parameter
            found[parameter.name] = slope * parameter.si_factor
        return found


def _index(sensors: Sequence[Sensor], name: str) -> int | None:
    return next((k for k, sensor in enumerate(sensors) if sensor.name == name), None)
