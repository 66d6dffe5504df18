"""Modes from measured FRFs, with standard deviations, and what the FRFs say against them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.measurement.alignment import scaled
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import without_gaps
from calib.measurement.mac import most_real, phase_collinearity
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.thinning import thinned
from calib.modal_analysis.adequacy import adequacy, resonances_without_mode
from calib.modal_analysis.identification import INSTEAD, Identification
from calib.modal_analysis.judgement import (
    PAIR,
    WINDOW,
    accepted_modes,
    complex_shape,
    none_counts,
    residual_words,
    scatter_of_modes,
    scatter_words,
    window_words,
)
from calib.modal_analysis.model import ModalFRFModel, fit_residues, most_likely_model, rank_one
from calib.modal_analysis.poles import poles_by_order
from calib.modal_analysis.scatter import hidden_pairs, scatter, without_split
from calib.modal_analysis.spread import Spread, aligned, both_parts, jackknife
from calib.modal_analysis.stabilisation import (
    Chain,
    orders_needed,
    pole_chains,
    pole_table,
    stable,
    stable_in_parts,
    with_accepted,
)

IDENTIFYING = "identifying all repeats, and all but one"
"""Name of the stage."""


def modes_from_frfs(
    frfs: MeasuredFRFs, repeats: Sequence[MeasuredFRFs] = (), *, accept: Sequence[float] = (),
    progress: Progress = silent,
) -> Identification:  # fmt: skip
    """Identify modes by stable poles, refine them by least squares, and check them against the FRFs.

    The poles come from the least-squares complex frequency method at ascending orders (`poles_by_order`), of the whole
    band and of its parts (`stable_in_parts`); those count that stay (`stable`), and that are not one mode which moves
    between functions (`without_split`). All poles are then refined together (`most_likely_model`), which removes the
    bias by noise. Where functions differ in a resonance, by
    drift or by the mass of a roving sensor, its frequency and damping are the mean over the functions (`scatter`); it
    is refused where two modes explain that better (`hidden_pairs`).
    A mode is refused where the fit misses the FRFs, where a further pole would move it (`adequacy`), where its shape
    is complex under one reference (`complex_shape`), or where it does not appear whichever repeat is left out.

    Many lines with standard deviations are thinned to means over close ones first, those of each repeat alike; see
    `thinned`.

    Where the records of the FRFs bear an exponential window (``window_rate``), which moved every pole to the left by
    the same amount, the poles are moved back; a mode without damping of its own is refused.

    Standard deviations come from the jackknife over the repeats (Efron and Stein 1981): everything is identified again
    without each repeat in turn, modes are matched as those of repeats are (`match_modes`), and the estimated bias is
    added in quadrature. They are multiplied by the residual in standard deviations where it exceeds 1 (Birge 1932),
    and are at least those of the mean by itself.
    Without repeats those of frequencies and damping come from the residuals of the fit and from what the functions
    contradict each other, and those of shapes are the spread over the orders; both are a measure of this test and not
    of repeated ones.

    Parameters
    ----------
    frfs : MeasuredFRFs
        Mean over the repeats; see `calib.read_frfs`. A line at 0 Hz is not used.
    repeats : sequence of MeasuredFRFs
        Each repeat by itself, with the same functions and lines.
    accept : sequence of float
        Natural frequencies, Hz, of refused modes that are kept all the same, with a note.
    progress : Progress
        Told how many of the sets of repeats are identified.

    Raises
    ------
    InputError
        When lines are too few (see `poles_by_order`), no mode counts, or no refused mode is near an accepted frequency.

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
    frfs = without_gaps(frfs)
    repeats = [without_gaps(one, frfs) for one in repeats]
    if frfs.freq[0] == 0:
        frfs = frfs.in_band(frfs.lowest_freq, float(frfs.freq[-1]))
    every_line, repeats = frfs, [_in_order(one, frfs) for one in repeats]
    if all(np.all(frfs.std[one.index] > 0) for one in frfs.functions):
        frfs, *repeats = (thinned(one, like=every_line) for one in (frfs, *repeats))
    sets = 1 + len(repeats) * (len(repeats) > 1)
    progress(IDENTIFYING, 0, sets)
    whole = _identified(frfs, accept)
    n = len(whole.chains)
    if not n:
        raise none_counts(frfs, [])
    moving = scatter(frfs, whole.model, n)
    checked = adequacy(frfs, replace(whole.model, synthesised=moving.synthesised), n)
    mpc, mpd = phase_collinearity(whole.shapes)
    pairs = hidden_pairs(frfs, whole.model.poles[:n], moving)
    few = [len(chain.orders) < whole.orders_needed for chain in whole.chains]
    why = [
        (f"stable at {len(whole.chains[k].orders)} orders only" if few[k] else "")
        or one.refused
        or (PAIR if k in pairs else "")
        or complex_shape(mpc[k], mpd[k], len(frfs.references))
        for k, one in enumerate(checked)
    ]
    spread = Spread(moving.freq_std, moving.damping_std, _shapes_over_orders(frfs, whole))
    if len(repeats) > 1:
        over, lacking = _jackknife(frfs, whole, repeats, accept, lambda k: progress(IDENTIFYING, 1 + k, sets))
        spread = _over_repeats(over, spread, [one.residual_std for one in checked])
        why = [
            own or ("not stable when one of the repeats is left out" if k in lacking else "")
            for k, own in enumerate(why)
        ]
    freq, damping = _freq_and_damping(moving.poles + frfs.window_rate)
    why = [own or (WINDOW if ratio <= 0 else "") for own, ratio in zip(why, damping, strict=True)]
    place = frfs.source or "FRFs"
    accepted = accepted_modes(accept, freq, damping, why, place)
    why = ["" if k in accepted else own for k, own in enumerate(why)]
    notes = [
        "; ".join([*([accepted[k]] if k in accepted else []), *([scatter_words(own)] if own > 0 else [])])
        for k, own in enumerate(moving.between)
    ]
    kept = [k for k, own in enumerate(why) if not own]
    names = {k: str(m) for m, k in enumerate(kept, start=1)}
    if not kept:
        raise none_counts(frfs, list(zip(freq, why, strict=True)))
    one_shape = min(len(frfs.responses), len(frfs.references)) > 1
    fit = pd.DataFrame([
        {
            "mode": names.get(k, ""), "freq": freq[k], "freq_std": spread.freq[k], "damping": damping[k],
            "damping_std": spread.damping[k], "orders": len(whole.chains[k].orders), "frac": one.frac,
            "residual_std": one.residual_std, "excess": one.excess,
            "rank_one": whole.rank_one[k] if one_shape else np.nan, "mpc": mpc[k], "mpd": mpd[k],
            "scatter": moving.between[k], "refused": why[k], "note": notes[k],
        }
        for k, one in enumerate(checked)
    ])  # fmt: skip
    poles = pole_table(whole.every, whole.chains, frfs.window_rate)
    poles["mode"] = [names.get(k - 1, "") for k in poles["mode"]]
    measured, synthesised = (_rms(values) for values in (frfs.values, moving.synthesised))
    curves = pd.DataFrame({"freq": frfs.freq, "measured": measured, "synthesised": synthesised})
    std_from = "repeats" if len(repeats) > 1 else "functions"
    modes = _measured(frfs, whole, freq, damping, spread, kept, max(len(repeats), 1), std_from)
    told = residual_words(
        freq[kept], [checked[k].residual_std for k in kept], [checked[k].excess for k in kept]
    )  # fmt: skip
    if frfs.window_rate > 0:
        taken = frfs.window_rate / (2 * np.pi * freq[kept])
        told = "; ".join(filter(None, [window_words(frfs.window_rate, taken), told]))
    own_notes = [f"mode {names[k]} is {note}" for k, note in accepted.items()]
    differ = scatter_of_modes({names[k]: moving.between[k] for k in kept})
    modes = replace(modes, notes=(*modes.notes, *(note for note in (told, differ) if note), *own_notes))
    missed = resonances_without_mode(every_line, whole.model.poles[:n])
    return Identification(modes, fit, poles, curves, missed, std_from)


