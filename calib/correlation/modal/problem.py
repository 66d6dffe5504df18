"""Evaluation of a model against a measurement: named parameter values in, named responses out."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.correlation.mesh_error import MeshError
from calib.correlation.modal import pairing as pairs
from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.order import Costs
from calib.correlation.modal.pairing import Pairing
from calib.correlation.modal.subspaces import has_equal_modes, turned_to_measured
from calib.correlation.standard_deviations import assumed_deviations, known_std
from calib.errors.errors import EvaluationError, InputError
from calib.measurement.mac import mac
from calib.measurement.modal import MeasuredModes
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.mode_tracking import Point, follow
from calib.structure.modal_model import ModalModel
from calib.structure.model import Assumption, StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.mode_target import ModeTarget
from calib.structure.reduction.reduced import ReducedModel

RESPONSES = ("natural_freq", "damped_freq", "damping_ratio", "mac", "emac", "margin")
"""Responses of every measured mode, named like ``mac_1B``."""

_DEFINITION = "modal responses 3"
"""Part of the fingerprint; increment it whenever the same modes would give other responses."""

DAMPING_MAX = 0.95
"""Damping ratio from which a mode is exempt from the tolerance: a nearly critical eigenvalue is almost defective."""

_LEAST_FREQ = 1e-12
"""Lower bound of model frequencies in Hz, which keeps their logarithm finite."""


@dataclass(frozen=True, eq=False)
class ModalProblem:
    """A model with modes against a modal measurement: pairing, comparison and responses.

    Attributes
    ----------
    model : ModalModel
    measured : MeasuredModes
    mode_clusters : mapping from str to tuple of str
        The model's clusters that carry the sensors of each measured mode; a missing mode takes all strain energy, so
        that its EMAC equals its MAC.
    mode_count : int
        Number of model modes solved and available for pairing.
    threshold : float
        Smallest EMAC of a pair.
    freq_window : (low, high) or None
        Model modes whose natural frequency in Hz lies outside are not paired.
    override : mapping from str to int
        The user's choice of pairs: measured mode to model mode, counted from 1.
    reference : mapping from str to float
        Values at which modes without measured shapes are paired by the order of their frequencies; at other values the
        modes are tracked from there. Missing parameters take their nominal value.
    base : ModalProblem or None
        The same problem for the base model, without the added effects, whose magnitudes are almost 0 at the reference.
        There its pairs without shapes are inherited, since an uncoupled added motion is not a mode of the structure,
        however well its frequency fits. Pairs chosen in both problems refer to modes of the base model and are
        inherited like its other pairs.
    mesh : MeshError or None
        Error of the mesh that residuals include; None for an exact mesh.

    Raises
    ------
    InputError
        When a name, number or window does not fit model and measurement, or a sensor cannot be located on the model.
    """

    model: ModalModel
    measured: MeasuredModes
    mode_clusters: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mode_count: int = 20
    threshold: float = 0.3
    freq_window: tuple[float, float] | None = None
    override: Mapping[str, int] = field(default_factory=dict)
    reference: Mapping[str, float] = field(default_factory=dict)
    base: ModalProblem | None = None
    mesh: MeshError | None = None
    sensor_rows: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pairs.check_clusters(self.mode_clusters, self.measured.names, self.model.clusters, self.model.name)
        if self.mode_count < max(1, self.measured.n_modes):
            remedy = f"solve at least as many model modes as were measured ({self.measured.n_modes})"
            raise InputError(f"mode_count is {self.mode_count}", place="pairing", remedy=remedy)
        if not 0 <= self.threshold <= 1:
            raise InputError(f"threshold is {self.threshold}", place="pairing", remedy="choose between 0 and 1")
        if self.freq_window is not None and not 0 <= self.freq_window[0] < self.freq_window[1]:
            remedy = "give [low, high] in Hz, low first"
            raise InputError(f"freq_window is {tuple(self.freq_window)}", place="pairing", remedy=remedy)
        pairs.check_override(self.override, self.measured.names, self.mode_count)
        object.__setattr__(self, "sensor_rows", self.model.sensor_rows(self.measured.sensors))

    @property
    def space(self) -> ParameterSpace:
        """Parameters of the model."""
        return self.model.space

    @property
    def n_measured(self) -> int:
        """Number of measured modes."""
        return self.measured.n_modes

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the responses at the same complete set of named values could."""
        digest = hashlib.sha256(_DEFINITION.encode())
        digest.update((self.model.fingerprint + self.measured.fingerprint).encode())
        digest.update(repr([(p.name, p.unit, p.integer) for p in self.space.parameters]).encode())
        digest.update(np.ascontiguousarray(self.sensor_rows).tobytes())
        clusters = sorted((mode, tuple(sorted(names))) for mode, names in self.mode_clusters.items())
        window = None if self.freq_window is None else tuple(float(f) for f in self.freq_window)
        override = sorted((mode, int(number)) for mode, number in self.override.items())
        digest.update(repr((clusters, self.mode_count, float(self.threshold), window, override)).encode())
        if not self.measured.has_shapes:
            digest.update(repr(sorted({**self.space.values, **self.reference}.items())).encode())
        return digest.hexdigest()[:16]

    @property
    def numbers_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]] | None:
        """The user's function of the numbers of modes; None for a model of matrices, which runs no user code."""
        return self.model.numbers_function

    user_function = numbers_function

    def with_function(self, function: Callable[[Mapping[str, float]], Mapping[str, float]]) -> ModalProblem:
        """The same problem with another function of the numbers of modes."""
        return replace(self, model=self.model.with_function(function))

    @property
    def ledger_key(self) -> str:
        """Fingerprint of the numbers in the ledger; that of a function's modes does not depend on the measurement."""
        return self.model.fingerprint if self.numbers_function is not None else self.fingerprint

    @property
    def model_fingerprint(self) -> str:
        """Hash that changes whenever a result of the model could."""
        return self.model.fingerprint

    @property
    def assumed_std(self) -> tuple[Assumption, ...]:
        """Assumed standard deviations, where none is known."""
        return assumed_deviations(self.measured)

    @property
    def relative_std(self) -> np.ndarray:
        """Relative standard deviation of every frequency, accuracy and floors included, (n_modes,); NaN unknown."""
        return known_std(self.measured).freq

    @property
    def sensitivity_responses(self) -> list[str]:
        """Frequency and, with measured shapes, MAC of every mode."""
        kinds = ("natural_freq", "mac") if self.measured.has_shapes else ("natural_freq",)
        return [f"{kind}_{mode}" for kind in kinds for mode in self.measured.names]

    def with_model(self, model: ModalModel, added: int | None = None) -> ModalProblem:
        """The same problem with another model.

        ``added`` is the number of modes added by effects on this model, whose problem becomes the `base`; None for
        another form of this model.
        """
        if added is None:
            return replace(self, model=model)
        return replace(self, model=model, mode_count=self.mode_count + added, base=self)

    def over(
        self,
        whole: MeasuredModes,
        clusters: Mapping[str, tuple[str, ...]],
        override: Mapping[str, int],
        mode_count: int | None,
    ) -> ModalProblem:
        """The problem over held-out data too, for verification only; more model modes are solved, as they need.

        Parameters
        ----------
        whole : MeasuredModes
            Everything measured.
        clusters, override : mapping
            Of all modes.
        mode_count : int or None
            What the user requests; None for the usual number.
        """
        if mode_count is None:
            more = 2 * (whole.n_modes - self.measured.n_modes)
            count = min(self.mode_count + more, self.model.n_modes)
        else:
            count = self.mode_count + max(0, whole.n_modes - mode_count)
        return replace(self, measured=whole, mode_clusters=clusters, override=override, mode_count=count)

    @property
    def reducible(self) -> StructuralModel | None:
        """The model of matrices that a basis can reduce; None for a function and a reduced model."""
        return self.model.reducible

    @property
    def basis_names(self) -> tuple[str, ...]:
        """Parameters over which a basis must serve."""
        return self.space.names

    def basis_target(self, tolerance: float) -> ModeTarget:
        """All modes up to the end of the frequency window; ``tolerance`` is the relative error of an eigenvalue."""
        freq_max = self.freq_window[1] if self.freq_window else float(np.inf)
        return ModeTarget(self.mode_count, freq_max, DAMPING_MAX, tolerance)

    def reduced(self, basis: Basis) -> ModalProblem:
        """The same problem with a reduced model; InputError when the basis belongs to another model."""
        if self.reducible is None:
            raise InputError("the model is reduced already", place=self.model.name)
        return replace(self, model=ReducedModel(self.reducible, basis))

    def evaluate(self, values: Mapping[str, float]) -> dict[str, float]:
        """Flat responses at named values, ordered by measured mode.

        Frequencies in Hz. NaN for an unpaired mode, and for MAC, EMAC and margin without measured shapes.

        Raises
        ------
        EvaluationError
            When the modes cannot be solved or there are fewer than ``mode_count``.
        """
        return self.responses(self.compare(values))

    def responses(self, found: Comparison) -> dict[str, float]:
        """Flat responses of an existing comparison."""
        pairing, modes = found.pairing, found.modes
        out = {}
        for i, name in enumerate(self.measured.names):
            j = pairing.model_index[i]
            model = (modes.natural_freq, modes.damped_freq, modes.damping_ratio)
            numbers = [float(column[j]) if j >= 0 else math.nan for column in model]
            numbers += [float(column[i]) for column in (pairing.mac, pairing.emac, pairing.margin)]
            out.update({f"{kind}_{name}": number for kind, number in zip(RESPONSES, numbers, strict=True)})
        return out

    def solve(self, values: Mapping[str, float]) -> Modes:
        """The modes that `compare` compares; EvaluationError when the model cannot be solved."""
        return self.model.modes(self._complete(values), self.mode_count)

    def _complete(self, values: Mapping[str, float]) -> dict[str, float]:
        return self.space.complete(values if self.mesh is None else self.mesh.without(values))

    def compare(self, values: Mapping[str, float], solved: Modes | None = None) -> Comparison:
        """Comparison of model and measurement at named values; raises like `evaluate`.

        Modes already ``solved`` at these values are reused where they are enough.
        """
        complete, count = self._complete(values), self.mode_count
        modes = self.solve(values) if solved is None or solved.n_modes != count else solved
        if modes.n_modes < count:
            has = f"the model {self.model.name} has only {modes.n_modes} vibration modes"
            raise EvaluationError(f"{has}, {count} were requested")
        sensor_shapes = self.sensor_rows @ modes.shapes
        if self.measured.has_shapes:
            modes, sensor_shapes = turned_to_measured(self, complete, modes, sensor_shapes)
            shares = self.energy_shares(complete, modes)
            pairing, mac_matrix, emac_matrix = self.pair(self.measured.shapes, sensor_shapes, shares, modes)
        else:
            shape = (self.measured.n_modes, modes.n_modes)
            mac_matrix, emac_matrix = np.full(shape, np.nan), np.full(shape, np.nan)
            pairing = self._in_order(Point(complete, modes))
        multiple = 0.0 if self.mesh is None else self.mesh.at(values)
        return Comparison(
            self.model, self.measured, complete, modes, pairing, mac_matrix, emac_matrix, sensor_shapes,
            mesh_error=multiple,
        )  # fmt: skip

    def pair(
        self,
        shapes: np.ndarray,
        sensor_shapes: np.ndarray,
        shares: np.ndarray,
        modes: Modes,
        threshold: float | None = None,
        known: np.ndarray | None = None,
    ) -> tuple[Pairing, np.ndarray, np.ndarray]:
        """Pairs of measured shapes and model modes.

        Parameters
        ----------
        shapes : ndarray (n_sensors, n_measured)
            Of the measured modes; NaN where not measured.
        sensor_shapes : ndarray (n_sensors, n_model)
            Of the model.
        shares : ndarray (n_measured, n_model)
            From `energy_shares`.
        modes : Modes
        threshold : float, optional
            Instead of the problem's own.
        known : ndarray (n_measured, n_model), optional
            Instead of the MAC of single shapes.

        Returns
        -------
        pairing : Pairing
        mac, emac : ndarray (n_measured, n_model)
        """
        mac_matrix = mac(shapes, sensor_shapes) if known is None else known
        emac_matrix = pairs.emac(mac_matrix, shares)
        pairing = pairs.pair_by_shape(
            mac_matrix,
            emac_matrix,
            self.measured.names,
            threshold=self.threshold if threshold is None else threshold,
            candidates=pairs.in_window(modes.natural_freq, self.freq_window),
            override=self.override,
            log_ratio=np.log(np.maximum(modes.natural_freq, _LEAST_FREQ)) - np.log(self.measured.natural_freq)[:, None],
        )
        return pairing, mac_matrix, emac_matrix

    def _in_order(self, here: Point) -> Pairing:
        """Pairs without shapes: those of the reference point, tracked to here."""
        if self._reference is None:
            return self._ordered(here.modes)[0]
        there, pairing, costs = self._reference
        if here.values == there.values:
            return pairing
        chosen = [self.measured.names.index(mode) for mode in self._chosen]
        rows = np.setdiff1d(pairing.paired, chosen)
        reached = follow(self.model, there, here, pairing.model_index[rows])
        lost = tuple(rows[reached < 0].tolist())
        reached = np.where(pairs.in_window(here.modes.natural_freq, self.freq_window)[reached], reached, -1)
        found = self._ordered(here.modes, dict(zip(rows.tolist(), reached.tolist(), strict=True)), costs)[0]
        return replace(found, lost=lost)

    @cached_property
    def has_equal_modes(self) -> bool:
        """See `calib.correlation.modal.subspaces.has_equal_modes`."""
        return has_equal_modes(self)

    @cached_property
    def _base_reference(self) -> tuple[Point, Pairing, Costs] | None:
        """The reference of `base`, where it has the same measured modes."""
        base = self.base
        return base._reference if base is not None and base.measured.names == self.measured.names else None

    @cached_property
    def _chosen(self) -> dict[str, int]:
        """The user's choice of modes of this model; choices in `base` are among the inherited pairs."""
        inherited = {} if self.base is None or self._base_reference is None else self.base.override
        return {mode: number for mode, number in self.override.items() if inherited.get(mode) != number}

    @cached_property
    def _reference(self) -> tuple[Point, Pairing, Costs] | None:
        """Reference point of pairs without shapes; None where the model cannot be solved there."""
        from scipy.optimize import linear_sum_assignment

        values = self.space.complete({n: v for n, v in self.reference.items() if n in self.space.names})
        try:
            there = Point(values, self.model.modes(values, self.mode_count))
        except EvaluationError:
            return None
        if there.modes.n_modes < self.mode_count:
            return None
        if (inherited := self._base_reference) is None:
            return (there, *self._ordered(there.modes))
        (_, modes), pairing, costs = inherited
        index = pairing.model_index.copy()
        apart = np.abs(np.subtract.outer(modes.natural_freq[index[pairing.paired]], there.modes.natural_freq))
        index[pairing.paired] = linear_sum_assignment(apart)[1]
        own = {self.measured.names.index(mode) for mode in self._chosen}
        followed = {i: j for i, j in enumerate(index.tolist()) if i not in own}
        return there, self._ordered(there.modes, followed, costs)[0], costs

    def _ordered(
        self, modes: Modes, followed: Mapping[int, int] | None = None, costs: Costs | None = None
    ) -> tuple[Pairing, Costs]:
        return pairs.pair_by_order(
            self.measured.natural_freq,
            modes.natural_freq,
            self.measured.names,
            window=self.freq_window,
            override=self._chosen,
            followed=followed,
            costs=costs,
        )

    def energy_shares(self, values: Mapping[str, float], modes: Modes) -> np.ndarray:
        """Share of every model mode's strain energy that counts for every measured mode, (n_measured, n_modes)."""
        named = tuple(dict.fromkeys(name for clusters in self.mode_clusters.values() for name in clusters))
        shares = self.model.energy_shares(values, modes.shapes, named)
        strained = self.model.strain_energy(values, modes.shapes) > 0
        out = np.tile(np.where(strained, 1.0, 0.0), (self.measured.n_modes, 1))
        for i, mode in enumerate(self.measured.names):
            if mode in self.mode_clusters:
                # In the given order of clusters: floating-point sums depend on it.
                out[i] = sum(shares[named.index(name)] for name in dict.fromkeys(self.mode_clusters[mode]))
        return out
