"""Modes of a model followed by their own shapes while parameters move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.errors import EvaluationError
from calib.structure.modal_model import ModalModel
from calib.structure.modes import Modes

HALVINGS = 5
"""How often a path on which modes seem to change places is halved."""
SUCCESSOR = 0.3
"""MAC of a mode's successor on the shortest step at least: less is another mode, and its own has left those solved.

Where two modes veer, a step ends at half or more.
"""
_CROSSED = 0.25
"""Part of what a coupling that the shortest step could just show takes from the MAC of the whole one."""
_SAME_PLACE = 1e-6
"""What a mode that keeps its place is ahead, so that shapes which rotation leaves undetermined stay where they are."""


class Point(NamedTuple):
    """A complete set of values and the modes there."""

    values: Mapping[str, float]
    modes: Modes


def follow(model: ModalModel, start: Point, end: Point, columns: np.ndarray, halvings: int = HALVINGS) -> np.ndarray:
    """Index at the end of some modes at the start.

    Modes are matched one to one so that the sum of their MAC, in the weight of the start (the mass matrix, where there
    is one), is largest. Where all keep their places and are like what they were, they are followed. Where some seem to
    change places, the straight line between the two points is halved, again and again: two modes that veer exchange
    their shapes and not their places, which shorter steps show; two that cross still change places on the shortest one.
    A mode that meets none like itself there (`SUCCESSOR`) has left those that are solved, and is followed no longer.

    Two modes that veer with the coupling k, over a path on which they move apart by d on both sides, end with a MAC of
    ``1 - (k/d)^2``; a step shows them apart while it is no longer than k. Where modes that change places are so alike
    that not even the shortest step could show them apart, they cross, and no step is halved.

    Parameters
    ----------
    model : ModalModel
    start, end : Point
        With the same number of modes.
    columns : ndarray (n,), int
        Modes at the start; -1 for none.
    halvings : int

    Returns
    -------
    ndarray (n,), int
        Modes at the end, -1 for one without a successor; where there are fewer modes on the way than asked, the answer
        is that of the longer step.
    """
    live = np.flatnonzero(columns >= 0)
    reached = np.full(len(columns), -1)
    found, alike = _matched(model, start, end, columns[live])
    reached[live] = np.where(alike >= SUCCESSOR, found, -1)
    moved = found != columns[live]
    if not halvings or np.all(alike >= np.where(moved, 1 - _CROSSED * 4.0**-halvings, SUCCESSOR)):
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


def _matched(model: ModalModel, start: Point, end: Point, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Successors of some modes, and how alike they are."""
    a, b = start.modes.shapes[:, columns], end.modes.shapes
    here, there = (model.weighted(start.values, shapes) for shapes in (a, b))
    product = np.abs(here.conj().T @ b) ** 2
    size = np.outer(np.einsum("ij,ij->j", a.conj(), here).real, np.einsum("ij,ij->j", b.conj(), there).real)
    alike = np.divide(product, size, out=np.zeros_like(product), where=size > 0)
    alike[np.arange(len(columns)), columns] += _SAME_PLACE
    rows = np.arange(len(columns))
    found = np.asarray(linear_sum_assignment(alike, maximize=True)[1])
    return found, alike[rows, found]
