"""Modes of several set-ups of ambient records: matched, and their shapes merged by the common sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.measurement.alignment import scaled
from calib.measurement.mac import most_real, phase_collinearity
from calib.measurement.matching import match_modes
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.places import Misplaced
from calib.measurement.rules import RULES as READ
from calib.modal_analysis.identification import AMBIENT, Identification
from calib.modal_analysis.judgement import accepted_modes
from calib.modal_analysis.rules import RULES

ROUNDS = 5
"""Alternations of factors and merged shape, which agree after two or three."""
LEAST_STD = 1e-6
"""Smallest standard deviation of an entry of a shape, whose largest is 1."""


@dataclass(frozen=True, eq=False)
class _Merged:
    """One mode of all set-ups: ``members`` are (set-up, place), ``why`` it does not count."""

    members: tuple[tuple[int, int], ...]
    freq: tuple[float, float]
    damping: tuple[float, float]
    shape: np.ndarray
    std: np.ndarray
    why: str


def merged_setups(found: Sequence[Identification], accept: Sequence[float] = ()) -> Identification:
    """Modes of set-ups with common sensors as modes of all sensors.

    Every set-up is identified by itself (PoSER; Reynders, Magalhães, Roeck and Cunha 2009). Modes are matched as those
    of repeats are (`match_modes`), by the common sensors and within `RULES.same_freq` of the frequency or five standard
    deviations. Shapes are scaled to each other by weighted least squares over the common sensors. Frequency and damping
    are means weighed by their variances, and their standard deviations grow by the root of chi-square over its degrees
    of freedom where set-ups differ by more (Birge 1932), as drift and the mass of sensors make them.

    A mode does not count that some set-up lacks, or whose common sensors move too little to scale it: the factor is
    uncertain by more than `RULES.damping_unsure` of it. An accepted one keeps the shape at the sensors that have it.

    Parameters
    ----------
    found : sequence of Identification
        Of records, in the order of the set-ups.
    accept : sequence of float
        See `calib.modal_analysis.ambient.modes_from_records`.

    Raises
    ------
    InputError
        For a set-up without a sensor in common with the others, modes that cannot be matched, and where none counts.
    """
    each = [one.modes for one in found]
    sensors = tuple(dict.fromkeys(sensor for one in each for sensor in one.sensors))
    order, place = _linked(each), ", ".join(one.source for one in each)
    rows = [[sensors.index(sensor) for sensor in one.sensors] for one in each]
    shapes = [_spread(one.shapes.astype(complex), here, len(sensors)) for one, here in zip(each, rows, strict=True)]
    std = [_spread(one.shape_std, here, len(sensors)) for one, here in zip(each, rows, strict=True)]
    index = match_modes([one.source for one in each], [one.natural_freq for one in each], shapes).index
    columns = [column for k in range(index.shape[1]) for column in _same_freq(each, index[:, k])]
    modes = [
        _merged([(r, k) for r, k in sorted(own, key=lambda pair: order.index(pair[0]))], each, shapes, std)
        for own in columns
    ]  # fmt: skip
    modes.sort(key=lambda one: one.freq[0])
    why = [one.why for one in modes]
    freq, damping = (np.array([getattr(one, name)[0] for one in modes]) for name in ("freq", "damping"))
    accepted = accepted_modes(accept, freq, damping, why, place)
    why = ["" if k in accepted else own for k, own in enumerate(why)]
    kept = [k for k, own in enumerate(why) if not own]
    if not kept:
        raise InputError(f"no mode counts in all its set-ups ({modes[0].freq[0]:.4g} Hz: {why[0]})", place=place,
                         remedy=AMBIENT)  # fmt: skip
    names = {k: str(n) for n, k in enumerate(kept, start=1)}
    merged = _modes([modes[k] for k in kept], each, sensors)
    notes = [f"mode {names[k]} is {note}" for k, note in accepted.items()]
    return Identification(
        replace(merged, notes=(*merged.notes, *notes)), _fit(found, modes, names, why, accepted),
        _poles(found, modes, names), _curves(found), tuple(sorted({f for one in found for f in one.missed})),
        found[0].std_from if len({one.std_from for one in found}) == 1 else "parts", "records",
    )  # fmt: skip


def _spread(values: np.ndarray, rows: Sequence[int], n_sensors: int) -> np.ndarray:
    """Values of a set-up (n_own, n_modes) at all sensors; NaN where it has none."""
    out = np.full((n_sensors, values.shape[1]), np.nan, dtype=values.dtype)
    out[list(rows)] = values
    return out


def _linked(each: Sequence[MeasuredModes]) -> list[int]:
    """Set-ups in an order in which each has a sensor in common with one before."""
    order, rest = [0], list(range(1, len(each)))
    while rest:
        known = {sensor for r in order for sensor in each[r].sensors}
        linked = next((r for r in rest if known & set(each[r].sensors)), None)
        if linked is None:
            raise InputError(
                f"it has no sensor in common with {each[0].source}", place=each[rest[0]].source,
                remedy="leave one sensor, the reference, at its place in every set-up",
            )  # fmt: skip
        order.append(linked)
        rest.remove(linked)
    return order


def _same_freq(each: Sequence[MeasuredModes], column: np.ndarray) -> list[list[tuple[int, int]]]:
    """Members of a matched mode in groups of the same frequency."""
    members = sorted(((r, int(k)) for r, k in enumerate(column) if k >= 0), key=lambda m: each[m[0]].natural_freq[m[1]])
    groups: list[list[tuple[int, int]]] = []
    for r, k in members:
        own, sure = each[r].natural_freq[k], each[r].freq_std[k]
        if groups:
            s, m = groups[-1][-1]
            reach = max(READ.same_freq * own, 5 * float(np.hypot(sure, each[s].freq_std[m])))
            if own - each[s].natural_freq[m] <= reach:
                groups[-1].append((r, k))
                continue
        groups.append([(r, k)])
    return groups


def _merged(
    members: Sequence[tuple[int, int]], each: Sequence[MeasuredModes], shapes: Sequence[np.ndarray],
    std: Sequence[np.ndarray],
) -> _Merged:  # fmt: skip
    """One mode of its set-ups, of which each has sensors in common with those before, if the mode counts."""
    own = np.array([shapes[r][:, k] for r, k in members])
    sure = np.maximum(np.array([std[r][:, k] for r, k in members]), LEAST_STD)
    factors, doubt = np.ones(len(own), dtype=complex), np.zeros(len(own))
    known, free = np.isfinite(own), ""
    shape, spread = own[0].copy(), sure[0].copy()
    for _ in range(ROUNDS):
        for n in range(1, len(own)):
            common = known[n] & np.isfinite(shape)
            if not common.any():
                free = "no common sensor holds it"
                continue
            weight = 1 / (spread[common] ** 2 + np.abs(factors[n] * sure[n, common]) ** 2)
            size = float(weight @ np.abs(own[n, common]) ** 2)
            factors[n] = (weight * own[n, common].conj()) @ shape[common] / size
            doubt[n] = 1 / np.sqrt(size)
            shape, spread = _mean(own[: n + 1], sure[: n + 1], factors, doubt)
        shape, spread = _mean(own, sure, factors, doubt)
    unsure = doubt[1:] > RULES.damping_unsure * np.abs(factors[1:])
    lacking = [one.source for r, one in enumerate(each) if r not in [r for r, _ in members]]
    why = f"not found in {len(lacking)} of {len(each)} set-ups: {lacking[0]}" if lacking else free
    if not why and unsure.any():
        why = f"the common sensors move too little in it to scale {each[members[int(np.argmax(unsure)) + 1][0]].source}"
    peak = float(np.nanmax(np.abs(shape)))
    turned = np.where(np.isfinite(shape), shape, 0.0)
    shape = np.where(np.isfinite(shape), most_real(turned), complex(np.nan, np.nan))
    return _Merged(
        tuple(members), _weighed([(each[r].natural_freq[k], each[r].freq_std[k]) for r, k in members]),
        _weighed([(each[r].damping_ratio[k], each[r].damping_std[k]) for r, k in members]),
        scaled(shape[:, None])[0][:, 0], spread / peak, why,
    )  # fmt: skip


def _mean(own: np.ndarray, sure: np.ndarray, factors: np.ndarray, doubt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shape over all sensors and its standard deviation, of set-ups (n_setups, n_sensors) in a common scale."""
    known = np.isfinite(own)
    factor = factors[: len(own), None]
    spread = np.hypot(np.abs(factor) * sure, np.where(known, np.abs(own), 0.0) * doubt[: len(own), None])
    weight = np.where(known, 1 / spread**2, 0.0)
    total = weight.sum(axis=0)
    mean = np.where(known, factor * own, 0.0)
    there = total > 0
    shape, std = np.full(len(total), complex(np.nan, np.nan)), np.full(len(total), np.nan)
    shape[there] = (weight * mean).sum(axis=0)[there] / total[there]
    std[there] = 1 / np.sqrt(total[there])
    return shape, std


