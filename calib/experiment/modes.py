"""Measured modes of a study, and the problem of a model with modes against them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from calib.correlation.modal.problem import ModalProblem, usual_mode_count
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import std_for
from calib.errors.errors import InputError
from calib.experiment.tested import Tested
from calib.measurement.modal import MeasuredModes
from calib.structure.modal_model import ModalModel
from calib.study.misfit import misfit

MODE_COLUMNS = (
    "mode", "held_out", "natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std", "repeats",
    "freq_std_used", "damping_std_used",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class TestedModes(Tested):
    """Measured modes of a study.

    Attributes
    ----------
    given : MeasuredModes
    """

    given: MeasuredModes

    words = "modes"
    can_hold_out = ("modes", "sensors")

    @property
    def modes(self) -> MeasuredModes:
        """All of them."""
        return self.given

    @property
    def repeats(self) -> int:
        """Repeats of the measurement."""
        return self.given.n_repeats

    @property
    def sensed(self) -> tuple[MeasuredModes]:
        """The modes in use."""
        return (self.used_modes,)

    @cached_property
    def used_modes(self) -> MeasuredModes:
        """The modes that are not held out, at sensors that are not."""
        study, whole = self.study, self.given
        held = study.settings.held_out
        try:
            used = whole.without(held.modes, held.sensors)
        except InputError as fault:
            sensors = [sensor.name for sensor in whole.sensors]
            unknown = [("modes", k) for k, name in enumerate(held.modes) if name not in whole.names]
            unknown += [("sensors", k) for k, name in enumerate(held.sensors) if name not in sensors]
            place = study.place("held_out", *(unknown[0] if unknown else ()))
            raise InputError(fault.problem, place=place, remedy=fault.remedy) from None
        if not used.n_modes:
            place = study.place("held_out", "modes")
            raise InputError("every measured mode is held out", place=place, remedy="leave some to fit")
        if whole.has_shapes and not used.has_shapes:
            raise InputError(
                "every sensor is held out",
                place=study.place("held_out", "sensors"),
                remedy="leave some by which modes are paired",
            )
        return used

    def problem(self, model: ModalModel, base: ModalModel) -> ModalProblem:
        """The problem over the modes in use; as many more modes are solved as effects add degrees of freedom."""
        study, measured = self.study, self.used_modes
        pairing, n_added = study.settings.pairing, model.n_modes - base.n_modes
        default = usual_mode_count(measured, model.n_modes - n_added)
        count = pairing.mode_count if pairing.mode_count is not None else default
        if count < measured.n_modes:
            raise InputError(
                f"mode_count is {count}, but {measured.n_modes} modes were measured",
                place=study.place("pairing", "mode_count"),
                remedy="solve at least as many, better a few more",
            )
        named = {mode: key for key in ("override", "clusters") for mode in getattr(pairing, key)}
        held_out = set(study.settings.held_out.modes)
        for mode in sorted(named.keys() - set(measured.names) - held_out):
            raise InputError(
                f"mode {mode!r} was not measured",
                place=study.place("pairing", named[mode], mode, mark="key"),
                remedy=f"the measured modes are {', '.join(measured.names)}",
            )
        try:
            return ModalProblem(
                model=model,
                measured=measured,
                mode_clusters={m: c for m, c in pairing.clusters.items() if m not in held_out},
                mode_count=count + n_added,
                threshold=pairing.threshold,
                freq_window=pairing.freq_window,
                override={m: k for m, k in pairing.override.items() if m not in held_out},
            )
        except InputError as fault:
            raise misfit(study, model, fault) from None

    def whole_problem(self, problem: ModalProblem) -> ModalProblem | None:
        """See `Tested`."""
        pairing, held = self.study.settings.pairing, self.study.settings.held_out
        if not (held.modes or held.sensors):
            return None
        try:
            return problem.over(self.given, pairing.clusters, pairing.override, pairing.mode_count)
        except InputError as fault:
            raise misfit(self.study, problem.model, fault) from None

    def pair(self, problem: ModalProblem) -> ModalResidual:
        """See `Tested`."""
        return ModalResidual(problem)

    def table(self) -> pd.DataFrame:
        """`MODE_COLUMNS`: frequencies in Hz, damping as a ratio, and the number of repeats of the frequency."""
        held, whole = self.study.settings.held_out, self.given
        freq_std, damping_std = self._std_used()
        columns = {
            "mode": list(whole.names),
            "held_out": [name in held.modes for name in whole.names],
            **{name: getattr(whole, name) for name in MODE_COLUMNS[2:-3]},
            "repeats": whole.counts("freq"),
            "freq_std_used": freq_std * whole.natural_freq,
            "damping_std_used": damping_std * whole.damping_ratio,
        }
        return pd.DataFrame(columns, columns=list(MODE_COLUMNS))

    def _std_used(self) -> tuple[np.ndarray, np.ndarray]:
        """Relative standard deviations of frequency and damping, (n_modes,): of the fit, or of the held-out check."""
        every, used = std_for(self.given), self.used_modes
        freq, damping = every.freq.copy(), every.damping.copy()
        fitted, rows = std_for(used), [self.given.names.index(name) for name in used.names]
        freq[rows], damping[rows] = fitted.freq, fitted.damping
        return freq, damping
