"""Sensor check against modes paired with a model: sensors that are turned round, exchanged or dead."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.modal import MeasuredModes
from calib.measurement.rules import RULES

FindingKind = Literal["flipped", "swapped", "dead", "axes"]


@dataclass(frozen=True)
class SensorFinding:
    """One suspicion about one or two sensors.

    Attributes
    ----------
    kind : {"flipped", "swapped", "dead", "axes"}
    sensors : tuple of str
        One name, or two for swapped sensors; all those of which the axes are wrong.
    mac_before, mac_after : float
        Mean MAC over the paired modes without and with this correction, after the corrections listed earlier; a dead
        sensor is corrected by leaving it out. Of axes over all measured modes, each with its best partner.
    sentence : str
    whose : str
        Whose axes, such as ``all sensors``; empty for single sensors.
    """

    kind: FindingKind
    sensors: tuple[str, ...]
    mac_before: float
    mac_after: float
    sentence: str
    whose: str = ""

    @property
    def warning(self) -> str:
        """The sentence as a warning."""
        return f"Check {'the axes' if self.whose else 'this sensor'}: {self.sentence}"


def check_sensors(measured: np.ndarray, model: np.ndarray, names: Sequence[str]) -> tuple[SensorFinding, ...]:
    """Find sensors that are turned round, exchanged or dead, before measurement and model are compared.

    Corrections are added (or withdrawn) greedily while the mean MAC rises, in several orders; then the weakest is
    withdrawn until each remaining one

    - has a log-likelihood ratio of ``(n_sensors - 1) n_modes / 2 * log((1 - MAC_without) / (1 - MAC_with))``, of mean
      MACs, above `RULES.check_evidence` plus the logarithm of the number of hypotheses. The least-squares residual of a
      mode is ``|a|^2 (1 - MAC)``, so this is the profile likelihood ratio for normal residuals of one unknown variance:
      a poor model, or few sensors and modes, need a larger gain;
    - does not rest on a single mode, and lowers the MAC of hardly any mode.

    With a single mode (which determines neither sign nor exchange) or fewer than four sensors there are no findings.

    Parameters
    ----------
    measured : ndarray (n_sensors, n_modes)
        Real or complex, each mode of any scale; NaN where not measured.
    model : ndarray (n_sensors, n_modes)
        Paired column by column; finite.
    names : sequence of str, length n_sensors

    Returns
    -------
    tuple of SensorFinding
        Dead sensors first, then corrections by falling gain; empty when nothing is suspicious.

    Raises
    ------
    InputError
        When the arrays do not fit together or the model is not finite.
    """
    a, b = np.array(measured, dtype=complex), np.array(model, dtype=complex)
    if a.ndim != 2 or a.shape != b.shape or a.shape[0] != len(names):
        raise InputError(
            f"measured shapes {a.shape}, model shapes {b.shape} and {len(names)} names do not fit", place="sensor check"
        )
    if not np.all(np.isfinite(b)):
        raise InputError("the model's shapes are not finite", place="sensor check")
    seen = np.isfinite(a)
    a = np.where(seen, a, 0.0)
    usable = np.any(a != 0, axis=0) & np.any((b != 0) & seen, axis=0)
    if usable.sum() < 2:
        return ()
    a, b, seen = a[:, usable], b[:, usable], seen[:, usable]
    # largest modulus first, then the norm, so that nothing over- or underflows
    a, b = a / np.abs(a).max(axis=0), b / np.abs(b).max(axis=0)
    dead, kinds = _dead(a, b, seen)
    findings = []
    for k, kind in zip(dead, kinds, strict=True):
        without = seen.copy()
        without[k] = False
        before, after = _Shapes(a, b, seen).mean_mac, _Shapes(np.where(without, a, 0.0), b, without).mean_mac
        sentence = (
            f"sensor {names[k]} looks dead: it is {kind} in all {a.shape[1]} modes although the model moves there"
        )
        findings.append(SensorFinding("dead", (names[k],), before, after, sentence))
        a, seen = np.where(without, a, 0.0), without
    # a mode with fewer sensors is fitted, not tested, by its free factor
    enough = (seen & (a != 0)).sum(axis=0) >= RULES.check_sensors
    rows = np.flatnonzero(seen[:, enough].any(axis=1))
    if enough.sum() < 2 or len(rows) < RULES.check_sensors:
        return tuple(findings)
    state = _Shapes(a[np.ix_(rows, enough)], b[np.ix_(rows, enough)], seen[np.ix_(rows, enough)])
    for operation in _search(state):
        corrected = state.after([operation])
        named = tuple(names[rows[k]] for k in operation)
        sentence = _sentence(state, corrected, operation, named)
        kind_of: FindingKind = "flipped" if len(operation) == 1 else "swapped"
        findings.append(SensorFinding(kind_of, named, state.mean_mac, corrected.mean_mac, sentence))
        state = corrected
    return tuple(findings)


Operation = tuple[int, ...]
"""Rows of a correction: one to turn round, two to exchange."""


@dataclass(frozen=True)
class _Shapes:
    """Measured (zero where not seen) and model shapes (n_sensors, n_modes), and where they were seen."""

    a: np.ndarray
    b: np.ndarray
    seen: np.ndarray

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Products ``a^H b``, ``a^H a`` and ``b^H b`` over the sensors seen, each (n_modes,)."""
        return (
            (self.a.conj() * self.b).sum(axis=0),
            (np.abs(self.a) ** 2).sum(axis=0),
            (np.abs(self.b) ** 2 * self.seen).sum(axis=0),
        )

    @property
    def mac(self) -> np.ndarray:
        """MAC of every pair, (n_modes,)."""
        return _mac(*self.parts)

    @property
    def mean_mac(self) -> float:
        """Mean of `mac`."""
        return float(self.mac.mean())

    def after(self, operations: Sequence[Operation]) -> _Shapes:
        """Shapes after corrections; no sensor takes part in two of them."""
        exchanged = [rows for rows in operations if len(rows) > 1]
        return _Shapes(with_corrected_rows(self.a, operations), self.b, with_corrected_rows(self.seen, exchanged))