def _freq_and_damping(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = np.abs(poles)
    return size / (2 * np.pi), -poles.real / size


def _over_repeats(over: Spread, within: Spread, residual_std: Sequence[float]) -> Spread:
    """Standard deviations over the repeats, widened by residuals, and at least those within their mean.

    A few repeats may agree by chance; residuals of all lines and functions do not.
    """
    wider = np.array([max(1.0, one) if np.isfinite(one) else 1.0 for one in residual_std])
    freq, damping = (np.fmax(a * wider, b) for a, b in ((over.freq, within.freq), (over.damping, within.damping)))
    shapes = np.where(np.isfinite(over.shapes), over.shapes, within.shapes) * wider
    return Spread(freq, damping, shapes)


@dataclass(frozen=True, eq=False)
class _Identified:
    """Stable modes of one set of FRFs: the first poles of the model are theirs, the last two lie outside the band."""

    every: tuple[Chain, ...]
    chains: tuple[Chain, ...]
    model: ModalFRFModel
    shapes: np.ndarray
    rank_one: np.ndarray
    orders_needed: float

    @property
    def natural_freq(self) -> np.ndarray:
        return np.asarray(np.abs(self.model.poles[: len(self.chains)]) / (2 * np.pi))

    @property
    def damping_ratio(self) -> np.ndarray:
        own = self.model.poles[: len(self.chains)]
        return np.asarray(-own.real / np.abs(own))


def _identified(frfs: MeasuredFRFs, accept: Sequence[float] = ()) -> _Identified:
    poles = poles_by_order(frfs)
    every, needed = pole_chains(frfs, poles), orders_needed(len(poles))
    counted = stable(every, len(poles))
    further = stable_in_parts(frfs, counted)
    every += further
    chains = with_accepted(every, (*counted, *further), accept)
    if not chains:
        none = fit_residues(frfs, np.zeros(0, complex))
        return _Identified(every, chains, none, np.zeros((0, 0)), np.zeros(0), needed)
    starts = np.array([chain.pole for chain in chains])
    left = without_split(frfs, starts, [len(chain.orders) for chain in chains])
    chains, starts = tuple(chains[k] for k in left), starts[left]
    model = most_likely_model(frfs, starts)
    residues = model.residues[: len(chains)]
    shapes = np.stack([_unit(_shape(frfs, own)) for own in residues], axis=1)
    order = np.argsort(np.abs(model.poles[: len(chains)]))
    ranked = np.concatenate([order, np.arange(len(chains), len(model.poles))])
    return _Identified(
        every, tuple(chains[k] for k in order), model.reordered(ranked), shapes[:, order],
        np.array([rank_one(residues[k])[2] for k in order]), needed,
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
    after = np.clip(np.searchsorted(repeat.freq, frfs.freq), 1, len(repeat.freq) - 1)
    lines = after - (2 * frfs.freq <= repeat.freq[after - 1] + repeat.freq[after])  # the nearest
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


def _jackknife(
    frfs: MeasuredFRFs, whole: _Identified, repeats: Sequence[MeasuredFRFs], accept: Sequence[float],
    told: Callable[[int], None],
) -> tuple[Spread, set[int]]:  # fmt: skip
    """Standard deviations over the repeats, and the modes that some set of all repeats but one lacks."""
    n, values = len(repeats), np.array([one.values for one in repeats])
    less = float(np.sqrt(n / (n - 1)))
    without = []
    for k in range(n):
        told(k)
        others = np.delete(values, k, axis=0).mean(axis=0)
        without.append(_identified(replace(frfs, values=others, std=frfs.std * less), accept))
    try:
        return jackknife(whole, without, [one.source for one in repeats])
    except InputError as fault:
        raise InputError(fault.problem, place=fault.place, remedy=INSTEAD) from None


def _shapes_over_orders(frfs: MeasuredFRFs, whole: _Identified) -> np.ndarray:
    """Standard deviations of shapes over the orders, (n_sensors, n_modes)."""
    shapes = []
    for k, chain in enumerate(whole.chains):
        own = []
        for flat in chain.residues:
            table = np.full(frfs.values.shape[1:], complex(np.nan, np.nan))
            for one, value in zip(frfs.functions, flat, strict=True):
                table[one.i, one.j] = value
            own.append(aligned(whole.shapes[:, k], _shape(frfs, table)))
        shapes.append(both_parts(np.array(own)))
    return np.stack(shapes, axis=1)


def _measured(
    frfs: MeasuredFRFs, whole: _Identified, freq: np.ndarray, damping: np.ndarray, spread: Spread, kept: Sequence[int],
    n_repeats: int, std_from: str,
) -> MeasuredModes:  # fmt: skip
    sensors: tuple[Sensor, ...] = frfs.responses if _by_response(frfs) else frfs.references
    words = {
        "repeats": f"standard deviations from {n_repeats} repeats, each left out in turn",
        "functions": "one measurement: standard deviations come from its residuals and from what its functions "
        "contradict each other, not from repeated tests",
    }[std_from]
    freq, damping = freq[list(kept)], damping[list(kept)]
    notes = (words, *frfs.notes, *([] if _by_response(frfs) else ["shapes at the references, by reciprocity"]))
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
