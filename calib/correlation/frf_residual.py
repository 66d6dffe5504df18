"""Whitened residual of measured and model FRFs, nuisances of the test included, with analytic derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.correlation.frf_channels import Channels
from calib.correlation.frf_comparison import FRFComparison, frac_and_amplitude
from calib.correlation.frf_faults import FRFFault, frf_faults
from calib.correlation.frf_nuisance import LOADING, OF_ROWS, ChannelError, Nuisance, require_channels
from calib.correlation.frf_rows import Rows
from calib.degrees_of_freedom import KNOWN, beside_known
from calib.errors import InputError
from calib.fingerprint import digest_of
from calib.measurement.frf import MeasuredFRFs
from calib.outcome import answered
from calib.space import ParameterSpace
from calib.structure.basis import Basis
from calib.structure.derivatives import beside_roots
from calib.structure.frf import frf, frf_derivatives
from calib.structure.frf_target import FRFTarget
from calib.structure.loaded import loaded
from calib.structure.model import Assumption, StructuralModel
from calib.structure.reduced import ReducedModel

UNKNOWN_STD = 0.02
"""Assumed standard deviation of real and imaginary part each, relative to the modulus, where none is known: that of 12
averages at a coherence of 0.99 (Bendat and Piersol 2010)."""

_DEFINITION = "FRF residual 2"
"""Part of the fingerprint; increment it whenever the same FRFs would give another residual or derivative."""


class FRFRow(NamedTuple):
    """What one entry of the residual compares.

    Attributes
    ----------
    mode : str
        Empty.
    kind : str
        ``frf``.
    sensor : str
        Response over reference, such as ``12z/3z``.
    part : str
        ``re`` or ``im``.
    freq : float
        Line, Hz.
    """

    mode: str
    kind: str
    sensor: str
    part: str
    freq: float


def assumed_frfs(frfs: MeasuredFRFs) -> tuple[Assumption, ...]:
    """Assumed standard deviations of FRFs; empty when all are stated."""
    if not (np.isfinite(frfs.values) & ~np.isfinite(frfs.total_std)).any():
        return ()
    reason = "neither repeats nor coherence are given"
    return (Assumption("standard deviation of FRFs", f"{100 * UNKNOWN_STD:g}", "% of each modulus", reason),)


@dataclass(frozen=True, eq=False)
class FRFProblem:
    """A model with matrices and measured FRFs of it.

    Attributes
    ----------
    model : StructuralModel or ReducedModel
        Of the structure alone.
    measured : MeasuredFRFs
    nuisances : tuple of Nuisance
        Errors of channels and transducers, masses of accelerometers, stingers; their parameters follow the model's.

    Raises
    ------
    InputError
        For a sensor or a reference that the model cannot place, or a nuisance that is given twice or fits neither.
    """

    model: StructuralModel | ReducedModel
    measured: MeasuredFRFs
    nuisances: tuple[Nuisance, ...] = ()
    space: ParameterSpace = field(init=False, repr=False)
    loaded_model: StructuralModel | ReducedModel = field(init=False, repr=False)
    _channels: Channels = field(init=False, repr=False)
    _rows: Rows = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names = [nuisance.parameter.name for nuisance in self.nuisances]
        for name in names:
            if names.count(name) > 1 or name in self.model.space:
                raise InputError(f"{name!r} is a parameter twice", place="nuisances of FRFs", remedy="keep one")
        require_channels(self.nuisances, self.measured)
        whole = self.model.model if isinstance(self.model, ReducedModel) else self.model
        loads = [n.load(whole) for n in self.nuisances if isinstance(n, LOADING)]
        errors = tuple(n for n in self.nuisances if isinstance(n, ChannelError))
        rows = Rows.of([n for n in self.nuisances if isinstance(n, OF_ROWS)], self.measured, self.model)
        model, own = loaded(self.model, loads), self.model.space
        parameters = (*model.space.parameters, *(e.parameter for e in errors), *(e.parameter for e in rows.errors))
        object.__setattr__(self, "space", ParameterSpace(parameters, own.constraints))
        object.__setattr__(self, "loaded_model", model)
        object.__setattr__(self, "_channels", Channels(errors, self.measured))
        object.__setattr__(self, "_rows", rows)

    @property
    def function(self) -> None:
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

    def reduced(self, basis: Basis) -> FRFProblem:
        """The same problem with a reduced model; InputError when the basis belongs to another model."""
        if not isinstance(self.model, StructuralModel):
            raise InputError("the model is reduced already", place=self.model.name)
        return replace(self, model=ReducedModel(self.model, basis))

    def target(self, std: np.ndarray) -> FRFTarget:
        """What a basis for these FRFs must represent, of a model at full order.

        ``std`` is the standard deviation of every entry, (n_freq, n_responses, n_references).
        """
        assert isinstance(self.model, StructuralModel)
        loads = tuple(n.load(self.model) for n in self.nuisances if isinstance(n, LOADING))
        unit = np.where(np.isfinite(self.measured.values), std, np.inf)
        rows, quantity = self._rows, self.measured.quantity
        return FRFTarget(self.measured.freq, rows.responses, rows.references, unit, quantity, loads, moved=rows.moved)

    @property
    def n_measured(self) -> int:
        """Number of measured frequency lines."""
        return len(self.measured.freq)

    @cached_property
    def fingerprint(self) -> str:
        """Hash that changes whenever the responses at the same values could, which measured values enter."""
        channels = sorted((e.kind, e.sensor, e.side) for e in self._channels.errors)
        known = self.loaded_model.fingerprint, self.measured.fingerprint
        return digest_of(_DEFINITION, *known, channels, *self._rows.content)[:16]

    def functions(self, values: Mapping[str, float]) -> np.ndarray:
        """FRFs at named values, (n_freq, n_responses, n_references), complex; EvaluationError where it has none."""
        si = self._si(values)
        return self._frf(values, *self._rows.rows(si)) * self._channels.factors(si)

    def _frf(self, values: Mapping[str, float], responses: np.ndarray, references: np.ndarray) -> np.ndarray:
        own = self._of_model(values)
        return frf(self.loaded_model, own, self.measured.freq, responses, references, self.measured.quantity)

    @cached_property
    def response_names(self) -> tuple[str, ...]:
        """Names of the responses: ``frac RESPONSE/REFERENCE`` of every measured function, then ``amplitude ...``."""
        return tuple(f"{kind} {own.name}" for kind in ("frac", "amplitude") for own in self.measured.functions)

    def responses(self, functions: np.ndarray) -> dict[str, float]:
        """Responses of FRFs (n_freq, n_responses, n_references), each 1 for a right model.

        See `calib.correlation.frf_comparison.frac_and_amplitude`.
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
        functions, slopes = frf_derivatives(
            self.loaded_model, self._of_model(values), measured.freq, *rows, own, measured.quantity
        )
        found = dict(zip(own, slopes, strict=True))
        if moved := self._rows.asked(names):
            wider = [np.vstack(pair) for pair in zip(rows, self._rows.beside(moved, si), strict=True)]
            found |= self._rows.derivatives(moved, self._frf(values, *wider))
        found = {name: slope * factors for name, slope in found.items()}
        functions = functions * factors
        return np.array(
            [found[n] if n in found else self._channels.slope(n, si, functions) for n in names]
        ).reshape(len(names), *functions.shape)  # fmt: skip

    def _si(self, values: Mapping[str, float]) -> dict[str, float]:
        return self.space.si(self.space.complete(values))

    def _of_model(self, values: Mapping[str, float]) -> dict[str, float]:
        complete = self.space.complete(values)
        return {name: complete[name] for name in self.loaded_model.space.names}


