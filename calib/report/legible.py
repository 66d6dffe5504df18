"""Whether a figure is still legible at the width that it was drawn with."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

_LEAST = 1.0
"""Narrowest panel in inches of which a drawing can still be read."""
_LETTERS = 11.5
"""Letters of an axis' label on an inch of the width of the figure."""
_PIXEL = 1.0
"""Part of a text outside the figure that is not seen."""


def is_legible(figure: Figure) -> bool:
    """Whether every text lies inside the figure, none covers another of its panel, and every panel has room."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a font may lack characters: the figure is then marked where it is saved
        warnings.filterwarnings("error", message="constrained_layout not applied")  # no room is left for the panels
        try:
            figure.draw_without_rendering()
        except UserWarning:
            return False
    panels = [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]
    if any(ax.get_window_extent().width < _LEAST * figure.dpi for ax in panels):
        return False
    whole = figure.bbox.padded(_PIXEL)
    beyond = [label for ax in figure.axes for axis in (ax.xaxis, ax.yaxis) for label in _ticks(axis, False)]
    texts = [text for text in figure.findobj(Text) if isinstance(text, Text) and _is_shown(text)]
    boxes = _boxes(text for text in texts if not any(text is label for label in beyond))
    if not all(whole.containsx(box.x0) and whole.containsx(box.x1) for box in boxes):
        return False
    return not any(_cover_each_other(_boxes(group)) for ax in panels for group in _groups(ax))


def wrap_labels(figure: Figure) -> None:
    """Break the labels of the axes where they would be longer than the figure is wide."""
    room = int(_LETTERS * float(figure.get_size_inches()[0]))
    for ax in figure.axes:
        lines = ax.get_xlabel().split("\n")
        ax.set_xlabel("\n".join(textwrap.fill(line, room, break_long_words=False) for line in lines))


def _ticks(axis: Axis, inside: bool) -> list[Text]:
    """Labels of ticks inside the limits of an axis, or beyond them, where they are not drawn."""
    low, high = sorted(axis.get_view_interval())
    reach = 1e-6 * (high - low)
    found = zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False)
    return [label for at, label in found if (low - reach <= at <= high + reach) == inside]


def _is_shown(text: Text) -> bool:
    return text.get_visible() and bool(text.get_text().strip())


def _groups(ax: Axes) -> list[list[Text]]:
    """Texts of a panel that must not cover each other: labels of either axis, and those written into it."""
    groups = [_ticks(ax.xaxis, True), _ticks(ax.yaxis, True), list(ax.texts)]
    return [[text for text in group if _is_shown(text)] for group in groups]


def _boxes(texts: Iterable[Text]) -> list[Bbox]:
    return [text.get_window_extent() for text in texts]


def _cover_each_other(boxes: list[Bbox]) -> bool:
    return any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
