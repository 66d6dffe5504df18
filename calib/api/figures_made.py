"""Figures of a folder, made by all processes that share tasks, and put into pages and files by this one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from calib.execution.stage import Progress
from calib.execution.tasks import each
from calib.report.figures import FigureRequest, Figures, RenderedFigure
from calib.report.tables import CurrentFolder


def make_all(figures: Figures, request: FigureRequest, progress: Progress) -> dict[str, RenderedFigure]:
    """Make all figures of a folder; they are the same whoever makes them.

    Parameters
    ----------
    figures : Figures
    request : FigureRequest
        What is made of each figure.
    progress : callable
        Called before every figure that this process makes.

    Raises
    ------
    InputError
        A table is damaged.
    """
    names = list(figures.plan)
    task = _Task(figures.folder, figures.title, figures.synthetic, figures.prefix, figures.axes, request)
    task.__dict__["figures"] = figures  # this process has read the tables
    found = each(_make_one, task, names, lambda done: progress("drawing figures", done, len(names)))
    return dict(zip(names, found, strict=True))


@dataclass(frozen=True)
class _Task:
    """What every process needs; each other one reads the tables itself, which are on this machine."""

    stays_here: ClassVar = True
    folder: CurrentFolder
    title: str
    synthetic: bool
    prefix: str
    axes: str
    request: FigureRequest

    @cached_property
    def figures(self) -> Figures:
        return Figures(self.folder, self.title, self.synthetic, self.prefix, self.axes)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "figures"}


def _make_one(task: _Task, name: str) -> RenderedFigure:
    return task.figures.render(name, task.request)
