"""A figure that can be drawn: its name, its caption, and who draws it from which tables."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ParamSpec

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.report.style import owner_of
from calib.report.tables import Folder

_P = ParamSpec("_P")


@dataclass(frozen=True)
class Drawing:
    """A figure that can be drawn.

    Attributes
    ----------
    name : str
        Name of its file, without suffix.
    caption : str
        Part of its heading.
    draw : callable
        Returns it.
    tables : tuple of str
        The tables that it shows, CSV files of the folder without suffix.
    """

    name: str
    caption: str
    draw: Callable[[], Figure]
    tables: tuple[str, ...]

    @property
    def key(self) -> str:
        """Digest of what it shows, apart from the code that draws; empty where that is not known."""
        return self.draw.key if isinstance(self.draw, _Bound) else ""


def bound(draw: Callable[_P, Axes | Figure], /, *data: _P.args, **looks: _P.kwargs) -> Callable[[], Figure]:
    """The function that draws the given data, whatever their names refer to by the time it is called.

    Parameters
    ----------
    draw : callable
        Returns the figure, or Axes in a figure of their own.
    *data, **looks
        Its arguments.
    """
    return _Bound(draw, data, looks)


@dataclass(frozen=True, eq=False)
class _Bound:
    """A function of drawings with its arguments."""

    draw: Callable[..., Axes | Figure]
    data: tuple[Any, ...]
    looks: Mapping[str, Any]

    def __call__(self) -> Figure:
        found = self.draw(*self.data, **self.looks)
        return owner_of(found) if isinstance(found, Axes) else found

    @property
    def key(self) -> str:
        """Digest of function and arguments; empty where they cannot be written."""
        named = (self.draw.__module__, self.draw.__qualname__)
        try:
            return hashlib.sha256(pickle.dumps((named, self.data, self.looks), protocol=5)).hexdigest()
        except (pickle.PicklingError, TypeError, AttributeError):
            return ""


def existing(folder: Folder, names: Sequence[str]) -> tuple[str, ...]:
    """Of these tables those that the folder has, without suffix."""
    return tuple(name for name in names if (folder / f"{name}.csv").exists())
