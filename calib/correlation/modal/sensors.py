"""Faulty sensors, tested on the pairs that form once they are corrected."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

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


def suspicious_sensors(problem: ModalProblem, found: Comparison) -> tuple[SensorFinding, ...]:
    """Sensors with inverted sign, exchanged or dead.

    A faulty sensor lowers the MAC of every mode, so that modes lose their partners, and with them the evidence of the
    fault. The shapes are therefore paired under trial corrections, added one by one while the sum of EMAC rises, and
    `calib.measurement.check.check_sensors` tests the sensors on these tentative pairs. A finding counts only if the
    evidence is as strong against the best pairs of the shapes as measured, without the threshold: otherwise the freedom
    to choose partners would favour the correction.

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
    names = [s.name for s in measured.sensors]
    search = _Search(problem, found, problem.energy_shares(found.values, found.modes))
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
        bounds = list(self._bounds(shapes, free))
        bounds.sort(key=lambda pair: -pair[1])
        return [one for one, _ in bounds[: RULES.corrections_tried]]

    def _bounds(self, shapes: np.ndarray, free: np.ndarray) -> Iterator[tuple[Operation, float]]:
        seen, model = np.isfinite(shapes), self.found.sensor_shapes
        a = np.where(seen, shapes, 0.0)
        own = a.conj()[:, :, None] * model[:, None, :]  # (n_sensors, n_measured, n_model)
        product = own.sum(axis=0)
        size = (np.abs(a) ** 2).sum(axis=0)[:, None] * (seen.astype(float).T @ np.abs(model) ** 2)
        weight = np.divide(self.shares, size, out=np.zeros_like(size), where=size > 0)

        def bound(products: np.ndarray) -> np.ndarray:
            value = np.abs(products) ** 2 * weight
            best = np.max(value, axis=-1, initial=0.0)
            return np.sum(np.where(best >= self.problem.threshold, best, 0.0), axis=-1)

        for k, i in enumerate(free):
            yield (int(i),), float(bound(product - 2 * own[i]))
            others = free[k + 1 :]
            crossed = a[i].conj()[None, :, None] * model[others][:, None, :] + a[others].conj()[:, :, None] * model[i]
            for j, value in zip(others, bound(product + crossed - own[i] - own[others]), strict=True):
                yield (int(i), int(j)), float(value)


def _score(pairing: Pairing) -> float:
    return float(np.nansum(pairing.emac))
