"""Repeats of one measurement: brought to a common phase and scale, averaged, with the scatter of the mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.errors import InputError
from calib.mac import mac

StdOf = Literal["mean", "repeat"]
MAC_LOWEST = 0.5
"""Below this MAC with the first repeat, a note says that a mode may not be the same one."""


@dataclass(frozen=True)
class ShapeSet:
    """Shapes of one file.

    Attributes
    ----------
    source : str
        File they come from.
    sensors : tuple of (int, str)
        Node label and direction, length n_sensors.
    shapes : ndarray (n_sensors, n_modes), complex
        Any scale and phase; NaN where not measured.
    std : ndarray (n_sensors, n_modes)
        Standard deviation in the scale of `shapes`; NaN where unknown.
    """

    source: str
    sensors: tuple[tuple[int, str], ...]
    shapes: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class Repeat:
    """Modes of one file.

    Attributes
    ----------
    source : str
    names : tuple of str
        Mode names, length n_modes.
    named : bool
        Whether the names were given by the file; numbers in order otherwise.
    natural_freq, freq_std : ndarray (n_modes,)
        Hz; std NaN where unknown.
    damping_ratio, damping_std : ndarray (n_modes,)
        NaN where unknown.
    shape_set : ShapeSet or None
        Columns in the order of `names`.
    notes : tuple of str
    """

    source: str
    names: tuple[str, ...]
    named: bool
    natural_freq: np.ndarray
    freq_std: np.ndarray
    damping_ratio: np.ndarray
    damping_std: np.ndarray
    shape_set: ShapeSet | None = None
    notes: tuple[str, ...] = ()

    def reordered(self, order: Sequence[int]) -> Repeat:
        """Same repeat with its modes in another order."""
        pick = list(order)
        shape_set = self.shape_set
        if shape_set is not None:
            shape_set = replace(shape_set, shapes=shape_set.shapes[:, pick], std=shape_set.std[:, pick])
        return replace(
            self,
            names=tuple(self.names[k] for k in pick),
            natural_freq=self.natural_freq[pick],
            freq_std=self.freq_std[pick],
            damping_ratio=self.damping_ratio[pick],
            damping_std=self.damping_std[pick],
            shape_set=shape_set,
        )


@dataclass(frozen=True)
class Combined:
    """Mean over repeats with the standard deviation of that mean; shapes scaled to a largest modulus of 1.

    Attributes
    ----------
    names : tuple of str
    natural_freq, freq_std, damping_ratio, damping_std : ndarray (n_modes,)
    sensors : tuple of (int, str)
    shapes, shape_std : ndarray (n_sensors, n_modes)
    notes : tuple of str
    """

    names: tuple[str, ...]
    natural_freq: np.ndarray
    freq_std: np.ndarray
    damping_ratio: np.ndarray
    damping_std: np.ndarray
    sensors: tuple[tuple[int, str], ...]
    shapes: np.ndarray
    shape_std: np.ndarray
    notes: tuple[str, ...]


def combine_repeats(
    repeats: Sequence[Repeat],
    *,
    std_of: StdOf = "mean",
    count: int | None = None,
    mode_names: Sequence[str] | None = None,
) -> Combined:
    """Average repeats of the same modes.

    Modes are matched by name when every file names its modes, in order otherwise. With several repeats the standard
    deviation of the mean is that of the scatter over the root of their number; with one it is the one of the file.

    Parameters
    ----------
    repeats : sequence of Repeat
        At least one; either all carry shapes or only the first, or none.
    std_of : {"mean", "repeat"}
        Whether standard deviations in a single file are those of the mean or of one repeat.
    count : int, optional
        Number of repeats behind a single file.
    mode_names : sequence of str, optional
        New names of the modes, in the order of the first repeat.

    Raises
    ------
    InputError
        When repeats do not hold the same modes and sensors, or the count is missing.
    """
    matched = _match_modes(repeats)
    first = matched[0]
    names = first.names if mode_names is None else _new_names(mode_names, first)
    notes = [note for repeat in repeats for note in repeat.notes]
    freq = np.stack([r.natural_freq for r in matched])
    damping = np.stack([r.damping_ratio for r in matched])
    unknown = [name for name, known in zip(names, np.isfinite(damping).all(axis=0), strict=True) if not known]
    if unknown:
        notes.append(f"damping of {', '.join(unknown)} unknown: natural and damped frequencies taken as equal")
    if len(matched) > 1:
        if any(np.isfinite(r.freq_std).any() or np.isfinite(r.damping_std).any() for r in matched):
            notes.append(f"the deviations in the files are not used: the scatter between {len(matched)} repeats is")
        freq_mean, freq_std = _mean_and_std(freq)
        damping_mean, damping_std = _mean_and_std(damping)
    else:
        factor = _std_factor(first.source, std_of, count, bool(np.isfinite(first.freq_std).any()))
        freq_mean, freq_std = freq[0], first.freq_std * factor
        factor = _std_factor(first.source, std_of, count, bool(np.isfinite(first.damping_std).any()))
        damping_mean, damping_std = damping[0], first.damping_std * factor
        if not np.isfinite(freq_std).any():
            notes.append("one repeat without standard deviations: the scatter of the frequencies is unknown")

    sets = [r.shape_set for r in matched if r.shape_set is not None]
    sensors: tuple[tuple[int, str], ...] = ()
    shapes = np.zeros((0, len(first.names)), dtype=complex)
    shape_std = np.zeros((0, len(first.names)))
    if sets:
        sensors = sets[0].sensors
        sets = [_match_sensors(sets[0], s) for s in sets]
        if len(sets) > 1:
            shapes, shape_std, more = _average_shapes(sets, names)
            notes.extend(more)
            if any(np.isfinite(s.std).any() for s in sets):
                notes.append(
                    f"the shape deviations in the files are not used: the scatter between {len(sets)} repeats is"
                )
        else:
            factor = _std_factor(sets[0].source, std_of, count, bool(np.isfinite(sets[0].std).any()))
            shapes, shape_std = _scaled(sets[0].shapes, sets[0].std * factor)
            if not np.isfinite(shape_std).any():
                notes.append("one repeat without standard deviations: the scatter of the shapes is unknown")
        for name, column in zip(names, shapes.T, strict=True):
            if not np.isfinite(column).any():
                notes.append(f"no shape was measured for mode {name}")
    return Combined(
        names,
        freq_mean,
        freq_std,
        damping_mean,
        damping_std,
        sensors,
        shapes,
        shape_std,
        tuple(dict.fromkeys(notes)),
    )


def _match_modes(repeats: Sequence[Repeat]) -> list[Repeat]:
    """Repeats with their modes in the order of the first one."""
    first = repeats[0]
    by_name = all(r.named for r in repeats)
    out = []
    for repeat in repeats:
        if len(repeat.names) != len(first.names):
            raise InputError(
                f"it holds {len(repeat.names)} modes, but {first.source} holds {len(first.names)}",
                place=repeat.source,
                remedy="every file must be one repeat of the same modes",
            )
        if by_name:
            for name in first.names:
                if name not in repeat.names:
                    raise InputError(
                        f"mode {name!r} of {first.source} is missing",
                        place=repeat.source,
                        remedy="every file must be one repeat of the same modes",
                    )
            repeat = repeat.reordered([repeat.names.index(name) for name in first.names])
        out.append(repeat)
    return out


def _new_names(given: Sequence[str], first: Repeat) -> tuple[str, ...]:
    names = tuple(given)
    if len(names) != len(first.names):
        raise InputError(
            f"{len(names)} mode names are given for {len(first.names)} measured modes",
            place=first.source,
            remedy="name every mode, in the order of the first file",
        )
    if len(set(names)) != len(names) or not all(name.strip() for name in names):
        raise InputError("a mode name is empty or given twice", place=first.source, remedy="give each its own name")
    return names


def _match_sensors(first: ShapeSet, other: ShapeSet) -> ShapeSet:
    """Shapes with their rows in the order of the first set."""
    where = {sensor: k for k, sensor in enumerate(other.sensors)}
    for mine, theirs in ((first, other), (other, first)):
        for node, direction in mine.sensors:
            if (node, direction) not in theirs.sensors:
                raise InputError(
                    f"sensor {node}{direction} of {mine.source} is missing",
                    place=theirs.source,
                    remedy="every file must hold the same sensors",
                )
    order = [where[sensor] for sensor in first.sensors]
    return replace(other, sensors=first.sensors, shapes=other.shapes[order], std=other.std[order])


def _std_factor(source: str, std_of: StdOf, count: int | None, needed: bool) -> float:
    """Factor from the standard deviation in a single file to that of the mean."""
    if std_of == "mean" or not needed:
        return 1.0
    if count is None:
        raise InputError(
            "its standard deviations are those of one repeat, but the number of repeats is not given",
            place=source,
            remedy="give the number of repeats, or state that they belong to the mean",
        )
    return 1.0 / float(np.sqrt(count))


def _mean_and_std(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of real values (n_repeats, ...) over the known ones, and its standard deviation (NaN for fewer than two)."""
    known = np.isfinite(stack)
    n = known.sum(axis=0)
    mean = np.where(n > 0, np.where(known, stack, 0.0).sum(axis=0) / np.maximum(n, 1), np.nan)
    square = (np.where(known, stack - mean, 0.0) ** 2).sum(axis=0)
    return mean, np.where(n > 1, np.sqrt(square / np.maximum(n - 1, 1) / np.maximum(n, 1)), np.nan)


