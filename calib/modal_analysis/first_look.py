"""What measured modes, FRFs and records tell by themselves, before any model: complexity, auto-MAC, indicators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from calib.measurement.frf import MeasuredFRFs
from calib.measurement.mac import comac, mac, phase_collinearity, relative_motion
from calib.measurement.matching import match_modes
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.record import MeasuredRecord


def modes_seen(modes: MeasuredModes) -> pd.DataFrame:
    """One row a mode: frequency, damping, complexity, and the other mode whose shape is most alike.

    Columns ``mode, freq, freq_std`` (Hz), ``damping, damping_std`` (ratios), ``mpc, mpd, mcf`` (phase collinearity,
    phase deviation in degrees, and complexity factor ``1 - mpc``; see `calib.measurement.mac.phase_collinearity`),
    ``like`` and ``mac``; NaN and empty where unknown, as without shapes.
    """
    none = np.full(modes.n_modes, np.nan)
    mpc, mpd = phase_collinearity(modes.shapes) if modes.has_shapes else (none, none)
    others = np.abs(auto_mac(modes).drop(columns="mode").to_numpy(dtype=float))
    np.fill_diagonal(others, -1.0)
    known = modes.has_shapes and modes.n_modes > 1
    like = others.argmax(axis=1) if known else np.zeros(modes.n_modes, dtype=int)
    return pd.DataFrame(
        {
            "mode": list(modes.names), "freq": modes.natural_freq, "freq_std": modes.freq_std,
            "damping": modes.damping_ratio, "damping_std": modes.damping_std, "mpc": mpc, "mpd": mpd, "mcf": 1.0 - mpc,
            "like": [modes.names[k] if known else "" for k in like],
            "mac": others[np.arange(modes.n_modes), like] if known else none,
        }
    )  # fmt: skip


def auto_mac(modes: MeasuredModes) -> pd.DataFrame:
    """MAC of every mode with every other: column ``mode`` and one a mode; NaN without shapes."""
    values = mac(modes.shapes, modes.shapes) if modes.has_shapes else np.full((modes.n_modes,) * 2, np.nan)
    table = pd.DataFrame(values, columns=list(modes.names))
    table.insert(0, "mode", list(modes.names))
    return table


def repeats_comac(repeats: Sequence[MeasuredModes]) -> pd.DataFrame:
    """CoMAC of every sensor between each repeat and the first, the lowest of them, worst sensor first.

    Columns ``sensor, comac, repeat``, the number of the repeat that is lowest, from 1, and ``motion``, how much the
    sensor moves (see `calib.measurement.mac.relative_motion`): noise alone makes the CoMAC low of one that hardly does.
    Modes are matched as on reading, see `calib.measurement.matching.match_modes`; empty with fewer than two repeats
    with shapes.
    """
    columns = ["sensor", "comac", "repeat", "motion"]
    names = [sensor.name for sensor in repeats[0].sensors] if repeats else []
    common = [name for name in names if all(name in {s.name for s in one.sensors} for one in repeats)]
    if len(repeats) < 2 or not common:
        return pd.DataFrame(columns=columns)
    shapes = []
    for one in repeats:
        own = [sensor.name for sensor in one.sensors]
        shapes.append(one.shapes[[own.index(name) for name in common]])
    index = match_modes([one.source for one in repeats], [one.natural_freq for one in repeats], shapes).index
    found = np.full((len(repeats), len(common)), np.nan)
    for r in range(1, len(repeats)):
        both = (index[0] >= 0) & (index[r] >= 0)
        if both.any():
            found[r] = comac(shapes[0][:, index[0][both]], shapes[r][:, index[r][both]])
    lowest = np.nan_to_num(found, nan=np.inf).argmin(axis=0)
    table = pd.DataFrame(
        {
            "sensor": common, "comac": found[lowest, np.arange(len(common))], "repeat": lowest + 1,
            "motion": relative_motion(shapes[0]),
        }
    )  # fmt: skip
    return table.sort_values("comac", kind="stable", ignore_index=True)


def functions_seen(frfs: MeasuredFRFs, coherence: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """One row a function: its band, level and coherence.

    Columns ``function, lines, freq_min, freq_max`` (Hz), ``peak_freq`` (Hz) and ``peak``, the largest modulus (SI), and
    ``coherence, coherence_least``: the median over all lines, and the least at the resonances of all functions.

    Parameters
    ----------
    frfs : MeasuredFRFs
    coherence : mapping from function to ndarray (n_freq,)
        See `coherences`; none for functions without.
    """
    peaks = [int(np.argmin(np.abs(frfs.freq - one.freq))) for one in frfs.resonances()]
    rows = []
    for function in frfs.functions:
        size = np.abs(frfs.values[function.index])
        own = coherence.get(function.name, np.full(len(frfs.freq), np.nan))
        at, freq = own[peaks], frfs.freq[function.lines]
        rows.append(
            (
                function.name, len(freq), freq[0], freq[-1], freq[size.argmax()], size.max(),
                np.nanmedian(own) if np.isfinite(own).any() else np.nan,
                np.nanmin(at) if np.isfinite(at).any() else np.nan,
            )
        )  # fmt: skip
    columns = ["function", "lines", "freq_min", "freq_max", "peak_freq", "peak", "coherence", "coherence_least"]
    return pd.DataFrame(rows, columns=columns)


def coherences(frfs: MeasuredFRFs) -> dict[str, np.ndarray]:
    """Coherence of every function with known standard deviations, by its name, (n_freq,); NaN where unknown.

    With n repeats of one excitation and the standard deviation s of the mean, of real and imaginary part each, it is
    ``1/(1 + 2 n s^2/|H|^2)``: that of which s follows (Bendat and Piersol 2010, section 9.2.4).
    """
    out = {}
    for function in frfs.functions:
        own, std = frfs.values[:, function.i, function.j], frfs.std[:, function.i, function.j]
        with np.errstate(divide="ignore", invalid="ignore"):
            known = 1.0 / (1.0 + 2.0 * frfs.n_repeats * std**2 / np.abs(own) ** 2)
        if np.isfinite(known).any():
            out[function.name] = known
    return out


def indicators(frfs: MeasuredFRFs) -> pd.DataFrame:
    """Complex mode indicator functions, one a reference, and the normal mode indicator.

    Columns ``freq`` (Hz), ``cmif_1, cmif_2, ...``, the singular values of the matrix of responses and references on
    each line (Shih et al. 1988), and ``mif``, ``sum |Re H| |H| / sum |H|^2`` of displacement or acceleration, which
    falls to 0 where all responses are a quarter of a period behind the force. Entries that were not measured count
    as 0.
    """
    values = np.where(np.isfinite(frfs.values), frfs.values, 0.0)
    singular = np.linalg.svd(values, compute_uv=False)
    phase = values * (-1j if frfs.quantity == "mobility" else 1.0)  # mobility is a quarter of a period ahead
    power = np.sum(np.abs(values) ** 2, axis=(1, 2))
    real = np.sum(np.abs(phase.real) * np.abs(values), axis=(1, 2))
    table = pd.DataFrame({"freq": frfs.freq})
    for k in range(singular.shape[1]):
        table[f"cmif_{k + 1}"] = singular[:, k]
    return table.assign(mif=np.divide(real, power, out=np.full(len(power), np.nan), where=power > 0))


def channels_seen(records: Sequence[MeasuredRecord]) -> pd.DataFrame:
    """One row a record and channel: ``record`` (from 1), ``sensor, rms, peak, crest`` (peak over rms), ``held``.

    ``held`` is the share of samples that equal the largest or the smallest one: clipped where it is large. SI.
    """
    rows = []
    for number, record in enumerate(records, start=1):
        for sensor, own in zip(record.sensors, record.values.T, strict=True):
            moving = own - own.mean()
            rms, peak = float(np.sqrt(np.mean(moving**2))), float(np.abs(moving).max(initial=0.0))
            held = float(np.mean((own == own.max()) | (own == own.min())))
            rows.append((number, sensor.name, rms, peak, peak / rms, held))
    return pd.DataFrame(rows, columns=["record", "sensor", "rms", "peak", "crest", "held"])


def spectra(records: Sequence[MeasuredRecord]) -> pd.DataFrame:
    """Singular values of the cross spectra over frequency, ``freq`` (Hz), ``cmif_1, cmif_2`` (squared unit a Hz).

    Averaged over half-overlapping Hann windows and records (Brincker, Zhang and Andersen 2001), with a resolution of
    about 1/1000 of the rate or, in short records, of eight windows.
    """
    from scipy.signal import csd  # slow to import

    length = min(1024, *(len(record.values) // 8 for record in records))
    total: np.ndarray | float = 0.0
    freq = np.zeros(0)
    for record in records:
        own = record.values - record.values.mean(axis=0)
        freq, cross = csd(own.T[:, None], own.T[None], fs=record.rate, nperseg=length, axis=-1)
        total = total + np.moveaxis(cross, -1, 0) * len(own)
    average = np.asarray(total) / sum(len(record.values) for record in records)
    singular = np.linalg.svd(average, compute_uv=False)
    table = pd.DataFrame({"freq": freq})
    for k in range(min(2, singular.shape[1])):
        table[f"cmif_{k + 1}"] = singular[:, k]
    return table.iloc[1:].reset_index(drop=True)


def nodes_seen(sensors: Sequence[Sensor]) -> pd.DataFrame:
    """Measured nodes with their places and directions: ``node, x, y, z`` (m, NaN where unknown), ``directions``."""
    rows: dict[int, list[Sensor]] = {}
    for sensor in sensors:
        rows.setdefault(sensor.node, []).append(sensor)
    return pd.DataFrame(
        [
            (node, *(own[0].point or (np.nan,) * 3), " ".join(dict.fromkeys(s.direction for s in own)))
            for node, own in sorted(rows.items())
        ],
        columns=["node", "x", "y", "z", "directions"],
    )
