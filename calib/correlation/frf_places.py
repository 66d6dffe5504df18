"""Measured FRFs of transducers that do not sit where they are said to.

A transducer at a distance d from its stated place measures, or drives, the motion ``r + d dr`` instead of r, with r its
row over the degrees of freedom. In a beam or plate dr holds rotations, in a rigid part ``theta x d``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.correlation.frf_prior import LIMIT, in_test, require_positive
from calib.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.space import Parameter
from calib.structure.model import StructuralModel
from calib.structure.reduced import ReducedModel

_ROUNDING = 1e-9
"""Change of the motion at a sensor, over the motion, that is no effect of its place."""


@dataclass(frozen=True)
class PlaceError:
    """Distance of a transducer from its stated place along one axis; the direction in which it acts is right.

    An accelerometer and a force of the same name sit at the same place.

    Attributes
    ----------
    sensor : Sensor
        With its place, as a table of sensors states it.
    along : {"x", "y", "z"}
    prior_sd : float
        mm. Places that are right within a radius r have one of 0.45 r for each axis (uniform in a ball).
    test : str
        As of `ChannelError`.

    Raises
    ------
    InputError
        For another axis, a sensor without a place, or a standard deviation that is not positive.
    """

    sensor: Sensor
    along: str
    prior_sd: float
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        place = self.place
        if self.along not in DIRECTIONS[:3]:
            raise InputError(f"it is wrong along {self.along!r}", place=place, remedy="give x, y or z")
        if self.sensor.point is None:
            raise InputError("it is not stated", place=place, remedy="give its coordinates in the table of sensors")
        require_positive(self.prior_sd, place)

    @property
    def name(self) -> str:
        """Of its transducer."""
        return self.sensor.name

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"place of {self.name}"

    def among(self, measured: MeasuredFRFs) -> tuple[str, ...]:
        """Names of all transducers."""
        return tuple(sensor.name for sensor in measured.sensors)

    @property
    def parameter(self) -> Parameter:
        """Such as ``place_x_12z``."""
        reach, end = LIMIT * self.prior_sd, in_test(self.test)
        return Parameter(
            f"place_{self.along}_{self.name}{end}", 0.0, -reach, reach, "mm", prior_sd=self.prior_sd,
            description=f"distance of {self.name} from its place along {self.along}{end}",
        )  # fmt: skip

    def matters(self, model: StructuralModel | ReducedModel) -> bool:
        """Whether a distance of one standard deviation changes the motion by more than rounding."""
        change = self.parameter.si_factor * self.prior_sd * np.abs(self.slope(model)).max()
        return bool(change > _ROUNDING * np.abs(model.sensor_rows([self.sensor])).max())

    def slope(self, model: StructuralModel | ReducedModel) -> np.ndarray:
        """Change of the motion at the sensor over its distance, (n_dof,), in 1/m; zero where its place has no effect.

        A secant from one standard deviation on one side to one on the other, since motions are interpolated in pieces.
        """
        reach = self.parameter.si_factor * self.prior_sd
        ends = []
        for sign in (1, -1):
            point = np.array(self.sensor.point, dtype=float)
            point[DIRECTIONS.index(self.along)] += sign * reach
            x, y, z = point.tolist()
            ends.append(replace(self.sensor, point=(x, y, z)))
        up, down = model.sensor_rows(ends)
        return np.asarray((up - down) / (2 * reach))


def of_every_place(
    measured: MeasuredFRFs, prior_sd: float, model: StructuralModel | ReducedModel
) -> tuple[PlaceError, ...]:
    """Errors of the places of all transducers, along each axis that changes what they measure on a model.

    Parameters
    ----------
    measured : MeasuredFRFs
    prior_sd : float
        mm.
    model : StructuralModel or ReducedModel

    Raises
    ------
    InputError
        When a transducer has no place, or no place has an effect.
    """
    each = {sensor.name: sensor for sensor in measured.sensors}
    every = [PlaceError(sensor, along, prior_sd) for sensor in each.values() for along in DIRECTIONS[:3]]
    found = tuple(error for error in every if error.matters(model))
    if not found:
        raise InputError(
            f"the model {model.name} has the same motion about each place", place="places of FRFs",
            remedy="leave the places out of the nuisances, or give the model elements",
        )  # fmt: skip
    return found


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
