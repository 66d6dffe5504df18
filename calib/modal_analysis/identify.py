"""Modes from measured FRFs, with standard deviations, and what the FRFs say against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.measurement.alignment import scaled
from calib.measurement.files.csv_format import FINEST
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.mac import most_real
from calib.measurement.modal import MeasuredModes, Sensor
from calib.modal_analysis.adequacy import Adequacy, adequacy, resonances_without_mode
from calib.modal_analysis.model import ModalFRFModel, fit_residues, most_likely_model, rank_one
from calib.modal_analysis.poles import poles_by_order
from calib.modal_analysis.spread import Spread, aligned, both_parts, jackknife
from calib.modal_analysis.stabilisation import Chain, pole_chains, pole_table, stable

INSTEAD = 'fit the FRFs themselves: kind = "frf" in study.toml, or calib.FRFTest'
"""Remedy where modes do not describe the FRFs."""
AMBIENT = "measure longer, or give a band around the modes that are wanted"
"""Remedy where time records do not tell."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Modes of a structure, identified from its FRFs.

    Attributes
    ----------
    modes : MeasuredModes
        Those that count, in ascending frequency, with standard deviations of the mean; names ``1``, ``2``, ...
    fit : DataFrame
        Every stable mode: ``mode`` (its name; empty where it was refused), ``freq``, ``freq_std`` (Hz), ``damping``,
        ``damping_std`` (ratios), ``orders`` (at which it is stable), ``frac``, ``residual_std`` and ``excess`` (see
        `calib.modal_analysis.adequacy.Adequacy`), ``rank_one`` (share of its residues that one shape describes) and
        ``refused`` (why; empty where it counts).
    poles : DataFrame
        See `calib.modal_analysis.stabilisation.pole_table`, with the names of the modes in ``mode``.
    curves : DataFrame
        ``freq`` (Hz), ``measured`` and ``synthesised``: root mean squares over all functions, in the quantity's unit.
    missed : tuple of float
        Resonances without a mode, Hz.
    std_from : {"repeats", "orders", "parts"}
        Whether standard deviations come from leaving out each repeat in turn, from the spread over model orders, or
        from leaving out parts of the one record.
    of : {"FRFs", "records"}
        What they were identified from; of records ``curves`` are half-spectra, in the squared unit a Hz, and an order
        of ``poles`` is a number of states, not of pole pairs.
    """

    modes: MeasuredModes
    fit: pd.DataFrame
    poles: pd.DataFrame
    curves: pd.DataFrame
    missed: tuple[float, ...]
    std_from: str
    of: str = "FRFs"

    @property
    def verdict(self) -> str:
        """Whether the modes describe what they were identified from, in one sentence."""
        refused = self.fit[self.fit["refused"] != ""]
        doubts = [f"{_hz(refused['freq'])} refused"] * bool(len(refused))
        doubts += [f"no mode for the resonances at {_hz(self.missed)}"] * bool(self.missed)
        whole = self.fit["frac"][self.fit["refused"] == ""]
        if not doubts:
            what = "FRFs" if self.of == "FRFs" else "correlations of the records"
            return f"The modes describe the {what} around their resonances (FRAC {whole.min():.4f} or more)."
        if self.of == "records":
            return f"Not all of these records is described by modes that count ({'; '.join(doubts)}): {AMBIENT}."
        return f"Modes alone do not describe these FRFs ({'; '.join(doubts)}): {INSTEAD}."


def modes_from_frfs(frfs: MeasuredFRFs, repeats: Sequence[MeasuredFRFs] = ()) -> Identification:
    """Identify modes by stable poles, refine them by least squares, and check them against the FRFs.

    The poles come from the least-squares complex frequency method at ascending orders (`poles_by_order`); those count
    that stay (`stable`). All poles are then refined together (`most_likely_model`), which removes the bias by noise.
    A mode is refused where the fit misses the FRFs, where a further pole would move it (`adequacy`), or where it does
    not appear whichever repeat is left out.

    Standard deviations come from the jackknife over the repeats (Efron and Stein 1981): everything is identified again
    without each repeat in turn, modes are matched as those of repeats are (`match_modes`), and the estimated bias is
    added in quadrature. Without repeats they are the spread over the orders, a measure of the method and not of the
    test. Both are multiplied by the residual in standard deviations where it exceeds 1 (Birge 1932).

    Parameters
    ----------
    frfs : MeasuredFRFs
        Mean over the repeats; see `calib.read_frfs`.
    repeats : sequence of MeasuredFRFs
        Each repeat by itself, with the same functions and lines.

    Raises
    ------
    InputError
        When lines are too few (see `poles_by_order`), or no mode counts.

    Examples
    --------
    A mass of 10 kg on a spring of 4 kN/m and a damper of 8 Ns/m:

    >>> import numpy as np
    >>> import calib
    >>> from calib.measurement.frf import MeasuredFRFs
    >>> freq, place = np.linspace(1.0, 6.0, 51), (calib.Sensor(1, "x"),)
    >>> omega = 2 * np.pi * freq
    >>> values = (1 / (4e3 + 8j * omega - 10.0 * omega**2))[:, None, None]
    >>> frfs = MeasuredFRFs(freq, place, place, "receptance", values, std=0.01 * abs(values))
    >>> found = calib.modes_from_frfs(frfs)
    >>> found.modes.natural_freq.round(3), found.modes.damping_ratio.round(4)
    (array([3.183]), array([0.02]))
    """
    whole = _identified(frfs)
    if not whole.chains:
        raise InputError("no pole is stable over the model orders", place=frfs.source or "FRFs", remedy=INSTEAD)
    checked = adequacy(frfs, whole.model, len(whole.chains))
    why = [one.refused for one in checked]
    if len(repeats) > 1:
        spread, lacking = _jackknife(frfs, whole, [_in_order(one, frfs) for one in repeats])
        why = [
            own or ("not stable when one of the repeats is left out" if k in lacking else "")
            for k, own in enumerate(why)
        ]
    else:
        spread = _over_orders(frfs, whole)
    wider = np.array([max(1.0, one.residual_std) if np.isfinite(one.residual_std) else 1.0 for one in checked])
    spread = Spread(spread.freq * wider, spread.damping * wider, spread.shapes * wider)
    kept = [k for k, own in enumerate(why) if not own]
    names = {k: str(n) for n, k in enumerate(kept, start=1)}
    fit = _fit_table(whole, checked, spread, names, why)
    if not kept:
        raise InputError(
            f"the {len(why)} stable poles do not describe it ({fit['refused'].iloc[0]})", place=frfs.source or "FRFs",
            remedy=INSTEAD,
        )  # fmt: skip
    poles = pole_table(whole.every, whole.chains)
    poles["mode"] = [names.get(k - 1, "") for k in poles["mode"]]
    measured, synthesised = (_rms(values) for values in (frfs.values, whole.model.synthesised))
    curves = pd.DataFrame({"freq": frfs.freq, "measured": measured, "synthesised": synthesised})
    std_from = "repeats" if len(repeats) > 1 else "orders"
    return Identification(
        _measured(frfs, whole, spread, kept, max(len(repeats), 1), std_from), fit, poles, curves,
        resonances_without_mode(frfs, whole.model.poles[: len(whole.chains)]), std_from,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Identified:
    """Stable modes of one set of FRFs: the first poles of the model are theirs, the last two lie outside the band."""

    every: tuple[Chain, ...]
    chains: tuple[Chain, ...]
    model: ModalFRFModel
    shapes: np.ndarray
    rank_one: np.ndarray

    @property
    def natural_freq(self) -> np.ndarray:
        return np.asarray(np.abs(self.model.poles[: len(self.chains)]) / (2 * np.pi))

    @property
    def damping_ratio(self) -> np.ndarray:
        own = self.model.poles[: len(self.chains)]
        return np.asarray(-own.real / np.abs(own))


def _identified(frfs: MeasuredFRFs) -> _Identified:
    poles = poles_by_order(frfs)
    every = pole_chains(frfs, poles)
    chains = stable(every, len(poles))
    if not chains:
        return _Identified(every, chains, fit_residues(frfs, np.zeros(0, complex)), np.zeros((0, 0)), np.zeros(0))
    model = most_likely_model(frfs, np.array([chain.pole for chain in chains]))
    residues = model.residues[: len(chains)]
    shapes = np.stack([_unit(_shape(frfs, own)) for own in residues], axis=1)
    order = np.argsort(np.abs(model.poles[: len(chains)]))
    ranked = np.concatenate([order, np.arange(len(chains), len(model.poles))])
    return _Identified(
        every, tuple(chains[k] for k in order), model.reordered(ranked), shapes[:, order],
        np.array([rank_one(residues[k])[2] for k in order]),
    )  # fmt: skip


def _by_response(frfs: MeasuredFRFs) -> bool:
    """Whether shapes are those at the responses: of a roving hammer they are those at the references (reciprocity)."""
    return len(frfs.responses) >= len(frfs.references)


def _shape(frfs: MeasuredFRFs, residues: np.ndarray) -> np.ndarray:
    """Mode shape in the residues of one mode, (n_sensors,)."""
    shape, participation, _ = rank_one(residues)
    return shape if _by_response(frfs) else participation


def _unit(shape: np.ndarray) -> np.ndarray:
    """A shape with a largest modulus of 1, as real as possible."""
    return scaled(most_real(shape)[:, None])[0][:, 0]


def _in_order(repeat: MeasuredFRFs, frfs: MeasuredFRFs) -> MeasuredFRFs:
    """A repeat with responses and references in the order of the mean and in its band."""
    i, j = (
        _places(repeat, own, wanted)
        for own, wanted in ((repeat.responses, frfs.responses), (repeat.references, frfs.references))
    )
    lines = np.abs(repeat.freq[:, None] - frfs.freq).argmin(axis=0)
    here = np.ix_(lines, i, j)
    return replace(
        repeat, freq=frfs.freq, responses=frfs.responses, references=frfs.references, values=repeat.values[here],
        std=repeat.std[here],
    )  # fmt: skip


def _places(repeat: MeasuredFRFs, own: Sequence[Sensor], wanted: Sequence[Sensor]) -> np.ndarray:
    names = [sensor.name for sensor in own]
    if lacking := [sensor.name for sensor in wanted if sensor.name not in names]:
        raise InputError(
            f"it lacks {lacking[0]}", place=repeat.source or "repeat", remedy="give the same functions in every repeat"
        )
    return np.array([names.index(sensor.name) for sensor in wanted])


def _jackknife(frfs: MeasuredFRFs, whole: _Identified, repeats: Sequence[MeasuredFRFs]) -> tuple[Spread, set[int]]:
    """Standard deviations over the repeats, and the modes that some set of all repeats but one lacks."""
    n, values = len(repeats), np.array([one.values for one in repeats])
    less = float(np.sqrt(n / (n - 1)))
    without = [
        _identified(replace(frfs, values=np.delete(values, k, axis=0).mean(axis=0), std=frfs.std * less))
        for k in range(n)
    ]
    try:
        return jackknife(whole, without, [one.source for one in repeats])
    except InputError as fault:
        raise InputError(fault.problem, place=fault.place, remedy=INSTEAD) from None


def _over_orders(frfs: MeasuredFRFs, whole: _Identified) -> Spread:
    freq, damping = np.array([chain.spread for chain in whole.chains]).T
    shapes = []
    for k, chain in enumerate(whole.chains):
        own = []
        for flat in chain.residues:
            table = np.full(frfs.values.shape[1:], complex(np.nan, np.nan))
            for one, value in zip(frfs.functions, flat, strict=True):
                table[one.i, one.j] = value
            own.append(aligned(whole.shapes[:, k], _shape(frfs, table)))
        shapes.append(both_parts(np.array(own)))
    return Spread(freq, damping, np.stack(shapes, axis=1))


def _fit_table(
    whole: _Identified, checked: Sequence[Adequacy], spread: Spread, names: dict[int, str], why: Sequence[str]
) -> pd.DataFrame:
    return pd.DataFrame([
        {
            "mode": names.get(k, ""), "freq": whole.natural_freq[k], "freq_std": spread.freq[k],
            "damping": whole.damping_ratio[k], "damping_std": spread.damping[k], "orders": len(whole.chains[k].orders),
            "frac": one.frac, "residual_std": one.residual_std, "excess": one.excess, "rank_one": whole.rank_one[k],
            "refused": why[k],
        }
        for k, one in enumerate(checked)
    ])  # fmt: skip


def _measured(
    frfs: MeasuredFRFs, whole: _Identified, spread: Spread, kept: Sequence[int], n_repeats: int, std_from: str
) -> MeasuredModes:
    sensors: tuple[Sensor, ...] = frfs.responses if _by_response(frfs) else frfs.references
    words = {
        "repeats": f"standard deviations from {n_repeats} repeats, each left out in turn",
        "orders": "one measurement: standard deviations are the spread over model orders, not that of repeated tests",
    }[std_from]
    freq, damping = whole.natural_freq[list(kept)], whole.damping_ratio[list(kept)]
    notes = (words, *([] if _by_response(frfs) else ["shapes at the references, by reciprocity"]))
    return MeasuredModes(
        names=tuple(str(k) for k in range(1, len(kept) + 1)), natural_freq=freq,
        damped_freq=freq * np.sqrt(1 - damping**2), freq_std=spread.freq[list(kept)], damping_ratio=damping,
        damping_std=spread.damping[list(kept)], sensors=sensors, shapes=whole.shapes[:, list(kept)],
        shape_std=spread.shapes[:, list(kept)], n_repeats=n_repeats, synthetic=frfs.synthetic, source=frfs.source,
        notes=notes, misplaced=frfs.misplaced,
    )  # fmt: skip


def _rms(values: np.ndarray) -> np.ndarray:
    """Root mean square over all functions, (n_freq,)."""
    return np.asarray(np.sqrt(np.nanmean(np.abs(values) ** 2, axis=(1, 2))))


def _hz(values: Sequence[float] | pd.Series) -> str:
    return f"{', '.join(f'{value:.4g}' for value in values)} Hz"


def modes_table(modes: MeasuredModes) -> pd.DataFrame:
    """Columns of `read_modes_csv`; standard deviations of the mean, NaN where unknown."""
    return pd.DataFrame({
        "mode": modes.names, "freq": modes.natural_freq, "freq_kind": "natural",
        "freq_std": _known(modes.freq_std, modes.natural_freq), "damping": modes.damping_ratio,
        "damping_std": _known(modes.damping_std, modes.damping_ratio),
    })  # fmt: skip


def _known(std: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Standard deviations, NaN where they are rounding errors of data without noise."""
    return np.where(std > FINEST * np.abs(value), std, np.nan)


def shapes_table(modes: MeasuredModes) -> pd.DataFrame:
    """Columns of `calib.measurement.files.csv_format.read_shapes_csv`, mode by mode."""
    return pd.DataFrame([
        {
            "mode": name, "node": sensor.node, "direction": sensor.direction, "re": modes.shapes[i, k].real,
            "im": modes.shapes[i, k].imag, "std": modes.shape_std[i, k],
        }
        for k, name in enumerate(modes.names)
        for i, sensor in enumerate(modes.sensors)
    ])  # fmt: skip


def sensor_table(modes: MeasuredModes) -> pd.DataFrame:
    """Columns of `calib.measurement.files.csv_format.read_sensor_table`, for the nodes whose places are known."""
    places = {sensor.node: sensor for sensor in modes.sensors if sensor.point is not None}
    rows = [
        {"node": node, **dict(zip("xyz", sensor.point or (), strict=True)), "on": sensor.on or ""}
        for node, sensor in places.items()
    ]
    return pd.DataFrame(rows, columns=["node", "x", "y", "z", "on"])
