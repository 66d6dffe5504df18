"""Test: what was measured of a structure under one condition, here its modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from calib.correlation.modal.fault_library import modal_faults
from calib.correlation.modal.problem import ModalProblem, usual_mode_count
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import assumed_deviations
from calib.errors.arguments import by_name, integer, names, number, objects
from calib.errors.errors import InputError
from calib.experiment.checked import UNNAMED, Claimed, Model, band, named, place_of
from calib.experiment.frf import FRFTest
from calib.experiment.response import ResponseTest
from calib.experiment.test import BaseTest
from calib.hypotheses.function_perturbations import model_hypotheses
from calib.hypotheses.modal import ModalAdapter
from calib.hypotheses.of_test import basis_for
from calib.measurement.accuracy import Accuracy
from calib.measurement.disagreements import Disagreement
from calib.measurement.modal import MeasuredModes
from calib.measurement.responses import read_responses
from calib.missing.facts import MeasurementFacts
from calib.problem.effect import Effect
from calib.structure.effects.perturbations import Perturbation
from calib.structure.function_model import FunctionModel
from calib.structure.model import Assumption
from calib.study.study import Study


@dataclass(frozen=True, eq=False)
class ModalTest(BaseTest):
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
        Parts of the model whose strain energy carries a mode; see `calib.correlation.modal.problem.ModalProblem`.
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

    def pair(self, model: Model) -> ModalResidual:
        """The whitened residual of a model, without held-out data."""
        return ModalResidual(self.problem(model))

    def whole_problem(self, model: Model) -> ModalProblem | None:
        """The forward problem with held-out data, for verification; None where nothing is held out."""
        if not self.held_out:
            return None
        return self.problem(model).over(self.modes, self.clusters, self.override, self.mode_count)

    @property
    def sensed(self) -> tuple[MeasuredModes]:
        """The data in use, whose sensors are places of local perturbations."""
        return (self.used,)

    def adapter(
        self,
        model: Model,
        effects: tuple[Effect, ...],
        local: tuple[Perturbation, ...],
        facts: MeasurementFacts,
        name: str,
    ) -> ModalAdapter:
        """See `BaseTest`."""
        pair = self.pair(model)
        pair = replace(pair, faults=modal_faults(pair.problem.model, pair.problem.measured, test=name))
        basis, large = basis_for(model, pair.problem, effects, local, facts.seed)
        found, own = model_hypotheses(model, pair, effects, local, model.space.without(self.condition), name, basis)
        return ModalAdapter(found, own, facts, self.whole_problem(model), reduced=large)

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
        return assumed_deviations(self.used)


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
        return replace(model, space=model.space.held(condition))
    except InputError as fault:
        raise InputError(fault.problem, place=f"condition of test {test}", remedy=fault.remedy) from None
