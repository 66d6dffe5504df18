"""Whether identified modes describe the FRFs: the fit around each of them, and whether a further pole would move it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.measurement import rules as reading
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.thinning import resonances_of_many
from calib.modal_analysis.model import ModalFRFModel, refined_again
from calib.modal_analysis.rules import RULES


@dataclass(frozen=True)
class Adequacy:
    """How well the modal model fits the FRFs around one mode, over `ReadRules.resonance_widths` half-power widths.

    Attributes
    ----------
    frac : float
        Frequency response assurance criterion (Heylen and Lammens 1996) over all lines and functions of the window.
    residual_std : float
        Root mean square of the errors in standard deviations of the FRFs; NaN where these are unknown.
    excess : float
        Root mean square of the errors beyond the expectation of the noise, over that of the FRFs.
    refused : str
        Why the mode does not count; empty where it does.
    """

    frac: float
    residual_std: float
    excess: float
    refused: str = ""


def adequacy(frfs: MeasuredFRFs, model: ModalFRFModel, n_modes: int) -> tuple[Adequacy, ...]:
    """Check each of the first ``n_modes`` poles of a model.

    A mode is refused when its excess is above `RULES.excess_most`. Where the fit is worst beyond noise, a further pole
    is tried; if it pays for its parameters by the Bayesian information criterion (Schwarz 1978), every mode is refused
    that it moves by more than poles may move from one order to the next. Such a pole is not stable: the modes there
    cannot be told apart.
    """
    windows = [_window(frfs, pole) for pole in model.poles[:n_modes]]
    found = fits(frfs, model, n_modes)
    doubted: dict[int, str] = {}
    surplus = [_surplus(frfs, model, own) for own in windows]
    if surplus and max(surplus) > RULES.excess_sure:
        doubted = _moved(frfs, model, n_modes, int(np.argmax(surplus)))
    out = []
    for k, one in enumerate(found):
        why = doubted.get(k, "")
        if one.excess > RULES.excess_most:
            why = f"the fit around it misses {100 * one.excess:.0f} % of the FRFs beyond noise"
        out.append(replace(one, refused=why))
    return tuple(out)


def fits(frfs: MeasuredFRFs, model: ModalFRFModel, n_modes: int) -> tuple[Adequacy, ...]:
    """The fit around each of the first ``n_modes`` poles of a model, none refused."""
    return tuple(_fit(frfs, model, _window(frfs, pole)) for pole in model.poles[:n_modes])


def resonances_without_mode(frfs: MeasuredFRFs, poles: np.ndarray) -> tuple[float, ...]:
    """Resonances in the power of the FRFs with no pole (rad/s) within a half-power width or two lines, Hz."""
    found = frfs.resonances() if len(frfs.freq) <= reading.RULES.lines_most else resonances_of_many(frfs)
    own, lines = np.abs(poles) / (2 * np.pi), 2 * float(np.max(np.diff(frfs.freq)))
    return tuple(one.freq for one in found if not np.any(np.abs(own - one.freq) <= max(one.width, lines)))


def _window(frfs: MeasuredFRFs, pole: complex) -> np.ndarray:
    """Lines of the window around a pole, bool."""
    own = abs(pole) / (2 * np.pi)
    away = np.abs(frfs.freq - own)
    reach = max(
        0.5 * reading.RULES.resonance_widths * 2 * (-pole.real / abs(pole)) * own,
        float(np.sort(away)[min(RULES.compared_lines, len(away)) - 1]),
    )
    return np.asarray(away <= reach)


def _fit(frfs: MeasuredFRFs, model: ModalFRFModel, window: np.ndarray) -> Adequacy:
    measured, synthesised, std = frfs.values[window], model.synthesised[window], frfs.total_std[window]
    error, power = np.abs(measured - synthesised) ** 2, float(np.nansum(np.abs(measured) ** 2))
    product = abs(np.nansum(measured.conj() * synthesised)) ** 2
    noise = float(np.nansum(2 * std**2))
    known = std > 0
    return Adequacy(
        float(product / (power * np.nansum(np.abs(synthesised) ** 2))),
        float(np.sqrt(np.mean(error[known] / (2 * std[known] ** 2)))) if known.any() else np.nan,
        float(np.sqrt(max(float(np.nansum(error)) - noise, 0.0) / power)),
    )


def _surplus(frfs: MeasuredFRFs, model: ModalFRFModel, window: np.ndarray) -> float:
    """Squared errors over a window beyond their expectation, in standard deviations of their sum; -inf if unknown."""
    std = frfs.total_std[window]
    known = std > 0
    if not known.any():
        return -np.inf
    squares = np.abs(frfs.values[window] - model.synthesised[window])[known] ** 2 / (2 * std[known] ** 2)
    return float((squares.sum() - len(squares)) / np.sqrt(len(squares)))


def _moved(frfs: MeasuredFRFs, model: ModalFRFModel, n_modes: int, worst: int) -> dict[int, str]:
    """Modes that a further pole beside the worst one moves beyond the limits of stabilisation, with the reason."""
    pole = complex(model.poles[worst])
    tried = [refined_again(frfs, model, pole + side * 1j * abs(pole.real)) for side in (-1, 1)]
    best = min(tried, key=lambda one: _squares(frfs, one))
    rows = 2 * sum(len(one.lines) for one in frfs.functions)
    price = (2 + 2 * len(frfs.functions)) * np.log(rows)
    if _squares(frfs, model) - _squares(frfs, best) <= price:
        return {}
    before, after = model.poles[:n_modes], best.poles[1 : n_modes + 1]
    ratio = [-p.real / np.abs(p) for p in (before, after)]
    moved = np.abs(np.abs(after) / np.abs(before) - 1) > RULES.freq_change
    moved |= np.abs(ratio[1] / ratio[0] - 1) > RULES.damping_change
    where = abs(best.poles[0]) / (2 * np.pi)
    return {
        int(k): f"a further pole near {where:.4g} Hz, which is not stable, would move it" for k in np.flatnonzero(moved)
    }


def _squares(frfs: MeasuredFRFs, model: ModalFRFModel) -> float:
    """Sum of squared errors of real and imaginary parts in standard deviations."""
    std = frfs.total_std
    return float(np.nansum(np.abs(frfs.values - model.synthesised)[std > 0] ** 2 / std[std > 0] ** 2))
