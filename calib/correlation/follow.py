"""Modes of a model followed by their own shapes while parameters move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.errors import EvaluationError
from calib.structure.model import ModalModel
from calib.structure.modes import Modes

HALVINGS = 5
"""How often a path on which modes seem to change places is halved."""
_SAME_PLACE = 1e-6
"""What a mode that keeps its place is ahead, so that shapes which rotation leaves undetermined stay where they are."""


class Point(NamedTuple):
    """A complete set of values and the modes there."""

    values: Mapping[str, float]
    modes: Modes


def follow(model: ModalModel, start: Point, end: Point, columns: np.ndarray, halvings: int = HALVINGS) -> np.ndarray:
    """Index at the end of some modes at the start.

    Modes are matched one to one so that the sum of their MAC, in the mass matrix of the start, is largest. Where all
    keep their places, they are followed. Where some seem to change places, the straight line between the two points is
    halved, again and again: two modes that veer exchange their shapes and not their places, which shorter steps show;
    two that cross still change places on the shortest one.

    Parameters
    ----------
    model : ModalModel
    start, end : Point
        With the same number of modes.
    columns : ndarray (n,), int
        Modes at the start.
    halvings : int

    Returns
    -------
    ndarray (n,), int
        Modes at the end; where there are fewer than asked, the answer is that of the longer step.
    """
    reached = _matched(model, start, end, columns)
    if not halvings or np.array_equal(reached, columns):
        return reached
    whole = {p.name for p in model.space.parameters if p.integer}
    values = {n: v if n in whole else 0.5 * (start.values[n] + v) for n, v in end.values.items()}
    try:
        middle = Point(values, model.modes(values, end.modes.n_modes))
    except EvaluationError:
        return reached
    if middle.modes.n_modes < end.modes.n_modes:
        return reached
    halfway = follow(model, start, middle, columns, halvings - 1)
    return follow(model, middle, end, halfway, halvings - 1)


def _matched(model: ModalModel, start: Point, end: Point, columns: np.ndarray) -> np.ndarray:
    mass = model.matrices(start.values)[2]
    a, b = start.modes.shapes[:, columns], end.modes.shapes
    weighted = mass @ a
    product = np.abs(weighted.conj().T @ b) ** 2
    size = np.outer(np.einsum("ij,ij->j", a.conj(), weighted).real, np.einsum("ij,ij->j", b.conj(), mass @ b).real)
    alike = np.divide(product, size, out=np.zeros_like(product), where=size > 0)
    alike[np.arange(len(columns)), columns] += _SAME_PLACE
    return np.asarray(linear_sum_assignment(alike, maximize=True)[1])
