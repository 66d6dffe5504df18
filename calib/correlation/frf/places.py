"""Measured FRFs of transducers that do not sit where they are said to.

A transducer at a distance d from its stated place measures, or drives, the motion ``r + d dr`` instead of r, with r its
row over the degrees of freedom (see `calib.correlation.frf.rows`). In a beam or plate dr holds rotations, in a rigid
part ``theta x d``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.frf.rows import RowError, in_test, require_positive_std
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.space import Parameter
from calib.structure.geometry import Mesh, at_nodes
from calib.structure.model import StructuralModel
from calib.structure.places import along_mesh
from calib.structure.reduction.reduced import ReducedModel

_ROUNDING = 1e-9
"""Change of the motion at a sensor, over the motion, that is no effect of its place."""


@dataclass(frozen=True)
class PlaceError(RowError):
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
        require_positive_std(self.prior_sd, place)

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"place of {self.name}"

    @property
    def parameter(self) -> Parameter:
        """Such as ``place_x_12z``."""
        reach, end = RULES.limit * self.prior_sd, in_test(self.test)
        return Parameter(
            f"place_{self.along}_{self.name}{end}", 0.0, -reach, reach, "mm", prior_sd=self.prior_sd,
            description=f"distance of {self.name} from its place along {self.along}{end}",
        )  # fmt: skip

    def matters(self, model: StructuralModel | ReducedModel) -> bool:
        """Whether a distance of one standard deviation changes the motion by more than rounding."""
        change = self.parameter.si_factor * self.prior_sd * np.abs(self.other(model)).max()
        return bool(change > _ROUNDING * np.abs(model.sensor_rows([self.sensor])).max())

    def changed(self, measured: MeasuredFRFs) -> tuple[tuple[Sensor, ...], tuple[Sensor, ...]]:
        """All transducers: a response and a reference of one name sit at one place."""
        return measured.responses, measured.references

    def other(self, model: StructuralModel | ReducedModel) -> np.ndarray:
        """Change of the motion at the sensor over its distance, (n_dof,), in 1/m; zero where its place has no effect.

        A secant from one standard deviation on one side to one on the other, since motions are interpolated in pieces.
        Where the model ends on one side, it starts at the stated place; InputError where it ends on both. Of a model
        that finds nodes only, the gradient between the nodes before and after it along the mesh.
        """
        whole = model.whole
        if at_nodes(whole.locator):
            return self._between_nodes(model, whole.mesh)
        reach = self.parameter.si_factor * self.prior_sd
        try:
            up, down = model.sensor_rows([self._moved(reach), self._moved(-reach)])
            return np.asarray((up - down) / (2 * reach))
        except InputError:
            (here,) = model.sensor_rows([self.sensor])
        try:
            return np.asarray((model.sensor_rows([self._moved(reach)])[0] - here) / reach)
        except InputError:
            return np.asarray((here - model.sensor_rows([self._moved(-reach)])[0]) / reach)

    def _between_nodes(self, model: StructuralModel | ReducedModel, mesh: Mesh) -> np.ndarray:
        (here,) = model.sensor_rows([self.sensor])
        assert self.sensor.point is not None
        found = along_mesh(mesh, self.sensor.point) if mesh.placed.all() else []
        for _, before, after in (way for way in found if way[0][0] == self.along):
            ends = [replace(self.sensor, point=(float(p[0]), float(p[1]), float(p[2]))) for p in (before, after)]
            first, last = model.sensor_rows(ends)
            return np.asarray((last - first) / (after - before)[DIRECTIONS.index(self.along)])
        return np.zeros_like(here)

    def _moved(self, distance: float) -> Sensor:
        """The sensor at a distance along the axis, m."""
        point = np.array(self.sensor.point, dtype=float)
        point[DIRECTIONS.index(self.along)] += distance
        x, y, z = point.tolist()
        return replace(self.sensor, point=(x, y, z))


def place_nuisances(
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

    Examples
    --------
    A beam turns about its own axis: below or above it a vertical sensor reads the same.

    >>> import numpy as np
    >>> import calib
    >>> from calib.measurement.frf import MeasuredFRFs
    >>> from models.railway import bogie_on_rig
    >>> own = (calib.Sensor(1, "y", (-1.3, 0.62, 1.05), "frame"),)
    >>> frfs = MeasuredFRFs(np.array([8.0, 9.0]), own, own, "accelerance", np.ones((2, 1, 1)) + 0j, np.ones((2, 1, 1)))
    >>> [error.parameter.name for error in calib.place_nuisances(frfs, 3.0, bogie_on_rig())]
    ['place_x_1y', 'place_z_1y']
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
