"""Detection of unit errors: measured frequencies in rad/s, responses in millimetres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calib.correlation.rules import RULES

FREQ_FACTORS: Mapping[float, str] = {
    2 * math.pi: "look like rad/s",
    60.0: "look like 1/min",
    1e3: "look like mHz, or the model's units do not fit together",
    1e6: "look like units that do not fit together (N/mm against N/m, tonnes against kg)",
}
"""Factors of measured over model frequency; inverted for the model's."""
VALUE_FACTORS = (1e3, 1e6, 1e9)


def frequency_hint(
    measured: Sequence[float] | np.ndarray, model: Sequence[float] | np.ndarray, mac: np.ndarray | None = None
) -> str | None:
    """A sentence when measured and model frequencies differ by a known factor, else None.

    Modes are matched by shape where at least two measured modes, and half of them, have a model mode with a MAC of 0.7
    or more, whatever its frequency; else by ascending order, with at least three modes. By shape, three quarters of the
    ratios, and their median, must lie within 25 % of the factor; by order, where one extra mode shifts the others, all
    of them. Ratios that all exceed 100 are reported too.

    Parameters
    ----------
    measured, model : ndarray (n_measured,), (n_model,)
        Natural frequencies, Hz; vibration modes only.
    mac : ndarray (n_measured, n_model), optional
    """
    ours, theirs = np.asarray(measured, dtype=float), np.asarray(model, dtype=float)
    ratios = _by_shape(ours, theirs, mac)
    how, share = "modes of the same shape", RULES.unit_share
    if ratios is None:
        ratios, how, share = _by_order(ours, theirs), "modes in ascending order", 1.0
    if ratios is None:
        return None
    for factor, words in FREQ_FACTORS.items():
        for whose, side, sign in (("measured", "model's", 1.0), ("model's", "measured", -1.0)):
            logs = np.log(ratios) * sign - math.log(factor)
            near = np.abs(logs) < math.log(1 + RULES.unit_near)
            if near.mean() >= share and abs(np.median(logs)) < math.log(1 + RULES.unit_near):
                return (
                    f"The {whose} frequencies are about {factor:.3g} times the {side} ({how}): they {words}. "
                    "Frequencies are in Hz."
                )
    median = float(np.median(ratios))
    if np.all(ratios > RULES.unit_far) or np.all(ratios < 1 / RULES.unit_far):
        return f"The measured frequencies are {median:.2g} times the model's ({how}): check the units of both."
    return None


def response_hints(measured: Mapping[str, float], model: Mapping[str, float]) -> tuple[str, ...]:
    """Sentences for scalar responses that are far from the model's: near 1e3, 1e6 or 1e9, or in rad/s.

    A single response is reported from a factor of `RULES.unit_far` on. Responses with the same name up to the first
    underscore (``freq_1``, ``freq_2``) are frequencies in rad/s when all, and at least three, are near 2 pi.
    """
    usable = [n for n in measured if measured[n] and model.get(n) and math.isfinite(model[n])]
    ratio = {n: abs(measured[n] / model[n]) for n in usable}
    out = []
    far = {n: r for n, r in ratio.items() if r >= RULES.unit_far or r <= 1 / RULES.unit_far}
    for name, r in far.items():
        factor = next(
            (f for f in VALUE_FACTORS if abs(math.log(max(r, 1 / r) / f)) < math.log(1 + RULES.unit_near)), None
        )
        size = f"about {factor:g}" if factor is not None else f"{max(r, 1 / r):.2g}"
        first, second = ("measured", "model's") if r > 1 else ("model's", "measured")
        words = f"The {first} value of {name} is {size} times the {second}: check the units."
        out.append(words)
    heads: dict[str, list[float]] = {}
    for name in usable:
        if name not in far and "_" in name:
            heads.setdefault(name.split("_", 1)[0], []).append(math.log(ratio[name]))
    for head, logs in heads.items():
        if len(logs) < RULES.unit_by_order:
            continue
        for whose, side, sign in (("measured", "model's", 1.0), ("model's", "measured", -1.0)):
            if np.all(np.abs(np.array(logs) * sign - math.log(2 * math.pi)) < math.log(1 + RULES.unit_near)):
                out.append(f"The {whose} values {head}_... are about 6.28 times the {side}: they look like rad/s.")
    return tuple(out)


def _by_shape(measured: np.ndarray, model: np.ndarray, mac: np.ndarray | None) -> np.ndarray | None:
    """Ratios of the modes with a certain partner by shape; None when these are too few."""
    if mac is None or not len(model):
        return None
    known = np.nan_to_num(mac)
    best = np.argmax(known, axis=1)
    sure = (known[np.arange(len(measured)), best] >= RULES.unit_mac) & (model[best] > 0)
    if sure.sum() < max(RULES.unit_by_shape, len(measured) / 2):
        return None
    return np.asarray(measured[sure] / model[best[sure]])


def _by_order(measured: np.ndarray, model: np.ndarray) -> np.ndarray | None:
    """Ratios in ascending order, without rigid-body motion; None when these are too few."""
    vibrations = np.sort(model[model > 1e-4 * np.max(model, initial=0.0)])
    count = min(len(measured), len(vibrations))
    if count < RULES.unit_by_order:
        return None
    return np.asarray(np.sort(measured)[:count] / vibrations[:count])
