"""Whitened residual of measured and model modes, with derivatives."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import scipy.sparse as sp

from calib.correlation.compare import Comparison
from calib.correlation.fitted_shape import FittedShape
from calib.correlation.modal_faults import ModalFault, Readings
from calib.correlation.problem import ModalProblem
from calib.correlation.standard_deviations import USUAL, Floors, StandardDeviations, dof_behind, std_for
from calib.fingerprint import digest_of
from calib.mac import is_real
from calib.space import ParameterSpace
from calib.structure.derivatives import ModeDerivatives, beside_roots
from calib.structure.modal_model import ModalModel

_LEAST_RATIO = 1e-6
"""Lower bound of model damping ratios, which keeps their logarithm finite."""

_DEFINITION = "modal residual 1"
"""Part of the fingerprint; increment it whenever the same modes would give another residual or derivative."""

Kind = Literal["frequency", "damping", "shape"]


class Row(NamedTuple):
    """What one entry of the residual compares.

    Attributes
    ----------
    mode : str
        Measured mode.
    kind : {"frequency", "damping", "shape"}
    sensor : str
        Name of the sensor, empty unless ``kind`` is ``shape``.
    part : str
        ``re`` or ``im`` of a shape, else empty.
    """

    mode: str
    kind: Kind
    sensor: str = ""
    part: str = ""


@dataclass(frozen=True, eq=False)
class ModalResidual:
    """Whitened differences between measured and model modes.

    Rows are (measured - model)/std, always in the same number and order:

    - ``ln natural_freq`` of every measured mode, and ``ln damping_ratio`` where one above 0 was measured and the model
      has damping;
    - every measured entry of a shape, ``u - a v`` with the complex factor a of least squares (in whitened entries), in
      real and imaginary part. A measured shape that is real up to a phase has real rows only: the model shape is first
      rotated to its most real phase, as in the MAC.

    A measured mode without a partner counts as a difference of 1 in frequency and damping (100 %) and as MAC 0, so that
    losing a pair can only raise the sum of squares. Modes are paired anew at every point; a search that accepts only
    decreasing sums of squares is safe against changes of pairing.

    Attributes
    ----------
    problem : ModalProblem
    floors : Floors
    pool : bool or None
        See `std_for`.
    use_damping, use_shapes : bool
        False omits those rows.
    factor_sensors : tuple of str or None
        Names of the sensors on which the factors of shapes are fitted; the other sensors are predicted. None for all.
    faults : tuple of ModalFault
        Faults of this measurement, whose magnitudes are parameters beside those of the model; 0 unless set.
    std : StandardDeviations
    rows : tuple of Row
        Length n_rows.
    """

    problem: ModalProblem
    floors: Floors = USUAL
    pool: bool | None = None
    use_damping: bool = True
    use_shapes: bool = True
    factor_sensors: tuple[str, ...] | None = None
    faults: tuple[ModalFault, ...] = ()
    std: StandardDeviations = field(init=False, repr=False)
    rows: tuple[Row, ...] = field(init=False, repr=False)
    _damped: tuple[int, ...] = field(init=False, repr=False)
    _parts: tuple[tuple[int, str], ...] = field(init=False, repr=False)
    _readings: Readings = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "std", std_for(self.problem.measured, self.floors, self.pool))
        object.__setattr__(self, "_damped", self._damping_modes())
        object.__setattr__(self, "_parts", self._shape_parts())
        object.__setattr__(self, "rows", self._rows())
        object.__setattr__(self, "_readings", Readings(self.faults, 2 * np.pi * self.problem.measured.natural_freq))

    def _rows(self) -> tuple[Row, ...]:
        measured = self.problem.measured
        rows = [Row(mode, "frequency") for mode in measured.names]
        rows += [Row(measured.names[i], "damping") for i in self._damped]
        for i, part in self._parts:
            known = np.flatnonzero(np.isfinite(measured.shapes[:, i]))
            rows += [Row(measured.names[i], "shape", measured.sensors[s].name, part) for s in known]
        return tuple(rows)

    def _damping_modes(self) -> tuple[int, ...]:
        """Measured modes with a damping row."""
        if not self.use_damping or not self.problem.model.dissipates:
            return ()
        return tuple(np.flatnonzero(self.problem.measured.damping_ratio > 0).tolist())

    def _shape_parts(self) -> tuple[tuple[int, str], ...]:
        """Measured modes and parts of their shapes, in row order; a single sensor carries no information."""
        shapes = self.problem.measured.shapes
        if not self.use_shapes or not self.problem.measured.has_shapes:
            return ()
        real = is_real(shapes)
        several = np.isfinite(shapes).sum(axis=0) > 1
        out: list[tuple[int, str]] = []
        for i in np.flatnonzero(several).tolist():
            out += [(i, "re")] if real[i] else [(i, "re"), (i, "im")]
        return tuple(out)

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the residual or its derivatives at the same named values could."""
        std = (self.std.freq, self.std.damping, self.std.shape)
        layout = (self.rows, self._damped, self._parts, self.factor_sensors)
        faults = [(f.name, f.shares, f.damping) for f in self.faults]
        return digest_of(_DEFINITION, self.problem.fingerprint, std, layout, *([faults] if faults else []))[:16]

    @property
    def kinds(self) -> np.ndarray:
        """Kind of every row, shape (n_rows,), str."""
        return np.array([row.kind for row in self.rows])

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row, (n_rows,): relative for frequencies and damping, as given for shapes."""
        shapes = self.problem.measured.shapes
        blocks = [self.std.freq, self.std.damping[list(self._damped)]]
        blocks += [self.std.shape[np.isfinite(shapes[:, i]), i] for i, _ in self._parts]
        return np.concatenate(blocks)

    @property
    def n_rows(self) -> int:
        """Number of comparisons."""
        return len(self.rows)

    @property
    def n_fitted_factors(self) -> int:
        """Real numbers fitted to the scale and phase of model shapes, which reduce the degrees of freedom."""
        return len(self._parts)

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Fitted factors by mode and kind."""
        counts: dict[tuple[str, str], int] = {}
        for i, _ in self._parts:
            block = (self.problem.measured.names[i], "shape")
            counts[block] = counts.get(block, 0) + 1
        return counts

    @property
    def std_dof(self) -> dict[str, float]:
        """Degrees of freedom behind the standard deviation of each kind of row; infinite where it is known."""
        counts = Counter(self.kinds.tolist())
        counts["shape"] -= self.n_fitted_factors
        own, floors, pool = self.problem.measured, self.floors, self.pool
        return {k: float(dof_behind(own, k, n, floors, pool)) for k, n in counts.items() if n > 0}

    def n_fitted_factors_of(self, modes: Collection[str]) -> int:
        """Number of fitted factors of some measured modes."""
        return sum(self.problem.measured.names[i] in modes for i, _ in self._parts)

    # -- at named values -----------------------------------------------------------------------------------------------

    @cached_property
    def space(self) -> ParameterSpace:
        """Parameters of the model, and after them the magnitudes of faults."""
        own = self.problem.space
        more = tuple(fault.magnitude for fault in self.faults)
        return ParameterSpace((*own.parameters, *more), own.constraints) if more else own

    @property
    def told_by_responses(self) -> bool:
        """Whether a solution can be restored from its responses."""
        return False

    def with_model(self, model: ModalModel, added: int | None = None) -> ModalResidual:
        """The same measurement with another model; see `ModalProblem.with_model`."""
        return replace(self, problem=self.problem.with_model(model, added))

    def solve(self, values: Mapping[str, float]) -> Comparison:
        """Comparison at named values; EvaluationError when the model cannot be solved there."""
        at = self._readings.active(values)
        found = self.problem.compare({name: value for name, value in values.items() if name not in self._readings})
        return self._with_faults(found, at) if at else found

    def _with_faults(self, found: Comparison, at: Mapping[str, float]) -> Comparison:
        """A comparison with faults: modes are paired by what the sensors read."""
        readings, problem = self._readings, self.problem
        if not problem.measured.has_shapes or not readings.reach_shapes(at):
            return replace(found, faults=at)
        motions, omega = self._sources @ found.modes.shapes, 2 * np.pi * found.modes.natural_freq
        read = np.column_stack(
            [readings.shape(at, w, v, m) for w, v, m in zip(omega, found.sensor_shapes.T, motions.T, strict=True)]
        )
        shares = problem.energy_shares(found.values, found.modes)
        pairing, mac, emac = problem.pair(problem.measured.shapes, read, shares, found.modes)
        return replace(found, faults=at, pairing=pairing, mac=mac, emac=emac)

    def responses(self, solution: Comparison) -> dict[str, float]:
        """See `ModalProblem.responses`."""
        return self.problem.responses(solution)

    def unpaired(self, solution: Comparison) -> frozenset[str]:
        """Measured modes without a partner."""
        return frozenset(self.problem.measured.names[i] for i in solution.pairing.unpaired_measured)

    def restored(self, responses: Mapping[str, float]) -> None:
        """None: modes cannot be restored from responses."""
        return

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual at named values, shape (n_rows,); EvaluationError when the model cannot be solved there."""
        return self.of(self.solve(values))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the residual, per unit of each parameter, shape (n_rows, n_params).

        Shape rows hold ``-a (I - v v^H/v^H v) dv/std``: the part of the derivative along v, which is proportional to
        the residual and orthogonal to it, is left out (Kaufman 1975), so that it carries no information. The gradient
        of the sum of squares is exact. Rows of unpaired modes, and shape rows of modes without a derivative (see
        `calib.structure.derivatives`), are 0.
        """
        return self.slope(values, names, self.solve)

    def slope(
        self, values: Mapping[str, float], names: Sequence[str], at: Callable[[Mapping[str, float]], Comparison]
    ) -> np.ndarray:
        """The Jacobian with solutions from ``at``."""
        own = [name for name in names if name not in self._readings]
        found = at(self.regular(values, own))
        if len(own) == len(names):
            return self.slope_of(found, names, self.derivatives(found, names, at))
        columns = np.zeros((self.n_rows, len(names)))
        if own:
            columns[:, [name not in self._readings for name in names]] = self.slope(values, own, at)
            found = at(values)
        motions = self._sources @ found.modes.shapes
        for k, name in enumerate(names):
            if name in self._readings:
                columns[:, k] = self._fault_slope(found, name, motions)
        return columns

    def frequencies(
        self, values: Mapping[str, float], names: Sequence[str], at: Callable[[Mapping[str, float]], Comparison]
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Frequencies of all model modes with their relative derivatives, for prediction intervals.

        Parameters
        ----------
        values : mapping
        names : sequence of str
        at : callable
            Returns the comparison at named values.

        Returns
        -------
        labels : tuple of str
            Name of the measured mode, or ``model 7`` for an unpaired model mode.
        freq : ndarray (n_modes,)
            Natural frequencies of the model, Hz.
        jacobian : ndarray (n_modes, n_params)
            Of ``ln natural_freq``, per unit of each parameter.
        """
        found = at(self.regular(values, names))
        freq, index = found.modes.natural_freq, found.pairing.model_index
        owner = {int(index[i]): self.problem.measured.names[i] for i in found.pairing.paired}
        slopes = self._derivatives(found, names, range(len(freq)), np.zeros((0, found.modes.shapes.shape[0])), at)
        labels = tuple(owner.get(j, f"model {j + 1}") for j in range(len(freq)))
        return labels, freq, (slopes.natural_freq / freq).T

    def regular(self, values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
        """Point at which derivatives by the named parameters are taken; see `beside_roots`."""
        own = {name: value for name, value in values.items() if name not in self._readings}
        return beside_roots(self.problem.space, self.problem.model.roots, own, names) | self._readings.active(values)

    def derivatives(
        self,
        found: Comparison,
        names: Sequence[str],
        at: Callable[[Mapping[str, float]], Comparison] | None = None,
    ) -> ModeDerivatives:
        """Derivatives of the paired modes, in the order of the measured modes, with shapes at the sensors.

        ``at`` returns comparisons at other values, for a model whose derivatives are differences; by default they are
        solved.
        """
        chosen = found.pairing.model_index[found.pairing.paired]
        rows = self.problem.sensor_rows if self._parts else np.zeros((0, found.modes.shapes.shape[0]))
        if self._parts and found.faults:
            rows = np.vstack([rows, self._sources.toarray()])
        return self._derivatives(found, names, chosen, rows, at)

    def _derivatives(
        self,
        found: Comparison,
        names: Sequence[str],
        chosen: Sequence[int] | np.ndarray,
        rows: np.ndarray,
        at: Callable[[Mapping[str, float]], Comparison] | None,
    ) -> ModeDerivatives:
        reached = at or self.solve
        return self.problem.model.derivatives(
            found.values, found.modes, names, chosen, rows, lambda values: reached(values).modes
        )

    # -- from a comparison ---------------------------------------------------------------------------------------------

    def of(self, found: Comparison) -> np.ndarray:
        """Whitened residual of an existing comparison, shape (n_rows,)."""
        measured, std = self.problem.measured, self.std
        freq = found.paired(found.modes.natural_freq)
        ratio = self._ratio(found)
        damped = list(self._damped)
        with np.errstate(invalid="ignore"):
            blocks = [
                np.nan_to_num(np.log(measured.natural_freq / freq), nan=1.0) / std.freq,
                np.nan_to_num(np.log(measured.damping_ratio[damped] / ratio[damped]), nan=1.0) / std.damping[damped],
            ]
        fitted: dict[int, FittedShape] = {}
        for i, part in self._parts:
            if i not in fitted:
                fitted[i] = self._fit(found, i)
            blocks.append(fitted[i].residual.real if part == "re" else fitted[i].residual.imag)
        return np.concatenate(blocks)

    def slope_of(self, found: Comparison, names: Sequence[str], slopes: ModeDerivatives) -> np.ndarray:
        """Derivative of the residual of an existing comparison; ``slopes`` as from `derivatives`."""
        std, n = self.std, len(names)
        place = {int(i): k for k, i in enumerate(found.pairing.paired)}
        zero = np.zeros(n)
        blocks = []
        for i in range(self.problem.measured.n_modes):
            k = place.get(i)
            freq = zero if k is None else slopes.natural_freq[:, k] / found.modes.natural_freq[self._partner(found, i)]
            blocks.append(-freq[None] / std.freq[i])
        for i in self._damped:
            k = place.get(i)
            ratio = 0.0 if k is None else float(self._ratio(found)[i])
            known = k is not None and ratio > _LEAST_RATIO
            blocks.append(-(slopes.damping_ratio[:, k] / ratio if known else zero)[None] / std.damping[i])
        turned: dict[int, np.ndarray] = {}
        for i, part in self._parts:
            k = place.get(i)
            if i not in turned:
                fit = self._fit(found, i)
                blank = k is None or not slopes.regular[k]
                turned[i] = np.zeros((len(fit.residual), n)) if blank else fit.slope(self._read(found, i, slopes))
            blocks.append(turned[i].real if part == "re" else turned[i].imag)
        return np.vstack(blocks)

    def factor_spread(self, found: Comparison) -> np.ndarray:
        """Sensitivity of the residual to one standard deviation of every fitted factor, (n_rows, n_fitted_factors).

        The noise n of the sensors used to fit a factor changes it by ``v^H n/v^H v`` (whitened entries), with standard
        deviation ``1/|v|`` in real and imaginary part each, and with it the predictions at all other sensors. This is
        independent of the effect of the noise on the parameters, whose derivative is orthogonal to v. Rows of the
        sensors used are 0: their noise is in the residual.
        """
        blocks = [np.zeros((int(np.sum(self.kinds != "shape")), self.n_fitted_factors))]
        for k, (i, part) in enumerate(self._parts):
            fit, width = self._fit(found, i), 2 if (i, "im") in self._parts else 1
            first = k if part == "re" else k - 1
            moved = np.where(fit.on, 0.0, -fit.shape)[:, None] * np.array([1.0, 1.0j])[:width]
            block = np.zeros((len(moved), self.n_fitted_factors))
            block[:, first : first + width] = moved.real if part == "re" else moved.imag
            blocks.append(block / (math.sqrt(fit.power) or 1.0))
        return np.vstack(blocks)

    def _ratio(self, found: Comparison) -> np.ndarray:
        """Damping ratios of the partners as the analysis gives them, (n_measured,); NaN where unpaired."""
        added = self._readings.added_damping(found.faults) if found.faults else 0.0
        return np.asarray(np.maximum(found.paired(found.modes.damping_ratio) + added, _LEAST_RATIO))

    def _read(self, found: Comparison, i: int, slopes: ModeDerivatives) -> np.ndarray:
        """Derivatives of the reading of measured mode i, (n_sensors, n_params), from those of motions."""
        change = slopes.shapes[:, :, found.pairing.paired.tolist().index(i)].T
        if not found.faults:
            return change
        n = len(self.problem.measured.sensors)
        return self._readings.shape(found.faults, self._readings.omega[i], change[:n], change[n:])

    def _fault_slope(self, found: Comparison, name: str, motions: np.ndarray) -> np.ndarray:
        """Derivative of the residual by the magnitude of a fault, (n_rows,)."""
        measured, readings = self.problem.measured, self._readings
        ratio, more = self._ratio(found), readings.damping_slope(name)
        out = [np.zeros(measured.n_modes)]
        damped = list(self._damped)
        with np.errstate(invalid="ignore"):
            known = ratio[damped] > _LEAST_RATIO
        out.append(np.where(known, -more[damped] / ratio[damped], 0.0) / self.std.damping[damped])
        turned: dict[int, np.ndarray] = {}
        for i, part in self._parts:
            if i not in turned:
                fit, j = self._fit(found, i), self._partner(found, i)
                if j < 0:
                    turned[i] = np.zeros(len(fit.residual), dtype=complex)
                elif readings.turns_to_modulus(name):
                    turned[i] = fit.modulus_slope
                else:
                    change = readings.shape_slope(found.faults, name, i, len(measured.sensors), motions[:, j])
                    turned[i] = fit.slope(change[:, None])[:, 0]
            out.append(turned[i].real if part == "re" else turned[i].imag)
        return np.concatenate(out)

    @cached_property
    def _sources(self) -> sp.csr_array:
        """Motions of which faulty channels read a share, over the degrees of freedom, (n_sources, n_dof)."""
        return sp.csr_array(self.problem.model.sensor_rows(self._readings.sources))

    @staticmethod
    def _partner(found: Comparison, i: int) -> int:
        return int(found.pairing.model_index[i])

    def _fit(self, found: Comparison, i: int) -> FittedShape:
        measured, j = self.problem.measured, self._partner(found, i)
        known = np.isfinite(measured.shapes[:, i])
        target, std = measured.shapes[known, i], self.std.shape[known, i]
        shape = np.zeros(len(target)) if j < 0 else self._reading(found, i, j)[known]
        on = np.ones(len(target), dtype=bool)
        if self.factor_sensors is not None:
            on = np.array([s.name in self.factor_sensors for s in measured.sensors])[known]
        modulus = self._readings.modulus(found.faults)
        return FittedShape.of(target, shape.astype(complex), std, known, on, (i, "im") not in self._parts, modulus)

    def _reading(self, found: Comparison, i: int, j: int) -> np.ndarray:
        """What the sensors read of model mode j as measured mode i, (n_sensors,)."""
        shape = found.sensor_shapes[:, j]
        if not found.faults:
            return shape
        omega = self._readings.omega[i]
        return self._readings.shape(found.faults, omega, shape, self._sources @ found.modes.shapes[:, j])
