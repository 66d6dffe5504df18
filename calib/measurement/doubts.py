"""What must not be missed about measured data: entries that were left out, and values that contradict one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.measurement.modal import MeasuredModes
from calib.measurement.places import Doubt
from calib.measurement.rules import RULES


def doubts_of(measured: object) -> tuple[str, ...]:
    """Sentences on a measurement of any kind, each told whatever is asked for.

    They are the notes of its reader that are a `Doubt`, and of modes `modal_doubts`.
    """
    notes: Sequence[str] = getattr(measured, "notes", ())
    said = [f"Check this: {note}." for note in notes if isinstance(note, Doubt)]
    return (*said, *(modal_doubts(measured) if isinstance(measured, MeasuredModes) else ()))


def modal_doubts(measured: MeasuredModes) -> tuple[str, ...]:
    """What contradicts itself in measured modes: units, exchanged columns, standard deviations and places."""
    return tuple(
        filter(None, (_percent(measured), _damping_std(measured), *_shape_std(measured), _one_place(measured)))
    )


def _percent(measured: MeasuredModes) -> str:
    known = measured.damping_ratio[np.isfinite(measured.damping_ratio)]
    if len(known) < RULES.doubt_modes or known.min() < RULES.percent_damping:
        return ""
    low, high = f"{known.min():.3g}", f"{known.max():.3g}"
    size = low if low == high else f"{low} to {high}"
    return (
        f"The damping ratios look like percent: {size} in all {len(known)} modes. Damping is a ratio, 0.01 for one "
        "percent."
    )


def _damping_std(measured: MeasuredModes) -> str:
    known = np.isfinite(measured.damping_ratio) & np.isfinite(measured.damping_std)
    ratio, std = measured.damping_ratio[known], measured.damping_std[known]
    if len(ratio) < RULES.doubt_modes or not np.all(std > ratio):
        return ""
    return (
        f"The standard deviations of the damping ratios exceed the ratios in all {len(ratio)} modes: check whether "
        "damping and damping_std are exchanged."
    )


def _shape_std(measured: MeasuredModes) -> list[str]:
    """On standard deviations of shapes, whose largest entry is 1 in every mode."""
    known = np.isfinite(measured.shapes) & np.isfinite(measured.shape_std)
    if not known.any():
        return []
    imaginary, std = np.asarray(measured.shapes).imag[known], measured.shape_std[known]
    # shapes are scaled by a real factor, so that signs and zeros are those of the file
    if len(std) >= RULES.doubt_entries and np.all(std == 0) and np.all(imaginary > 0):
        words = "All standard deviations of the shapes are 0 and all imaginary parts positive"
        return [f"{words}: check whether im and std are exchanged."]
    out = []
    zero = known & (measured.shape_std == 0) & (np.abs(measured.shapes) < 1 - RULES.shape_resolution)
    if zero.any():
        row, column = (int(index[0]) for index in np.nonzero(zero))
        where = f"{measured.sensors[row].name} of mode {measured.names[column]}"
        more = "" if zero.sum() == 1 else f" and of {zero.sum() - 1} more"
        why = "leave it empty where it is unknown" if measured.n_repeats == 1 else "its repeats are rounded or copied"
        out.append(f"The standard deviation of the shape entry {where}{more} is 0: {why}.")
    if np.median(std) > RULES.shape_std_most:
        out.append(
            f"The standard deviations of the shapes, {np.median(std):.3g} in the median, exceed the largest entry: "
            "such shapes say nothing. Check their scale."
        )
    return out


def _one_place(measured: MeasuredModes) -> str:
    points = {sensor.node: sensor.point for sensor in measured.sensors if sensor.point is not None}
    if len(points) < 2 or len(set(points.values())) > 1:
        return ""
    return f"All {len(points)} measured nodes are at the same place: check the table of sensors or the universal file."


def same_to_the_digit(names: Sequence[str], freq: np.ndarray) -> list[str]:
    """A note where a frequency (n_repeats, n_modes) is the same in several repeats, so that they tell no scatter."""
    count = np.isfinite(freq).sum(axis=0)
    same = (count >= RULES.same_repeats) & (np.nanmin(freq, axis=0) == np.nanmax(freq, axis=0))
    if not same.any():
        return []
    listed = ", ".join(f"{names[m]} ({np.nanmax(freq[:, m]):g} Hz)" for m in np.flatnonzero(same).tolist())
    return [Doubt(
        f"the frequency of mode {listed} is the same to the digit in all its repeats: rounded or copied, their scatter "
        "is unknown"
    )]  # fmt: skip
