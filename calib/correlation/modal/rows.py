"""Rows of the residual of a modal test: what each entry compares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from calib.measurement.mac import is_real
from calib.measurement.modal import MeasuredModes

Kind = Literal["frequency", "damping", "shape"]


class ModalRow(NamedTuple):
    """What one entry of the residual compares.

    Attributes
    ----------
    mode : str
        Measured mode.
    kind : {"frequency", "damping", "shape"}
    sensor : str
        Name of the sensor, empty unless ``kind`` is ``shape``.
    part : str
        ``re`` or ``im`` of a shape, else empty.
    """

    mode: str
    kind: Kind
    sensor: str = ""
    part: str = ""


def damping_modes(measured: MeasuredModes) -> tuple[int, ...]:
    """Measured modes with a damping ratio above 0."""
    return tuple(np.flatnonzero(measured.damping_ratio > 0).tolist())


def shape_parts(measured: MeasuredModes) -> tuple[tuple[int, str], ...]:
    """Measured modes and parts of their shapes, in row order; a single sensor carries no information."""
    if not measured.has_shapes:
        return ()
    shapes = measured.shapes
    real = is_real(shapes)
    several = np.isfinite(shapes).sum(axis=0) > 1
    out: list[tuple[int, str]] = []
    for i in np.flatnonzero(several).tolist():
        out += [(i, "re")] if real[i] else [(i, "re"), (i, "im")]
    return tuple(out)


def modal_rows(
    measured: MeasuredModes, damped: Sequence[int], parts: Sequence[tuple[int, str]]
) -> tuple[ModalRow, ...]:
    """A row for the frequency of every mode, the damping of some, and every measured entry of parts of shapes."""
    rows = [ModalRow(mode, "frequency") for mode in measured.names]
    rows += [ModalRow(measured.names[i], "damping") for i in damped]
    for i, part in parts:
        known = np.flatnonzero(np.isfinite(measured.shapes[:, i]))
        rows += [ModalRow(measured.names[i], "shape", measured.sensors[s].name, part) for s in known]
    return tuple(rows)
