"""Checks that hold for a library of effects on any model; the tests of each library assess their numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from calib import Effect, MeasuredModes, ParameterSpace, Sensor, StructuralModel
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import Floors
from calib.measurement.mac import mac
from calib.structure import Addition, Modes, extend
from calib.structure.eigenproblem.symmetric_factor import symmetric_factor

STD_FREQ, STD_DAMPING, STD_SHAPE = 0.005, 0.07, 0.025
"""Standard deviation of the mean of five repeats: relative, relative, of the largest motion."""
PRIOR = {"K_": 0.15, "E_": 0.15, "RM": 0.4, "c_": 0.4}
"""Relative prior width of parameters by the start of their names; that of all others is 20 in their own unit."""
LEAST_PIVOT = 1e-9


def points(effect: Effect) -> Sequence[Mapping[str, float]]:
    """Plausible magnitudes, with nuisance parameters where there are any."""
    return effect.grid or ({effect.name: effect.plausible},)


def limits(effect: Effect) -> list[dict[str, float]]:
    """Both limits of the magnitude, each with nuisance parameters as they are and at their limits."""
    nuisance = [{}, *({q.name: v} for q in effect.nuisance for v in (q.lower, q.upper))]
    return [{effect.name: s, **own} for s in (effect.magnitude.lower, effect.magnitude.upper) for own in nuisance]


def noise_free(model: StructuralModel, sensors: Sequence[Sensor], modes: Modes, which: Sequence[int]) -> MeasuredModes:
    """Some modes of a model as measured without error, with the standard deviations above."""
    chosen = list(which)
    shapes = model.sensor_rows(sensors) @ modes.shapes[:, chosen]
    freq, ratio = modes.natural_freq[chosen], modes.damping_ratio[chosen]
    return MeasuredModes(
        names=tuple(f"mode {k + 1}" for k in chosen),
        natural_freq=freq,
        damped_freq=modes.damped_freq[chosen],
        freq_std=STD_FREQ * freq,
        damping_ratio=ratio,
        damping_std=STD_DAMPING * ratio,
        sensors=tuple(sensors),
        shapes=shapes / np.abs(shapes).max(axis=0),
        shape_std=np.full(shapes.shape, STD_SHAPE),
    )


def outside(vector: np.ndarray, columns: np.ndarray, prior: bool) -> float:
    """Share of a vector outside the span of columns; with a prior they may move by about their own size only."""
    g = np.vstack([columns, np.eye(columns.shape[1])]) if prior else columns
    q = np.linalg.qr(g)[0]
    wide = np.pad(vector, (0, len(g) - len(vector)))
    return float(np.linalg.norm(wide - q @ (q.T @ wide)) / np.linalg.norm(vector))


@dataclass(frozen=True, eq=False)
class Alone:
    """Each effect by itself on a base model."""

    base: StructuralModel
    effects: Mapping[str, Effect]
    _built: dict[str, Addition] = field(init=False, default_factory=dict)

    def addition(self, name: str) -> Addition:
        """Matrices that the effect adds."""
        if name not in self._built:
            self._built[name] = self.effects[name].build(self.base)
        return self._built[name]

    def change(self, name: str, values: Mapping[str, float]) -> list[sp.csr_array]:
        """Its K, C and M over the base model's degrees of freedom and its own; selected terms are left out."""
        space = ParameterSpace(self.base.space.parameters + self.effects[name].parameters)
        si, added = space.si(space.complete(values)), self.addition(name)
        zero = sp.csr_array((self.base.n_dof + added.n_added,) * 2)
        return [
            sp.csr_array(sum((t.matrix * t.coefficient(si) for t in terms), zero))
            for terms in (added.stiffness, added.damping, added.mass)
        ]

    def field(self, motion: Callable[..., Sequence[Any]], bodies: Collection[str] | None = None) -> np.ndarray:
        """See `field_of`."""
        return field_of(self.base, motion, bodies)

    def rigid(self, *arguments: Any) -> np.ndarray:
        """See `rigid`."""
        return rigid(self.base, *arguments)


def field_of(
    model: StructuralModel, motion: Callable[..., Sequence[Any]], bodies: Collection[str] | None = None
) -> np.ndarray:
    """Motion of bodies (all by default) by a function of x, y and z that gives three shifts and three turns."""
    frame, d, node = model.locator.frame, model.dofs.direction, model.dofs.node
    full = np.stack(np.broadcast_arrays(*motion(*frame.points.T)), axis=1)
    own = np.array([bodies is None or frame.bodies[k] in bodies for k in node])
    return np.where(own, full[node, d], 0.0)


