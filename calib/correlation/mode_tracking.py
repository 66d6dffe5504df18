"""Mode tracking: modes of a model followed by their shapes while parameters change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.correlation.rules import RULES
from calib.errors.errors import EvaluationError
from calib.structure.modal_model import ModalModel
from calib.structure.modes import Modes

_SAME_PLACE = 1e-6
"""Bonus for a mode that keeps its number, so that arbitrarily rotated shapes of repeated modes are not exchanged."""


class Point(NamedTuple):
    """A complete set of values and the modes there."""

    values: Mapping[str, float]
    modes: Modes


def follow(
    model: ModalModel, start: Point, end: Point, columns: np.ndarray, halvings: int = RULES.halvings
) -> np.ndarray:
    """Indices at the end point of modes at the start point.

    Modes are matched one to one so that the sum of their MAC, in the weight of the start (the mass matrix, where there
    is one), is largest. Where all keep their numbers and similar shapes, the matching is accepted. Where some seem to
    change numbers, the straight line between the two points is halved repeatedly: two modes that veer exchange their
    shapes but not their numbers, as shorter steps show; two that cross still change numbers on the shortest step. A
    mode without a similar one there (`RULES.successor`) has left the solved modes and is no longer tracked.

    Two modes that veer with the coupling k, over a path on which they move apart by d on both sides, end with a MAC of
    ``1 - (k/d)^2``; a step resolves them while it is no longer than k. Modes that change numbers with shapes so similar
    that even the shortest step could not resolve veering cross, and no step is halved.

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
        Modes at the end, -1 for one without a successor; where the path has fewer modes than requested, the longer step
        decides.
    """
    live = np.flatnonzero(columns >= 0)
    reached = np.full(len(columns), -1)
    found, similarity = _matched(model, start, end, columns[live])
    reached[live] = np.where(similarity >= RULES.successor, found, -1)
    moved = found != columns[live]
    if not halvings or np.all(similarity >= np.where(moved, 1 - RULES.crossed * 4.0**-halvings, RULES.successor)):
        return reached
    integers = {p.name for p in model.space.parameters if p.integer}
    values = {n: v if n in integers else 0.5 * (start.values[n] + v) for n, v in end.values.items()}
    try:
        middle = Point(values, model.modes(values, end.modes.n_modes))
    except EvaluationError:
        return reached
    if middle.modes.n_modes < end.modes.n_modes:
        return reached
    halfway = follow(model, start, middle, columns, halvings - 1)
    return follow(model, middle, end, halfway, halvings - 1)


def _matched(model: ModalModel, start: Point, end: Point, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Successors of some modes, and their MAC."""
    a, b = start.modes.shapes[:, columns], end.modes.shapes
    here, there = (model.weighted(start.values, shapes) for shapes in (a, b))
    product = np.abs(here.conj().T @ b) ** 2
    size = np.outer(np.einsum("ij,ij->j", a.conj(), here).real, np.einsum("ij,ij->j", b.conj(), there).real)
    similarity = np.divide(product, size, out=np.zeros_like(product), where=size > 0)
    similarity[np.arange(len(columns)), columns] += _SAME_PLACE
    rows = np.arange(len(columns))
    found = np.asarray(linear_sum_assignment(similarity, maximize=True)[1])
    return found, similarity[rows, found]
