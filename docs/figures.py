"""Draw the figures of the documents from the results of the studies: ``make docs-figures``.

Every figure is one that a study draws itself, or is drawn by the same functions from its tables. A figure whose results
are not at hand keeps its committed file, and the script says so.
"""

from __future__ import annotations

import argparse
import io
import json
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from PIL import Image

from calib.report.figures import Figures
from calib.report.scene import upright
from calib.report.style import DPI, add_heading, legend_above, style, take_dollars_literally
from calib.report.tables import read_results
from calib.report.worst import draw_worst
from calib.results.answer import in_prose
from calib.study.loading import module_of

HERE = Path(__file__).resolve().parent
APART, SAME = 64, 1e-4
"""Steps of 255 by which a colour has changed, and the share of such pixels up to which two pictures show the same."""
TICKS = [m * 10**k for k in range(-3, 3) for m in (1, 2, 3, 5)]
"""Of a logarithmic axis that spans little more than a decade."""


@dataclass(frozen=True)
class Shown:
    """A figure of a results folder: the folder, and the name of the figure there."""

    folder: str
    name: str


FIGURES = {
    "rig_misfit": Shown("four_storey_rig", "where_it_fails"),
    "rig_why": Shown("four_storey_rig_missing", "why_this_effect"),
    "bogie_selection": Shown("bogie", "selection"),
    "bogie_comparison": Shown("bogie", "comparison"),
    "bogie_mode_shapes": Shown("bogie", "mode_shapes_after"),
    "bogie_parameters": Shown("bogie", "parameters"),
    "bogie_pareto": Shown("bogie", "pareto"),
    "bogie_search_errors": Shown("bogie", "search_errors"),
    "hidden_bogie": Shown("hidden_bogie", "answer"),
    "hidden_bushing": Shown("hidden_bushing", "answer"),
    "hidden_misfit": Shown("hidden_bogie", "sensor_misfit"),
    "hidden_effects": Shown("hidden_bogie", "ranked_effects"),
    "hidden_why": Shown("hidden_bogie", "why_this_effect"),
    "hidden_where": Shown("hidden_bogie", "where_this_effect"),
    "hidden_next": Shown("hidden_bogie", "next_measurement"),
    "hidden_errors": Shown("hidden_bogie", "added_errors"),
    "hidden_three_steps": Shown("hidden_three", "error_by_step"),
    "vehicle_model": Shown("vehicle", "model"),
    "vehicle_frequencies": Shown("vehicle", "modes"),
    "vehicle_comparison": Shown("vehicle", "comparison"),
    "vehicle_mode_shapes": Shown("vehicle", "mode_shapes_after"),
    "vehicle_modes_bogies": Shown("vehicle", "model_modes_initial_2"),
    "vehicle_modes_car": Shown("vehicle", "model_modes_initial_1"),
    "vehicle_parameters": Shown("vehicle", "parameters"),
    "vehicle_sensitivity": Shown("vehicle", "sensitivity"),
    "hidden_effect_errors": Shown("hidden_effect", "errors_before_after"),
    "solar_panel_model": Shown("solar_panel", "model"),
    "solar_panel_study": Shown("solar_panel", "frf_overlays"),
    "solar_panel_reduction": Shown("solar_panel_article", "reduction"),
    "solar_panel_convergence": Shown("solar_panel_article", "convergence"),
    "solar_panel_factors": Shown("solar_panel_article", "factors"),
    "solar_panel_functions": Shown("solar_panel_article", "functions"),
    "tire_tire": Shown("tire_contact_article", "tire"),
    "tire_sections": Shown("tire_contact_article", "sections"),
    "tire_loads": Shown("tire_contact_article", "loads"),
    "tire_patch": Shown("tire_contact_article", "patch"),
    "tire_displacements": Shown("tire_contact_article", "displacements"),
    "tire_surfaces": Shown("tire_contact_article", "surfaces"),
    "tire_load_table": Shown("tire_contact_article", "load_table"),
    "tire_times": Shown("tire_contact_article", "times"),
    "tire_effects": Shown("hidden_tire", "ranked_effects"),
}
WORST = "hidden_worst"
"""The figure of two studies: that of the bogie, without and with what it lacks."""
SCRIPTS = {
    "solar_panel_article": HERE.parent / "studies/solar_panel/article_figures.py",
    "tire_contact_article": HERE.parent / "studies/tire_contact/article_figures.py",
}
"""Folders that a script of a study has written, and the script that draws them."""


