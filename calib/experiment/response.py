"""ResponseTest: measured scalar responses, and how they are compared with a model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.correlation.modal.responses import response_problem
from calib.correlation.response.problem import FunctionProblem, Targets, assumed_responses
from calib.correlation.response.residual import ResponseResidual, response_std
from calib.errors.arguments import by_name, integer, number
from calib.errors.errors import InputError
from calib.experiment.held_out import HeldOutGroups, held_out_responses
from calib.experiment.test import UNNAMED, Claimed, Model, Test, TestError, require_named, test_place
from calib.measurement.responses import MeasuredResponses
from calib.structure.model import Assumption

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class ResponseTest(Test):
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
    stated_repeats : int, optional
        Repeats behind the standard deviations, where the responses do not show them.

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
    stated_repeats: int | None = None

    words = "scalar responses"
    can_hold_out = ("responses",)

    def __post_init__(self) -> None:
        place, known = require_named(self), self.measured.targets
        if self.stated_repeats is not None:
            object.__setattr__(self, "stated_repeats", integer(self.stated_repeats, 1, f"{place}, stated_repeats"))
        for k, name in enumerate(self.held_out):
            if name not in known:
                raise TestError.at_keys(
                    f"held-out response {name!r} was not measured", f"the measured responses are {', '.join(known)}",
                    place, "held_out", "responses", k,
                )  # fmt: skip
        if not self.used:
            words = "every measured response is held out"
            raise TestError.at_keys(words, "leave some to fit", place, "held_out", "responses")

    @cached_property
    def measured(self) -> MeasuredResponses:
        """All measured responses, with few repeats pooled and the claimed accuracy added."""
        place, given = test_place(self), self.responses
        if not isinstance(given, MeasuredResponses):
            read = by_name(given, f"{place}, responses")
            given = MeasuredResponses({n: _value(v, f"{place}, response {n}") for n, v in read.items()}, {})
        try:
            return given.prepared(self.accuracy)
        except InputError as fault:
            keys = ("measurement", "accuracy")
            raise TestError.at_keys(fault.problem, fault.remedy or "", f"{place}, accuracy", *keys) from None
        except (TypeError, ValueError) as fault:
            raise InputError(str(fault), place=f"{place}, accuracy") from None

    @cached_property
    def used(self) -> Targets:
        """The scalar responses in use, each a value with its standard deviation or None."""
        return {n: t for n, t in self.measured.targets.items() if n not in self.held_out}

    @property
    def fitted_responses(self) -> Targets:
        """The scalar responses in use."""
        return self.used

    @property
    def repeats(self) -> int | None:
        """Those that the responses show, else those that are stated."""
        counted = self.measured.repeats
        return self.stated_repeats if counted is None else counted

    def problem(self, model: Model, base: Any = None) -> FunctionProblem:
        """The forward problem of a model, without held-out responses."""
        pooled, measured = self.measured.pooled_repeats, self.measured
        repeats = self.stated_repeats if pooled is None else pooled
        return response_problem(model, measured, self.used, repeats, test_place(self))

    def residual(self, problem: Any) -> ResponseResidual:
        """The whitened residual of a forward problem over such data."""
        return ResponseResidual(problem)

    def whole_responses(self, problem: FunctionProblem) -> FunctionProblem | None:
        """See `Test`."""
        return replace(problem, targets=self.measured.targets) if self.held_out else None

    @property
    def unseen(self) -> HeldOutGroups:
        """Held-out responses, by their group."""
        return held_out_responses(self.measured.targets, self.held_out)

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is stated."""
        return assumed_responses(self.used)

    def table(self) -> pd.DataFrame:
        """``response, held_out, value, std, repeats, std_used``."""
        import pandas as pd

        whole = self.measured
        rows = [
            (name, name in self.held_out, value, np.nan if std is None else std, whole.counts.get(name, np.nan), used)
            for (name, (value, std)), used in zip(whole.targets.items(), response_std(whole.targets), strict=True)
        ]
        return pd.DataFrame(rows, columns=["response", "held_out", "value", "std", "repeats", "std_used"])


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