def _scaled(shapes: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns divided by their largest modulus; columns without a value or of zeros stay as they are."""
    peak = np.max(np.where(np.isfinite(shapes), np.abs(shapes), 0.0), axis=0, initial=0.0)
    peak = np.where(peak > 0, peak, 1.0)
    return shapes / peak, std / peak


def _average_shapes(sets: Sequence[ShapeSet], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Mean shape, its standard deviation, and notes, after a least-squares complex factor on every repeat."""
    # each column is scaled first so that the products below cannot overflow
    stack = np.stack([_scaled(s.shapes, s.std)[0] for s in sets])
    notes = []
    for m, name in enumerate(names):
        reference = next((k for k in range(len(sets)) if np.isfinite(stack[k, :, m]).any()), None)
        if reference is None:
            continue
        target = stack[reference, :, m]
        for k in range(reference + 1, len(sets)):
            column = stack[k, :, m]
            both = np.isfinite(column) & np.isfinite(target)
            size = np.vdot(column[both], column[both]).real
            if size == 0:
                if np.isfinite(column).any():
                    notes.append(f"mode {name} of {sets[k].source} shares no sensor with {sets[reference].source}")
                stack[k, :, m] = np.nan
                continue
            agreement = float(mac(target[:, None], column[:, None])[0, 0])
            if agreement < MAC_LOWEST:
                notes.append(
                    f"mode {name} of {sets[k].source} has a MAC of only {agreement:.2f} with that of "
                    f"{sets[reference].source}; it may be another mode"
                )
            stack[k, :, m] = column * (np.vdot(column[both], target[both]) / size)
    mean_re, std_re = _mean_and_std(stack.real)
    mean_im, std_im = _mean_and_std(stack.imag)
    # the imaginary part of a real shape is no second sample of the scatter
    real = ~np.any(np.nan_to_num(stack.imag) != 0.0, axis=(0, 1))
    std = np.where(real, std_re, np.sqrt((std_re**2 + std_im**2) / 2.0))
    mean = mean_re.astype(complex)
    mean.imag = mean_im
    shapes, std = _scaled(mean, std)
    return shapes, std, notes
