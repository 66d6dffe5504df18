"""Measured modes from arrays."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.errors.arguments import integer, numbers
from calib.errors.errors import InputError
from calib.measurement.accuracy import Accuracy
from calib.measurement.modal import MeasuredModes, Sensor

_PLACE = "measured modes"


def modes(
    freq: ArrayLike,
    shapes: ArrayLike | None = None,
    *,
    sensors: Iterable[Sensor | str | tuple[int, str]] = (),
    damping: ArrayLike | None = None,
    freq_std: ArrayLike | None = None,
    damping_std: ArrayLike | None = None,
    shape_std: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    repeats: int = 1,
    accuracy: Any = None,
    synthetic: bool = False,
) -> MeasuredModes:
    """Measured modes from arrays; what is not given is unknown.

    Parameters
    ----------
    freq : array_like
        Natural frequencies (n_modes,), Hz.
    shapes : array_like, optional
        Real or complex (n_sensors, n_modes); each is scaled to a largest modulus of 1.
    sensors : sequence of Sensor, str or (node, direction)
        One for each row of the shapes, such as ``"12y"``.
    damping : array_like, optional
        Damping ratios (n_modes,).
    freq_std, damping_std : array_like or float, optional
        Standard deviations of the means (n_modes,), Hz and as a ratio.
    shape_std : array_like or float, optional
        Of real and imaginary part each (n_sensors, n_modes), in the unit of the shapes.
    names : sequence of str, optional
        Of the modes; ``"1"``, ``"2"``, ... by default.
    repeats : int
        Repeats behind the standard deviations.
    accuracy : str or mapping, optional
        Claimed accuracy, such as ``"1 %"``; see `calib.ModalTest`.
    synthetic : bool
        Whether no structure was measured.

    Raises
    ------
    InputError
        For arrays of other sizes, and shapes without sensors.

    Examples
    --------
    >>> import calib
    >>> measured = calib.modes([8.32, 27.23], [[0.4, 1.0], [0.8, -0.7]], sensors=["1x", "2x"], freq_std=0.02)
    >>> print(measured)
    2 modes at 2 sensors
    mode  natural Hz  std Hz  damping %
       1        8.32    0.02
       2       27.23    0.02
    """
    natural = _sized(freq, None, "freq")
    placed = tuple(_sensor(one) for one in sensors)
    size, ratio = natural.shape, np.full(natural.shape, np.nan)
    if damping is not None:
        ratio = _sized(damping, size, "damping")
    rows = np.zeros((0, len(natural))) if shapes is None else numbers(shapes, f"{_PLACE}, shapes")
    if rows.shape != (len(placed), len(natural)):
        raise InputError(
            f"shapes are {' by '.join(map(str, rows.shape))}, for {len(placed)} sensors and {len(natural)} modes",
            place=_PLACE, remedy="give one row for each sensor and one column for each mode",
        )  # fmt: skip
    largest = np.max(np.abs(np.nan_to_num(rows)), axis=0, initial=0.0)
    scale = np.where(largest > 0, largest, 1.0)
    spread = np.full(rows.shape, np.nan) if shape_std is None else _sized(shape_std, rows.shape, "shape_std") / scale
    labels = tuple(str(k + 1) for k in range(len(natural))) if names is None else tuple(names)
    return MeasuredModes(
        labels, natural, natural * np.sqrt(1 - np.nan_to_num(ratio) ** 2),
        np.full(size, np.nan) if freq_std is None else _sized(freq_std, size, "freq_std"), ratio,
        np.full(size, np.nan) if damping_std is None else _sized(damping_std, size, "damping_std"), placed,
        rows / scale, spread, n_repeats=integer(repeats, 1, f"{_PLACE}, repeats"), synthetic=synthetic,
        accuracy=Accuracy.of(accuracy),
    )  # fmt: skip


def _sized(entry: ArrayLike, shape: tuple[int, ...] | None, what: str) -> np.ndarray:
    """Real numbers of a shape, or of one dimension; a single number stands for all."""
    found = np.asarray(numbers(entry, f"{_PLACE}, {what}"), dtype=float)
    if shape is not None and found.ndim == 0:
        return np.full(shape, float(found))
    if found.ndim != 1 if shape is None else found.shape != shape:
        wanted = "one for each mode" if shape is None or len(shape) == 1 else "one for each sensor and mode"
        raise InputError(f"it has the shape {found.shape}", place=f"{_PLACE}, {what}", remedy=f"give {wanted}")
    return found


def _sensor(entry: Any) -> Sensor:
    """A sensor as it is, from a name such as ``12y``, or from node and direction."""
    if isinstance(entry, Sensor):
        return entry
    if isinstance(entry, str) and (match := re.fullmatch(r"(\d+)(\w+)", entry)):
        return Sensor(int(match[1]), match[2])
    if isinstance(entry, tuple | list) and len(entry) == 2:
        return Sensor(integer(entry[0], 0, f"{_PLACE}, sensors"), str(entry[1]))
    raise InputError(f"a sensor is {entry!r:.40}", place=_PLACE, remedy='give a name such as "12y", or a calib.Sensor')
