"""What tests of every kind have in common: a name, a condition, data in use and data held out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem, Targets
from calib.correlation.response.residual import ResponseResidual
from calib.errors.arguments import names, number, values
from calib.errors.errors import InputError
from calib.experiment.held_out import HeldOutGroups
from calib.measurement.disagreements import Disagreement
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.partners import require_limit
from calib.problem.space import ParameterSpace
from calib.results.in_short import Short, names_in_line
from calib.structure.function_model import FunctionModel
from calib.structure.located import sensor_partners
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import Assumption, StructuralModel

if TYPE_CHECKING:
    import pandas as pd

Model = StructuralModel | ModalFunctionModel | FunctionModel
ForwardProblem = ModalProblem | FunctionProblem | FRFProblem
Residual = ModalResidual | ResponseResidual | FRFResidual

UNNAMED = "test"
"""Name of a test that was given none."""
Claimed = str | float | Mapping[str, str | float] | None


class TestError(InputError):
    """Something wrong in a test, with the keys under which a study's file has it.

    Attributes
    ----------
    keys : tuple of str or int
        Such as ``("pairing", "mode_count")``; empty where no single entry is wrong.
    mark : {"value", "key"}
        Whether the value is wrong or the key itself.
    """

    __test__ = False  # no test of pytest's
    keys: tuple[str | int, ...] = ()
    mark: Any = "value"

    @classmethod
    def at_keys(cls, problem: str, remedy: str, place: str, *keys: str | int, mark: str = "value") -> TestError:
        """An error with its keys; ``place`` is how the test is named where there is no file."""
        out = cls(problem, place=place, remedy=remedy)
        out.keys, out.mark = keys, mark
        return out


class Test(Short, ABC):
    """A test under one condition; subclasses say what was measured, and how a model is compared with it.

    Analyses in memory take any subclass. Data that are neither modes nor FRFs are compared value by value; they then
    ask the following of what `problem` and `residual` return.

    - The problem: ``space``, ``fingerprint``, ``targets`` (value and standard deviation by name), ``evaluate``
      (responses by the same names), ``with_model``, ``search_targets``, ``sensitivity_responses``, ``relative_std``,
      ``std_dof``, ``assumed_std``; ``reducible``, ``user_function`` and ``numbers_function`` may be None. See
      `calib.correlation.response.problem.FunctionProblem`.
    - The residual: what `calib.problem.problem.Pair` lists, ``within``, ``with_model``, ``unpaired``, ``faults``,
      ``measured_values`` and ``std``. See `calib.correlation.response.residual.ResponseResidual`.
    """

    __test__ = False  # no test of pytest's
    name: str
    condition: Mapping[str, float]
    held_out: tuple[str, ...]
    node_limit: float | None = None

    words: ClassVar[str]
    """The kind in words."""
    can_hold_out: ClassVar[tuple[str, ...]]
    """Kinds of data that it can hold out, as a study's file names them."""
    many_minima: ClassVar[bool] = False
    """Whether the sum of squares over its data typically has many minima, so that a rejected fit starts further."""
    shows_mesh: ClassVar[bool] = False
    """Whether its data show the error of a mesh, so that a finer one may be given."""

    def __str__(self) -> str:
        """Name, condition and what is kept back, above the data."""
        held = [str(one) for name in vars(self) if name.startswith("held_out") for one in getattr(self, name)]
        lines = [f"{self.name}:" if self.name else "a test:"]
        lines += [f"condition: {', '.join(f'{n} = {v:g}' for n, v in self.condition.items())}"] * bool(self.condition)
        lines += [f"validation data: {names_in_line(held)}"] * bool(held)
        return "\n".join([*lines, str(self.measured)])

    @property
    @abstractmethod
    def measured(self) -> Any:
        """Everything that was measured, held-out data included."""

    @property
    @abstractmethod
    def used(self) -> Any:
        """The data in use, without held-out ones."""

    @abstractmethod
    def problem(self, model: Any, base: Any = None) -> Any:
        """The forward problem of a model, without held-out data.

        ``base`` is the model before effects were added to it; by default the model itself.
        """

    @abstractmethod
    def residual(self, problem: Any) -> Residual:
        """The whitened residual of a forward problem over such data."""

    def located(self, model: Any) -> Any:
        """A model on which sensors may lie as far off as the test states; itself where it states nothing."""
        if self.node_limit is None or not isinstance(model, StructuralModel | ModalFunctionModel):
            return model
        return replace(model, sensor_tolerance=self.node_limit)

    def on_nodes(self, model: Any, sensors: Iterable[Sensor]) -> Any:
        """The model as `located`; InputError where the nodes of sensors have no partners on it."""
        found = self.located(model)
        partners = sensor_partners(found, sensors)
        if partners is not None and partners.unit:  # what lies off the model is told sensor by sensor
            partners.require(found.name)
        return found

    def pair(self, model: Any) -> Any:
        """The whitened residual of a model, without held-out data."""
        return self.residual(self.problem(model))

    def whole_problem(self, problem: Any) -> ModalProblem | None:
        """The forward problem with held-out modes and sensors too, for verification; None where none are held out.

        See `calib.correlation.modal.problem.ModalProblem.over`.

        Raises
        ------
        InputError
            When a held-out sensor has no place on the model, or a held-out mode an impossible pair.
        """
        return None

    def whole_responses(self, problem: FunctionProblem) -> FunctionProblem | None:
        """The forward problem with held-out scalar responses too, for verification; None where none are held out."""
        return None

    @property
    def measured_modes(self) -> MeasuredModes | None:
        """All modes; None for data of other kinds."""
        return None

    @property
    def fitted_modes(self) -> MeasuredModes | None:
        """Modes in use; None for data of other kinds."""
        return None

    @property
    def measured_frfs(self) -> MeasuredFRFs | None:
        """All FRFs; None for data of other kinds."""
        return None

    @property
    def fitted_responses(self) -> Targets:
        """Scalar responses in use; empty for data of other kinds."""
        return {}

    @property
    def unseen(self) -> HeldOutGroups:
        """Held-out scalar responses or FRFs by group; empty for modes. For verification only."""
        return {}

    @property
    def sensed(self) -> tuple[Any, ...]:
        """The data in use whose sensors are places of local perturbations; empty for data without sensors."""
        return ()

    @property
    def held_out_sensors(self) -> tuple[str, ...]:
        """Sensors that no fit uses."""
        return ()

    @property
    def held_out_words(self) -> str:
        """What no fit uses, in words; empty where nothing is held out."""
        return ", ".join(self.held_out)

    @property
    def beside(self) -> Self:
        """The test as one of several; parameters of its own, where it has some, then bear its name."""
        return self

    def space(self, model: Any) -> ParameterSpace:
        """Parameters of a model, and those of the test itself where it has some."""
        space: ParameterSpace = self.problem(model).space
        return space

    @property
    @abstractmethod
    def repeats(self) -> int | None:
        """Repeats behind the measured values; None where they are not stated."""

    @property
    def synthetic(self) -> bool:
        """Whether the measurement is marked as synthetic; scalar responses carry no such mark."""
        return bool(getattr(self.measured, "synthetic", False))

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Values in which one repeat disagrees with the others."""
        found: tuple[Disagreement, ...] = self.measured.disagreements
        return found

    @property
    def claimed(self) -> str:
        """The claimed accuracy, in words; empty without."""
        words: str = self.measured.claimed
        return words

    @property
    def notes(self) -> tuple[str, ...]:
        """How the measurement was read."""
        found: tuple[str, ...] = self.measured.notes
        return found

    @property
    @abstractmethod
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is stated."""

    @abstractmethod
    def table(self) -> pd.DataFrame:
        """All data with their standard deviations, held-out data included and marked."""


def require_named(test: Any) -> str:
    """Check the fields that all kinds of test share; returns the test as errors name it."""
    if not isinstance(test.name, str) or not test.name:
        raise InputError(f"its name is {test.name!r}", place="test", remedy='give one, such as name="loaded"')
    place = test_place(test)
    object.__setattr__(test, "held_out", names(test.held_out, f"{place}, held_out"))
    object.__setattr__(test, "condition", values(test.condition, f"{place}, condition"))
    if test.node_limit is not None:
        object.__setattr__(test, "node_limit", number(test.node_limit, f"{place}, node_limit"))
        require_limit(test.node_limit)
    return place


def test_place(test: Any) -> str:
    """The test as an error names it; one that was given no name is "the test"."""
    return f"test {test.name}" if test.name != UNNAMED else "the test"


def band(entry: object, place: str) -> tuple[float, float]:
    """Two frequencies, Hz."""
    ends = tuple(number(f, place) for f in entry) if isinstance(entry, Sequence | np.ndarray) else ()
    if isinstance(entry, str) or len(ends) != 2:
        raise InputError(f"it is {entry!r:.40}", place=place, remedy="give (low, high) in Hz")
    return ends[0], ends[1]
