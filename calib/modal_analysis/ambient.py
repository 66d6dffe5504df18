"""Modes from time records of responses alone, with standard deviations, and what the records say against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy import signal

from calib.errors.errors import InputError
from calib.measurement.alignment import scaled
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.mac import mac, most_real, phase_collinearity
from calib.measurement.modal import MeasuredModes
from calib.measurement.record import MeasuredRecord
from calib.modal_analysis.adequacy import Adequacy, fits, resonances_without_mode
from calib.modal_analysis.identification import AMBIENT, Identification
from calib.modal_analysis.judgement import accepted_modes
from calib.modal_analysis.model import fit_residues, rank_one
from calib.modal_analysis.rules import RULES
from calib.modal_analysis.setups import merged_setups
from calib.modal_analysis.spread import Spread, aligned, both_parts
from calib.modal_analysis.stabilisation import Chain
from calib.modal_analysis.subspace import (
    Correlations,
    Poles,
    poles_at,
    poles_at_orders,
    record_correlations,
    samples_needed,
    stable_clusters,
)
from calib.results.answer import hertz

DECIMATED_MOST = 10
"""Largest factor of one step of decimation."""


def modes_from_records(
    records: Sequence[MeasuredRecord], band: tuple[float, float] | None = None, *, accept: Sequence[float] = ()
) -> Identification:
    """Identify modes from responses to unmeasured, broad-banded forces.

    Poles come from covariance-driven stochastic subspace identification at ascending orders (`poles_at_orders`),
    clustered by pyOMA2's preset (`stable_clusters`); natural frequency, damping ratio and shape are medians over the
    orders. Shapes have no scale.

    Standard deviations come from the jackknife (Efron and Stein 1981) with the poles at fixed orders: over the records
    where there are several, else over `RULES.parts` parts of the record, whose correlations count as independent.

    A mode is refused where it is lost when one of the records or parts is left out, where its natural frequency is
    uncertain by more than 1 % or its damping ratio by more than half of it, where it is too slow for the sampling rate
    (a band then decimates the record), where one shape does not describe its share
    of the half-spectra (see `half_spectra`), and where the modal model misses these by more than `RULES.excess_most`
    beyond noise.

    Parameters
    ----------
    records : sequence of MeasuredRecord
        Of one rate; see `calib.measurement.files.read_records.read_records`. Records with the same sensors are repeats;
        others are set-ups, which need a sensor in common, at its place in each (see `merged_setups`).
    band : (float, float), optional
        In which modes are identified, Hz; records that are sampled faster than it needs are decimated, as far as the
        samples that this leaves suffice.
    accept : sequence of float
        Natural frequencies, Hz, of refused modes that are kept all the same, with a note.

    Raises
    ------
    InputError
        When pyOMA2 is not installed, records are too short, no mode counts, or no refused mode is near an accepted
        frequency.

    Examples
    --------
    A mass on a spring at 4 Hz with 1 % of critical damping, under random forces for ten minutes:

    >>> import numpy as np
    >>> from scipy.signal import cont2discrete, lfilter
    >>> import calib
    >>> from calib.measurement.record import MeasuredRecord
    >>> omega, rate, rng = 2 * np.pi * 4.0, 100.0, np.random.default_rng(1)
    >>> b, a, _ = cont2discrete(([1.0, 0.0, 0.0], [1.0, 0.02 * omega, omega**2]), 1 / rate, method="bilinear")
    >>> motion = np.outer(lfilter(b.ravel(), a, rng.standard_normal(60000)), [1.0, 0.5])
    >>> noisy = motion + 0.01 * rng.standard_normal(motion.shape)
    >>> sensors = (calib.Sensor(1, "z"), calib.Sensor(2, "z"))
    >>> record = MeasuredRecord(rate, noisy, sensors, "acceleration", synthetic=True)
    >>> calib.modes_from_records([record]).modes.natural_freq.round(1).tolist()
    [4.0]
    """
    setups: dict[frozenset[str], list[MeasuredRecord]] = {}
    for one in records:
        setups.setdefault(frozenset(sensor.name for sensor in one.sensors), []).append(one)
    if len(setups) < 2:
        return _of_setup(records, band, accept)
    found = [_of_setup(own, band, ()) for own in setups.values()]
    # an accepted mode may be one that a single set-up refuses
    near = [[f for f in accept if _refuses(one, f)] for one in found]
    found = [
        _of_setup(own, band, wanted) if wanted else one
        for own, wanted, one in zip(setups.values(), near, found, strict=True)
    ]
    given = {f for wanted in near for f in wanted}
    return merged_setups(found, [f for f in accept if f not in given])


def _refuses(found: Identification, freq: float) -> bool:
    """Whether a mode near a frequency, Hz, is refused, and none counts there."""
    near = found.fit[(found.fit["freq"] / freq - 1).abs() <= RULES.accepted_reach]
    return bool(len(near)) and bool((near["refused"] != "").all())


def _of_setup(
    records: Sequence[MeasuredRecord], band: tuple[float, float] | None, accept: Sequence[float]
) -> Identification:
    """Modes from records with the same sensors."""
    place = ", ".join(one.source for one in records) or "records"
    low, high = _in_record(band, records[0].rate, place)
    used = [_prepared(one, None if band is None else high, _samples_least(records)) for one in records]
    scale = np.sqrt(np.mean([np.mean(one.values**2, axis=0) for one in used], axis=0))
    used = [replace(one, values=one.values / scale) for one in used]  # sensors of small motion count as others do
    table = record_correlations(used, RULES.parts)
    poles = poles_at_orders(table.hankel, table.rows, table.rate)
    chains = tuple(c for c in stable_clusters(poles) if low <= abs(c.pole) / (2 * np.pi) <= high)
    if not chains:
        raise InputError("no pole is stable over the model orders", place=place, remedy=AMBIENT)
    shapes = np.stack([_shape(c) for c in chains], axis=1)
    spread, lacking = _jackknife(table, chains, shapes, len(records))
    shapes, spread = shapes * scale[:, None], replace(spread, shapes=spread.shapes * scale[:, None])
    peak = np.abs(shapes).max(axis=0)
    spread, shapes = replace(spread, shapes=spread.shapes / peak), scaled(shapes)[0]

    spectra = half_spectra(used, RULES.parts, (low, high))
    spectra = replace(spectra, values=spectra.values * np.outer(scale, scale), std=spectra.std * np.outer(scale, scale))
    moved = np.array([c.pole for c in chains]) - window_rate(table.rate)
    model = fit_residues(spectra, moved)
    adequacies = fits(spectra, model, len(chains))
    one_shape = [rank_one(own)[2] for own in model.residues]
    slowest = RULES.periods_least * table.rate / (2 * table.rows)
    why = [
        f"slower than {hertz(slowest)}, which the sampling rate is too fast for: give a band that ends closer above it"
        if _freq(c) < slowest
        else _refused(c, k, adequacies[k], one_shape[k], spread, lacking, len(records))
        for k, c in enumerate(chains)
    ]
    freq, damping = (np.array([of(c) for c in chains]) for of in (_freq, _ratio))
    accepted = accepted_modes(accept, freq, damping, why, place)
    why = ["" if k in accepted else own for k, own in enumerate(why)]
    mpc, mpd = phase_collinearity(shapes)
    kept = [k for k, own in enumerate(why) if not own]
    names = {k: str(n) for n, k in enumerate(kept, start=1)}
    fit = pd.DataFrame([
        {
            "mode": names.get(k, ""), "freq": _freq(c), "freq_std": spread.freq[k], "damping": _ratio(c),
            "damping_std": spread.damping[k], "orders": len(c.orders), "frac": adequacies[k].frac,
            "residual_std": adequacies[k].residual_std, "excess": adequacies[k].excess,
            "rank_one": one_shape[k] if len(shapes) > 1 else np.nan, "mpc": mpc[k], "mpd": mpd[k],
            "refused": why[k], "note": accepted.get(k, ""),
        }
        for k, c in enumerate(chains)
    ])  # fmt: skip
    if not kept:
        raise InputError(
            f"none of its {len(why)} stable poles counts ({_first_reason(fit)})", place=place, remedy=AMBIENT
        )
    curves = pd.DataFrame({
        "freq": spectra.freq,
        **{name: np.sqrt(np.mean(np.abs(v) ** 2, axis=(1, 2)))
           for name, v in (("measured", spectra.values), ("synthesised", model.synthesised))},
    })  # fmt: skip
    std_from = "repeats" if len(records) > 1 else "parts"
    modes = _measured(records, chains, shapes, spread, kept)
    modes = replace(modes, notes=(*modes.notes, *(f"mode {names[k]} is {note}" for k, note in accepted.items())))
    return Identification(
        modes, fit, _pole_table(poles, chains, names, (low, high)), curves,
        resonances_without_mode(spectra, moved), std_from, "records",
    )  # fmt: skip


def _in_record(band: tuple[float, float] | None, rate: float, place: str) -> tuple[float, float]:
    low, high = band or (0.0, rate / 2)
    if not 0 <= low < high:
        raise InputError(f"the band {low:g} to {high:g} Hz is empty", place=place, remedy="give its lower end first")
    if high > rate / 2:
        raise InputError(
            f"the band ends at {high:g} Hz, above half the rate of {rate:g} Hz", place=place, remedy="end it below"
        )
    return low, high


def _samples_least(records: Sequence[MeasuredRecord]) -> int:
    """Samples of a record that correlations need."""
    return samples_needed(len(records[0].sensors), -(-RULES.parts // len(records)))


def _prepared(record: MeasuredRecord, high: float | None, least: int) -> MeasuredRecord:
    """A record without its trend, decimated to what a band up to a frequency needs, and not below so many samples."""
    values, rate = signal.detrend(record.values, axis=0), record.rate
    factor = 1 if high is None else min(int(rate / (RULES.rate_over_band * high)), len(values) // least)
    while factor > 1:
        step = min(factor, DECIMATED_MOST)
        values, rate, factor = signal.decimate(values, step, ftype="fir", axis=0), rate / step, factor // step
    return replace(record, values=values, rate=rate)


def _freq(chain: Chain) -> float:
    return float(abs(chain.pole) / (2 * np.pi))


def _ratio(chain: Chain) -> float:
    return float(-chain.pole.real / abs(chain.pole))


def _shape(chain: Chain) -> np.ndarray:
    """Median over the orders of both parts, largest modulus 1, as real as possible."""
    middle = chain.residues[int(np.argmin(np.abs(chain.natural_freq - np.median(chain.natural_freq))))]
    every = np.array([aligned(middle, own) for own in chain.residues])
    return np.asarray(scaled(most_real(_median(every))[:, None])[0][:, 0])


def _median(shapes: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """Median of both parts of aligned shapes (n, n_sensors)."""
    return np.asarray(np.median(np.real(shapes), axis=0) + 1j * np.median(np.imag(shapes), axis=0))


def _jackknife(
    table: Correlations, chains: Sequence[Chain], shapes: np.ndarray, n_records: int
) -> tuple[Spread, set[int]]:
    """Standard deviations, and the modes that are lost when one of the parts, or records, is left out."""
    n_parts = len(table.parts)
    each = n_parts // n_records if n_records > 1 else 1
    groups = [range(k, k + each) for k in range(0, n_parts, each)]
    hankels = [table.without(list(group)) for group in groups]
    chosen = [_orders(chain) for chain in chains]
    found: dict[tuple[int, int], list[tuple[float, float, np.ndarray] | None]] = {}
    for order in sorted({order for own in chosen for order in own}):
        here = [poles_at(hankel, table.rows, table.rate, order) for hankel in hankels]
        for k, chain in enumerate(chains):
            if order in chosen[k]:
                at = chain.orders.index(order)
                own_freq = chain.natural_freq[at]
                found[k, order] = [_nearest(one, own_freq, chain.residues[at], shapes[:, k]) for one in here]
    n = len(groups)
    grown = (n - 1) / np.sqrt(n)
    freq, damping, std = np.full(len(chains), np.nan), np.full(len(chains), np.nan), np.full(shapes.shape, np.nan)
    lacking = set()
    for k in range(len(chains)):
        each_part = [
            [one for one in row if one is not None] for row in zip(*(found[k, o] for o in chosen[k]), strict=True)
        ]
        if min(map(len, each_part)) < max(1, len(chosen[k]) // 2):
            lacking.add(k)
            continue
        freq[k], damping[k] = (
            grown * np.std([np.median([one[j] for one in own]) for own in each_part], ddof=1) for j in (0, 1)
        )
        std[:, k] = grown * both_parts(np.array([_median([one[2] for one in own]) for own in each_part]))
    return Spread(freq, damping, std), lacking


def _orders(chain: Chain) -> tuple[int, ...]:
    """Orders at which a mode is identified again."""
    common = tuple(order for order in RULES.orders_resampled if order in chain.orders)
    return common or (chain.orders[len(chain.orders) // 2],)


def _nearest(
    found: tuple[np.ndarray, np.ndarray, np.ndarray], freq: float, shape: np.ndarray, reference: np.ndarray
) -> tuple[float, float, np.ndarray] | None:
    """The pole nearest to a mode among those of its shape; None without one."""
    alike = np.flatnonzero(mac(found[2].T, shape[:, None])[:, 0] >= RULES.same_mac)
    if not len(alike):
        return None
    best = alike[np.argmin(np.abs(found[0][alike] - freq))]
    return float(found[0][best]), float(found[1][best]), aligned(reference, found[2][best])


def _refused(
    chain: Chain, k: int, adequacy: Adequacy, one_shape: float, spread: Spread, lacking: set[int], n_records: int
) -> str:
    """Why a mode does not count; empty where it does."""
    if k in lacking:
        return f"lost when one of the {'records' if n_records > 1 else 'parts of the record'} is left out"
    if spread.freq[k] > RULES.freq_change * _freq(chain):
        return f"its natural frequency is uncertain by {100 * spread.freq[k] / _freq(chain):.2g} %"
    if spread.damping[k] > RULES.damping_unsure * _ratio(chain):
        return f"its damping ratio is uncertain by {100 * spread.damping[k] / _ratio(chain):.0f} % of it"
    if one_shape < RULES.one_shape_least:
        return f"one shape describes only {100 * one_shape:.0f} % of the correlations around it"
    if adequacy.excess > RULES.excess_most:
        return f"the modes miss {100 * adequacy.excess:.0f} % of the correlations around it beyond noise"
    return ""


def _first_reason(fit: pd.DataFrame) -> str:
    return f"{fit['freq'].iloc[0]:.4g} Hz: {fit['refused'].iloc[0]}"


def _pole_table(
    poles: Poles, chains: Sequence[Chain], names: dict[int, str], band: tuple[float, float]
) -> pd.DataFrame:
    """Columns of `calib.modal_analysis.stabilisation.pole_table`; the order is the number of states."""
    of = {
        (order, round(float(f), 9)): names.get(k, "")
        for k, chain in enumerate(chains)
        for order, f in zip(chain.orders, chain.natural_freq, strict=True)
    }
    row, order = np.nonzero(np.isfinite(poles.natural_freq) & (poles.damping_ratio < RULES.record_overdamped))
    freq = poles.natural_freq[row, order]
    table = pd.DataFrame({
        "order": order, "freq": freq, "damping": poles.damping_ratio[row, order],
        "stable": poles.steady[row, order],
        "mode": [of.get((int(o), round(float(f), 9)), "") for o, f in zip(order, freq, strict=True)],
    })  # fmt: skip
    inside = (table["freq"] >= band[0]) & (table["freq"] <= band[1]) & (table["order"] <= RULES.record_order_most)
    return table[inside].sort_values(["order", "freq"], ignore_index=True)


def _measured(
    records: Sequence[MeasuredRecord], chains: Sequence[Chain], shapes: np.ndarray, spread: Spread, kept: list[int]
) -> MeasuredModes:
    several = len(records) > 1
    words = (
        f"standard deviations from {len(records)} records, each left out in turn" if several else
        f"one record: standard deviations from {RULES.parts} parts of it, each left out in turn, not from "
        "repeated tests"
    )  # fmt: skip
    freq, damping = (np.array([of(chains[k]) for k in kept]) for of in (_freq, _ratio))
    return MeasuredModes(
        names=tuple(str(k) for k in range(1, len(kept) + 1)), natural_freq=freq,
        damped_freq=freq * np.sqrt(1 - damping**2), freq_std=spread.freq[kept], damping_ratio=damping,
        damping_std=spread.damping[kept], sensors=records[0].sensors, shapes=shapes[:, kept],
        shape_std=spread.shapes[:, kept], n_repeats=len(records), synthetic=records[0].synthetic,
        source=", ".join(one.source for one in records),
        notes=(words, *(note for one in records for note in one.notes)), misplaced=records[0].misplaced,
    )  # fmt: skip


def window_rate(rate: float) -> float:
    """By how much the window moves every pole to the left, rad/s, at a sampling rate in Hz."""
    return float(-np.log(RULES.window_end) * rate / RULES.lags)


def half_spectra(records: Sequence[MeasuredRecord], n_parts: int, band: tuple[float, float]) -> MeasuredFRFs:
    """Fourier transforms of the correlations at positive lags, with standard deviations over parts of the records.

    Under white forces a correlation at positive lags is a sum of decaying modes, ``phi_r g_r^T exp(s_r t)`` and its
    conjugate (Peeters and De Roeck 1999; Cauberghe 2004), so that its transform has the form of a receptance with
    residues of rank one. An exponential window moves the poles by `window_rate`.

    Returns
    -------
    MeasuredFRFs
        In the squared unit of the records a Hz; responses and references are the sensors. Noise that all lags share,
        which fills the whole band evenly, is part of the series that stands for modes outside it.
    """
    rate, n = records[0].rate, len(records[0].sensors)
    each = max(-(-n_parts // len(records)), 1)
    parts = []
    for one in records:
        length = len(one.values) // each
        lags = min(RULES.lags, length)
        size = 1 << int(2 * length - 1).bit_length()
        for k in range(each):
            own = np.fft.rfft(one.values[k * length : (k + 1) * length], size, axis=0)
            table = np.zeros((RULES.lags, n, n))
            for i in range(n):
                whole = np.fft.irfft(own[:, [i]] * own.conj(), size, axis=0)[:lags]
                table[:lags, i] = whole / (length - np.arange(lags))[:, None]
            parts.append(table)
    decay = np.exp(-window_rate(rate) * np.arange(RULES.lags) / rate)
    spectra = np.array([np.fft.rfft(part * decay[:, None, None], 2 * RULES.lags, axis=0) / rate for part in parts])
    freq = np.fft.rfftfreq(2 * RULES.lags, 1 / rate)
    used = (freq > 0) & (freq >= band[0]) & (freq <= band[1])
    spectra = spectra[:, used]
    spread = (spectra.real.var(axis=0, ddof=1) + spectra.imag.var(axis=0, ddof=1)) / 2
    return MeasuredFRFs(
        freq[used], records[0].sensors, records[0].sensors, "receptance", spectra.mean(axis=0),
        np.sqrt(spread / len(parts)), n_repeats=len(parts), synthetic=records[0].synthetic,
        source=", ".join(one.source for one in records),
    )  # fmt: skip
