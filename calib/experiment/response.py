"""ResponseTest: measured scalar responses, and how they are compared with a model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from calib.correlation.modal.responses import response_problem
from calib.correlation.response.problem import FunctionProblem, assumed_responses
from calib.correlation.response.residual import ResponseResidual
from calib.errors.arguments import by_name, number
from calib.errors.errors import InputError
from calib.experiment import Unseen, unseen_responses
from calib.experiment.checked import UNNAMED, Claimed, Model, named, place_of
from calib.experiment.test import BaseTest
from calib.hypotheses.function_perturbations import model_hypotheses
from calib.hypotheses.scalar import ScalarAdapter
from calib.measurement.disagreements import Disagreement
from calib.measurement.responses import MeasuredResponses, response_kinds
from calib.missing.facts import MeasurementFacts
from calib.problem.effect import Effect
from calib.structure.effects.perturbations import Perturbation
from calib.structure.model import Assumption


@dataclass(frozen=True, eq=False)
class ResponseTest(BaseTest):
    """Measured scalar responses, compared with those of a `calib.FunctionModel` or with numbers of modes.

    A model with modes has the responses ``freq_1``, ``freq_2``, ... (natural frequencies in ascending order, Hz) and
    ``damping_1``, ... (damping ratios): the frequencies of a data sheet, say. With shapes a `ModalTest` pairs better.

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

    A model of matrices fitted to two frequencies; those of the model are sqrt(k/m) times 0.618 and 1.618:

    >>> import numpy as np
    >>> model = calib.StructuralModel.from_matrices(
    ...     stiffness={"k": np.array([[2.0, -1.0], [-1.0, 1.0]])}, mass=np.diag([10.0, 10.0]),
    ...     dofs=[(1, "x"), (2, "x")], parameters=[calib.Parameter("k", 30.0, 10.0, 90.0, "kN/m")],
    ... )
    >>> sheet = calib.ResponseTest({"freq_1": (6.22, 0.01), "freq_2": (16.29, 0.02)})
    >>> round(calib.Problem(model, sheet).calibrate().values["k"], 1)
    40.0
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
        measured = self.measured
        used = {n: t for n, t in measured.targets.items() if n not in self.held_out}
        return response_problem(model, measured, used, measured.pooled_repeats, place_of(self))

    def pair(self, model: Model) -> ResponseResidual:
        """The whitened residual of a model, without held-out responses."""
        return ResponseResidual(self.problem(model))

    @property
    def unseen(self) -> Unseen:
        """Held-out responses, by their group."""
        return unseen_responses(self.measured.targets, self.held_out)

    def adapter(
        self,
        model: Model,
        effects: tuple[Effect, ...],
        local: tuple[Perturbation, ...],
        facts: MeasurementFacts,
        name: str,
    ) -> ScalarAdapter:
        """See `BaseTest`."""
        space = model.space.without(self.condition)
        found, own = model_hypotheses(model, self.pair(model), effects, local, space, name)
        return ScalarAdapter(found, own, facts, self.unseen)

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
