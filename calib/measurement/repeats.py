"""Average of repeats of one measurement, in a common phase and scale, with the standard deviation of the mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.alignment import mean_and_std, scaled
from calib.measurement.disagreements import Disagreement, Pooling, bad_shape, disagreeing, leave_out
from calib.measurement.doubts import same_to_the_digit
from calib.measurement.mac import mac
from calib.measurement.matching import Matching, match_modes
from calib.measurement.rules import RULES

StdOf = Literal["mean", "repeat"]


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
    left_out : tuple of str
        Names of modes that the file holds and that were left out on reading.
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
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Combined:
    """Mean over repeats with the standard deviation of that mean; shapes scaled to a largest modulus of 1.

    Attributes
    ----------
    names : tuple of str
    natural_freq, freq_std, damping_ratio, damping_std : ndarray (n_modes,)
    sensors : tuple of (int, str)
    shapes, shape_std : ndarray (n_sensors, n_modes)
    freq_count, damping_count : ndarray (n_modes,), int
        Repeats behind each value, at least 1 for a frequency.
    shape_count : ndarray (n_sensors, n_modes), int
    disagreements : tuple of Disagreement
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
    freq_count: np.ndarray
    damping_count: np.ndarray
    shape_count: np.ndarray
    disagreements: tuple[Disagreement, ...]
    notes: tuple[str, ...]


