"""Test: the measured modes or responses of a structure under one condition."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import pandas as pd

from calib.analyses.fit_statistics import FitStatistics
from calib.analyses.verify import errors_of
from calib.correlation.function_problem import FunctionProblem
from calib.correlation.problem import ModalProblem, usual_mode_count
from calib.correlation.residual import ModalResidual
from calib.correlation.response_residual import ResponseResidual
from calib.correlation.responses import assumed_responses
from calib.correlation.standard_deviations import assumptions
from calib.errors import InputError
from calib.forward import Unseen, unseen_responses
from calib.front.checked import UNNAMED, Claimed, band, named, place_of
from calib.front.frf_test import FRFTest
from calib.function import FunctionModel
from calib.given import by_name, integer, names, number, objects
from calib.measurement.accuracy import Accuracy
from calib.measurement.disagreements import Disagreement
from calib.measurement.modal import MeasuredModes
from calib.measurement.responses import MeasuredResponses, read_responses, response_kinds
from calib.space import ParameterSpace
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import Assumption, StructuralModel
from calib.study import Study

Model = StructuralModel | ModalFunctionModel | FunctionModel


@dataclass(frozen=True, eq=False)
class ModalTest:
    """Measured modes, and how they are compared with a model.

    Attributes
    ----------
    modes : MeasuredModes
        From `calib.read_modes`, for example.
    held_out : sequence of str
        Modes and sensors (like ``12y``) that no fit uses; they verify it.
    name : str
        Identifies the test where several are fitted together.
    condition : mapping from str to float
        Parameter values of this test only, each in its own unit.
    accuracy : str or mapping, optional
        Claimed accuracy beside the repeatability, such as ``"1 %"`` or ``{"freq": "0.5 %"}``.
    clusters : mapping from mode to cluster names
        Parts of the model whose strain energy carries a mode; see `calib.correlation.problem.ModalProblem`.
    mode_count : int, optional
        Model modes that are solved; twice as many as measured by default.
    freq_window : (float, float), optional
        Hz; model modes outside are never paired.
    threshold : float
        Least EMAC of a pair.
    override : mapping from mode to int
        Model modes, from 1, that are paired whatever their EMAC.

    Examples
    --------
    Two frequencies of a string under tension; the second one verifies the fit:

    >>> import numpy as np
    >>> import calib
    >>> freq, unknown, no_shapes = np.array([50.0, 100.0]), np.full(2, np.nan), np.zeros((0, 2))
    >>> modes = calib.MeasuredModes(
    ...     ("1", "2"), freq, freq, 0.002 * freq, unknown, unknown, sensors=(), shapes=no_shapes, shape_std=no_shapes,
    ... )
    >>> test = calib.ModalTest(modes, held_out=("2",))
    >>> test.used.names
    ('1',)
    >>> space = calib.ParameterSpace((calib.Parameter("line", 0.02, 0.005, 0.05, "kg/m"),))
    >>> def string(v):
    ...     return {"natural_freq": np.array([1, 2]) * np.sqrt(100.0 / v["line"]) / 2, "shapes": np.array([[0.7, 1.0]])}
    >>> model = calib.ModalFunctionModel("string", space, string, sensors=["1z"], n_modes=2)
    >>> round(calib.Problem(model, test).calibrate().values["line"], 4)
    0.01
    """

    modes: MeasuredModes
    held_out: tuple[str, ...] = ()
    name: str = UNNAMED
    condition: Mapping[str, float] = field(default_factory=dict)
    accuracy: Claimed = None
    clusters: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mode_count: int | None = None
    freq_window: tuple[float, float] | None = None
    threshold: float = 0.3
    override: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        place = named(self)
        (modes,) = objects([self.modes], MeasuredModes, f"{place}, modes")
        known = (*modes.names, *(s.name for s in modes.sensors))
        for name in self.held_out:
            if name not in known:
                raise InputError(
                    f"held-out mode or sensor {name!r} was not measured", place=place,
                    remedy=f"the measured ones are {', '.join(known)}",
                )  # fmt: skip
        object.__setattr__(
            self, "clusters", {m: names(c, f"{place}, clusters") for m, c in by_name(self.clusters, place).items()}
        )
        chosen = by_name(self.override, f"{place}, override")
        object.__setattr__(self, "override", {m: integer(k, 1, f"{place}, override of {m}") for m, k in chosen.items()})
        number(self.threshold, f"{place}, threshold")
        if self.mode_count is not None:
            object.__setattr__(self, "mode_count", integer(self.mode_count, 1, f"{place}, mode_count"))
        if self.freq_window is not None:
            object.__setattr__(self, "freq_window", band(self.freq_window, f"{place}, freq_window"))
        try:
            claimed = self.modes.accuracy if self.accuracy is None else Accuracy.of(self.accuracy)
        except (TypeError, ValueError) as fault:
            raise InputError(str(fault), place=f"{place}, accuracy") from None
        object.__setattr__(self, "modes", replace(self.modes, accuracy=claimed))

    @property
    def synthetic(self) -> bool:
        """Whether the measurement is marked as synthetic."""
        return self.modes.synthetic

    @cached_property
    def used(self) -> MeasuredModes:
        """The modes in use, without held-out data."""
        modes = [name for name in self.held_out if name in self.modes.names]
        return self.modes.without(modes, [name for name in self.held_out if name not in modes])

    def problem(self, model: Model) -> ModalProblem:
        """The forward problem of a model, without held-out data."""
        if isinstance(model, FunctionModel):
            raise InputError(
                f"the model {model.name} has no modes",
                place=place_of(self),
                remedy="give a ResponseTest, or a ModalFunctionModel",
            )
        used = self.used
        count = self.mode_count if self.mode_count is not None else usual_mode_count(used, model.n_modes)
        held_out = set(self.held_out) - set(used.names)
        return ModalProblem(
            model=model,
            measured=used,
            mode_clusters={m: c for m, c in self.clusters.items() if m not in held_out},
            mode_count=count,
            threshold=self.threshold,
            freq_window=self.freq_window,
            override={m: k for m, k in self.override.items() if m not in held_out},
        )

    @property
    def beside(self) -> ModalTest:
        """The test as one of several: it has no parameters of its own that would bear its name."""
        return self

    def space(self, model: Model) -> ParameterSpace:
        """Parameters of a model; the test has none of its own."""
        return model.space

    def pair(self, model: Model) -> ModalResidual:
        """The whitened residual of a model, without held-out data."""
        return ModalResidual(self.problem(model))

    def whole_problem(self, model: Model) -> ModalProblem | None:
        """The forward problem with held-out data, for verification; None where nothing is held out."""
        if not self.held_out:
            return None
        return self.problem(model).over(self.modes, self.clusters, self.override, self.mode_count)

    def errors(self, model: Model, values: Mapping[str, float], fit: FitStatistics) -> pd.DataFrame:
        """Errors on fitted, left-one-out and held-out data; see `calib.analyses.verify.errors_of`."""
        return errors_of(
            self.problem(model),
            self.whole_problem(model),
            {},
            model.space,
            values,
            joint=fit.parts.get(self.name),
            active=fit.active,
        )

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Values in which one repeat disagrees with the others."""
        return self.modes.disagreements

    @property
    def claimed(self) -> str:
        """The claimed accuracy, in words; empty without."""
        return self.modes.claimed

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is stated."""
        return assumptions(self.used)


@dataclass(frozen=True, eq=False)
class ResponseTest:
    """Measured scalar responses, compared with those of a `calib.FunctionModel`.

    Attributes
    ----------
    responses : mapping from str to float or (float, float or None), or MeasuredResponses
        Each in its own unit: a value, or a value with the standard deviation of its mean; see `calib.read_responses`.
    held_out : sequence of str
        Responses that no fit uses; they verify it.
    name, condition
        As in `ModalTest`.
    accuracy : str or mapping, optional
        Claimed accuracy: a share of every value, or by response or kind.

    Examples
    --------
    >>> import calib
    >>> measured = {"mass": (12.4, 0.1), "f1": 5.03, "f2": 31.5}
    >>> test = calib.ResponseTest(measured, held_out=["f2"], accuracy={"f1": "1 %"})
    >>> test.claimed
    '1 % of f1'
    >>> round(test.measured.targets["f1"][1], 4)  # its standard deviation
    0.0503
    """

    responses: Mapping[str, float | tuple[float, float | None]] | MeasuredResponses
    held_out: tuple[str, ...] = ()
    name: str = UNNAMED
    condition: Mapping[str, float] = field(default_factory=dict)
    accuracy: Claimed = None

    def __post_init__(self) -> None:
        place, known = named(self), self.measured.targets
        for name in self.held_out:
            if name not in known:
                raise InputError(
                    f"held-out response {name!r} was not measured", place=place,
                    remedy=f"the measured ones are {', '.join(known)}",
                )  # fmt: skip

    @property
    def synthetic(self) -> bool:
        """False: scalar responses carry no such mark."""
        return False

    @cached_property
    def measured(self) -> MeasuredResponses:
        """All measured responses, with few repeats pooled and the claimed accuracy added."""
        place, given = place_of(self), self.responses
        if not isinstance(given, MeasuredResponses):
            read = by_name(given, f"{place}, responses")
            given = MeasuredResponses({n: _value(v, f"{place}, response {n}") for n, v in read.items()}, {})
        kinds = response_kinds(given.targets)
        try:
            return given.pooled(kinds).claiming(kinds, self.accuracy)
        except InputError as fault:
            raise InputError(fault.problem, place=f"{place}, accuracy", remedy=fault.remedy) from None
        except (TypeError, ValueError) as fault:
            raise InputError(str(fault), place=f"{place}, accuracy") from None

    def problem(self, model: Model) -> FunctionProblem:
        """The forward problem of a model, without held-out responses."""
        if not isinstance(model, FunctionModel):
            raise InputError(f"the model {model.name} returns modes", place=place_of(self), remedy="give a ModalTest")
        measured = self.measured
        used = {n: t for n, t in measured.targets.items() if n not in self.held_out}
        return FunctionProblem(
            model.space, model.function, used, model.fingerprint, measured.pooled_repeats, measured.shares
        )

    @property
    def beside(self) -> ResponseTest:
        """The test as one of several: it has no parameters of its own that would bear its name."""
        return self

    def space(self, model: Model) -> ParameterSpace:
        """Parameters of a model; the test has none of its own."""
        return model.space

    def pair(self, model: Model) -> ResponseResidual:
        """The whitened residual of a model, without held-out responses."""
        return ResponseResidual(self.problem(model))

    @property
    def unseen(self) -> Unseen:
        """Held-out responses, by their group."""
        return unseen_responses(self.measured.targets, self.held_out)

    def errors(self, model: Model, values: Mapping[str, float], fit: FitStatistics) -> pd.DataFrame:
        """Errors on fitted, left-one-out and held-out data; see `calib.analyses.verify.errors_of`."""
        return errors_of(
            self.problem(model),
            None,
            self.unseen,
            model.space,
            values,
            joint=fit.parts.get(self.name),
            active=fit.active,
        )

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Values in which one repeat disagrees with the others."""
        return self.measured.disagreements

    @property
    def claimed(self) -> str:
        """The claimed accuracy, in words; empty without."""
        return self.measured.claimed

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is stated."""
        return assumed_responses({n: t for n, t in self.measured.targets.items() if n not in self.held_out})


TESTS = (ModalTest, ResponseTest, FRFTest)
Test = ModalTest | ResponseTest | FRFTest


def test_of(study: Study) -> Test:
    """The only test of a study."""
    given, name, condition = study.settings, study.test or "test", study.condition
    if study.frfs is not None:
        held = given.held_out
        return FRFTest(study.frfs, held.sensors, held.references, held.bands, study.nuisances, name, condition)
    if study.whole is not None:
        pairing = given.pairing
        return ModalTest(
            study.whole,
            held_out=(*given.held_out.modes, *given.held_out.sensors),
            name=name,
            condition=condition,
            clusters=pairing.clusters,
            mode_count=pairing.mode_count,
            freq_window=pairing.freq_window,
            threshold=pairing.threshold,
            override=pairing.override,
        )
    data = given.measurement
    read = read_responses(study.folder / str(data.responses), data.pooling)
    return ResponseTest(read, given.held_out.responses, name, condition, data.accuracy)


def model_of(study: Study) -> Model:
    """The model of a study's only test with the selected parameters free; those of nuisances belong to the test."""
    space = study.search_space
    own = {name: value for name, value in space.values.items() if name not in study.model.space}
    return replace(study.model, space=space.without(own))


def under(model: Model, test: str, condition: Mapping[str, float]) -> Model:
    """A model with the parameters of a test's condition fixed; InputError for one that it lacks."""
    try:
        return replace(model, space=model.space.freeze(condition))
    except InputError as fault:
        raise InputError(fault.problem, place=f"condition of test {test}", remedy=fault.remedy) from None


def _value(given: object, place: str) -> tuple[float, float | None]:
    """A measured value and the standard deviation of its mean, None where it is unknown."""
    pair = tuple(given) if isinstance(given, tuple | list) else (given, None)
    if len(pair) != 2:
        raise InputError(f"it has {len(pair)} entries", place=place, remedy="give a value, or (value, std)")
    value, std = number(pair[0], place), None if pair[1] is None else number(pair[1], f"{place}, std")
    if not math.isfinite(value):
        raise InputError(f"it is {value}", place=place, remedy="give a finite number")
    if std is not None and not 0 < std < math.inf:
        raise InputError(f"its standard deviation is {std}", place=place, remedy="give a positive one or None")
    return value, std
