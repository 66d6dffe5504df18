"""FRFTest: measured frequency response functions, and how they are compared with a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from calib.correlation.frf.nuisance import NUISANCES, Nuisance, belonging_to, concerned, require_channels
from calib.correlation.frf.problem import FRFProblem, assumed_frfs
from calib.correlation.frf.residual import FRFResidual
from calib.errors.arguments import names, objects
from calib.errors.errors import InputError
from calib.experiment.held_out import HeldOutGroups, held_out_frfs
from calib.experiment.test import UNNAMED, Claimed, Test, TestError, band, require_named, test_place
from calib.measurement.accuracy import frf_claim
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import HeldOutFRFs
from calib.measurement.thinning import thinned
from calib.structure.model import Assumption, StructuralModel

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class FRFTest(Test):
    """Measured frequency response functions, compared with those of a model with matrices.

    More than 2000 lines are thinned to means over close ones, which tell as much of parameters (see
    `calib.measurement.thinning.thinned`).

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
    name, condition, node_limit
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
    node_limit: float | None = None

    words = "FRFs"
    many_minima = True  # resonances have to overlap first
    can_hold_out = ("sensors", "references", "bands")
    shows_mesh = True

    def __post_init__(self) -> None:
        place = require_named(self)
        (frfs,) = objects([self.frfs], MeasuredFRFs, f"{place}, frfs")
        object.__setattr__(self, "nuisances", objects(self.nuisances, NUISANCES, f"{place}, nuisances"))
        require_channels(self.nuisances, frfs)
        if frfs.window_rate > 0:
            raise InputError(
                f"an exponential window of {1 / frfs.window_rate:.3g} s is in its FRFs, whose damping no model has",
                place=f"{place}, frfs", remedy="measure until the responses decay, or compare modes: calib modes",
            )  # fmt: skip
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
            keys, lacking = unknown
            raise TestError.at_keys(lacking.problem, lacking.remedy or "", place, "held_out", *keys)

    @property
    def _held_out(self) -> HeldOutFRFs:
        return HeldOutFRFs(self.held_out, self.held_out_references, tuple(self.held_out_bands))

    @cached_property
    def _parts(self) -> tuple[MeasuredFRFs, dict[str, MeasuredFRFs]]:
        used, unseen = self._held_out.split(self.frfs)
        return thinned(used), {group: thinned(own) for group, own in unseen.items()}

    @property
    def measured(self) -> MeasuredFRFs:
        """Everything that was measured."""
        return self.frfs

    @property
    def measured_frfs(self) -> MeasuredFRFs:
        """All FRFs, held-out ones included."""
        return self.frfs

    @property
    def repeats(self) -> int:
        """Repeats of the measurement."""
        return self.frfs.n_repeats

    @property
    def held_out_sensors(self) -> tuple[str, ...]:
        """Responses that no fit uses."""
        return self.held_out

    @property
    def held_out_words(self) -> str:
        """Sensors, references and bands, those of which some are held out."""
        bands = [f"{low:g} to {high:g} Hz" for low, high in self.held_out_bands]
        by_kind = {"sensors": self.held_out, "references": self.held_out_references, "bands": bands}
        return "; ".join(f"{kind} {', '.join(names)}" for kind, names in by_kind.items() if names)

    @property
    def used(self) -> MeasuredFRFs:
        """The FRFs in use, without held-out ones."""
        return self._parts[0]

    @property
    def unseen(self) -> HeldOutGroups:
        """Held-out FRFs, by their group, with the nuisances that concern them."""
        return held_out_frfs(self._parts[1], self.nuisances)

    def problem(self, model: Any, base: Any = None) -> FRFProblem:
        """The forward problem of a model, without held-out FRFs; transducers load the structure all the same."""
        if not isinstance(model, StructuralModel):
            raise TestError.at_keys(
                f"the model {model.name} has no matrices, so it has no FRFs",
                "give a StructuralModel; matrices of other codes make one too", test_place(self), "measurement", "kind",
            )  # fmt: skip
        model = self.on_nodes(model, (*self.used.responses, *self.used.references))
        return FRFProblem(model, self.used, concerned(self.nuisances, self.used))

    @property
    def beside(self) -> FRFTest:
        """The test as one of several: parameters of its own bear its name."""
        return replace(self, nuisances=belonging_to(self.name, self.nuisances))

    def residual(self, problem: Any) -> FRFResidual:
        """The whitened residual of a forward problem over such data."""
        return FRFResidual(problem)

    @property
    def sensed(self) -> tuple[MeasuredFRFs]:
        """The data in use, whose sensors are places of local perturbations."""
        return (self.used,)

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is known."""
        return assumed_frfs(self.used)

    def table(self) -> pd.DataFrame:
        """``response, reference, held_out, quantity, lines, freq_min, freq_max, repeats``, one row per function.

        Bands that are held out are not marked.
        """
        import pandas as pd

        whole, rows = self.frfs, []
        for function in whole.functions:
            response, reference, freq = function.response.name, function.reference.name, whole.freq[function.lines]
            held_out = response in self.held_out or reference in self.held_out_references
            rows.append((response, reference, held_out, whole.quantity, len(freq), freq[0], freq[-1], whole.n_repeats))
        columns = ["response", "reference", "held_out", "quantity", "lines", "freq_min", "freq_max", "repeats"]
        return pd.DataFrame(rows, columns=columns)