@dataclass(frozen=True, eq=False)
class FRFResidual:
    """Whitened differences between measured and model FRFs.

    Rows are (measured - model)/std of the real, then of the imaginary part of every measured entry: reference by
    reference, response by response, line by line. The standard deviation joins repeatability and claimed accuracy, or
    is `UNKNOWN_STD` of the modulus where neither is known; rows count as independent.

    Attributes
    ----------
    problem : FRFProblem
    faults : tuple of FRFFault
        Those of its nuisances that are faults to be found, and not fitted otherwise.

    Raises
    ------
    InputError
        When nothing was measured, or a standard deviation is zero.
    """

    problem: FRFProblem
    faults: tuple[FRFFault, ...] = ()
    _known: np.ndarray = field(init=False, repr=False)
    _std: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        measured = self.problem.measured
        known = np.isfinite(measured.values)
        total = measured.total_std
        std = np.where(np.isfinite(total), total, UNKNOWN_STD * np.abs(measured.values))
        if not known.any():
            raise InputError("no FRF was measured", place=measured.source or "FRFs", remedy="give at least one")
        if not np.all(std[known] > 0):
            k, i, j = (int(index[0]) for index in np.nonzero(known & ~(std > 0)))
            raise InputError(
                f"the standard deviation of {measured.responses[i].name} over {measured.references[j].name} "
                f"at {measured.freq[k]:.6g} Hz is not positive",
                place=measured.source or "FRFs",
                remedy="give repeats that differ, or a claimed accuracy",
            )
        object.__setattr__(self, "_known", known)
        object.__setattr__(self, "_std", std)

    @property
    def space(self) -> ParameterSpace:
        """Parameters of the model, and after them those of the nuisances."""
        return self.problem.space

    @cached_property
    def rows(self) -> tuple[FRFRow, ...]:
        """Labels of the rows, length n_rows."""
        measured = self.problem.measured
        return tuple(
            FRFRow("", "frf", function.name, part, freq)
            for part in ("re", "im")
            for function in measured.functions
            for freq in measured.freq[function.lines].tolist()
        )

    def _stacked(self, functions: np.ndarray) -> np.ndarray:
        """Entries (..., n_freq, n_responses, n_references) as real rows (..., n_rows), in the order of `rows`."""
        turned = np.swapaxes(functions, -3, -1)[..., np.swapaxes(self._known, 0, -1)]
        return np.concatenate([turned.real, turned.imag], axis=-1)

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviation of every row, (n_rows,), in the unit of the quantity."""
        return self._stacked(self._std * (1 + 1j))

    @property
    def entry_std(self) -> np.ndarray:
        """Standard deviation of every entry, (n_freq, n_responses, n_references), in the unit of the quantity."""
        return self._std

    def compared(self, values: Mapping[str, float]) -> FRFComparison:
        """Measured and model FRFs at named values; EvaluationError where the model has none."""
        return FRFComparison(self.problem.measured, self.solve(values), self._std)

    @property
    def target(self) -> FRFTarget:
        """What a reduced basis must represent: these FRFs, in units of their standard deviations, without faults."""
        suspects = {fault.error for fault in self.faults}
        fitted = tuple(n for n in self.problem.nuisances if n not in suspects)
        return replace(self.problem, nuisances=fitted).target(self._std)

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over the modulus of its FRF, (n_rows,)."""
        size = self._stacked(np.abs(self.problem.measured.values) * (1 + 1j))
        return np.divide(self.std, size, out=np.full(len(size), np.inf), where=size > 0)

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Empty: no FRF has a fitted factor."""
        return {}

    @property
    def std_dof(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviations: those of all repeats, less two parts of each function.

        A claimed accuracy counts as known, so that a larger part of it adds degrees of freedom (see `beside_known`).
        """
        measured = self.problem.measured
        if measured.n_repeats < 2:
            return {"frf": np.inf}
        estimated = 2.0 * (measured.n_repeats - 1) * int(self._known.sum()) - 2 * len(measured.functions)
        shares = np.nan_to_num(measured.std[self._known] / self._std[self._known]) ** 2
        return {"frf": min(beside_known(estimated, shares), KNOWN)}

    @cached_property
    def fingerprint(self) -> str:
        """Hash that changes whenever the residual or its derivatives at the same values could."""
        return digest_of(_DEFINITION, self.problem.fingerprint, self._std.tobytes())[:16]

    @property
    def told_by_responses(self) -> bool:
        """The solution cannot be restored from its responses."""
        return False

    def suspected(self, test: str = "") -> FRFResidual:
        """The same with every fault that it may have as parameters of value 0, which bear the name of a test."""
        faults = frf_faults(self.problem.model, self.problem.measured, self.problem.nuisances, test)
        errors = (*self.problem.nuisances, *(fault.error for fault in faults))
        return replace(self, problem=replace(self.problem, nuisances=errors), faults=faults)

    def with_model(self, model: StructuralModel | ReducedModel, added: int | None = None) -> FRFResidual:
        """The same measured FRFs and nuisances with another model; ``added`` concerns modes and is ignored."""
        return replace(self, problem=replace(self.problem, model=model))

    def solve(self, values: Mapping[str, float]) -> np.ndarray:
        """FRFs at named values, (n_freq, n_responses, n_references); EvaluationError where it has none."""
        found: dict[str, np.ndarray] = {}

        def ask(point: Mapping[str, float]) -> dict[str, float]:
            found["functions"] = self.problem.functions(point)
            return {}

        answered(ask, values)
        return found["functions"]

    def responses(self, solution: np.ndarray) -> dict[str, float]:
        """FRAC and amplitude ratio of every function; see `FRFProblem.responses`."""
        return self.problem.responses(solution)

    def restored(self, responses: Mapping[str, float]) -> None:
        """None: see `told_by_responses`."""
        return

    def unpaired(self, solution: np.ndarray) -> frozenset[str]:
        """Empty: FRFs are matched by their places."""
        return frozenset()

    def of(self, solution: np.ndarray) -> np.ndarray:
        """Whitened residual of FRFs already computed, (n_rows,)."""
        return np.asarray(self._stacked(self.problem.measured.values - solution) / self.std)

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual at named values, (n_rows,); EvaluationError where the model has no FRFs."""
        return self.of(self.solve(values))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Its derivatives per unit of each parameter, (n_rows, n_params); of an integer parameter zero."""
        return self.slope(values, names, self.solve)

    def slope(
        self, values: Mapping[str, float], names: Sequence[str], at: Callable[[Mapping[str, float]], np.ndarray]
    ) -> np.ndarray:
        """The Jacobian, which needs no solution of another point."""
        if not names:
            return np.zeros((len(self.std), 0))
        return np.asarray(-self._stacked(self.problem.slopes(values, names)).T / self.std[:, None])

    def frequencies(
        self, values: Mapping[str, float], names: Sequence[str], at: Callable[[Mapping[str, float]], np.ndarray]
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Empty: no modes are solved; see `ModalResidual.frequencies`."""
        return (), np.zeros(0), np.zeros((0, len(names)))
