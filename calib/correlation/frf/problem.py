"""A model with matrices and measured FRFs of it, nuisances of the test included, with analytic derivatives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.correlation.frf.comparison import frac_and_amplitude
from calib.correlation.frf.factor import Channels
from calib.correlation.frf.nuisance import Nuisance, require_channels
from calib.correlation.frf.rows import TransducerRows
from calib.correlation.mesh_error import MeshError
from calib.correlation.rules import RULES
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of
from calib.structure.effects.loaded import with_loads
from calib.structure.eigenproblem.derivatives import beside_roots
from calib.structure.frf import frf, frf_derivatives
from calib.structure.model import Assumption, StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.frf_target import FRFTarget
from calib.structure.reduction.reduced import ReducedModel

DEFINITION = "FRF residual 2"
"""Part of the fingerprint; increment it whenever the same FRFs would give another residual or derivative."""


def assumed_frfs(frfs: MeasuredFRFs) -> tuple[Assumption, ...]:
    """Assumed standard deviations of FRFs; empty when all are stated."""
    if not (np.isfinite(frfs.values) & ~np.isfinite(frfs.total_std)).any():
        return ()
    reason = "neither repeats nor coherence are given"
    return (
        Assumption("standard deviation of FRFs", f"{100 * RULES.unknown_frf_std:g}", "% of each amplitude", reason),
    )


@dataclass(frozen=True, eq=False)
class FRFProblem:
    """A model with matrices and measured FRFs of it.

    Attributes
    ----------
    model : StructuralModel or ReducedModel
        Of the structure alone.
    measured : MeasuredFRFs
    nuisances : tuple of Nuisance
        Errors of channels, transducers and resonances, masses of accelerometers, stingers; their parameters follow the
        model's.
    mesh : MeshError or None
        Error of the mesh, whose multiple is the last parameter; None for an exact mesh.
    suspects : tuple of Nuisance
        Those of the nuisances that are faults to be found, which no reduced basis represents.

    Raises
    ------
    InputError
        For a sensor or a reference that the model cannot place, or a nuisance that is given twice or fits neither.
    """

    model: StructuralModel | ReducedModel
    measured: MeasuredFRFs
    nuisances: tuple[Nuisance, ...] = ()
    mesh: MeshError | None = None
    suspects: tuple[Nuisance, ...] = ()
    space: ParameterSpace = field(init=False, repr=False)
    loaded_model: StructuralModel | ReducedModel = field(init=False, repr=False)
    _channels: Channels = field(init=False, repr=False)
    _rows: TransducerRows = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = Counter(nuisance.parameter.name for nuisance in self.nuisances)
        for name, count in names.items():
            if count > 1 or name in self.model.space:
                raise InputError(f"{name!r} is a parameter twice", place="nuisances of FRFs", remedy="keep one")
        require_channels(self.nuisances, self.measured)
        loads = [load for n in self.nuisances for load in n.loads(self.model.whole)]
        errors = tuple(error for n in self.nuisances for error in n.of_channel)
        rows = TransducerRows.of([error for n in self.nuisances for error in n.of_rows], self.measured, self.model)
        model, own = with_loads(self.model, loads), self.model.space
        of_rows = {e.parameter.name: e.parameter for e in rows.errors}  # one error may change several rows
        parameters = (*model.space.parameters, *(e.parameter for e in errors), *of_rows.values())
        parameters += () if self.mesh is None else (self.mesh.parameter,)
        object.__setattr__(self, "space", ParameterSpace(parameters, own.constraints))
        object.__setattr__(self, "loaded_model", model)
        object.__setattr__(self, "_channels", Channels(errors, self.measured))
        object.__setattr__(self, "_rows", rows)

    @property
    def user_function(self) -> None:
        """None: a model of matrices runs no user code."""
        return

    @property
    def numbers_function(self) -> None:
        """None: a model of matrices runs no user code."""
        return

    def with_function(self, function: object) -> FRFProblem:
        """The problem itself, which has no function."""
        return self

    @property
    def ledger_key(self) -> str:
        """Fingerprint of the responses in the ledger."""
        return self.fingerprint

    @property
    def model_fingerprint(self) -> str:
        """Hash that changes whenever a result of the model could."""
        return self.model.fingerprint

    @property
    def assumed_std(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is known."""
        return assumed_frfs(self.measured)

    @property
    def relative_std(self) -> np.ndarray:
        """NaN, (1,): the misfit of a search has no share of known noise."""
        return np.array([np.nan])

    @property
    def sensitivity_responses(self) -> list[str]:
        """FRAC and amplitude of every function."""
        return list(self.response_names)

    @property
    def search_targets(self) -> dict[str, float]:
        """Responses that a search compares, each 1 for a right model."""
        return dict.fromkeys(self.response_names, 1.0)

    @property
    def reducible(self) -> StructuralModel | None:
        """The model at full order, which a basis can reduce; None for a reduced model."""
        return self.model.reducible

    @property
    def basis_names(self) -> tuple[str, ...]:
        """Parameters over which a basis must serve: those of the model and of what loads it, without suspects."""
        return self._without_suspects.loaded_model.space.names

    @cached_property
    def entry_std(self) -> np.ndarray:
        """Standard deviation of every entry, (n_freq, n_responses, n_references), in the unit of the quantity."""
        total = self.measured.total_std
        assumed = RULES.unknown_frf_std * np.abs(self.measured.values) * self.measured.per_line
        return np.where(np.isfinite(total), total, assumed)

    def basis_target(self, tolerance: float) -> FRFTarget:
        """All FRFs in use in units of their standard deviations, without suspects, at full order.

        With `calib.structure.reduction.frf_target.TOLERANCE` whatever the one of eigenvalues.
        """
        own, measured = self._without_suspects, self.measured
        loads = tuple(load for n in own.nuisances for load in n.loads(self.model.whole))
        unit = np.where(np.isfinite(measured.values), self.entry_std, np.inf)
        rows = own._rows
        return FRFTarget(
            measured.freq, rows.responses, rows.references, unit, measured.quantity, loads, moved=rows.moved
        )

    @cached_property
    def _without_suspects(self) -> FRFProblem:
        if not self.suspects:
            return self
        fitted = tuple(n for n in self.nuisances if n not in self.suspects)
        return replace(self, nuisances=fitted, suspects=())

    def reduced(self, basis: Basis) -> FRFProblem:
        """The same problem with a reduced model; InputError when the basis belongs to another model."""
        if self.reducible is None:
            raise InputError("the model is reduced already", place=self.model.name)
        return replace(self, model=ReducedModel(self.reducible, basis))

    @property
    def n_measured(self) -> int:
        """Number of measured frequency lines."""
        return len(self.measured.freq)

    @cached_property
    def fingerprint(self) -> str:
        """Hash that changes whenever the responses at the same values could, which measured values enter."""
        channels = sorted(e.key for e in self._channels.errors)
        known = self.loaded_model.fingerprint, self.measured.fingerprint
        mesh = [] if self.mesh is None else [self.mesh.fingerprint]
        return digest_of(DEFINITION, *known, channels, *self._rows.content, *mesh)[:16]

    def functions(self, values: Mapping[str, float]) -> np.ndarray:
        """FRFs at named values, (n_freq, n_responses, n_references), complex; EvaluationError where it has none."""
        si, measured = self._si(values), self.measured
        own = frf(self.loaded_model, self._of_model(values), measured.freq, *self._rows.rows(si), measured.quantity)
        read = own * self._channels.factors(si)
        return read if self.mesh is None else read + self.mesh.at(values) * self.mesh.functions(self)

    def of_mesh(self, model: StructuralModel) -> FRFProblem:
        """The same measurement of the model on another mesh, without an error of it."""
        return replace(self, model=model, mesh=None)

    @cached_property
    def response_names(self) -> tuple[str, ...]:
        """Names of the responses: ``frac RESPONSE/REFERENCE`` of every measured function, then ``amplitude ...``."""
        return tuple(f"{kind} {own.name}" for kind in ("frac", "amplitude") for own in self.measured.functions)

    def responses(self, functions: np.ndarray) -> dict[str, float]:
        """Responses of FRFs (n_freq, n_responses, n_references), each 1 for a right model.

        See `calib.correlation.frf.comparison.frac_and_amplitude`.
        """
        found = frac_and_amplitude(self.measured, functions)
        return dict(zip(self.response_names, found.ravel().tolist(), strict=True))

    def evaluate(self, values: Mapping[str, float]) -> dict[str, float]:
        """The responses at named values; EvaluationError where the model has no FRFs."""
        return self.responses(self.functions(self.space.complete(values)))

    def slopes(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Their derivatives, (n_params, n_freq, n_responses, n_references), complex, per unit of each parameter."""
        measured, own = self.measured, [name for name in names if name in self.loaded_model.space]
        values = beside_roots(self.space, self.loaded_model.roots, values, names)
        si = self._si(values)
        rows, factors = self._rows.rows(si), self._channels.factors(si)
        asked = self._rows.asked(names)
        solved = frf_derivatives(
            self.loaded_model, self._of_model(values), measured.freq, *rows, own, measured.quantity,
            self._rows.beside(asked, si),
        )  # fmt: skip
        found = dict(zip(own, solved.derivatives, strict=True))
        found |= self._rows.derivatives(asked, solved.felt, solved.driven)
        found = {name: slope * factors for name, slope in found.items()}
        found |= {} if self.mesh is None else {self.mesh.name: self.mesh.functions(self)}
        functions = solved.functions * factors
        return np.array(
            [found[n] if n in found else self._channels.slope(n, si, functions) for n in names]
        ).reshape(len(names), *functions.shape)  # fmt: skip

    def _si(self, values: Mapping[str, float]) -> dict[str, float]:
        return self.space.si(self.space.complete(values))

    def _of_model(self, values: Mapping[str, float]) -> dict[str, float]:
        complete = self.space.complete(values)
        return {name: complete[name] for name in self.loaded_model.space.names}
