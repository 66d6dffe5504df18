"""Faulty sensors, tested on the pairs that form once they are corrected."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.correlation.modal.axes import turned_axes
from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.pairing import Pairing
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.rules import RULES
from calib.measurement import rules as reading
from calib.measurement.check import (
    Operation,
    SensorFinding,
    check_sensors,
    evidence_required,
    log_likelihood_ratio,
    silent_rows,
    with_corrected_rows,
)

_NEAR = 2
"""Model modes of each measured one that the bound of a correction takes exactly."""
_BLOCK = 4096
"""Pairs of sensors of which the bounds are in memory at a time."""
_ROUNDING = 1e-9
"""By which a bound is raised, so that no rounding error hides a pair."""


def suspicious_sensors(problem: ModalProblem, found: Comparison) -> tuple[SensorFinding, ...]:
    """Sensors with inverted sign, exchanged or dead.

    A faulty sensor lowers the MAC of every mode, so that modes lose their partners, and with them the evidence of the
    fault. The shapes are therefore paired under trial corrections, added one by one while the sum of EMAC rises, and
    `calib.measurement.check.check_sensors` tests the sensors on these tentative pairs. A finding counts only if the
    evidence is as strong against the best pairs of the shapes as measured, without the threshold: otherwise the freedom
    to choose partners would favour the correction. Wrong axes of all sensors or of many nodes come first where they
    explain the shapes better than single sensors do, or as well in fewer corrections (see
    `calib.correlation.modal.axes.turned_axes`).

    Parameters
    ----------
    problem : ModalProblem
    found : Comparison
        Of that problem.

    Returns
    -------
    tuple of SensorFinding
        See `check_sensors`; empty without shapes.
    """
    measured = found.measured
    if not measured.has_shapes:
        return ()
    shares = problem.energy_shares(found.values, found.modes)
    single = _single(problem, found, shares)
    turned = turned_axes(problem, found, shares)
    if turned is None:
        return single
    more = _single(turned.problem, turned.found, problem.energy_shares(found.values, turned.found.modes))
    gain = (more or (turned.finding,))[-1].mac_after - (single[-1].mac_after if single else -np.inf)
    few = gain > -reading.RULES.check_gain and len(more) + 1 < len(single)
    return (turned.finding, *more) if few or gain > reading.RULES.check_gain else single


def _single(problem: ModalProblem, found: Comparison, shares: np.ndarray) -> tuple[SensorFinding, ...]:
    """Findings on single sensors and pairs; ``shares`` (n_measured, n_model) of strain energy."""
    measured = problem.measured
    names = [s.name for s in measured.sensors]
    search = _Search(problem, found, shares)
    partners = search.tentative()
    findings = search.check(partners, names)
    if np.array_equal(partners, found.pairing.model_index):
        return findings
    rows = np.flatnonzero(partners >= 0)
    if findings and search.outweighs(findings[-1].mac_after, rows):
        new = [int(i) for i in rows if partners[i] != found.pairing.model_index[i]]
        described = ", ".join(f"{measured.names[i]} with model mode {partners[i] + 1}" for i in new)
        return tuple(replace(f, sentence=f"{f.sentence} (with tentative pairs: {described})") for f in findings)
    return search.check(found.pairing.model_index, names)


@dataclass(frozen=True, eq=False)
class _Search:
    """Corrections of the measured shapes and the pairs they lead to."""

    problem: ModalProblem
    found: Comparison
    shares: np.ndarray

    def check(self, partners: np.ndarray, names: Sequence[str]) -> tuple[SensorFinding, ...]:
        """Findings for given partners of the measured modes, -1 for none."""
        rows = np.flatnonzero(partners >= 0)
        return check_sensors(self.found.measured.shapes[:, rows], self.found.sensor_shapes[:, partners[rows]], names)

    def tentative(self) -> np.ndarray:
        """Partners of the measured modes under the corrections that raise the sum of EMAC most, -1 for none."""
        shapes, n = self._spoken(), self.found.measured.n_modes
        chosen: list[Operation] = []
        pairing = self._pair(shapes)
        while True:
            tried = [[*chosen, one] for one in self._promising(with_corrected_rows(shapes, chosen), chosen)]
            pairs = [self._pair(with_corrected_rows(shapes, operations)) for operations in tried]
            best = max(range(len(pairs)), key=lambda k: _score(pairs[k]), default=None)
            if best is None or _score(pairs[best]) <= _score(pairing) + reading.RULES.check_gain * n:
                break
            chosen, pairing = tried[best], pairs[best]
        out = pairing.model_index.copy()
        for i in np.flatnonzero(out < 0):  # a mode that loses its partner by the corrections counts against them
            own = self.found.pairing.model_index[i]
            out[i] = own if own not in out else -1
        return out

    def outweighs(self, mac_after: float, rows: np.ndarray) -> bool:
        """Whether the evidence holds against the best pairs of the shapes as measured."""
        best = self._pair(self.found.measured.shapes, threshold=0.0)
        without = float(np.nan_to_num(best.mac[rows]).mean())
        n_sensors = len(self.found.measured.sensors)
        return log_likelihood_ratio(n_sensors, len(rows), without, mac_after) >= evidence_required(n_sensors)

    def _spoken(self) -> np.ndarray:
        """Measured shapes, scaled to a largest modulus of 1, without uninformative sensors."""
        shapes = np.array(self.found.measured.shapes)
        size = np.nanmax(np.where(np.isnan(shapes), 0.0, np.abs(shapes)), axis=0, initial=0.0)
        shapes = shapes / np.where(size > 0, size, 1.0)
        shapes[list(silent_rows(shapes, np.isfinite(shapes)))] = np.nan
        return shapes

    def _pair(self, shapes: np.ndarray, threshold: float | None = None) -> Pairing:
        return self.problem.pair(shapes, self.found.sensor_shapes, self.shares, self.found.modes, threshold)[0]

    def _promising(self, shapes: np.ndarray, chosen: Sequence[Operation]) -> list[Operation]:
        """Corrections whose best partners, one mode at a time, have the largest sum of EMAC."""
        busy = {row for rows in chosen for row in rows}
        free = np.array([k for k in range(len(shapes)) if k not in busy and np.isfinite(shapes[k]).any()], dtype=int)
        corrections = Corrections.of(shapes, self.found.sensor_shapes, self.shares, self.problem.threshold)
        return corrections.best(free, RULES.corrections_tried)


@dataclass(frozen=True, eq=False)
class Corrections:
    """Sums of EMAC at the best partners, one measured mode at a time, once rows are turned round or exchanged.

    A correction adds a matrix of rank one to the products of measured and model shapes, ``-2 conj(a_i) b_i`` or
    ``-conj(a_i - a_j) (b_i - b_j)`` (a measured, b model). A sum over all model modes for every pair of rows grows with
    the square of the sensors times both numbers of modes. `best` therefore bounds it first, with those model modes of
    which the products are largest exactly, and all others by the triangle inequality.

    Attributes
    ----------
    a : ndarray (n_sensors, n_measured)
        Measured shapes; 0 where not measured.
    model : ndarray (n_sensors, n_model)
    product : ndarray (n_measured, n_model)
        ``a^H model``.
    weight : ndarray (n_measured, n_model)
        EMAC over the squared modulus of a product.
    threshold : float
        EMAC below which a pair counts as none.
    """

    a: np.ndarray
    model: np.ndarray
    product: np.ndarray
    weight: np.ndarray
    threshold: float

    @staticmethod
    def of(shapes: np.ndarray, model: np.ndarray, shares: np.ndarray, threshold: float) -> Corrections:
        """For measured shapes (n_sensors, n_measured), NaN where not measured, and shares (n_measured, n_model)."""
        seen = np.isfinite(shapes)
        a = np.where(seen, shapes, 0.0)
        size = (np.abs(a) ** 2).sum(axis=0)[:, None] * (seen.astype(float).T @ np.abs(model) ** 2)
        weight = np.divide(shares, size, out=np.zeros_like(size), where=size > 0)
        return Corrections(a, model, a.conj().T @ model, weight, threshold)

    def best(self, free: np.ndarray, number: int) -> list[Operation]:
        """The corrections of free rows with the largest sums, largest first.

        Parameters
        ----------
        free : ndarray (n_free,), int
            Ascending.
        number : int
        """
        found: list[tuple[float, Operation]] = [(-self.value((int(i),)), (int(i),)) for i in free]
        first, second = np.triu_indices(len(free), 1)
        pairs = np.column_stack([free[first], free[second]])
        bounds = np.concatenate([np.zeros(0), *self._bounds(pairs)])
        for k in np.argsort(-bounds, kind="stable").tolist():
            found = sorted(found)[:number]
            if len(found) == number and bounds[k] < -found[-1][0]:
                break
            pair = (int(pairs[k, 0]), int(pairs[k, 1]))
            found.append((-self.value(pair), pair))
        return [rows for _, rows in sorted(found)[:number]]

    def value(self, rows: Operation) -> float:
        """Sum of EMAC with one row turned round, or two exchanged."""
        i, j = rows[0], rows[-1]
        change = -2 * np.outer(self.a[i].conj(), self.model[i])
        if i != j:
            change = -np.outer((self.a[i] - self.a[j]).conj(), self.model[i] - self.model[j])
        return float(self._counted(np.abs(self.product + change) ** 2 * self.weight))

    def _counted(self, values: np.ndarray) -> np.ndarray:
        """Sum over measured modes (second to last axis) of the largest EMAC, where it reaches the threshold."""
        best = np.max(values, axis=-1, initial=0.0)
        return np.sum(np.where(best >= self.threshold, best, 0.0), axis=-1)

    def _bounds(self, pairs: np.ndarray) -> Iterator[np.ndarray]:
        """Upper bounds of `value` for pairs (n_pairs, 2), a block at a time."""
        length = np.linalg.norm(self.a, axis=0)
        size = np.sqrt(self.weight) * np.abs(self.product)
        near = np.argsort(-size, axis=1)[:, :_NEAR]  # (n_measured, n_near)
        mode = np.arange(len(size))[:, None]
        product, weight = self.product[mode, near], self.weight[mode, near]
        size[mode, near] = 0.0
        farther = np.max(size, axis=1, initial=0.0)
        reach = np.max(np.sqrt(self.weight) * length[:, None], axis=0, initial=0.0)  # (n_model,)
        share = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
        for block in np.split(pairs, range(_BLOCK, len(pairs), _BLOCK)):
            i, j = block.T
            off = (self.a[i] - self.a[j]).conj()
            apart = self.model[i] - self.model[j]
            known = np.abs(product - off[:, :, None] * apart[:, near]) ** 2 * weight
            others = farther + np.abs(off) * share * np.max(reach * np.abs(apart), axis=1, initial=0.0)[:, None]
            both = np.maximum(np.max(known, axis=-1, initial=0.0), others**2)
            yield self._counted(both[:, :, None] * (1 + _ROUNDING))


def _score(pairing: Pairing) -> float:
    return float(np.nansum(pairing.emac))