def rigid(
    model: StructuralModel,
    direction: int,
    bodies: Collection[str] | None = None,
    centre: Sequence[float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """Motion of bodies (all by default) as one rigid piece, over the degrees of freedom there are."""
    unit = np.eye(6)[direction]

    def motion(*places: np.ndarray) -> list[Any]:
        arms = np.stack(places, axis=1) - np.asarray(centre)
        return [*(unit[:3] + np.cross(unit[3:], arms)).T, *unit[3:]]

    return field_of(model, motion, bodies)


def energy(matrix: sp.csr_array, motion: np.ndarray) -> float:
    """Product of a matrix with a motion of the base model on either side; what was added stands still."""
    wide = np.pad(motion, (0, matrix.shape[0] - len(motion)))
    return float(wide @ matrix @ wide)


@dataclass(frozen=True, eq=False)
class Library:
    """A base model and the effects it may lack, all of them terms of one model that is made once.

    Attributes
    ----------
    base : StructuralModel
    effects : mapping from str to Effect
    measured : callable
        Gives the measured modes on which signatures are defined.
    mode_count : int
        Modes solved for them.
    asked : tuple of str
        Continuous parameters of the base model that columns are asked for; empty for all.
    """

    base: StructuralModel
    effects: Mapping[str, Effect]
    measured: Callable[[], MeasuredModes]
    mode_count: int
    asked: tuple[str, ...] = ()
    _single: dict[str, StructuralModel] = field(init=False, default_factory=dict)

    @cached_property
    def _once(self) -> Mapping[str, Effect]:
        """The effects, each built once however many models have it: all those models are made from one base."""
        built = Alone(self.base, self.effects)
        return {n: replace(e, build=lambda _, name=n: built.addition(name)) for n, e in self.effects.items()}

    @cached_property
    def together(self) -> StructuralModel:
        """The base model with every effect."""
        return extend(self.base, list(self._once.values()))

    def alone(self, name: str) -> StructuralModel:
        """The base model with one effect; all effects without a grid, which add no motions, share one model."""
        key = name if self.effects[name].grid else ""
        if key not in self._single:
            plain = [e for e in self._once.values() if not e.grid]
            self._single[key] = extend(self.base, [self._once[name]] if key else plain)
        return self._single[key]

    def values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Complete values of the common model, with all effects at 0 but those named."""
        return self.together.space.complete(dict.fromkeys(self.effects, 0.0) | dict(values))

    def gap(self, values: Mapping[str, float]) -> float:
        """Largest relative difference of the common model's matrices from the base model's; coupling counts too."""
        n, worst = self.base.n_dof, 0.0
        for own, bare in zip(self.together.matrices(self.values(values)), self.base.matrices({}), strict=True):
            scale = abs(bare).max()
            worst = max(worst, abs(own[:n, :n] - bare).max() / scale, abs(own[:n, n:]).max() / scale)
        return float(worst)

    def slope_gaps(self, name: str, others: Mapping[str, float]) -> dict[str, float]:
        """How far each derivative of the matrices is from differences, over what rounding allows, at most 1.

        By the effect's parameters and by those of the base model that its terms depend on.
        """
        effect, model = self.effects[name], self.together
        point = self.values({**others, **points(effect)[0]})
        terms = [t for own in (model.stiffness, model.damping, model.mass) for t in (*own.terms, *own.selected)]
        mixed = {n for t in terms if name in t.coefficient.names for n in t.coefficient.names}
        out = {}
        for moving in (*effect.names, *sorted(mixed & set(self.base.space.names))):
            step = 1e-4 * max(abs(point[moving]), 1e-6)
            up, down = (model.matrices({**point, moving: point[moving] + s * step}) for s in (1, -1))
            slopes = model.matrix_derivatives(point, moving)
            out[moving] = 0.0 if any(abs(slope).max() > 0 for slope in slopes) else np.inf
            for slope, above, below in zip(slopes, up, down, strict=True):
                allowed = 1e-6 * abs(slope).max() + 1e-13 * abs(above).max() / step
                error = abs((above - below) / (2 * step) - slope).max()
                out[moving] = max(out[moving], float(error / allowed) if allowed else 0.0)
        return out

    def negative_directions(self, values: Mapping[str, float]) -> int:
        """How many directions K, C or M have in which they are negative beyond rounding (Sylvester's law of inertia).

        A matrix that is only added to keeps the directions of the one with all effects at 0, and is not factored.
        """
        found = 0
        for matrix, before, still in zip(
            self.together.matrices(self.values(values)), self._still, self._negative_still, strict=True
        ):
            change = sp.csr_array(matrix - before)
            change.eliminate_zeros()
            seen = np.unique(change.nonzero()[0])
            size = np.linalg.eigvalsh(change[seen][:, seen].toarray()) if 0 < len(seen) < 500 else np.full(1, -np.inf)
            added = len(seen) == 0 or size[0] >= -1e-12 * size[-1]
            found += still if added else _negative(matrix)
        return found

    @cached_property
    def _negative_still(self) -> tuple[int, ...]:
        return tuple(map(_negative, self._still))

    def solved(self, values: Mapping[str, float]) -> Modes:
        """Modes of the model with the one effect whose parameters are named."""
        (name,) = (n for n in values if n in self.effects)
        model = self.alone(name)
        zero = {n: 0.0 for n in self.effects if n in model.space and n != name}
        return model.modes({**zero, **values}, self.mode_count + model.n_dof - self.base.n_dof)

    def residual(self, name: str | None = None) -> ModalResidual:
        """Whitened differences of the model with one effect, or of the base model, from the measurement."""
        model = self.base if name is None else self.alone(name)
        count = self.mode_count + model.n_dof - self.base.n_dof
        problem = ModalProblem(model, self._measured, mode_count=count, threshold=0.1)
        return ModalResidual(problem, Floors(freq=0.0, damping=0.0, shape=0.0))

    @cached_property
    def _measured(self) -> MeasuredModes:
        return self.measured()

    @cached_property
    def _still(self) -> tuple[sp.csr_array, ...]:
        """Matrices of the common model with all effects at 0."""
        return tuple(self.together.matrices(self.values({})))

    @cached_property
    def _own(self) -> tuple[str, ...]:
        """Parameters of the base model by which there are derivatives."""
        return self.asked or tuple(p.name for p in self.base.space.parameters if not p.integer)

    @cached_property
    def _slopes(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Derivatives by those parameters and by every effect without a grid."""
        effects = tuple(n for n, e in self.effects.items() if not e.grid)
        residual = self.residual(effects[0])
        return self._own + effects, residual.jacobian(dict.fromkeys(effects, 0.0), self._own + effects)

    def columns(self, names: Sequence[str] | None = None) -> np.ndarray:
        """Derivatives by parameters of the base model over their prior widths, (n_rows, n_names); all by default."""
        known, slopes = self._slopes
        own = self._own if names is None else list(names)
        widths = [PRIOR.get(n[:2], 0.0) * self.base.space[n].value or 20.0 for n in own]
        return slopes[:, [known.index(n) for n in own]] * widths

    def signatures(self, name: str) -> Iterator[np.ndarray]:
        """Signature of an effect in the residual: a derivative, or a difference for every point of its grid in turn."""
        effect = self.effects[name]
        if not effect.grid:
            known, slopes = self._slopes
            yield slopes[:, known.index(name)] * effect.plausible
        for point in effect.grid:
            yield self.residual(name).residual(point)


def _negative(matrix: sp.csr_array) -> int:
    """Directions in which a matrix is negative beyond rounding."""
    scale = sp.diags_array(1 / np.sqrt(np.maximum(abs(matrix).max(axis=0).toarray().ravel(), 1e-12)))
    scaled = scale @ matrix @ scale + LEAST_PIVOT * sp.eye_array(matrix.shape[0])
    return int(np.count_nonzero(symmetric_factor(sp.csc_array(scaled)).pivots < 0))


def frequency_changes(
    base: StructuralModel, effect: Effect, values: Mapping[str, float], sensors: Sequence[Sensor], nominal: Modes
) -> np.ndarray:
    """Relative change of the natural frequency of every mode of ``nominal`` by one effect, partners found by MAC."""
    model = extend(base, [effect])
    moved = model.modes(values, nominal.n_modes + 4 + model.n_dof - base.n_dof)
    rows = base.sensor_rows(sensors)
    wide = np.pad(rows, ((0, 0), (0, model.n_dof - base.n_dof)))
    partner = mac(rows @ nominal.shapes, wide @ moved.shapes).argmax(axis=1)
    assert len(set(partner.tolist())) == nominal.n_modes
    changes: np.ndarray = moved.natural_freq[partner] / nominal.natural_freq - 1
    return changes
