"""ModalTest: measured modes under one condition, and how they are compared with a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import assumed_deviations, std_for
from calib.errors.arguments import by_name, integer, names, number, objects, values
from calib.errors.errors import EvaluationError, InputError
from calib.experiment.test import UNNAMED, Claimed, Model, Test, TestError, band, require_named, test_place
from calib.measurement.accuracy import Accuracy
from calib.measurement.corrections import corrected
from calib.measurement.modal import MeasuredModes
from calib.structure.function_model import FunctionModel
from calib.structure.model import Assumption, StructuralModel

if TYPE_CHECKING:
    import pandas as pd

MODE_COLUMNS = (
    "mode", "held_out", "natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std", "repeats",
    "freq_std_used", "damping_std_used",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class ModalTest(Test):
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
    set_ups : mapping from str to sequence of str
        Sensors that were scaled together, by the name of their set-up; an explanation suspects the factor of each.
    corrected : mapping from str to float
        Faults that are taken out, as an explanation names them, such as ``{"gain of sensor 12y": -0.1}``.
    node_limit : float, optional
        Largest distance of a measured node from the model node nearest to it, m; see
        `calib.measurement.partners.node_partners`.

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
    set_ups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    corrected: Mapping[str, float] = field(default_factory=dict)
    node_limit: float | None = None

    words = "modes"
    can_hold_out = ("modes", "sensors")
    shows_mesh = True

    def __post_init__(self) -> None:
        place = require_named(self)
        (modes,) = objects([self.modes], MeasuredModes, f"{place}, modes")
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
        groups = by_name(self.set_ups, f"{place}, set_ups")
        object.__setattr__(self, "set_ups", {n: names(s, f"{place}, set_ups") for n, s in groups.items()})
        object.__setattr__(self, "corrected", values(self.corrected, f"{place}, corrected"))
        try:
            claimed = modes.accuracy if self.accuracy is None else Accuracy.of(self.accuracy)
        except (TypeError, ValueError) as fault:
            raise InputError(str(fault), place=f"{place}, accuracy") from None
        try:
            modes = corrected(modes, self.corrected, f"{place}, corrected")
        except InputError as fault:
            keys = ("measurement", "corrected")
            raise TestError.at_keys(fault.problem, fault.remedy or "", f"{place}, corrected", *keys) from None
        object.__setattr__(self, "corrected", {})  # they are out
        object.__setattr__(self, "modes", replace(modes, accuracy=claimed))
        self._require_held_out(place)

    def _require_held_out(self, place: str) -> None:
        """InputError for a held-out mode or sensor that was not measured, and where nothing is left to fit."""
        known = (*self.modes.names, *(s.name for s in self.modes.sensors))
        for k, name in enumerate(self.held_out):
            if name not in known:
                raise TestError.at_keys(
                    f"held-out mode or sensor {name!r} was not measured",
                    f"the measured ones are {', '.join(known)}", place, "held_out", k,
                )  # fmt: skip
        used = self.used
        if not used.n_modes:
            raise TestError.at_keys("every measured mode is held out", "leave some to fit", place, "held_out", "modes")
        if self.modes.has_shapes and not used.has_shapes:
            raise TestError.at_keys(
                "every sensor is held out", "leave some by which modes are paired", place, "held_out", "sensors"
            )

    @property
    def measured(self) -> MeasuredModes:
        """Everything that was measured."""
        return self.modes

    @property
    def measured_modes(self) -> MeasuredModes:
        """All modes, held-out ones included."""
        return self.modes

    @property
    def fitted_modes(self) -> MeasuredModes:
        """The modes in use."""
        return self.used

    @property
    def repeats(self) -> int:
        """Repeats of the measurement."""
        return self.modes.n_repeats

    @property
    def held_out_sensors(self) -> tuple[str, ...]:
        """Sensors that no fit uses."""
        return tuple(name for name in self.held_out if name not in self.modes.names)

    @property
    def held_out_words(self) -> str:
        """Modes and sensors."""
        if not self.held_out:
            return ""
        modes = [name for name in self.held_out if name in self.modes.names]
        return f"modes {', '.join(modes) or 'none'}; sensors {', '.join(self.held_out_sensors) or 'none'}"

    @cached_property
    def used(self) -> MeasuredModes:
        """The modes in use, without held-out data."""
        modes = [name for name in self.held_out if name in self.modes.names]
        return self.modes.without(modes, self.held_out_sensors)

    def problem(self, model: Model, base: Model | None = None) -> ModalProblem:
        """The forward problem of a model, without held-out data; effects that add degrees of freedom add modes.

        As many more modes are solved as the model has more than ``base``, the model before effects were added.
        """
        if isinstance(model, FunctionModel):
            raise TestError.at_keys(
                f"the model {model.name} has no modes", "give a ResponseTest, or a ModalFunctionModel",
                test_place(self), "measurement",
            )  # fmt: skip
        used, n_base = self.used, _n_modes(model if base is None else base)
        count = self.mode_count
        if count is None:
            count = _vibration_modes(model if base is None else base, 2 * used.n_modes)
            if count < used.n_modes:
                raise TestError.at_keys(
                    f"the model {model.name} has {count} vibration modes, but {used.n_modes} modes were measured",
                    "leave out measured modes that it cannot have, or give it more degrees of freedom",
                    test_place(self),
                )  # fmt: skip
        if count < used.n_modes:
            raise TestError.at_keys(
                f"mode_count is {count}, but {used.n_modes} modes were measured",
                "solve at least as many, better a few more", test_place(self), "pairing", "mode_count",
            )  # fmt: skip
        for key, mode in self._unmeasured():
            raise TestError.at_keys(
                f"mode {mode!r} was not measured", f"the measured modes are {', '.join(used.names)}", test_place(self),
                "pairing", key, mode, mark="key",
            )  # fmt: skip
        held_out = set(self.held_out) & set(self.modes.names)
        return ModalProblem(
            model=self.on_nodes(model, used.sensors),
            measured=used,
            mode_clusters={m: c for m, c in self.clusters.items() if m not in held_out},
            mode_count=count + model.n_modes - n_base,
            threshold=self.threshold,
            freq_window=self.freq_window,
            override={m: k for m, k in self.override.items() if m not in held_out},
        )

    def _unmeasured(self) -> Iterator[tuple[str, str]]:
        """Modes that clusters or override name though they were not measured, with the field."""
        named = {mode: key for key in ("override", "clusters") for mode in getattr(self, key)}
        yield from ((named[mode], mode) for mode in sorted(named.keys() - set(self.modes.names)))

    def residual(self, problem: Any) -> ModalResidual:
        """The whitened residual of a forward problem over such data."""
        return ModalResidual(problem)

    def whole_problem(self, problem: Any) -> ModalProblem | None:
        """See `Test`."""
        if not self.held_out:
            return None
        whole: ModalProblem = problem.over(self.modes, self.clusters, self.override, self.mode_count)
        return whole

    @property
    def sensed(self) -> tuple[MeasuredModes]:
        """The data in use, whose sensors are places of local perturbations."""
        return (self.used,)

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is stated."""
        return assumed_deviations(self.used)

    def table(self) -> pd.DataFrame:
        """`MODE_COLUMNS`: frequencies in Hz, damping as a ratio, and the number of repeats of the frequency."""
        import pandas as pd

        whole = self.modes
        freq_std, damping_std = self._std_used()
        columns = {
            "mode": list(whole.names),
            "held_out": [name in self.held_out for name in whole.names],
            **{name: getattr(whole, name) for name in MODE_COLUMNS[2:-3]},
            "repeats": whole.counts("freq"),
            "freq_std_used": freq_std * whole.natural_freq,
            "damping_std_used": damping_std * whole.damping_ratio,
        }
        return pd.DataFrame(columns, columns=list(MODE_COLUMNS))

    def _std_used(self) -> tuple[np.ndarray, np.ndarray]:
        """Relative standard deviations of frequency and damping, (n_modes,): of the fit, or of the held-out check."""
        every, used = std_for(self.modes), self.used
        freq, damping = every.freq.copy(), every.damping.copy()
        fitted, rows = std_for(used), [self.modes.names.index(name) for name in used.names]
        freq[rows], damping[rows] = fitted.freq, fitted.damping
        return freq, damping


def _vibration_modes(model: Model, wanted: int) -> int:
    """The number wanted, or that which the model has at its nominal values: it may be free, or have few at all."""
    count = min(wanted, _n_modes(model))
    if not isinstance(model, StructuralModel) or model.n_dof > _MANY * wanted:
        return count
    try:
        return min(count, model.modes(model.space.values, count).n_modes)
    except EvaluationError:
        return count


_MANY = 4
"""A model with so many times the modes wanted has them, whatever its rigid-body modes."""


def _n_modes(model: Any) -> int:
    """Modes of a model with modes."""
    count: int = model.n_modes
    return count
