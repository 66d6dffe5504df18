"""Whitened residual of measured and model modes, with derivatives."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.faults import ModalFault
from calib.correlation.modal.faulty_modes import FaultyModes
from calib.correlation.modal.fitted_shape import FittedShape
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.rigid import both_meshes
from calib.correlation.modal.rows import ModalRow, damping_modes, modal_rows, shape_parts
from calib.correlation.standard_deviations import USUAL, Floors, StandardDeviations, dof_behind, std_for
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of
from calib.structure.eigenproblem.derivatives import ModeDerivatives, beside_roots
from calib.structure.modal_model import ModalModel
from calib.structure.modes import Modes

_LEAST_RATIO = 1e-6
"""Lower bound of model damping ratios, which keeps their logarithm finite."""

_DEFINITION = "modal residual 3"
"""Part of the fingerprint; increment it whenever the same modes would give another residual or derivative."""


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
    rows: tuple[ModalRow, ...] = field(init=False, repr=False)
    _damped: tuple[int, ...] = field(init=False, repr=False)
    _parts: tuple[tuple[int, str], ...] = field(init=False, repr=False)
    _faulty: FaultyModes = field(init=False, repr=False)

    def __post_init__(self) -> None:
        measured = self.problem.measured
        damped = damping_modes(measured) if self.use_damping and self.problem.model.dissipates else ()
        parts = shape_parts(measured) if self.use_shapes else ()
        object.__setattr__(self, "std", std_for(measured, self.floors, self.pool))
        object.__setattr__(self, "_damped", damped)
        object.__setattr__(self, "_parts", parts)
        object.__setattr__(self, "rows", modal_rows(measured, damped, parts))
        object.__setattr__(self, "_faulty", FaultyModes(self.problem, self.faults))

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the residual or its derivatives at the same named values could."""
        layout = (len(self.rows), self._damped, self._parts, self.factor_sensors)  # the measurement has their names
        faults = [(f.name, f.shares, f.damping, f.mixed) for f in self.faults]
        mesh, step = self.problem.mesh, getattr(self.problem.model, "step", None)  # of a function's derivatives
        further = [faults or None, None if mesh is None else mesh.fingerprint, step]
        own = ((self.std.freq, self.std.damping, self.std.shape), layout, *(one for one in further if one is not None))
        return digest_of(_DEFINITION, self.problem.fingerprint, *own)[:16]

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
    def shared_errors(self) -> np.ndarray:
        """(n_rows, 0): modes share no errors that their standard deviations do not tell."""
        return np.zeros((len(self.rows), 0))

    @property
    def row_freqs(self) -> np.ndarray:
        """Natural frequency of the measured mode of every row, (n_rows,), Hz."""
        measured = self.problem.measured
        known = dict(zip(measured.names, measured.natural_freq.tolist(), strict=True))
        return np.array([known[row.mode] for row in self.rows])

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
        return dict(Counter((self.problem.measured.names[i], "shape") for i, _ in self._parts))

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
        """Parameters of the model, and after them the magnitudes of faults and the error of the mesh."""
        own = self.problem.space
        more = tuple(fault.magnitude for fault in self.faults)
        more += () if self.problem.mesh is None else (self.problem.mesh.parameter,)
        return ParameterSpace((*own.parameters, *more), own.constraints) if more else own

    @property
    def told_by_responses(self) -> bool:
        """Whether a solution can be restored from its responses."""
        return False

    def with_model(self, model: ModalModel, added: int | None = None) -> ModalResidual:
        """The same measurement with another model; see `ModalProblem.with_model`."""
        return replace(self, problem=self.problem.with_model(model, added))

    def solve(self, values: Mapping[str, float], solved: Modes | None = None) -> Comparison:
        """Comparison at named values, of modes already ``solved`` there, if given; raises as `ModalProblem.compare`."""
        return self._faulty.compared(values, solved)

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
        `calib.structure.eigenproblem.derivatives`), are 0.
        """
        return self.slope(values, names, self.solve)

    def slope(
        self, values: Mapping[str, float], names: Sequence[str], at: Callable[[Mapping[str, float]], Comparison]
    ) -> np.ndarray:
        """The Jacobian with solutions from ``at``."""
        of_test = self._faulty.readings.names
        own = [name for name in names if name not in of_test]
        found = at(self.regular(values, own))
        if len(own) == len(names):
            return self.slope_of(found, names, self.derivatives(found, names, at))
        columns = np.zeros((self.n_rows, len(names)))
        if own:
            columns[:, [name not in of_test for name in names]] = self.slope(values, own, at)
            found = at(values)
        faults = [k for k, name in enumerate(names) if name in of_test]
        columns[:, faults] = self._fault_slopes(found, [names[k] for k in faults])
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
        mesh = self.problem.mesh
        own = self._faulty.without(values)
        if mesh is not None:
            own, names = mesh.without(own), mesh.others(names)
        point = beside_roots(self.problem.space, self.problem.model.roots, own, names)
        point |= {} if mesh is None else {mesh.name: mesh.at(values)}
        return point | self._faulty.readings.active(values)

    def derivatives(
        self, found: Comparison, names: Sequence[str], at: Callable[[Mapping[str, float]], Comparison] | None = None
    ) -> ModeDerivatives:
        """Derivatives of the paired modes, in the order of the measured modes, with shapes at the sensors.

        ``at`` returns comparisons at other values, for a model whose derivatives are differences; by default they are
        solved. The error of the mesh changes no mode.
        """
        mesh, chosen = self.problem.mesh, found.pairing.model_index[found.pairing.paired]
        rows = self._faulty.rows(found) if self._parts else np.zeros((0, found.modes.shapes.shape[0]))
        return self._derivatives(found, names if mesh is None else mesh.others(names), chosen, rows, at)

    def _derivatives(
        self, found: Comparison, names: Sequence[str], chosen: Sequence[int] | np.ndarray, rows: np.ndarray,
        at: Callable[[Mapping[str, float]], Comparison] | None,
    ) -> ModeDerivatives:  # fmt: skip
        reached, own = at or self.solve, (found.values, found.modes, names, chosen, rows)
        return self.problem.model.derivatives(*own, lambda values: reached(values).modes)

    # -- from a comparison ---------------------------------------------------------------------------------------------

    def of(self, found: Comparison) -> np.ndarray:
        """Whitened residual of an existing comparison, shape (n_rows,)."""
        measured, std = self.problem.measured, self.std
        freq = found.paired(found.modes.natural_freq)
        ratio, damped = self._ratio(found), list(self._damped)
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
        left = np.concatenate(blocks)
        return left - found.mesh_error * self.mesh_change if found.mesh_error else left

    @cached_property
    def mesh_change(self) -> np.ndarray:
        """Change of the whitened predictions to a finer mesh, (n_rows,); 0 for modes that it lacks."""
        here, there, lost = both_meshes(self.problem)
        return np.where([row.mode in lost for row in self.rows], 0.0, self.of(here) - self.of(there))

    def slope_of(self, found: Comparison, names: Sequence[str], slopes: ModeDerivatives) -> np.ndarray:
        """Derivative of the residual of an existing comparison; ``slopes`` as from `derivatives`."""
        mesh = self.problem.mesh
        if mesh is not None and mesh.name in names:
            own = self.slope_of(found, mesh.others(names), slopes)
            return np.insert(own, list(names).index(mesh.name), -self.mesh_change, axis=1)
        measured, n = self.problem.measured, len(names)
        place = {int(i): k for k, i in enumerate(found.pairing.paired)}
        freq, damping = np.zeros((measured.n_modes, n)), np.zeros((measured.n_modes, n))
        for i, k in place.items():
            freq[i] = slopes.natural_freq[:, k] / found.modes.natural_freq[int(found.pairing.model_index[i])]
            damping[i] = slopes.damping_ratio[:, k]

        def turned(i: int) -> np.ndarray | None:
            k = place.get(i)
            if k is None or not slopes.regular[k]:
                return None
            return self._fit(found, i).slope(self._faulty.reading_slope(found, i, k, slopes))

        return self._stacked(found, freq, damping, turned)

    def _fault_slopes(self, found: Comparison, names: Sequence[str]) -> np.ndarray:
        """Derivatives of the residual by the magnitudes of some faults, (n_rows, n_faults)."""
        readings, motions, measured = self._faulty.readings, self._faulty.motions(found), self.problem.measured
        slopes = readings.slopes(found.faults, names)

        def turned(i: int) -> np.ndarray | None:
            if (j := int(found.pairing.model_index[i])) < 0:
                return None
            fit = self._fit(found, i)
            out = fit.slope(slopes.of_mode(readings.omega[i], len(measured.sensors), motions[:, j]))
            for k, name in enumerate(names):
                if readings.turns_to_modulus(name):
                    out[:, k] = fit.modulus_slope
                elif readings.mixed(name)[:1] == measured.names[i : i + 1]:
                    out[:, k] = fit.target_slope(self._faulty.mixture(name))
            return out

        damping = np.column_stack([readings.damping_slope(name) for name in names])
        return self._stacked(found, np.zeros_like(damping), damping, turned)

    def _stacked(
        self,
        found: Comparison,
        freq: np.ndarray,
        damping: np.ndarray,
        turned: Callable[[int], np.ndarray | None],
    ) -> np.ndarray:
        """Derivatives of the residual, (n_rows, n), from those of ``ln freq`` and damping ratio, (n_measured, n).

        ``turned`` gives those of the shape rows of a measured mode, complex; None where they are 0.
        """
        std, damped, n = self.std, list(self._damped), freq.shape[1]
        with np.errstate(invalid="ignore"):
            ratio = self._ratio(found)[damped, None]
            known = np.where(ratio > _LEAST_RATIO, -damping[damped] / ratio, 0.0)
        blocks = [-freq / std.freq[:, None], known / std.damping[damped, None]]
        shapes: dict[int, np.ndarray | None] = {}
        for i, part in self._parts:
            if i not in shapes:
                shapes[i] = turned(i)
            one = shapes[i]
            if one is None:
                one = np.zeros((int(np.isfinite(self.problem.measured.shapes[:, i]).sum()), n))
            blocks.append(one.real if part == "re" else one.imag)
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
        ratio = found.paired(found.modes.damping_ratio) + self._faulty.added_damping(found)
        return np.asarray(np.maximum(ratio, _LEAST_RATIO))

    def _fit(self, found: Comparison, i: int) -> FittedShape:
        measured, j = self.problem.measured, int(found.pairing.model_index[i])
        known = np.isfinite(measured.shapes[:, i])
        target, std = (measured.shapes[:, i] - self._faulty.mixtures(found, i))[known], self.std.shape[known, i]
        shape = np.zeros(len(target)) if j < 0 else self._faulty.reading(found, i, j)[known]
        on = np.ones(len(target), dtype=bool)
        if self.factor_sensors is not None:
            on = np.array([s.name in self.factor_sensors for s in measured.sensors])[known]
        modulus = self._faulty.readings.modulus(found.faults)
        return FittedShape.of(target, shape.astype(complex), std, known, on, (i, "im") not in self._parts, modulus)
