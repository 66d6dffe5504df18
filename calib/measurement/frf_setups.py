"""Set-ups of one test: files with different functions, merged by what they have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_repeats import FRFRepeat, combine_frfs, off_axis
from calib.measurement.modal import Sensor
from calib.measurement.rules import RULES


def combine_setups(repeats: Sequence[FRFRepeat], averages: int | None = None, synthetic: bool = False) -> MeasuredFRFs:
    """Mean of the repeats of each set-up, and all set-ups as one measurement.

    Files with the same functions are repeats of a set-up (see `combine_frfs`). Those that bring functions of their own
    belong to another one. Set-ups that share functions, such as the driving point, are scaled by them: by the ratio of
    root mean squares, which drifting resonances do not bias. A shared function is then the mean over its set-ups. Those
    that share a reference or a response alone have the scale of their force or sensor.

    Parameters
    ----------
    repeats : sequence of FRFRepeat
    averages, synthetic
        See `combine_frfs`.

    Returns
    -------
    MeasuredFRFs
        With NaN for functions that no set-up holds, and the fewest repeats of a set-up; notes tell the scales.

    Raises
    ------
    InputError
        Where `combine_frfs` does; for a file that lacks functions of another and has none of its own; for set-ups that
        differ in quantity or lines, share no function, reference or response, or whose shared functions differ by more
        than `RULES.setup_scale`.
    """
    groups: list[list[FRFRepeat]] = []
    for one in repeats:
        same = next((group for group in groups if group[0].functions.keys() == one.functions.keys()), None)
        if same is None:
            groups.append([one])
        else:
            same.append(one)
    for group in groups:
        others = {key for other in groups if other is not group for key in other[0].functions}
        if len(groups) > 1 and not group[0].functions.keys() - others:
            return combine_frfs(repeats, averages, synthetic)  # a repeat that lacks functions, which this refuses
    setups = [combine_frfs(group, averages, synthetic) for group in groups]
    if len(setups) < 2:
        return setups[0]
    whole, *rest = setups
    while rest:
        linked = next((k for k, one in enumerate(rest) if _names(one) & _names(whole)), None)
        if linked is None:
            linked = next((k for k, one in enumerate(rest) if _ends(one) & _ends(whole)), None)
        if linked is None:
            raise InputError(
                f"it has no function, reference or response in common with {whole.source}", place=rest[0].source,
                remedy="give the set-up that links them, or measure the driving point in each",
            )  # fmt: skip
        whole = _merged(whole, rest.pop(linked))
    note = f"{len(setups)} set-ups are merged: their resonances may differ by drift and by the mass of the sensors"
    return replace(whole, n_repeats=min(one.n_repeats for one in setups), notes=(*whole.notes, note))


def _names(frfs: MeasuredFRFs) -> set[str]:
    return {one.name for one in frfs.functions}


def _ends(frfs: MeasuredFRFs) -> set[tuple[str, str]]:
    """References and responses, by their names."""
    each = (("reference", frfs.references), ("response", frfs.responses))
    return {(kind, one.name) for kind, sensors in each for one in sensors}


def _merged(whole: MeasuredFRFs, one: MeasuredFRFs) -> MeasuredFRFs:
    """Two set-ups as one, the second in the scale of the first."""
    if one.quantity != whole.quantity:
        raise InputError(
            f"it holds {one.quantity}, but {whole.source} {whole.quantity}", place=one.source,
            remedy="export the same quantity",
        )  # fmt: skip
    if off_axis(one.freq, whole.freq).any():
        raise InputError(
            f"its frequencies are not those of {whole.source}", place=one.source, remedy="measure on common lines"
        )
    responses, references = (
        tuple(dict.fromkeys((*first, *second)))
        for first, second in ((whole.responses, one.responses), (whole.references, one.references))
    )
    ours, theirs = (_spread(frfs, responses, references) for frfs in (whole, one))
    common = np.isfinite(ours[0]) & np.isfinite(theirs[0])
    notes, scale = (*whole.notes, *one.notes), 1.0
    if common.any():
        scale = _scale(whole, one, ours[0][common], theirs[0][common])
        shared = [name for name in (fn.name for fn in one.functions) if name in _names(whole)]
        notes = (*notes, f"{one.source}: scaled by {scale:.4g} to {', '.join(shared)} of {whole.source}")
    else:
        kinds = {kind for kind, _ in _ends(one) & _ends(whole)}
        what = "a reference with {}, by whose force" if "reference" in kinds else "a response with {}, by whose sensor"
        notes = (*notes, f"{one.source}: shares {what.format(whole.source)} it is scaled")
    values = np.where(np.isfinite(ours[0]), ours[0], scale * theirs[0])
    values[common] = (ours[0][common] + scale * theirs[0][common]) / 2
    std = np.where(np.isfinite(ours[0]), ours[1], scale * theirs[1])
    std[common] = np.hypot(ours[1][common], scale * theirs[1][common]) / 2
    return replace(
        whole, responses=responses, references=references, values=values, std=std,
        source=f"{whole.source}, {one.source}", notes=notes,
    )  # fmt: skip


def _spread(
    frfs: MeasuredFRFs, responses: Sequence[Sensor], references: Sequence[Sensor]
) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations at more responses and references, NaN where they were not measured."""
    values = np.full((len(frfs.freq), len(responses), len(references)), complex(np.nan, np.nan))
    std = np.full(values.shape, np.nan)
    i, j = [responses.index(one) for one in frfs.responses], [references.index(one) for one in frfs.references]
    values[:, np.array(i)[:, None], np.array(j)], std[:, np.array(i)[:, None], np.array(j)] = frfs.values, frfs.std
    return values, std


def _scale(whole: MeasuredFRFs, one: MeasuredFRFs, ours: np.ndarray, theirs: np.ndarray) -> float:
    """Factor of the second set-up by the functions that both hold."""
    scale = float(np.sqrt(np.sum(np.abs(ours) ** 2) / np.sum(np.abs(theirs) ** 2)))
    if float(np.real(np.vdot(theirs, ours))) < 0:
        problem = f"what it has in common with {whole.source} has the opposite sign"
    elif abs(np.log(scale)) > np.log(1 + RULES.setup_scale):
        problem = f"what it has in common with {whole.source} is {1 / scale:.3g} times as large"
    else:
        return scale
    shared = ", ".join(sorted(_names(whole) & _names(one)))
    remedy = "check sensitivities, units and directions"
    raise InputError(f"{problem} ({shared})", place=one.source, remedy=remedy)
