"""FRFTest: measured frequency response functions, and how they are compared with a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from calib.correlation.frf.nuisance import NUISANCES, Nuisance, belonging_to, concerned, require_channels
from calib.correlation.frf.problem import FRFProblem, assumed_frfs
from calib.correlation.frf.residual import FRFResidual
from calib.errors.arguments import names, objects
from calib.errors.errors import InputError
from calib.experiment import Unseen, unseen_frfs
from calib.experiment.checked import UNNAMED, Claimed, band, named, place_of
from calib.experiment.test import BaseTest
from calib.hypotheses.of_test import basis_for
from calib.hypotheses.scalar import FRFAdapter
from calib.measurement.accuracy import frf_claim
from calib.measurement.disagreements import Disagreement
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import HeldOutFRFs
from calib.missing.facts import MeasurementFacts
from calib.problem.effect import Effect
from calib.structure.effects.perturbations import Perturbation
from calib.structure.model import Assumption, StructuralModel


@dataclass(frozen=True, eq=False)
class FRFTest(BaseTest):
    """Measured frequency response functions, compared with those of a model with matrices.

    Attributes
    ----------
    frfs : MeasuredFRFs
        From `calib.read_frfs`, for example.
    held_out : sequence of str
        Response sensors (like ``12z``) that no fit uses; they verify it.
    held_out_references : sequence of str
        Likewise references: places and directions of the force.
    held_out_bands : sequence of (float, float)
        Likewise bands of lines, Hz.
    nuisances : sequence of Nuisance
        Errors of the test itself that a fit may find, each with its prior; see `calib.correlation.frf.nuisance`. In a
        problem with several tests their parameters bear the test's name.
    name, condition
        As in `calib.ModalTest`.
    accuracy : str, float or mapping, optional
        Claimed accuracy beside the repeatability: a share of the modulus such as ``"2 %"``, a floor in the unit of the
        FRFs, or both, ``{"share": "2 %", "floor": 1e-7}``.

    Examples
    --------
    A mass of 10 kg on a spring and a damper; the band above the resonance verifies the fit:

    >>> import numpy as np
    >>> import calib
    >>> from calib.measurement.frf import MeasuredFRFs
    >>> freq, place = np.linspace(1.0, 6.0, 51), (calib.Sensor(1, "x"),)
    >>> omega = 2 * np.pi * freq
    >>> values = (1 / (4e3 + 8j * omega - 10.0 * omega**2))[:, None, None]
    >>> frfs = MeasuredFRFs(freq, place, place, "receptance", values, std=0.01 * abs(values))
    >>> one = np.eye(1)
    >>> model = calib.StructuralModel.from_matrices({"k": one}, 10.0 * one, {"c": one}, dofs=[(1, "x")], parameters=[
    ...     calib.Parameter("k", 3.0, 1.0, 9.0, "kN/m"), calib.Parameter("c", 10.0, 1.0, 90.0, "Ns/m"),
    ... ])
    >>> test = calib.FRFTest(frfs, held_out_bands=[(4.0, 5.0)])
    >>> fit = calib.Problem(model, test).calibrate()
    >>> round(fit.values["k"], 2), round(fit.values["c"], 2)
    (4.0, 8.0)
    """

    frfs: MeasuredFRFs
    held_out: tuple[str, ...] = ()
    held_out_references: tuple[str, ...] = ()
    held_out_bands: Sequence[tuple[float, float]] = ()
    nuisances: Sequence[Nuisance] = ()
    name: str = UNNAMED
    condition: Mapping[str, float] = field(default_factory=dict)
    accuracy: Claimed = None

    def __post_init__(self) -> None:
        place = named(self)
        (frfs,) = objects([self.frfs], MeasuredFRFs, f"{place}, frfs")
        object.__setattr__(self, "nuisances", objects(self.nuisances, NUISANCES, f"{place}, nuisances"))
        require_channels(self.nuisances, frfs)
        try:
            claimed = frfs.accuracy if self.accuracy is None else frf_claim(self.accuracy)
        except (TypeError, ValueError) as fault:
            raise InputError(str(fault), place=f"{place}, accuracy") from None
        object.__setattr__(self, "frfs", replace(frfs, accuracy=claimed))
        references = names(self.held_out_references, f"{place}, held_out_references")
        bands = tuple(band(one, f"{place}, held_out_bands") for one in self.held_out_bands)
        object.__setattr__(self, "held_out_references", references)
        object.__setattr__(self, "held_out_bands", bands)
        unknown = self._held_out.unknown(self.frfs)
        if unknown is not None:
            lacking = unknown[1]
            raise InputError(lacking.problem, place=place, remedy=lacking.remedy)

    @property
    def _held_out(self) -> HeldOutFRFs:
        return HeldOutFRFs(self.held_out, self.held_out_references, tuple(self.held_out_bands))

    @cached_property
    def _parts(self) -> tuple[MeasuredFRFs, dict[str, MeasuredFRFs]]:
        return self._held_out.split(self.frfs)

    @property
    def synthetic(self) -> bool:
        """Whether the measurement is marked as synthetic."""
        return self.frfs.synthetic

    @property
    def used(self) -> MeasuredFRFs:
        """The FRFs in use, without held-out ones."""
        return self._parts[0]

    @property
    def unseen(self) -> Unseen:
        """Held-out FRFs, by their group, with the nuisances that concern them."""
        return unseen_frfs(self._parts[1], self.nuisances)

    def problem(self, model: Any) -> FRFProblem:
        """The forward problem of a model, without held-out FRFs."""
        if not isinstance(model, StructuralModel):
            raise InputError(
                f"the model {model.name} has no matrices", place=place_of(self),
                remedy="give a StructuralModel; matrices of other codes make one too",
            )  # fmt: skip
        return FRFProblem(model, self.used, concerned(self.nuisances, self.used))

    @property
    def beside(self) -> FRFTest:
        """The test as one of several: parameters of its own bear its name."""
        return replace(self, nuisances=belonging_to(self.name, self.nuisances))

    def pair(self, model: Any) -> FRFResidual:
        """The whitened residual of a model, without held-out FRFs."""
        return FRFResidual(self.problem(model))

    @property
    def sensed(self) -> tuple[MeasuredFRFs]:
        """The data in use, whose sensors are places of local perturbations."""
        return (self.used,)

    def adapter(
        self,
        model: Any,
        effects: tuple[Effect, ...],
        local: tuple[Perturbation, ...],
        facts: MeasurementFacts,
        name: str,
    ) -> FRFAdapter:
        """See `BaseTest`."""
        pair = self.pair(model)
        basis, large = basis_for(model, pair.problem, effects, local, facts.seed)
        space = pair.space.without(self.condition)
        return FRFAdapter.of(pair.suspected(name), effects, local, space, facts, self.unseen, basis, large)

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Empty: repeats of FRFs are not compared with each other."""
        return ()

    @property
    def claimed(self) -> str:
        """The claimed accuracy, in words; empty without."""
        return self.frfs.claimed

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is known."""
        return assumed_frfs(self.used)
