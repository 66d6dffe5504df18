"""Designs of a study as a caller asks for them: printed, written and drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from calib.api import steps
from calib.api.display import AnalysisResult
from calib.api.entries.designed import designs_entries
from calib.api.entries.entry import Words
from calib.api.figures import plain, write_named
from calib.errors.arguments import path as path_of
from calib.report.style import owner_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from calib.analyses.designs import Designs
    from calib.study.study_file import StudyFile


class DesignKeys(TypedDict, total=False):
    """What is told of designs beside the best ones.

    Attributes
    ----------
    feasible : bool
        Leave out those that failed.
    design : int
        Tell the values of this design alone, by its number in the table.
    csv : path
        File of the whole table.
    anthill : sequence of (str, str)
        Pairs of columns, each drawn as a cloud coloured by density, into the folder of results.
    parallel : bool
        Draw the free parameters of all designs side by side, the best ones marked.
    """

    feasible: bool
    design: int | None
    csv: str | Path | None
    anthill: Sequence[tuple[str, str]]
    parallel: bool


def designs(study: Any, best: int, keys: DesignKeys) -> AnalysisResult:
    """See `calib.api.study.Study.designs`."""
    found = steps.listed(study)
    found = found.feasible if keys.get("feasible") else found
    printed = tuple(designs_entries(found, best, keys.get("design")))
    csv = keys.get("csv")
    written = study.folder.path if csv is None else found.write(path_of(csv, "csv"))
    most = min(best, 20) if keys.get("parallel") else 0
    drawn = draw_designs(found, study.loaded, study.folder.path, keys.get("anthill", ()), most)
    study.listener.listed(found, [*printed, *(Words(f"Drawn: {path}", "always") for path in drawn)], written)
    return AnalysisResult(found.sentences, found.table, study.folder.path, found, printed)


def draw_designs(
    found: Designs, study: StudyFile, folder: Path, clouds: Sequence[tuple[str, str]], parallel: int
) -> tuple[Path, ...]:
    """Draw clouds of two columns of designs, and their free parameters side by side with the best ones marked.

    Parameters
    ----------
    found : Designs
    study : StudyFile
    folder : Path
        Where ``anthill_*.png`` and ``designs_parallel.png`` go.
    clouds : sequence of (str, str)
        Columns.
    parallel : int
        Number of the best ones; 0 for no such picture.
    """
    from calib.report.designs import draw_anthill, draw_parallel

    axes = [*found.space.free_names, "objective"]
    labels = {p.name: f"{p.name}, {p.unit}" for p in found.space.parameters if p.unit not in ("", "-")}
    drawings = [(f"anthill_{plain(x)}_{plain(y)}", partial(draw_anthill, found.table, x, y)) for x, y in clouds]
    if parallel:
        drawings.append(("designs_parallel", partial(draw_parallel, found.table, axes, "objective", parallel)))
    log = [p.name for p in found.space.parameters if p.is_log]
    figures = [(name, partial(_owner, drawing, labels, log)) for name, drawing in drawings]
    return write_named(figures, f"{study.settings.title}: designs", study.synthetic, folder)


def _owner(draw: Callable[..., Axes], labels: Mapping[str, str], log: Sequence[str]) -> Figure:
    return owner_of(draw(labels=labels, log=log))
