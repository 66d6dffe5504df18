"""Axes of all sensors, or of those of some nodes, that are not those of the model: exchanged, turned or mirrored."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.problem import ModalProblem
from calib.errors.errors import InputError
from calib.measurement.check import SensorFinding, log_likelihood_ratio
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.rules import RULES

_TRANSLATIONS = DIRECTIONS[:3]
_GROUPS = 3
"""Ways to turn axes for which groups of nodes are searched."""
_LISTED = 8
"""Nodes named in a sentence."""


@dataclass(frozen=True)
class Turn:
    """A signed permutation of axes: ``x`` of the test is ``signs[0] axes[0]`` of the model, and so on."""

    axes: tuple[str, str, str]
    signs: tuple[int, int, int]

    def of(self, direction: str) -> tuple[str, int]:
        """Direction and sign that a direction of the test has in the model; a mirror reverses rotations once more."""
        k = DIRECTIONS.index(direction)
        if k < len(_TRANSLATIONS):
            return self.axes[k], self.signs[k]
        k -= len(_TRANSLATIONS)
        order = [_TRANSLATIONS.index(axis) for axis in self.axes]
        parity = round(float(np.linalg.det(np.eye(3)[order]))) * math.prod(self.signs)
        return f"r{self.axes[k]}", self.signs[k] * parity

    @property
    def complexity(self) -> tuple[int, int]:
        """Axes that have another name, and those that are reversed: of equally good ones the simplest is told."""
        return sum(a != b for a, b in zip(self.axes, _TRANSLATIONS, strict=True)), self.signs.count(-1)

    def words(self, directions: Sequence[str], whose: str) -> str:
        """What looks wrong, such as ``x and y of all sensors look exchanged``, of the directions that were measured."""
        changed = {d: self.of(d) for d in _TRANSLATIONS if d in directions and self.of(d) != (d, 1)}
        named = {axis for axis, _ in changed.values()}
        if all(d == axis for d, (axis, _) in changed.items()):
            return f"{' and '.join(changed)} of {whose} {'looks' if len(changed) == 1 else 'look'} reversed"
        if len(changed) == 2 and named == set(changed) and all(sign > 0 for _, sign in changed.values()):
            return f"{' and '.join(changed)} of {whose} look exchanged"
        parts = ", ".join(f"{d} is {'-' if sign < 0 else ''}{axis} of the model" for d, (axis, sign) in changed.items())
        return f"the axes of {whose} look turned ({parts})"


TURNS = sorted(
    (Turn((a, b, c), (i, j, k)) for a, b, c in itertools.permutations(_TRANSLATIONS)
     for i, j, k in itertools.product((1, -1), repeat=3)),
    key=lambda turn: turn.complexity,
)[1:]  # fmt: skip
"""All ways but the identity, simplest first."""


@dataclass(frozen=True, eq=False)
class Turned:
    """A problem with other axes of its sensors, compared at the same values, and what is told of them."""

    problem: ModalProblem
    found: Comparison
    finding: SensorFinding


def turned_axes(problem: ModalProblem, found: Comparison, shares: np.ndarray) -> Turned | None:
    """The turn of the axes of all sensors, or of those of some nodes, that the shapes ask for; None without one.

    Every signed permutation is paired anew. It counts where its evidence, a log-likelihood ratio as of
    `calib.measurement.check.check_sensors`, against the best pairs of the shapes as measured exceeds `check_evidence`
    plus the logarithm of the number of hypotheses, does not rest on a single mode, and hardly any mode loses. Fewer
    than three nodes are left to corrections of single sensors, and so are reversed signs of one axis of some nodes.

    Parameters
    ----------
    problem : ModalProblem
        With measured shapes.
    found : Comparison
        Of that problem.
    shares : ndarray (n_measured, n_model)
        Of strain energy, see `ModalProblem.energy_shares`.
    """
    measured, n_modes = problem.measured, problem.measured.n_modes
    if n_modes < 2 or len(measured.sensors) < RULES.check_sensors:
        return None
    search = _Axes.of(problem, found, shares)
    nodes = len(search.nodes)
    everywhere = np.ones(nodes, dtype=bool)
    whole = {turn: motion for turn in TURNS if (motion := search.motion(turn)) is not None}
    if nodes < 3 or not whole:
        return None
    scored = {turn: search.score(motion, everywhere) for turn, motion in whole.items()}
    best = max(scored.values())
    tried = [(next(turn for turn in whole if scored[turn] > best - RULES.check_gain * n_modes), everywhere)]
    tried += search.groups(whole)
    chosen: Turned | None = None
    for turn, group in tried:
        evidence = math.log(len(TURNS)) + (0.0 if group.all() else nodes * math.log(2))
        candidate = _evident(problem, found, search, turn, group, RULES.check_evidence + evidence)
        if candidate is not None and (
            chosen is None or candidate.finding.mac_after > chosen.finding.mac_after + RULES.check_gain
        ):
            chosen = candidate
    return chosen


def _evident(
    problem: ModalProblem, found: Comparison, search: _Axes, turn: Turn, group: np.ndarray, required: float
) -> Turned | None:
    """The problem with turned axes of a group of nodes, where the evidence is as large as required."""
    measured, nodes = problem.measured, search.nodes
    turned = {node for node, own in zip(nodes, group, strict=True) if own}
    shapes, sensors, changed = np.array(measured.shapes), list(measured.sensors), []
    for k, sensor in enumerate(measured.sensors):
        axis, sign = turn.of(sensor.direction)
        if sensor.node in turned and (axis, sign) != (sensor.direction, 1):
            sensors[k] = replace(sensor, direction=axis)
            shapes[k] *= sign
            changed.append(sensor)
    own = {s.node for s in changed}
    if len(own) < 3 or (turn.axes == _TRANSLATIONS and not group.all() and len(changed) < 2 * len(own)):
        return None
    try:
        other = replace(problem, measured=replace(measured, sensors=tuple(sensors), shapes=shapes))
    except InputError:
        return None
    compared = other.compare(found.values, found.modes)
    before, after = _best_mac(problem, found), _best_mac(other, compared)
    gain, n = after - before, len(sensors)
    mean_before, mean_after = float(before.mean()), float(after.mean())
    rest = (n - 1) * (gain.sum() - gain.max()) / (2 * max(1.0 - mean_after, RULES.check_residual))
    if (
        log_likelihood_ratio(n, len(gain), mean_before, mean_after) < required
        or rest < RULES.check_other_modes
        or -gain[gain < 0].sum() > RULES.check_against * gain[gain > 0].sum()
    ):
        return None
    listed = [str(node) for node in nodes if node in turned]
    more = f" and {len(listed) - _LISTED} more" if len(listed) > _LISTED else ""
    whose = "all sensors" if group.all() else f"the sensors at nodes {', '.join(listed[:_LISTED])}{more}"
    sentence = (
        f"{turn.words([s.direction for s in changed], whose)}: so corrected, the mean MAC over {len(gain)} modes rises "
        f"from {mean_before:.3f} to {mean_after:.3f}; correct the directions in the measured shapes, or turn the model"
    )
    names = tuple(s.name for s in changed)
    return Turned(other, compared, SensorFinding("axes", names, mean_before, mean_after, sentence, whose))


def _best_mac(problem: ModalProblem, found: Comparison) -> np.ndarray:
    """MAC of every measured mode with its best partner, (n_measured,), without a threshold; 0 where there is none."""
    shares = problem.energy_shares(found.values, found.modes)
    pairing = problem.pair(problem.measured.shapes, found.sensor_shapes, shares, found.modes, threshold=0.0)[0]
    return np.asarray(np.nan_to_num(pairing.mac))


@dataclass(frozen=True, eq=False)
class _Axes:
    """Motions of the model modes at the measured nodes along all axes, and sums over some nodes with turned ones."""

    sensors: tuple[Sensor, ...]
    nodes: tuple[int, ...]
    at: np.ndarray
    """Index of the node of each sensor, (n_sensors,)."""
    a: np.ndarray
    """Measured shapes, 0 where not measured, (n_sensors, n_measured)."""
    seen: np.ndarray
    own: np.ndarray
    """Motion as the sensors are named, (n_sensors, n_model)."""
    motions: dict[tuple[int, str], np.ndarray | None]
    shares: np.ndarray

    @staticmethod
    def of(problem: ModalProblem, found: Comparison, shares: np.ndarray) -> _Axes:
        """Of a comparison; motions along axes that were not measured come from the model, None where it has none."""
        sensors, seen = problem.measured.sensors, np.isfinite(problem.measured.shapes)
        nodes = tuple(dict.fromkeys(s.node for s in sensors))
        motions: dict[tuple[int, str], np.ndarray | None] = {
            (s.node, s.direction): row for s, row in zip(sensors, found.sensor_shapes, strict=True)
        }
        for sensor in sensors:
            kind = sensor.direction[:-1]
            for axis in _TRANSLATIONS:
                if (sensor.node, kind + axis) in motions:
                    continue
                try:
                    row = problem.model.sensor_rows([replace(sensor, direction=kind + axis)])
                    motions[sensor.node, kind + axis] = (row @ found.modes.shapes)[0]
                except InputError:
                    motions[sensor.node, kind + axis] = None
        a = np.where(seen, problem.measured.shapes, 0.0)
        size = np.abs(a).max(axis=0, initial=0.0)
        at = np.array([nodes.index(s.node) for s in sensors])
        return _Axes(
            sensors, nodes, at, a / np.where(size > 0, size, 1.0), seen, found.sensor_shapes, motions, shares
        )  # fmt: skip

    def motion(self, turn: Turn) -> np.ndarray | None:
        """Motion of the model along what the sensors would measure, (n_sensors, n_model); None where it has none."""
        rows = []
        for sensor in self.sensors:
            axis, sign = turn.of(sensor.direction)
            if (row := self.motions[sensor.node, axis]) is None:
                return None
            rows.append(sign * row)
        return np.array(rows)

    def score(self, motion: np.ndarray, group: np.ndarray) -> float:
        """Sum over the measured modes of the largest EMAC, where the nodes of a group have a motion."""
        b = np.where(group[self.at][:, None], motion, self.own)
        size = (np.abs(self.a) ** 2).sum(axis=0)[:, None] * (self.seen.T.astype(float) @ np.abs(b) ** 2)
        return float(self._counted(self.a.conj().T @ b, size))

    def _counted(self, product: np.ndarray, size: np.ndarray) -> np.ndarray:
        values = self.shares * np.abs(product) ** 2 / np.where(size > 0, size, np.inf)
        return np.asarray(np.max(values, axis=-1, initial=0.0).sum(axis=-1))

    def groups(self, motions: dict[Turn, np.ndarray]) -> list[tuple[Turn, np.ndarray]]:
        """The best group of nodes of each of the most promising turns, neither empty nor all nodes."""
        nobody = np.zeros(len(self.nodes), dtype=bool)
        first = {turn: self._grown(motion, nobody, steps=1)[0] for turn, motion in motions.items()}
        best = sorted(motions, key=lambda turn: -first[turn])[:_GROUPS]
        found = [(turn, self._grown(motions[turn], nobody)[1]) for turn in best]
        return [(turn, group) for turn, group in found if group.any() and not group.all()]

    def _grown(self, motion: np.ndarray, group: np.ndarray, steps: int = 100) -> tuple[float, np.ndarray]:
        """Score and group once nodes have joined or left it that raise the score, the most helpful ones at once."""
        change, energy = [], []
        for k in range(len(self.nodes)):
            rows = self.at == k
            a, seen = self.a[rows].conj().T, self.seen[rows].T.astype(float)
            change.append(a @ (motion[rows] - self.own[rows]))
            energy.append(seen @ (np.abs(motion[rows]) ** 2 - np.abs(self.own[rows]) ** 2))
        d_product, d_energy = np.array(change), np.array(energy)  # (n_nodes, n_measured, n_model)
        size_a = (np.abs(self.a) ** 2).sum(axis=0)[:, None]
        score = self.score(motion, group)
        for _ in range(steps):
            b = np.where(group[self.at][:, None], motion, self.own)
            product, size = self.a.conj().T @ b, self.seen.T.astype(float) @ np.abs(b) ** 2
            way = np.where(group, -1.0, 1.0)[:, None, None]
            gain = self._counted(product + way * d_product, size_a * (size + way * d_energy)) - score
            order = np.argsort(-gain, kind="stable")
            count = int((gain > 0).sum())
            while count:
                tried = group.copy()
                tried[order[:count]] ^= True
                if (reached := self.score(motion, tried)) > score:
                    group, score = tried, reached
                    break
                count //= 2
            else:
                break
        return score, group