def main() -> None:
    """Draw what the results at hand allow."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--results", type=Path, default=Path("results"), help="where the studies' results are")
    arguments.add_argument("--into", type=Path, default=HERE / "figures", help="where the figures go")
    arguments.add_argument("--only", metavar="NAME", help="one figure, which must be drawn")
    arguments.add_argument("--check", action="store_true", help="draw none; fail where the present code draws another")
    given = arguments.parse_args()
    given.into.mkdir(parents=True, exist_ok=True)
    both = [given.results / name for name in ("hidden_bogie", "hidden_bogie_extended")]
    drawn = {WORST: lambda: before_and_after(*both)}
    drawn |= {name: partial(of_folder, given.results / shown.folder, shown.name) for name, shown in FIGURES.items()}
    if given.only is not None and given.only not in drawn:
        arguments.error(f"there is no figure {given.only!r}")
    stale = []
    for name, draw in drawn.items():
        if given.only not in (None, name):
            continue
        figure, path = draw(), given.into / f"{name}.png"
        if figure is not None and given.check:
            stale += [name] if not shows(path, figure) else []
        elif figure is not None:
            write(figure, path)
        elif given.only is None:
            print(f"{name}: kept, its results are not in {given.results}")
        else:
            raise SystemExit(f"{name}: its results are not in {given.results}")
    if stale:
        raise SystemExit(f"the present code draws other figures: {', '.join(stale)}; make docs-figures draws them anew")


def of_folder(folder: Path, name: str) -> Figure | None:
    """A figure of a study or of a script, with its heading; None where there is none of that name.

    All but that of a sensitivity analysis are of calibrated studies.
    """
    if folder.name in SCRIPTS:
        return module_of(SCRIPTS[folder.name]).SET.drawn(folder, name)
    needed = "sensitivity.csv" if name == "sensitivity" else "summary.json"
    if not (folder / needed).is_file():
        return None
    record = _record(folder)
    drawing = Figures(folder, record["title"], record["synthetic"]).plan.get(name)
    if drawing is None:
        return None
    with style(), upright(record.get("axes", "")):
        figure = drawing.draw()
        add_heading(figure, f"{record['title']}: {drawing.caption}", record["synthetic"])
    return figure


def before_and_after(base: Path, extended: Path) -> Figure | None:
    """The worst comparisons of two calibrated models: as it was, and with the effects that `calib run` added."""
    files = [folder / "where_it_fails_after.csv" for folder in (base, extended)]
    if not all(file.is_file() for file in (base / "added.json", *files)):
        return None
    record = _record(base)
    (effect,) = json.loads((base / "added.json").read_text("utf-8"))["effects"]
    name = in_prose(effect["name"])
    labels = (f"without the {name}", "with it")
    with style():
        without, having = (read_results(file, ["kind", "what"], ["in_std"]) for file in files)
        ax = draw_worst(None, without, added=having)
        dots = [marks for marks in ax.collections if not str(marks.get_label()).startswith("_")]
        for marks, label in zip(dots, labels, strict=True):
            marks.set_label(label)
        legend_above(ax)
        low, high = ax.get_xlim()
        ax.set_xticks([tick for tick in TICKS if low <= tick <= high])
        ax.xaxis.set_minor_locator(NullLocator())
        add_heading(ax.figure, f"The worst errors of the model, without and with the {name}", record["synthetic"])
    return ax.figure


def _record(folder: Path) -> dict:
    return json.loads((folder / "record.json").read_text("utf-8"))


def picture(figure: Figure) -> Image.Image:
    """The figure as it is saved."""
    take_dollars_literally(figure)
    drawn = io.BytesIO()
    with style():
        figure.savefig(drawn, format="png", dpi=DPI)
    return Image.open(drawn).convert("RGB")


def shows(path: Path, figure: Figure) -> bool:
    """Whether a file shows a figure."""
    if not path.is_file():
        return False
    here, there = (np.asarray(one, dtype=int) for one in (Image.open(path).convert("RGB"), picture(figure)))
    return here.shape == there.shape and float(np.mean(np.abs(here - there).max(axis=2) > APART)) <= SAME


def write(figure: Figure, path: Path) -> None:
    """Save as PNG, with every colour; an interruption leaves the old file."""
    draft = path.with_suffix(".draft")
    picture(figure).save(draft, "png", optimize=True)
    os.replace(draft, path)
    print(path)


if __name__ == "__main__":
    main()
