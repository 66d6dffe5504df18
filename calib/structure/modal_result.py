"""Modes returned by a user's function: validation, and conversion to named numbers for the ledger."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.errors.errors import EvaluationError
from calib.measurement.modal import Sensor
from calib.structure.modes import Modes

_PARTS = ("natural_freq", "damping_ratio", "shapes")


def modes_from_result(result: Any, sensors: Sequence[Sensor], count: int, damped: bool) -> Modes:
    """Modes from the result of a function; of more than ``count`` the lowest.

    Parameters
    ----------
    result : Any
        See `calib.structure.modal_function.ModalFunctionModel`.
    sensors : sequence of Sensor
        Sensors of the rows of the shapes.
    count : int
        Number of modes requested.
    damped : bool
        Whether damping ratios are requested.

    Raises
    ------
    EvaluationError
        When the result is invalid: something is missing, of the wrong size, not finite, or not in ascending frequency.
    """
    freq, ratio, shapes = _given(result, damped)
    freq = _array("natural_freq", freq, 1, real=True)
    n = len(freq)
    shapes = _array("shapes", shapes, 2)
    if shapes.shape != (len(sensors), n):
        raise EvaluationError(
            f"the function gave shapes of {shapes.shape[0]} rows and {shapes.shape[1]} columns for "
            f"{len(sensors)} sensors and {n} frequencies"
        )
    ratio = np.zeros(n) if ratio is None else _array("damping_ratio", ratio, 1, real=True)
    if ratio.shape != (n,):
        raise EvaluationError(f"the function gave {len(ratio)} damping ratios for {n} frequencies")
    if n < count:
        raise EvaluationError(f"the function gave {n} modes, and n_modes says {count}")
    freq, ratio, shapes = freq[:count], ratio[:count], shapes[:, :count]
    for label, array in zip(_PARTS, (freq, ratio, shapes), strict=True):
        wrong = ~np.isfinite(array)
        if wrong.any():
            mode = int(np.argwhere(wrong)[0][-1])
            at = f" at sensor {sensors[int(np.argwhere(wrong)[0][0])].name}" if array.ndim == 2 else ""
            raise EvaluationError(f"{label} of mode {mode + 1} is {array[wrong][0]}{at}")
    if not np.all(freq > 0):
        k = int(np.argmax(~(freq > 0)))
        raise EvaluationError(
            f"the frequency of mode {k + 1} is {freq[k]:g} Hz, but rigid-body motions are not vibration modes"
        )
    if np.any(np.diff(freq) < 0):
        k = int(np.argmax(np.diff(freq) < 0))
        raise EvaluationError(
            f"modes are not in ascending frequency: {freq[k]:g} Hz stands before {freq[k + 1]:g} Hz (mode {k + 2})"
        )
    if np.any(np.abs(ratio) >= 1):
        k = int(np.argmax(np.abs(ratio) >= 1))
        raise EvaluationError(f"the damping ratio of mode {k + 1} is {ratio[k]:g}, which is not an oscillation")
    still = ~np.any(shapes, axis=0)
    if still.any():
        raise EvaluationError(f"mode {int(np.argmax(still)) + 1} moves no sensor")
    kept = shapes.astype(complex) if damped or np.iscomplexobj(shapes) else shapes
    return Modes(freq, freq * np.sqrt(1.0 - ratio**2), ratio, kept)


def _given(result: Any, damped: bool) -> tuple[Any, Any, Any]:
    """Frequencies, damping ratios where present, and shapes."""
    if isinstance(result, tuple | list):
        if len(result) not in (2, 3):
            raise EvaluationError(f"the function gave {len(result)} things, not frequencies, damping ratios and shapes")
        freq, ratio, shapes = result if len(result) == 3 else (result[0], None, result[1])
    else:
        get = result.get if isinstance(result, Mapping) else lambda name: getattr(result, name, None)
        freq, ratio, shapes = (get(name) for name in _PARTS)
    for name, part in (("natural_freq", freq), ("shapes", shapes), *([("damping_ratio", ratio)] if damped else [])):
        if part is None:
            said = f", {', '.join(map(str, result))}" if isinstance(result, Mapping) else ""
            raise EvaluationError(f"the function gave no {name} (it gave {type(result).__name__}{said})")
    if ratio is not None and not damped:
        if np.any(np.asarray(ratio) != 0):
            raise EvaluationError("the function gave damping ratios, and the model is declared without: damped=True")
        ratio = None
    return freq, ratio, shapes


def _array(label: str, given: Any, ndim: int, real: bool = False) -> np.ndarray:
    try:
        found = np.asarray(given)
    except ValueError:  # rows of different lengths
        found = np.array(None)
    if found.dtype.kind not in ("biuf" if real else "biufc") or found.ndim != ndim:
        words = "a number for each mode" if ndim == 1 else "a number for each sensor and mode"
        raise EvaluationError(f"the function gave {label} that are not {words}")
    return found.astype(complex if found.dtype.kind == "c" else float)


# -- as named numbers --------------------------------------------------------------------------------------------------


def mode_numbers(modes: Modes, sensors: Sequence[Sensor]) -> dict[str, float]:
    """Modes as named numbers: frequency, damping ratio, and real and imaginary part of the motion at every sensor."""
    out: dict[str, float] = {}
    for j in range(modes.n_modes):
        out[f"natural_freq {j + 1}"] = float(modes.natural_freq[j])
        out[f"damping_ratio {j + 1}"] = float(modes.damping_ratio[j])
        for sensor, entry in zip(sensors, modes.shapes[:, j], strict=True):
            out[f"{sensor.name} {j + 1}"] = float(entry.real)
            if modes.is_complex:
                out[f"{sensor.name} {j + 1} im"] = float(entry.imag)
    return out


def modes_from(numbers: Mapping[str, float], sensors: Sequence[Sensor], damped: bool) -> Mapping[str, Any]:
    """Input of `modes_from_result` from such numbers; EvaluationError where one is missing."""
    count = sum(name.startswith("natural_freq ") for name in numbers)
    try:
        each = [f"{j + 1}" for j in range(count)]
        shapes = np.array([[numbers[f"{s.name} {j}"] for j in each] for s in sensors])
        if any(name.endswith(" im") for name in numbers):
            shapes = shapes + 1j * np.array([[numbers[f"{s.name} {j} im"] for j in each] for s in sensors])
        ratio = np.array([numbers[f"damping_ratio {j}"] for j in each])
        freq = np.array([numbers[f"natural_freq {j}"] for j in each])
    except KeyError as missing:
        raise EvaluationError(f"the stored modes lack {missing}") from None
    return {"natural_freq": freq, "damping_ratio": ratio if damped else None, "shapes": shapes}


@dataclass(frozen=True, eq=False)
class Numbered:
    """A function of modes that takes their numbers from another function.

    Attributes
    ----------
    numbers : callable
        See `mode_numbers`.
    sensors : tuple of Sensor
    damped : bool
    """

    numbers: Callable[[Mapping[str, float]], Mapping[str, float]]
    sensors: tuple[Sensor, ...]
    damped: bool

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, Any]:
        """Modes, as `calib.structure.modal_function.ModalFunctionModel` expects them."""
        return modes_from(self.numbers(values), self.sensors, self.damped)