def _weighed(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of values with standard deviations, and its own."""
    value, std = np.array(values).T
    weight = 1 / std**2
    mean = float(weight @ value / weight.sum())
    chi = float(weight @ (value - mean) ** 2) / max(len(value) - 1, 1)
    return mean, float(np.sqrt(max(chi, 1.0) / weight.sum()))


def _modes(kept: Sequence[_Merged], each: Sequence[MeasuredModes], sensors: tuple[Sensor, ...]) -> MeasuredModes:
    freq, damping = (np.array([getattr(one, name) for one in kept]) for name in ("freq", "damping"))
    common = [s.name for s in sensors if all(s in one.sensors for one in each)]
    words = f"{len(each)} set-ups are merged by their common sensors"
    notes = (f"{words}: {', '.join(common)}" if common else words, *dict.fromkeys(n for one in each for n in one.notes))
    misplaced: tuple[Misplaced, ...] = tuple(dict.fromkeys(own for one in each for own in one.misplaced))
    return MeasuredModes(
        names=tuple(str(k) for k in range(1, len(kept) + 1)), natural_freq=freq[:, 0],
        damped_freq=freq[:, 0] * np.sqrt(1 - damping[:, 0] ** 2), freq_std=freq[:, 1], damping_ratio=damping[:, 0],
        damping_std=damping[:, 1], sensors=sensors, shapes=np.stack([one.shape for one in kept], axis=1),
        shape_std=np.stack([one.std for one in kept], axis=1), n_repeats=min(one.n_repeats for one in each),
        synthetic=each[0].synthetic, source=", ".join(one.source for one in each), notes=notes, misplaced=misplaced,
    )  # fmt: skip


def _fit(
    found: Sequence[Identification], modes: Sequence[_Merged], names: dict[int, str], why: Sequence[str],
    accepted: dict[int, str],
) -> pd.DataFrame:  # fmt: skip
    """One row a mode, with the worst of its set-ups, and those that single set-ups refuse."""
    worst = {"orders": "min", "frac": "min", "residual_std": "max", "excess": "max", "rank_one": "min"}
    rows = []
    for n, one in enumerate(modes):
        own = pd.DataFrame([_row(found[r], k) for r, k in one.members])
        (mpc,), (mpd,) = phase_collinearity(one.shape[:, None])
        rows.append({
            "mode": names.get(n, ""), "freq": one.freq[0], "freq_std": one.freq[1], "damping": one.damping[0],
            "damping_std": one.damping[1], **{name: own[name].agg(how) for name, how in worst.items()}, "mpc": mpc,
            "mpd": mpd, "refused": why[n], "note": accepted.get(n, ""),
        })  # fmt: skip
    table = pd.DataFrame(rows)
    refused = []
    for single in found:
        own = single.fit[single.fit["refused"] != ""]
        refused.append(own.assign(refused=[f"{single.modes.source}: {words}" for words in own["refused"]]))
    whole = pd.concat([table, *(part for part in refused if len(part))], ignore_index=True)
    return whole.sort_values("freq", ignore_index=True)


def _row(found: Identification, k: int) -> pd.Series:
    return found.fit[found.fit["mode"] == found.modes.names[k]].iloc[0]


def _poles(found: Sequence[Identification], modes: Sequence[_Merged], names: dict[int, str]) -> pd.DataFrame:
    """Poles of all set-ups, with the names of the merged modes."""
    tables = []
    for r, one in enumerate(found):
        merged = {
            one.modes.names[k]: names.get(n, "") for n, mode in enumerate(modes) for s, k in mode.members if s == r
        }
        tables.append(one.poles.assign(mode=[merged.get(name, "") for name in one.poles["mode"]]))
    return pd.concat(tables, ignore_index=True).sort_values(["order", "freq"], ignore_index=True)


def _curves(found: Sequence[Identification]) -> pd.DataFrame:
    """Root mean square half-spectra over all set-ups; those of the first where their lines differ."""
    first = found[0].curves
    if any(len(one.curves) != len(first) or not np.allclose(one.curves["freq"], first["freq"]) for one in found):
        return first
    each = {name: [one.curves[name] ** 2 for one in found] for name in ("measured", "synthesised")}
    return first.assign(**{name: np.sqrt(np.mean(squares, axis=0)) for name, squares in each.items()})
