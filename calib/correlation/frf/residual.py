"""Whitened residual of measured and model FRFs, with analytic derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.correlation.frf.comparison import FRFComparison
from calib.correlation.frf.faults import FRFFault, frf_faults
from calib.correlation.frf.problem import DEFINITION, FRFProblem
from calib.correlation.frf.resonances import ResonanceError, claimed_at_resonances
from calib.errors.errors import InputError
from calib.execution.outcome import named_responses
from calib.problem.degrees_of_freedom import KNOWN, beside_known
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel


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


@dataclass(frozen=True, eq=False)
class FRFResidual:
    """Whitened differences between measured and model FRFs.

    Rows are (measured - model)/std of the real, then of the imaginary part of every measured entry: reference by
    reference, response by response, line by line. The standard deviation joins repeatability and claimed accuracy, or
    is `RULES.unknown_frf_std` of the modulus where neither is known; rows count as independent.

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
        std = self.problem.entry_std
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

    def gain(self, slope: np.ndarray) -> np.ndarray:
        """Changes by one standard deviation of every row, (n, n_rows), of numbers that depend on the measured FRFs.

        ``slope`` (n, n_freq, n_responses, n_references), complex, are their derivatives S: an error dH changes them by
        ``Re sum(S dH)``.
        """
        return np.asarray(self._stacked(np.conj(slope) * self._std))

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviation of every row, (n_rows,), in the unit of the quantity."""
        return self._stacked(self._std * (1 + 1j))

    @property
    def measured_values(self) -> np.ndarray:
        """What was measured in every row, (n_rows,), in the unit of the quantity."""
        return self._stacked(self.problem.measured.values)

    @property
    def entry_std(self) -> np.ndarray:
        """Standard deviation of every entry, (n_freq, n_responses, n_references), in the unit of the quantity."""
        return self._std

    def compared(self, values: Mapping[str, float]) -> FRFComparison:
        """Measured and model FRFs at named values; EvaluationError where the model has none."""
        return FRFComparison(self.problem.measured, self.solve(values), self._std, self.problem.model)

    @property
    def row_freqs(self) -> np.ndarray:
        """Line of every row, (n_rows,), Hz."""
        return np.array([row.freq for row in self.rows])

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over the modulus of its FRF, (n_rows,)."""
        size = self._stacked(np.abs(self.problem.measured.values) * (1 + 1j))
        return np.divide(self.std, size, out=np.full(len(size), np.inf), where=size > 0)

    @cached_property
    def shared_errors(self) -> np.ndarray:
        """Change of the residual by one standard deviation of what is claimed at every resonance, (n_rows, n_errors).

        See `calib.correlation.frf.resonances.claimed_at_resonances`; without errors of resonances that are fitted.
        """
        fitted = {n.name for n in self.problem.nuisances if isinstance(n, ResonanceError)}
        changes = claimed_at_resonances(self.problem.measured, fitted)
        return np.asarray((self._stacked(changes) / self.std).T)

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
        return digest_of(DEFINITION, self.problem.fingerprint, self._std.tobytes())[:16]

    @property
    def told_by_responses(self) -> bool:
        """The solution cannot be restored from its responses."""
        return False

    def suspected(self, test: str = "") -> FRFResidual:
        """The same with every fault that it may have as parameters of value 0, which bear the name of a test."""
        faults = frf_faults(self.problem.model, self.problem.measured, self.problem.nuisances, test)
        suspects = tuple(fault.error for fault in faults)
        problem = replace(self.problem, nuisances=(*self.problem.nuisances, *suspects), suspects=suspects)
        return replace(self, problem=problem, faults=faults)

    def within(self, space: ParameterSpace) -> FRFResidual:
        """The same: derivatives of matrices keep to no limits."""
        return self

    def with_model(self, model: StructuralModel | ReducedModel, added: int | None = None) -> FRFResidual:
        """The same measured FRFs and nuisances with another model; ``added`` concerns modes and is ignored."""
        return replace(self, problem=replace(self.problem, model=model))

    def solve(self, values: Mapping[str, float]) -> np.ndarray:
        """FRFs at named values, (n_freq, n_responses, n_references); EvaluationError where it has none."""
        found: dict[str, np.ndarray] = {}

        def ask(point: Mapping[str, float]) -> dict[str, float]:
            found["functions"] = self.problem.functions(point)
            return {}

        named_responses(ask, values)
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
