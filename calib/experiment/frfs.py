"""Measured FRFs of a study, and the problem of a model of matrices against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from calib.correlation.frf.nuisance import Nuisance, belonging_to, concerned, of_every_channel
from calib.correlation.frf.places import of_every_place
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.frf.resonances import of_every_resonance
from calib.errors.errors import InputError
from calib.experiment.held_out import UnseenFRFs, unseen_frfs
from calib.experiment.tested import Tested
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import HeldOutFRFs
from calib.structure.model import StructuralModel
from calib.study.misfit import misfit


@dataclass(frozen=True, eq=False)
class TestedFRFs(Tested):
    """Measured FRFs of a study.

    Attributes
    ----------
    given : MeasuredFRFs
    """

    given: MeasuredFRFs

    words = "FRFs"
    can_hold_out = ("sensors", "references", "bands")

    @property
    def frfs(self) -> MeasuredFRFs:
        """All of them."""
        return self.given

    @property
    def repeats(self) -> int:
        """Repeats of the measurement."""
        return self.given.n_repeats

    @property
    def sensed(self) -> tuple[MeasuredFRFs]:
        """The FRFs in use."""
        return (self.used,)

    @property
    def held_out(self) -> HeldOutFRFs:
        """What is held out."""
        given = self.study.settings.held_out
        return HeldOutFRFs(given.sensors, given.references, given.bands)

    @cached_property
    def used(self) -> MeasuredFRFs:
        """The FRFs that are not held out."""
        held = self.held_out
        unknown = held.unknown(self.given)
        if unknown is not None:
            keys, fault = unknown
            raise InputError(fault.problem, place=self.study.place("held_out", *keys), remedy=fault.remedy)
        return held.split(self.given)[0]

    def nuisances(self, model: StructuralModel) -> tuple[Nuisance, ...]:
        """Those that the study names, of all channels and transducers of the test, held-out ones included."""
        given, whole = self.study.settings.measurement.nuisances, self.given
        found: tuple[Nuisance, ...] = of_every_channel(whole, **given.model_dump(exclude={"place", "resonance"}))
        if given.resonance is not None:
            found += of_every_resonance(self.used, given.resonance)  # what is held out enters no fit
        if given.place is not None:
            found += of_every_place(whole, given.place, model)
        return belonging_to(self.study.test, found)

    def unseen(self, nuisances: Sequence[Nuisance]) -> dict[str, UnseenFRFs]:
        """Held-out FRFs by group."""
        return unseen_frfs(self.held_out.split(self.given)[1], nuisances)

    def problem(self, model: StructuralModel, base: Any) -> FRFProblem:
        """The problem over the FRFs in use; transducers load the structure at held-out sensors too."""
        used = self.used  # told where it is wrong, unlike what does not fit the model
        try:
            return FRFProblem(model, used, concerned(self.nuisances(model), used))
        except InputError as fault:
            raise misfit(self.study, model, fault) from None

    def pair(self, problem: FRFProblem) -> FRFResidual:
        """See `Tested`."""
        return FRFResidual(problem)

    def table(self) -> pd.DataFrame:
        """``response, reference, held_out, quantity, lines, freq_min, freq_max, repeats``, one row per function.

        Bands that are held out are in the record.
        """
        held, whole, rows = self.study.settings.held_out, self.given, []
        for function in whole.functions:
            response, reference, freq = function.response.name, function.reference.name, whole.freq[function.lines]
            held_out = response in held.sensors or reference in held.references
            rows.append((response, reference, held_out, whole.quantity, len(freq), freq[0], freq[-1], whole.n_repeats))
        columns = ["response", "reference", "held_out", "quantity", "lines", "freq_min", "freq_max", "repeats"]
        return pd.DataFrame(rows, columns=columns)