def with_corrected_rows(shapes: np.ndarray, operations: Sequence[Operation]) -> np.ndarray:
    """Shapes (n_sensors, n_modes) with rows turned round or exchanged; no row takes part in two corrections."""
    out = shapes.copy()
    for rows in operations:
        out[list(rows)] = -out[list(rows)] if len(rows) == 1 else out[list(rows[::-1])]
    return out


def _mac(product: np.ndarray, size_a: np.ndarray, size_b: np.ndarray) -> np.ndarray:
    size = size_a * size_b
    return np.where(size > 0, np.abs(product) ** 2 / np.where(size > 0, size, 1.0), 0.0)


def _dead(a: np.ndarray, b: np.ndarray, seen: np.ndarray) -> tuple[list[int], list[str]]:
    """Rows that are zero or constant while the model moves there; columns scaled to a largest modulus of 1."""
    rows, kinds = [], []
    for k, kind in silent_rows(a, seen).items():
        motion = np.abs(b[k, seen[k]])
        if motion.max() > RULES.dead_model and (kind == "zero" or np.ptp(motion) > RULES.dead_model):
            rows.append(k)
            kinds.append(kind)
    return rows, kinds


def silent_rows(a: np.ndarray, seen: np.ndarray) -> dict[int, str]:
    """Rows that are ``zero`` or ``constant`` in all modes; columns scaled to a largest modulus of 1."""
    out = {}
    for k in range(len(a)):
        mine = a[k, seen[k]]
        if len(mine) < 2:
            continue
        if np.abs(mine).max() < RULES.dead_measured:
            out[k] = "zero"
        # two equal values are a coincidence, and the point to which shapes are scaled is 1 in every mode
        elif len(mine) > 2 and np.abs(mine[0]) < 0.999 and np.abs(mine - mine[0]).max() < 1e-9 * np.abs(mine[0]):
            out[k] = "constant"
    return out


def _search(start: _Shapes) -> list[Operation]:
    """Accepted corrections, from the best of several orders in which they are tried.

    On a symmetric structure, exchanging mirrored sensors has half the effect of reversing both, so that a single order
    can end in a local optimum. Of equally good explanations the shortest is taken.
    """
    best: list[Operation] = []
    best_mac = start.mean_mac
    for stages in ((1, 2), (2, 1), (3,)):
        chosen: list[Operation] = []
        for stage in stages:
            chosen = _grow(start, chosen, flips=stage != 2, swaps=stage != 1)
        kept = _prune(start, chosen)
        mac = start.after(kept).mean_mac
        better = mac - best_mac
        if better > RULES.check_gain or (better > -RULES.check_gain and kept and len(kept) < len(best)):
            best, best_mac = kept, mac
    return best


def _grow(start: _Shapes, given: Sequence[Operation], *, flips: bool, swaps: bool) -> list[Operation]:
    """Add or withdraw one correction at a time, each time the one that raises the mean MAC most."""
    chosen = list(given)
    while True:
        state = start.after(chosen)
        free = np.ones(len(start.a), dtype=bool)
        free[[row for rows in chosen for row in rows]] = False
        best_mac, best = state.mean_mac + RULES.check_gain, chosen
        for candidate, mac in _additions(state, np.flatnonzero(free), flips=flips, swaps=swaps):
            if mac > best_mac:
                best_mac, best = mac, [*chosen, candidate]
        for one in chosen:
            fewer = [other for other in chosen if other != one]
            mac = start.after(fewer).mean_mac
            if mac > best_mac:
                best_mac, best = mac, fewer
        if best is chosen:
            return chosen
        chosen = best