def combine_repeats(
    repeats: Sequence[Repeat],
    *,
    std_of: StdOf = "mean",
    count: int | None = None,
    mode_names: Sequence[str] | None = None,
    pooling: Pooling = "robust",
) -> Combined:
    """Average repeats of the same modes, each value over the repeats that hold it.

    Modes are matched by name when every file names its modes, by shape and frequency otherwise (see
    `calib.measurement.matching`). With several repeats the standard deviation of the mean is that of one repeat over
    the root of their number; with one repeat it is read from the file.

    Parameters
    ----------
    repeats : sequence of Repeat
        At least one; either all carry shapes or only the first, or none.
    std_of : {"mean", "repeat"}
        Whether standard deviations in a single file are those of the mean or of one repeat.
    count : int, optional
        Number of repeats behind a single file.
    mode_names : sequence of str, optional
        New names of the modes, in the order of the first repeat, or of all modes (those that it lacks by frequency).
    pooling : {"robust", "plain"}
        Whether values that disagree with the other repeats (see `calib.measurement.disagreements`) are left out of mean
        and standard deviation, or only reported.

    Raises
    ------
    InputError
        When the matching of modes is ambiguous, or the count is missing.
    """
    first = repeats[0]
    rows = tuple(dict.fromkeys(s for r in repeats if r.shape_set is not None for s in r.shape_set.sensors))
    tables = [_in_rows(repeat.shape_set, rows, len(repeat.names)) for repeat in repeats]
    matching = _match(repeats, tables)
    index = matching.index
    names = _names(repeats, index, mode_names)
    labels = _labels([repeat.source for repeat in repeats])
    notes = [note for repeat in repeats for note in repeat.notes]
    notes += _absent(repeats, index, names, rows)
    freq = _picked([r.natural_freq for r in repeats], index)
    damping = _picked([r.damping_ratio for r in repeats], index)
    with_shapes = [k for k, r in enumerate(repeats) if r.shape_set is not None]
    stack = np.stack([_columns(table, index[k]) for k, table in enumerate(tables)])
    found: list[Disagreement] = [
        bad_shape(labels[r], float(repeats[r].natural_freq[place]), names[column], agreement)
        for r, place, column, agreement in matching.set_aside
    ]
    if len(repeats) > 1:
        _require_no_copy(repeats)
        notes += same_to_the_digit(names, freq)
        found += disagreeing(labels, names, freq, damping, rows, stack, pooling)
        if pooling == "robust":
            freq, damping, stack = leave_out(found, freq, damping, stack)
    unknown = [name for name, known in zip(names, np.isfinite(damping).any(axis=0), strict=True) if not known]
    if unknown:
        notes.append(f"damping of {', '.join(unknown)} unknown: natural and damped frequencies taken as equal")
    if len(repeats) > 1:
        if any(np.isfinite(r.freq_std).any() or np.isfinite(r.damping_std).any() for r in repeats):
            notes.append(
                f"standard deviations are computed from the {len(repeats)} repeats; those in the files are not used"
            )
        freq_mean, freq_std = mean_and_std(freq)
        damping_mean, damping_std = mean_and_std(damping)
    else:
        factor = _std_factor(first.source, std_of, count, bool(np.isfinite(first.freq_std).any()))
        freq_mean, freq_std = freq[0], first.freq_std * factor
        factor = _std_factor(first.source, std_of, count, bool(np.isfinite(first.damping_std).any()))
        damping_mean, damping_std = damping[0], first.damping_std * factor
        if not np.isfinite(freq_std).any():
            notes.append("one repeat without standard deviations: the standard deviation of the frequencies is unknown")

    shapes = np.zeros((0, len(names)), dtype=complex)
    shape_std = np.zeros((0, len(names)))
    if with_shapes:
        sets = [repeats[k].shape_set for k in with_shapes]
        if len(with_shapes) > 1:
            shapes, shape_std, more = _average_shapes(stack[with_shapes], [labels[k] for k in with_shapes], names)
            notes.extend(more)
            if any(s is not None and np.isfinite(s.std).any() for s in sets):
                notes.append(
                    f"standard deviations of shapes are computed from the {len(sets)} repeats; those in the files are "
                    "not used"
                )
        else:
            (k,) = with_shapes
            given = repeats[k].shape_set
            assert given is not None
            factor = _std_factor(given.source, std_of, count, bool(np.isfinite(given.std).any()))
            shapes, shape_std = scaled(stack[k], _columns(given.std, index[k]).real * factor)
            if not np.isfinite(shape_std).any():
                notes.append("one repeat without standard deviations: the standard deviation of the shapes is unknown")
        for name, column in zip(names, shapes.T, strict=True):
            if not np.isfinite(column).any():
                notes.append(f"no shape was measured for mode {name}")
    behind = 1 if len(repeats) > 1 else (count or 1)
    return Combined(
        names, freq_mean, freq_std, damping_mean, damping_std, rows, shapes, shape_std,
        np.isfinite(freq).sum(axis=0) * behind, np.isfinite(damping).sum(axis=0) * behind,
        np.isfinite(stack).sum(axis=0) * behind, tuple(found), tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _require_no_copy(repeats: Sequence[Repeat]) -> None:
    """InputError for shapes that are those of an earlier repeat in any order, to the last digit: noise would differ."""
    ordered = [np.argsort(r.natural_freq, kind="stable") for r in repeats]
    freq = [r.natural_freq[own] for r, own in zip(repeats, ordered, strict=True)]
    for k, repeat in enumerate(repeats):
        for j, earlier in enumerate(repeats[:k]):
            one, two = earlier.shape_set, repeat.shape_set
            if one is None or two is None or not np.array_equal(freq[j], freq[k]):
                continue
            rows = [two.sensors.index(s) for s in one.sensors if s in two.sensors]
            same = len(rows) == len(one.sensors) == len(two.sensors)
            if same and np.array_equal(one.shapes[:, ordered[j]], two.shapes[rows][:, ordered[k]], equal_nan=True):
                words = f"it holds the same modes as {earlier.source}, to the last digit: a copy is no repeat"
                raise InputError(words, place=repeat.source, remedy="leave it out")


def _in_rows(given: ShapeSet | None, rows: Sequence[tuple[int, str]], n_modes: int) -> np.ndarray:
    """Shapes (n_sensors, n_modes) with the sensors in a common order; NaN where a file lacks one."""
    out = np.full((len(rows), n_modes), complex(np.nan, np.nan))
    if given is not None:
        where = {sensor: k for k, sensor in enumerate(rows)}
        out[[where[sensor] for sensor in given.sensors]] = given.shapes
    return out


def _match(repeats: Sequence[Repeat], tables: Sequence[np.ndarray]) -> Matching:
    if not all(repeat.named for repeat in repeats):
        return match_modes([r.source for r in repeats], [r.natural_freq for r in repeats], tables)
    names = tuple(dict.fromkeys(name for repeat in repeats for name in repeat.names))
    index = np.array([[r.names.index(name) if name in r.names else -1 for name in names] for r in repeats])
    return Matching(index)


def _names(repeats: Sequence[Repeat], index: np.ndarray, given: Sequence[str] | None) -> tuple[str, ...]:
    """Names of all matched modes: the user's, the files', or numbers."""
    first = repeats[0]
    own: list[str] = []
    for column in index.T:
        k = int(np.argmax(column >= 0))
        name = repeats[k].names[column[k]]
        if (k > 0 and not repeats[k].named) or name in own:
            name = next(str(n) for n in range(len(own) + 1, len(own) + len(index.T) + 2) if str(n) not in own)
        own.append(name)
    if given is None:
        return tuple(own)
    names = tuple(given)
    if len(names) not in (len(first.names), len(own)):
        lacking = ", ".join(own[len(first.names) :])
        raise InputError(
            f"{len(names)} mode names are given for {len(first.names)} measured modes"
            + (f", and for those that the first file lacks ({lacking})" if lacking else ""),
            place=first.source,
            remedy="name every mode, in the order of the first file",
        )
    names += tuple(own[len(names) :])
    if len(set(names)) != len(names) or not all(name.strip() for name in names):
        raise InputError("a mode name is empty or given twice", place=first.source, remedy="give each its own name")
    return names


def _absent(
    repeats: Sequence[Repeat], index: np.ndarray, names: Sequence[str], rows: Sequence[tuple[int, str]]
) -> list[str]:
    """Notes on modes and sensors that some repeats lack; a repeat that shares nothing with the others is refused."""
    notes = []
    held = index >= 0
    for repeat, own in zip(repeats, held, strict=True):
        if len(repeats) > 1 and not np.any(held[:, own].sum(axis=0) > 1):
            raise InputError(
                "none of its modes is in another repeat",
                place=repeat.source,
                remedy="every file must be one repeat of the same measurement",
            )
    for name, column in zip(names, index.T, strict=True):
        if (column < 0).any():
            sources = [repeats[k].source for k in np.flatnonzero(column < 0).tolist()]
            holding = np.flatnonzero(column >= 0).tolist()
            freq = np.mean([repeats[k].natural_freq[column[k]] for k in holding])
            where = f"not in {_few(sources)}"
            if len(holding) < len(sources):
                where = f"only in {_few([repeats[k].source for k in holding])}"
            notes.append(
                f"mode {name} ({freq:.4g} Hz) is in {len(holding)} of {len(column)} repeats, {where}: mean and "
                "standard deviation are over those that hold it"
            )
    carrying = [r.shape_set for r in repeats if r.shape_set is not None]
    for one in carrying:
        if len(carrying) > 1 and not any(set(one.sensors) & set(s.sensors) for s in carrying if s is not one):
            raise InputError(
                "none of its sensors is in another repeat",
                place=one.source,
                remedy="every file must be one repeat of the same measurement",
            )
    for node, direction in rows:
        sources = [s.source for s in carrying if (node, direction) not in s.sensors]
        if sources:
            notes.append(f"sensor {node}{direction} is not in {_few(sources)}: it is averaged over the other repeats")
    return notes


def _labels(sources: Sequence[str]) -> tuple[str, ...]:
    """Sources without their folders where that leaves them distinct."""
    short = tuple(PurePath(source).name for source in sources)
    return short if len(set(short)) == len(short) else tuple(sources)


def _few(sources: Sequence[str]) -> str:
    return ", ".join(sources[:3]) + (f" and {len(sources) - 3} more" if len(sources) > 3 else "")


def _picked(values: Sequence[np.ndarray], index: np.ndarray) -> np.ndarray:
    """Values of every repeat by matched mode, (n_repeats, n_modes); NaN where it lacks the mode."""
    out = np.full(index.shape, np.nan)
    for k, own in enumerate(values):
        held = index[k] >= 0
        out[k, held] = own[index[k, held]]
    return out


def _columns(table: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Columns of one repeat (n_sensors, ...) by matched mode, NaN where it lacks the mode."""
    out = np.full((len(table), len(places)), complex(np.nan, np.nan))
    held = places >= 0
    out[:, held] = table[:, places[held]]
    return out


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


def _average_shapes(
    given: np.ndarray, sources: Sequence[str], names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Mean of shapes (n_repeats, n_sensors, n_modes), its standard deviation, and notes.

    Every repeat is brought to the scale and phase of the first one by a least-squares complex factor.
    """
    # each column is scaled first so that the products below cannot overflow
    stack = np.stack([scaled(shapes)[0] for shapes in given])
    notes = []
    for m, name in enumerate(names):
        reference = next((k for k in range(len(stack)) if np.isfinite(stack[k, :, m]).any()), None)
        if reference is None:
            continue
        target = stack[reference, :, m]
        for k in range(reference + 1, len(stack)):
            column = stack[k, :, m]
            both = np.isfinite(column) & np.isfinite(target)
            size = np.vdot(column[both], column[both]).real
            if size == 0:
                if np.isfinite(column).any():
                    notes.append(f"mode {name} of {sources[k]} shares no sensor with {sources[reference]}")
                stack[k, :, m] = complex(np.nan, np.nan)
                continue
            agreement = float(mac(target[:, None], column[:, None])[0, 0])
            if agreement < RULES.noted_mac:
                notes.append(
                    f"mode {name} of {sources[k]} has a MAC of only {agreement:.2f} with that of "
                    f"{sources[reference]}; it may be another mode"
                )
            stack[k, :, m] = column * (np.vdot(column[both], target[both]) / size)
    mean_re, std_re = mean_and_std(stack.real)
    mean_im, std_im = mean_and_std(stack.imag)
    # the zero imaginary part of a real shape is not a second sample of the error
    real = ~np.any(np.nan_to_num(stack.imag) != 0.0, axis=(0, 1))
    std = np.where(real, std_re, np.sqrt((std_re**2 + std_im**2) / 2.0))
    mean = mean_re.astype(complex)
    mean.imag = mean_im
    shapes, std = scaled(mean, std)
    return shapes, std, notes
