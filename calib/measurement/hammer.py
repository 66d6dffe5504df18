"""FRFs from hammer records: hits are found, double hits and overloads left out, the others averaged.

Force and responses share a block, so that a trigger delay cancels. An exponential window, ``exp(-a t)`` on both, turns
``H(s)`` into ``H(s + a)``: every pole moves by ``a`` to the left, exactly, and is moved back where modes are identified
(Fladung and Rost 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import Quantity
from calib.measurement.frf_repeats import FRFRepeat, Key, few, repeat_of
from calib.measurement.places import Doubt, Point
from calib.measurement.record import QUANTITY_OF, SAME_RATE, MeasuredRecord
from calib.measurement.rules import RULES

Estimator = Literal["H1", "H2", "Hv"]
ESTIMATORS: tuple[Estimator, ...] = ("H1", "H2", "Hv")
NO_HITS = "give records of single hits; of a shaker's records export the FRFs"


class HammerFRFs(NamedTuple):
    """What `frfs_of_hits` returns.

    Attributes
    ----------
    repeats : tuple of FRFRepeat
        One a hit that counts; their mean is the average over the hits.
    window_rate : float
        By how much the window applied here moves every pole to the left, rad/s; 0 where responses decay by themselves.
    """

    repeats: tuple[FRFRepeat, ...]
    window_rate: float


@dataclass(frozen=True, eq=False)
class _Hit:
    """A hit: samples of its record at which the block begins, the pulse ends, and the next pulse begins or it ends."""

    record: MeasuredRecord
    points: dict[int, Point]
    begin: int
    peak: int
    pulse_end: int
    end: int

    @property
    def where(self) -> str:
        return f"{self.record.source}, hit at {self.peak / self.record.rate:.4g} s"

    def force(self, length: int) -> np.ndarray:
        """Force of the block without what is no part of the pulse, (length,)."""
        assert self.record.forces is not None
        own = self.record.forces[:, 0] - np.median(self.record.forces[:, 0])
        out = np.zeros(length)
        out[: self.pulse_end - self.begin] = own[self.begin : self.pulse_end]
        return out

    def responses(self, length: int) -> np.ndarray:
        """Responses of the block without their offset before the hit, (length, n_sensors)."""
        values = self.record.values
        before = values[max(0, self.begin - length // 10) : self.begin]
        block = values[self.begin : self.begin + length]
        return np.asarray(block - (before if len(before) >= RULES.offset_samples else block).mean(axis=0))


def frfs_of_hits(
    records: Sequence[tuple[MeasuredRecord, dict[int, Point]]],
    quantity: Quantity | None = None,
    estimator: Estimator = "H1",
) -> HammerFRFs:
    r"""FRFs of hammer records, averaged over the hits at one place under the same sensors.

    A record holds one hit or several. A pulse is what exceeds `RULES.hit_level` of the largest force of its record. A
    block reaches from a pulse to the next one, and all blocks are as long as the shortest. Left out, and told: a hit
    that the next one follows within `RULES.double_hit` of the usual distance, or that the record cuts as short (the
    usual distance is the upper quartile over all); and one with a channel at its limit (its largest value occurs
    `RULES.clipped_samples` times in the block). The force outside the pulse is set to 0. Where responses have not
    decayed to `RULES.decayed` at the end of the blocks, an exponential window takes them there.

    With spectra X and F of the hits, ``H1 = sum(X F*) / sum(|F|^2)``, ``H2 = sum(|X|^2) / sum(F X*)`` and ``Hv`` their
    geometric mean (Bendat and Piersol 2010, section 6.1.4; Rocklin, Crowley and Vold 1985). Noise of the responses
    leaves H1 without bias, noise of the force H2. The repeats are pseudo-values of leaving out each hit (Tukey 1958):
    their mean is the estimate over all, that of all but one the estimate without it.

    Parameters
    ----------
    records : sequence of (MeasuredRecord, places by node in m)
        Each with one force.
    quantity : {"receptance", "mobility", "accelerance"}, optional
        Where the records do not state their motion.
    estimator : {"H1", "H2", "Hv"}

    Raises
    ------
    InputError
        For records without hits or with several forces, of different rates, and where no hit is left.
    """
    if estimator not in ESTIMATORS:
        known = ", ".join(ESTIMATORS)
        raise InputError(f"the estimator is {estimator!r}", place="measurement", remedy=f"one of {known}")
    first = records[0][0]
    for one, _ in records:
        _require_one_force(one)
        if abs(one.rate / first.rate - 1) > SAME_RATE or one.motion != first.motion:
            what = "motion" if one.motion != first.motion else f"rate of {one.rate:.6g} Hz"
            raise InputError(
                f"its {what} is not that of {first.source}", place=one.source, remedy="give records measured alike"
            )
    own = _quantity(first, quantity)
    hits = [hit for one, points in records for hit in _hits_of(one, points)]
    usual = float(np.quantile([hit.end - hit.begin for hit in hits], 0.75))
    kept, dropped = _counted(hits, usual)
    if not kept:
        words = f"none of its {len(dropped)} hits counts: {few(dropped)}"
        raise InputError(words, place=first.source, remedy="hit once, and below the range of every channel")
    length = min(hit.end - hit.begin for hit in kept)
    groups: dict[tuple[object, ...], list[_Hit]] = {}
    for hit in kept:
        groups.setdefault((hit.record.references, frozenset(hit.record.sensors)), []).append(hit)
    rate = max(_window_rate(group, length) for group in groups.values())
    notes = [f"{len(kept)} of {len(kept) + len(dropped)} hits are used, blocks of {length} samples, {estimator}"]
    notes += [Doubt(f"left out: {words}") for words in dropped]
    if rate > 0:
        words = f"an exponential window of {1 / rate:.3g} s was applied"
        notes.append(f"responses had not decayed at the end of the blocks: {words}")
    repeats: list[FRFRepeat] = []
    for group in groups.values():
        repeats += _averaged(group, own, length, rate, estimator, notes if not repeats else [])
    return HammerFRFs(tuple(repeats), rate)


def _require_one_force(record: MeasuredRecord) -> None:
    if len(record.references) != 1:
        words = f"it holds {len(record.references)} forces"
        raise InputError(words, place=record.source, remedy="give one column with the force of the hammer")


def _quantity(record: MeasuredRecord, stated: Quantity | None) -> Quantity:
    found = stated if record.motion is None else QUANTITY_OF[record.motion]
    if found is None:
        remedy = "start it with a line '# unit: (m/s2)/N', or state unit or quantity"
        raise InputError("it does not state what its responses are", place=record.source, remedy=remedy)
    if stated not in (None, found):
        raise InputError(f"it holds {found}, not {stated}", place=record.source, remedy="correct one of them")
    return found


def _hits_of(record: MeasuredRecord, points: dict[int, Point]) -> list[_Hit]:
    """All pulses of a record, each until the next one or the end."""
    assert record.forces is not None
    force = record.forces[:, 0] - np.median(record.forces[:, 0])
    force = force * np.sign(force[np.argmax(np.abs(force))])
    noise = 1.4826 * float(np.median(np.abs(force)))
    above = force > max(RULES.hit_level * force.max(), RULES.hit_noise * noise)
    if not above.any() or above.mean() > RULES.hit_share:
        raise InputError("the force in it does not come in hits", place=record.source, remedy=NO_HITS)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], above.astype(int), [0]])))
    runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    pulses = [runs[0]]
    for start, end in runs[1:]:
        last = pulses[-1]
        if start - last[1] <= last[1] - last[0]:  # noise on its flank, or it rings
            pulses[-1] = last[0], end
        else:
            pulses.append((start, end))
    begins = [max(0, start - 2 * (end - start) - RULES.pulse_samples) for start, end in pulses]
    out = []
    for k, (start, end) in enumerate(pulses):
        until = begins[k + 1] if k + 1 < len(pulses) else len(force)
        tail = min(end + 2 * (end - start) + RULES.pulse_samples, until)
        peak = start + int(np.argmax(force[start:end]))
        out.append(_Hit(record, points, begins[k], peak, max(tail, end), max(until, end)))
    return out


def _counted(hits: Sequence[_Hit], usual: float) -> tuple[list[_Hit], list[str]]:
    """Hits that count, and why others do not."""
    kept, dropped, doubled = [], [], False
    for k, hit in enumerate(hits):
        again = k > 0 and hits[k - 1].record is hit.record
        if doubled and again:  # the second pulse of a double hit, whose first one is named
            doubled = hit.end - hit.begin < RULES.double_hit * usual
            continue
        short = hit.end - hit.begin < RULES.double_hit * usual
        more = k + 1 < len(hits) and hits[k + 1].record is hit.record
        doubled = short and more
        if short:
            after = (hits[k + 1].peak - hit.peak) / hit.record.rate if more else 0.0
            words = f"a double hit, the second one {after:.3g} s later" if more else "cut off by the end of the record"
            dropped.append(f"{hit.where}: {words}")
        elif clipped := _clipped(hit):
            dropped.append(f"{hit.where}: {few(clipped)} at the limit of the range (overload)")
        else:
            kept.append(hit)
    return kept, dropped


def _clipped(hit: _Hit) -> list[str]:
    """Channels at their limit in the block of a hit."""
    record = hit.record
    assert record.forces is not None
    names = [*(sensor.name for sensor in record.sensors), *(f"force {one.name}" for one in record.references)]
    block = np.column_stack([record.values, record.forces])[hit.begin : hit.end]
    return [name for name, own in zip(names, block.T, strict=True) if _is_clipped(own)]


def _is_clipped(values: np.ndarray) -> bool:
    """Whether a channel reaches its limit several times, and jumps there: a rounded peak is flat without a jump."""
    for own in (values, -values, np.abs(values)):
        at = np.flatnonzero(own == own.max())
        beside = own[np.clip(np.concatenate([at - 1, at + 1]), 0, len(own) - 1)]
        if len(at) >= RULES.clipped_samples and own.max() - beside.min() > RULES.clipped_step * np.ptp(values):
            return True
    return False


def _window_rate(hits: Sequence[_Hit], length: int) -> float:
    """Rate of the exponential window, 1/s, that takes what still moves at the end of the blocks to `RULES.decayed`."""
    quarter = length // 4
    if quarter < RULES.offset_samples:
        return 0.0
    window = np.hanning(quarter)[:, None]
    power = []
    for hit in hits:
        block, skipped = hit.responses(length)[:, _order(hit.record, hits[0].record)], hit.pulse_end - hit.begin
        skipped = min(skipped, length - 2 * quarter)
        parts = [part - part.mean(axis=0) for part in (block[skipped : skipped + quarter], block[-quarter:])]
        power.append([np.abs(np.fft.rfft(window * part, axis=0)[2:]) ** 2 for part in parts])
    early, late = np.mean(power, axis=0)
    moving = late > RULES.still_moving * np.median(late, axis=0)
    if not moving.any():
        return 0.0
    left = float(np.sqrt(np.max(np.where(moving, late / np.maximum(early, 1e-300), 0.0))))
    at_end = min(left ** (4 / 3), 1.0)  # from the middle of the first quarter to that of the last
    return max(float(np.log(at_end / RULES.decayed)), 0.0) * hits[0].record.rate / length


def _averaged(
    hits: Sequence[_Hit], quantity: Quantity, length: int, rate: float, estimator: Estimator, notes: Sequence[str]
) -> list[FRFRepeat]:
    """One repeat a hit, as pseudo-values of the average over the hits."""
    record = hits[0].record
    decay = np.exp(-rate * np.arange(length) / record.rate)
    freq = np.fft.rfftfreq(length, 1 / record.rate)
    force = np.array([np.fft.rfft(decay * hit.force(length)) for hit in hits])
    every_block = (hit.responses(length)[:, _order(hit.record, record)] for hit in hits)
    moved = np.array([np.fft.rfft(decay[:, None] * block, axis=0) for block in every_block])
    driven = np.mean(np.abs(force) ** 2, axis=0)
    weak = driven < 10 ** (-RULES.force_drop / 10) * driven.max()
    top = int(np.argmax(weak)) if weak.any() else len(freq)
    used = slice(0, max(int(np.searchsorted(freq[:top], record.rate / RULES.rate_over_lines, "right")), 2))
    freq, force, moved = freq[used], force[:, used, None], moved[:, used]
    every = np.stack([_estimate(estimator, moved, force, k) for k in range(len(hits))])
    whole = _estimate(estimator, moved, force)
    values = whole + (len(hits) - 1) * (every.mean(axis=0) - every) if len(hits) > 1 else whole[None]
    cross, power = np.sum(moved * force.conj(), axis=0), np.sum(np.abs(moved) ** 2, axis=0)
    coherence = np.abs(cross) ** 2 / np.maximum(power * np.sum(np.abs(force) ** 2, axis=0), 1e-300)
    reference = record.references[0]
    keys: list[Key] = [((own.node, own.direction), (reference.node, reference.direction)) for own in record.sensors]
    said = list(notes)
    if len(hits) > 1:
        words = f"coherence of {len(hits)} hits at {reference.name}: {np.median(coherence[1:]):.4f} in the median"
        said.append(f"{words}, {np.quantile(coherence[1:], 0.05):.3f} or less on one line in twenty")
    if top < len(weak):
        words = f"the force falls by {RULES.force_drop:g} dB at {freq[-1]:.5g} Hz, where its lines end"
        said.append(f"{reference.name}: {words}")
    every_note = list(dict.fromkeys(note for hit in hits for note in hit.record.notes))
    return [
        repeat_of(
            hit.where, freq, quantity, dict(zip(keys, values[k].T, strict=True)),
            dict(zip(keys, coherence.T, strict=True)), [*said, *every_note] if k == 0 else [], hit.points,
        )
        for k, hit in enumerate(hits)
    ]  # fmt: skip


def _order(record: MeasuredRecord, wanted: MeasuredRecord) -> list[int]:
    return [record.sensors.index(sensor) for sensor in wanted.sensors]


def _estimate(estimator: Estimator, moved: np.ndarray, force: np.ndarray, without: int | None = None) -> np.ndarray:
    """FRFs (n_lines, n_sensors) of spectra (n_hits, n_lines, n_sensors) and (n_hits, n_lines, 1), perhaps but one."""
    if without is not None and len(moved) > 1:
        moved, force = np.delete(moved, without, axis=0), np.delete(force, without, axis=0)
    cross, own = np.sum(moved * force.conj(), axis=0), np.sum(np.abs(force) ** 2, axis=0)
    first = cross / own
    if estimator == "H1":
        return np.asarray(first)
    silent = cross == 0  # no motion, as at 0 Hz without an offset
    second = np.sum(np.abs(moved) ** 2, axis=0) / np.where(silent, 1.0, cross.conj())
    if estimator == "H2":
        return np.asarray(second)
    return np.asarray(first * np.sqrt(np.abs(second) / np.where(silent, 1.0, np.abs(first))))