def _additions(state: _Shapes, free: np.ndarray, *, flips: bool, swaps: bool) -> Iterator[tuple[Operation, float]]:
    """Corrections of free rows with the mean MAC they give; of the exchanges of a row only the best."""
    product, size_a, size_b = state.parts
    own = state.a.conj() * state.b
    energy = np.abs(state.b) ** 2
    for k, i in enumerate(free):
        if flips:
            yield (int(i),), float(_mac(product - 2 * own[i], size_a, size_b).mean())
        others = free[k + 1 :]
        if swaps and len(others):
            shift = state.a[i].conj() * state.b[others] + state.a[others].conj() * state.b[i] - own[i] - own[others]
            lost = 1.0 * state.seen[i] - state.seen[others]
            swapped = _mac(product + shift, size_a, size_b + lost * (energy[others] - energy[i])).mean(axis=1)
            j = int(np.argmax(swapped))
            yield (int(i), int(others[j])), float(swapped[j])


def _prune(start: _Shapes, operations: Sequence[Operation]) -> list[Operation]:
    """Corrections with enough evidence each; the weakest is withdrawn first."""
    kept = list(operations)
    while kept:
        full = start.after(kept)
        verdicts = [_evidence(start.after([o for o in kept if o != one]), full) for one in kept]
        failing = [(evidence, k) for k, (evidence, accepted) in enumerate(verdicts) if not accepted]
        if not failing:
            break
        kept.pop(min(failing)[1])
    return kept


def _evidence(without: _Shapes, corrected: _Shapes) -> tuple[float, bool]:
    """Log-likelihood ratio of one correction given the others, and whether it is accepted."""
    n_sensors = len(corrected.a)
    gain = corrected.mac - without.mac
    evidence = log_likelihood_ratio(n_sensors, len(gain), without.mean_mac, corrected.mean_mac)
    other_modes = (
        (n_sensors - 1) * (gain.sum() - gain.max()) / (2 * max(1.0 - corrected.mean_mac, RULES.check_residual))
    )
    lost, won = -gain[gain < 0].sum(), gain[gain > 0].sum()
    accepted = (
        evidence >= evidence_required(n_sensors)
        and other_modes >= RULES.check_other_modes
        and lost <= RULES.check_against * won
        and corrected.mean_mac - without.mean_mac >= RULES.check_gain
    )
    return evidence, bool(accepted)


def log_likelihood_ratio(n_sensors: int, n_modes: int, without: float, corrected: float) -> float:
    """Evidence for a correction, from the mean MAC without and with it; see `check_sensors`."""
    residual, residual_without = (max(1.0 - m, RULES.check_residual) for m in (corrected, without))
    # the complex factor of every mode costs one degree of freedom
    return (n_sensors - 1) * n_modes / 2 * math.log(residual_without / residual)


def evidence_required(n_sensors: int) -> float:
    """Log-likelihood ratio that one correction needs, corrected for the number of hypotheses."""
    return RULES.check_evidence + math.log(n_sensors * (n_sensors + 1) / 2)


def _sentence(before: _Shapes, after: _Shapes, rows: Operation, names: tuple[str, ...]) -> str:
    rise = (
        f"raises the mean MAC over {before.a.shape[1]} paired modes from {before.mean_mac:.3f} to {after.mean_mac:.3f}"
    )
    if len(rows) == 1:
        return f"sensor {names[0]} looks turned round: reversing its sign {rise}"
    sentence = f"sensors {names[0]} and {names[1]} look exchanged: exchanging them {rise}"
    both = before.after([(rows[0],), (rows[1],)]).mean_mac
    if both - before.mean_mac >= 0.9 * (after.mean_mac - before.mean_mac):
        sentence += f"; reversing both signs would explain it as well ({both:.3f})"
    return sentence


def place_hints(measured: MeasuredModes, sensor_findings: Sequence[SensorFinding]) -> tuple[str, ...]:
    """A hint where suspicious sensors are among those whose locations are in doubt."""
    nodes = {one.node for one in measured.misplaced}
    doubtful = {s.name for s in measured.sensors if s.node in nodes}
    named = [name for finding in sensor_findings for name in finding.sensors if name in doubtful]
    if not named:
        return ()
    return (
        f"Check the locations of {', '.join(dict.fromkeys(named))} first: sensor table and universal file disagree "
        "there, and the findings on these sensors below may follow from that.",
    )
