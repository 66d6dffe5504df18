"""Designs of a study as a caller asks for them: printed, written and drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from calib.analyses.sensitivity import response_units
from calib.api import steps
from calib.api.display import FolderResult
from calib.api.entries.designed import designs_entries
from calib.api.entries.entry import Words
from calib.api.figures import file_name, write_named
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.report.numbers import labels_with_units
from calib.report.style import owner_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.analyses.designs import Designs
    from calib.study.several import AnyStudy


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
    draw : sequence of str
        Further pictures, of `PICTURES`: ``matrix`` (linear, rank and quadratic correlation of inputs and outputs with
        outputs), ``histograms``, ``history`` (of searches) and ``box`` (range of the best designs).
    """

    feasible: bool
    design: int | None
    csv: str | Path | None
    anthill: Sequence[tuple[str, str]]
    parallel: bool
    draw: Sequence[str]


PICTURES = ("matrix", "histograms", "history", "box")
"""Pictures of what designs have in common, by name."""


def designs_result(study: Any, best: int, keys: DesignKeys) -> FolderResult:
    """See `calib.api.study.Study.designs`."""
    found = steps.designs_step(study)
    found = found.feasible if keys.get("feasible") else found
    printed = tuple(designs_entries(found, best, keys.get("design")))
    csv = keys.get("csv")
    written = study.folder.path if csv is None else found.write(path_of(csv, "csv"))
    most = min(best, 20) if keys.get("parallel") else 0
    clouds = keys.get("anthill", ())
    drawn = draw_designs(found, study.loaded, study.folder.path, clouds, most, keys.get("draw", ()), min(best, 20))
    study.listener.listed(found, [*printed, *(Words(f"Drawn: {path}", "always") for path in drawn)], written)
    return FolderResult(found.sentences, found.table, study.folder.path, found, printed)


def draw_designs(
    found: Designs,
    study: AnyStudy,
    folder: Path,
    clouds: Sequence[tuple[str, str]],
    parallel: int,
    pictures: Sequence[str] = (),
    best: int = 12,
) -> tuple[Path, ...]:
    """Draw clouds of two columns of designs, their free parameters side by side, and what they have in common.

    Parameters
    ----------
    found : Designs
    study : AnyStudy
    folder : Path
        Where ``anthill_*.png`` and ``designs_*.png`` go.
    clouds : sequence of (str, str)
        Columns.
    parallel : int
        Number of the best ones over parallel axes; 0 for no such picture.
    pictures : sequence of str
        Of `PICTURES`.
    best : int
        Number of the best ones in a box.

    Raises
    ------
    InputError
        For an unknown picture or column.
    """
    from calib.report import design_statistics as common
    from calib.report.designs import draw_anthill, draw_parallel
    from calib.report.sensitivity import draw_sensitivity

    if unknown := [name for name in pictures if name not in PICTURES]:
        raise InputError(f"unknown picture {unknown[0]!r}", place="designs, draw", remedy=f"use {', '.join(PICTURES)}")
    inputs, space = list(found.space.free_names), found.space
    units = {**response_units(study, found.outputs), **{p.name: p.unit for p in space.parameters}}
    labels = labels_with_units(units)
    looks: dict[str, Any] = {"labels": labels, "log": [p.name for p in space.parameters if p.is_log]}
    figures: list[tuple[str, Callable[[], Any]]] = [
        (f"anthill_{file_name(x)}_{file_name(y)}", partial(draw_anthill, found.table, x, y, **looks)) for x, y in clouds
    ]
    if parallel:
        axes = [*inputs, "objective"]
        figures.append(("designs_parallel", partial(draw_parallel, found.table, axes, "objective", parallel, **looks)))
    outputs = [*found.outputs, "objective"]
    if "matrix" in pictures:
        matrices = common.correlations(found.table, [*inputs, *outputs], outputs, looks["log"])
        for kind, matrix in matrices.items():
            label = f"{kind} correlation (–)"
            draw = partial(draw_sensitivity, matrix, None, 0.1, label, signed=kind != "quadratic")
            figures.append((f"designs_matrix_{kind}", draw))
    if "histograms" in pictures:
        figures.append(
            ("designs_histograms", partial(common.histograms_figure, found.table, [*inputs, *outputs], **looks))
        )
    if "history" in pictures:
        figures.append(("designs_history", partial(common.draw_history, found.table)))
    if "box" in pictures:
        figures.append(("designs_box", partial(common.draw_box, found.feasible.table, space.frame(), best)))
    title = f"{study.settings.title}: designs"
    return write_named([(name, partial(_figure, draw)) for name, draw in figures], title, study.synthetic, folder)


def _figure(draw: Callable[[], Any]) -> Figure:
    """What is drawn, as a figure."""
    drawn = draw()
    return owner_of(drawn) if hasattr(drawn, "get_figure") and not hasattr(drawn, "add_subplot") else drawn
