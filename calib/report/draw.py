"""The figures of a results folder: which there are, from which tables, and who draws them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from calib.errors.errors import InputError
from calib.report.calibration import MOST_ENDS, draw_convergence, draw_searches, ends_figure, search_runs
from calib.report.comparison import comparison_figure, draw_comac, draw_mac_matrix
from calib.report.correlation import INDUCED, INPUTS, MOST_IN_MATRIX, POSTERIOR, STRONG, draw_correlation
from calib.report.drawing import Drawing, bound, existing
from calib.report.explanation_plan import plan_explanation
from calib.report.frequencies import draw_frequencies, stages_of_added
from calib.report.frf import draw_frac, draw_frf_lines, overlay_figure
from calib.report.mesh import read_mesh
from calib.report.metamodel import draw_prognosis
from calib.report.model import coloured_groups, model_figure
from calib.report.modes import model_modes_figure, pages
from calib.report.orthogonality import orthogonality_figure
from calib.report.parameters import draw_parameters
from calib.report.pareto import draw_pareto
from calib.report.places import DIRECTION, places_figure
from calib.report.profiles import profiles_figure
from calib.report.responses import draw_responses
from calib.report.robustness import BOUNDS, NUMBERS, robustness_figure
from calib.report.scene import PLACE
from calib.report.sensitivity import MEASURES, draw_selection, draw_sensitivity
from calib.report.shapes import mode_shapes_figure
from calib.report.style import stage_words
from calib.report.tables import Folder, comparison_kind, read_results, read_square, read_stages
from calib.report.worst import draw_worst
from calib.results.answer import in_prose
from calib.results.json_file import read_json

_MATRICES: dict[str, tuple[str, dict[str, Any]]] = {
    "sensitivity": ("sensitivity of the responses", {}),
    "partial": ("sensitivity, controlled for all other parameters", {"label": "partial rank correlation (–)"}),
    # 0.1 is the root of 1 % of the variance; smaller shares stay blank.
    "variance_share": (
        "variance share of each parameter, beyond all others",
        {"threshold": 0.1, "label": "square root of the variance share (–)", "signed": False},
    ),
}
"""Matrices of the sensitivity, with their captions and looks."""
_STAGES = ("before", "after")
_ADDED = "added"
"""Stage of the model that is calibrated with added effects."""


def plan(folder: Folder) -> dict[str, Drawing]:
    """Every figure for which a results folder has the tables, by name; all tables are read, nothing is drawn.

    Raises
    ------
    InputError
        A table is damaged.
    """
    effects = added_effects(folder)
    stages = (*_STAGES, *([_ADDED] if effects else []))
    compared = {stage: _comparison(folder / f"comparison_{stage}.csv") for stage in stages}
    parts = (
        _comparisons(folder, compared, effects),
        _frfs(folder, stages, effects),
        _correlations_of_shapes(folder, effects),
        _shapes_on_mesh(folder, compared, effects),
        _every_mode(folder, effects),
        _worst_comparisons(folder, stages, effects),
        _sensitivities(folder),
        _calibration(folder),
        plan_explanation(folder),
    )
    return {drawing.name: drawing for part in parts for drawing in part}


def _comparisons(folder: Folder, compared: Mapping[str, pd.DataFrame | None], effects: str) -> Iterator[Drawing]:
    """Modes, and scalar responses, of model and measurement."""
    before, after = compared["before"], compared["after"]
    if before is not None or after is not None:
        noise, added = _noise_mac(folder / "summary.json"), compared.get(_ADDED)
        draw = bound(comparison_figure, before, after, noise, added=added, effects=effects)
        yield Drawing("comparison", "model against measurement", draw, _there(folder, "comparison", list(compared)))
    scalar = {stage: _scalar_comparison(folder / f"comparison_{stage}.csv") for stage in compared}
    if any(table is not None for table in scalar.values()):
        draw = bound(draw_responses, scalar["before"], scalar["after"], added=scalar.get(_ADDED), effects=effects)
        yield Drawing(
            "responses", "responses of model and measurement", draw, _there(folder, "comparison", list(scalar))
        )


def _frfs(folder: Folder, stages: Sequence[str], effects: str) -> Iterator[Drawing]:
    """FRFs of model and measurement."""
    lines = read_stages(folder, "frf_lines", stages)
    overlays, functions = read_stages(folder, "frf", stages), read_stages(folder, "comparison", stages)
    if overlays and functions:
        caption = "FRFs that agree least, measured and of the model"
        draw = bound(overlay_figure, overlays, functions, effects=effects)
        yield Drawing("frf_overlays", caption, draw, _there(folder, "frf", stages))
        draw = bound(draw_frac, functions, effects=effects)
        yield Drawing("frac", "FRAC of every function", draw, _there(folder, "comparison", stages))
    if lines:
        draw = bound(draw_frf_lines, lines, effects=effects)
        caption = "errors of the FRFs along the frequency axis"
        yield Drawing("frf_lines", caption, draw, _there(folder, "frf_lines", stages))


def _correlations_of_shapes(folder: Folder, effects: str) -> Iterator[Drawing]:
    """MAC of all pairs of modes, mass-orthogonality, and CoMAC."""
    for stage in _STAGES:
        path = folder / f"mac_{stage}.csv"
        if path.exists():
            mac = read_results(path, ["mode"], others_are_numbers=True)
            yield Drawing(path.stem, f"MAC, {stage_words(stage, effects)}", bound(draw_mac_matrix, mac), (path.stem,))
    for stage in _STAGES:
        names = tuple(f"{kind}_orthogonality_{stage}" for kind in ("cross", "self"))
        if all((folder / f"{name}.csv").exists() for name in names):
            cross = read_results(folder / f"{names[0]}.csv", ["mode"], ["model_mode"], others_are_numbers=True)
            own = read_square(folder / f"{names[1]}.csv", "mode")
            caption = f"mass-orthogonality of the measured shapes, {stage_words(stage, effects)}"
            yield Drawing(f"orthogonality_{stage}", caption, bound(orthogonality_figure, cross, own), names)
    before, after = (_comac(folder / f"comac_{stage}.csv") for stage in _STAGES)
    if before is not None or after is not None:
        draw = bound(draw_comac, before, after, effects=effects)
        yield Drawing("comac", "CoMAC of the sensors", draw, _there(folder, "comac", _STAGES))


def _shapes_on_mesh(folder: Folder, compared: Mapping[str, pd.DataFrame | None], effects: str) -> Iterator[Drawing]:
    """The model, its modes, and measured shapes over them."""
    mesh = read_mesh(folder)
    if mesh is None:
        return
    shapes = {stage: _shapes(folder / f"shapes_{stage}.csv") for stage in _STAGES}
    placed = next((table for table in shapes.values() if table is not None), None)
    sensors, forces = _ends_of_functions(folder)
    if placed is not None:
        sensors = placed[placed["mode"] == placed["mode"].iloc[0]]
    if sensors is not None or coloured_groups(mesh):  # a mesh of lines in one colour is drawn with its modes
        draw = bound(model_figure, mesh, sensors, forces)
        yield Drawing("model", "the model", draw, ("mesh_points", "mesh_elements"))
    path = folder / "model_places.csv"
    if path.exists():
        marks = read_results(
            path,
            ["name", "form"],
            PLACE,
            complete=PLACE,
            blank=["kind", "parameters"],
            if_there=DIRECTION,
            may_be_empty=True,
        )
        if len(marks):
            caption = "springs, masses and supports of the model, and its parameters"
            yield Drawing("model_places", caption, bound(places_figure, mesh, marks), ("model_places",))
    for stage in ("initial", *_STAGES):  # the first is before the calibration of an earlier study too
        words = "before any calibration" if stage == "initial" else stage_words(stage, effects)
        moved, listed = folder / f"deflection_{stage}.csv", folder / f"model_modes_{stage}.csv"
        if not moved.exists() or not listed.exists():
            continue
        columns, found = ["point", "u", "v", "w"], ["damped_freq", "damping_ratio"]
        motion = read_results(moved, ["mode"], columns, complete=columns, may_be_empty=True)
        modes = read_results(listed, ["mode"], found, complete=["damped_freq"], may_be_empty=True)
        for page, some in pages(modes).items():
            caption = f"modes of the model, {words}: damped frequency"
            draw = bound(model_modes_figure, some, motion, mesh)
            yield Drawing(f"model_modes_{stage}{page}", caption, draw, (f"model_modes_{stage}",))
        if (measured := shapes.get(stage)) is not None:
            path = folder / f"expanded_shapes_{stage}.csv"
            expanded = (
                read_results(path, ["mode"], columns, complete=columns, may_be_empty=True) if path.exists() else None
            )
            draw = bound(mode_shapes_figure, measured, motion, mesh, compared[stage], expanded)
            caption = f"mode shapes, {words}: measured/model"
            yield Drawing(
                f"mode_shapes_{stage}", caption, draw, existing(folder, [f"shapes_{stage}", f"expanded_shapes_{stage}"])
            )


def _ends_of_functions(folder: Folder) -> tuple[pd.DataFrame | None, pd.DataFrame | None]:
    """Where FRFs were measured and where the structure was excited; None for other data."""
    functions, path = read_stages(folder, "comparison", _STAGES), folder / "sensors.csv"
    if not functions or not path.exists():
        return None, None
    known, compared = read_results(path, ["sensor", "direction"], PLACE), next(iter(functions.values()))
    return known[known["sensor"].isin(compared["response"])], known[known["sensor"].isin(compared["reference"])]


def _every_mode(folder: Folder, effects: str) -> Iterator[Drawing]:
    """Frequencies of all measured modes, held-out ones too."""
    if (every := _all_modes(folder / "modes.csv")) is not None:
        caption = f"{every['freq_kind'].iloc[0]} frequencies of all measured modes"
        yield Drawing("modes", caption, bound(draw_frequencies, every), ("modes",))
    if effects and (every := _all_modes(folder / "added_modes.csv")) is not None:
        caption = f"{every['freq_kind'].iloc[0]} frequencies of all measured modes, without and with {effects}"
        draw = bound(draw_frequencies, every, looks=stages_of_added(effects))
        yield Drawing("added_modes", caption, draw, ("added_modes",))


def _worst_comparisons(folder: Folder, stages: Sequence[str], effects: str) -> Iterator[Drawing]:
    """Comparisons in standard deviations."""
    worst = {stage: _failing(folder / f"where_it_fails_{stage}.csv") for stage in stages}
    if any(worst[stage] is not None for stage in _STAGES):
        draw = bound(draw_worst, worst["before"], worst["after"], added=worst.get(_ADDED), effects=effects)
        yield Drawing("where_it_fails", "the worst comparisons", draw, _there(folder, "where_it_fails", stages))


def _sensitivities(folder: Folder) -> Iterator[Drawing]:
    """Sensitivity of the responses, correlation of the inputs, and selection."""
    path, space = folder / "parameter_space.csv", None
    if path.exists():
        space = read_results(path, ["parameter"], ["lower", "upper"], blank=["unit"], unique="parameter")
    own = folder / "partial.csv"
    partial = read_results(own, ["parameter"], others_are_numbers=True) if own.exists() else None
    for name, (caption, looks) in _MATRICES.items():
        path = folder / f"{name}.csv"
        if path.exists():
            matrix = read_results(path, ["parameter"], others_are_numbers=True)
            beside = partial if name == "sensitivity" else None
            draw = bound(draw_sensitivity, matrix, space=space, partial=beside, **looks)
            yield Drawing(name, caption, draw, (name,))
    path = folder / "prognosis.csv"
    if path.exists() and (folder / "prognosis_inputs.csv").exists():
        total = read_results(path, ["response"], ["cop"])
        shares = read_results(folder / "prognosis_inputs.csv", ["response", "parameter"], ["cop"])
        draw = bound(draw_prognosis, total, shares)
        yield Drawing("prognosis", "prognosis by metamodels", draw, ("prognosis", "prognosis_inputs"))
    path = folder / "input_correlation.csv"
    if path.exists() and len(inputs := read_square(path)) > 1:
        draw = bound(draw_correlation, inputs, threshold=INDUCED, label=INPUTS)
        yield Drawing("input_correlation", "correlation induced by constraints or priors", draw, ("input_correlation",))
    path = folder / "selection.csv"
    if path.exists():
        numbers = [name for measure in MEASURES for name in (f"max_{measure}", f"{measure}_floor")]
        chosen = read_results(path, ["parameter"], numbers, flags=["measured", "selected"])
        yield Drawing("selection", "selection of parameters", bound(draw_selection, chosen), ("selection",))


def _calibration(folder: Folder) -> Iterator[Drawing]:
    """Calibrated parameters, their posterior correlation, and the searches."""
    path = folder / "parameters.csv"
    if path.exists():
        found = read_results(
            path,
            ["case", "parameter", "unit"],
            ["value", "ratio", "spread"],
            complete=["ratio"],
            flags=["on_limit", "stable", "identified", "search_on_limit"],
            if_there=["lower", "upper", "std", "low", "high", "search_value", "search_on_limit"],
            blank=["scale"],
        )
        best = _best_case(folder / "summary.json", list(dict.fromkeys(found["case"])))
        space = folder / "parameter_space.csv"
        known = read_results(space, ["parameter"], ["value", "prior_sd"]) if space.exists() else None
        path = folder / "unexplained_calibrated.csv"
        ends = ["low_unexplained", "high_unexplained"]
        wide = read_results(path, ["parameter"], ends, unique="parameter") if path.exists() else None
        draw = bound(draw_parameters, found, None, best, known, wide)
        yield Drawing("parameters", "calibrated parameters", draw, ("parameters",))
        if found["case"].nunique() > 1 or ("search_value" in found and found["search_value"].notna().any()):
            draw = bound(draw_searches, found, best_case=best)
            yield Drawing("searches", "where the cases ended", draw, ("parameters",))
    path = folder / "errors_by_case.csv"
    if path.exists():
        both = read_results(path, ["case", "point", "what"], ["error", "mac"], may_be_empty=True)
        if both["point"].nunique() > 1 and both["what"].nunique() <= MOST_ENDS:
            yield Drawing("search_errors", "errors by search and fit", bound(ends_figure, both), ("errors_by_case",))
    path = folder / "profiles.csv"
    if path.exists() and (folder / "intervals.csv").exists():
        numbers = ["value", "rise", "rise_data", "interval_at"]
        curves = read_results(path, ["parameter"], numbers, complete=numbers)
        ends = ["value", "lower", "upper", "linear_lower", "linear_upper"]
        found = read_results(folder / "intervals.csv", ["parameter", "unit"], ends, unique="parameter")
        draw = bound(profiles_figure, curves, found)
        yield Drawing("profiles", "profile likelihood of the parameters", draw, ("profiles", "intervals"))
    path = folder / "robustness.csv"
    if path.exists() and (folder / "robustness_samples.csv").exists():
        known = read_results(path, ["response"], list(NUMBERS), unique="response", blank=["unit"], unbounded=BOUNDS)
        drawn = read_results(folder / "robustness_samples.csv", [], others_are_numbers=True)
        caption = "robustness of the responses"
        yield Drawing("robustness", caption, bound(robustness_figure, known, drawn), ("robustness",))
    path = folder / "pareto.csv"
    if path.exists() and (folder / "pareto_objectives.csv").exists():
        numbers = ["design", "first", "second", "objective"]
        front = read_results(path, ["kind"], numbers, complete=numbers, flags=["knee", "lowest"])
        both = read_results(folder / "pareto_objectives.csv", ["name", "of"], ["weight"], complete=["weight"])
        names = ("pareto", "pareto_objectives")
        yield Drawing("pareto", " against ".join(both["name"]), bound(draw_pareto, front, both), names)
    path = folder / "posterior_correlation.csv"
    if path.exists() and len(posterior := read_square(path, may_be_empty=True)) > 1:
        draw = bound(draw_correlation, posterior, threshold=STRONG, label=POSTERIOR, most_in_matrix=MOST_IN_MATRIX)
        caption = "posterior correlation of the parameters"
        yield Drawing("posterior_correlation", caption, draw, ("posterior_correlation",))
    path = folder / "convergence.csv"
    if path.exists():
        misfit = ["best", "mean"]
        runs = read_results(path, ["case"], ["generation", *misfit], complete=["generation"], unbounded=misfit)
        runs = search_runs(runs)
        if len(runs):
            draw = bound(draw_convergence, runs)
            yield Drawing("convergence", "convergence of the search", draw, ("convergence",))


def _all_modes(path: Path) -> pd.DataFrame | None:
    """Table of all measured modes; None without the file or without rows in it."""
    if not path.exists():
        return None
    kinds = ("freq", "error", "mac")
    wanted = [f"{kind}_{stage}" for kind in kinds for stage in _STAGES]
    table = read_results(
        path, ["mode", "freq_kind"], ["freq_measured", *wanted], flags=["held_out"], may_be_empty=True,
        if_there=[f"{kind}_initial" for kind in kinds],
    )  # fmt: skip
    return table if len(table) else None


def _shapes(path: Path) -> pd.DataFrame | None:
    return read_results(path, ["mode", "direction"], ["x", "y", "z", "measured_re"]) if path.exists() else None


def _comparison(path: Path) -> pd.DataFrame | None:
    if not path.exists() or comparison_kind(path) != "modes":
        return None
    numbers = ["natural_freq_measured", "natural_freq_model", "freq_error", "mac"]
    return read_results(path, ["mode"], numbers, complete=["natural_freq_measured"], unique="mode")


def _there(folder: Folder, name: str, stages: Sequence[str]) -> tuple[str, ...]:
    """Names of the tables of each stage."""
    return existing(folder, [f"{name}_{stage}" for stage in stages])


def _scalar_comparison(path: Path) -> pd.DataFrame | None:
    if not path.exists() or comparison_kind(path) != "responses":
        return None
    numbers = ["measured", "model", "error", "error_in_std"]
    return read_results(path, ["response"], numbers, blank=["unit"], unique="response")


def _failing(path: Path) -> pd.DataFrame | None:
    """The comparisons with a standard deviation; None without the file or any."""
    if not path.exists():
        return None
    table = read_results(path, ["kind", "what"], ["in_std"], may_be_empty=True)
    return table if table["in_std"].notna().any() else None


def _comac(path: Path) -> pd.DataFrame | None:
    return read_results(path, ["sensor"], ["comac"], if_there=["motion"]) if path.exists() else None


def added_effects(folder: Folder) -> str:
    """Names of the effects that were added after an explanation, joined by " + "; empty where there are none."""
    path = folder / "added.json"
    effects = read_json(path, {"effects": [{"name": str}]}).get("effects", []) if path.exists() else []
    return " + ".join(in_prose(str(effect["name"])) for effect in effects)


def _noise_mac(path: Path) -> float:
    """Mean MAC that noise allows; NaN where unknown."""
    value = read_json(path, {"noise_mac": float}).get("noise_mac") if path.exists() else None
    return math.nan if value is None else float(value)


def _best_case(path: Path, cases: list[str]) -> str | None:
    if not path.exists():
        return None
    best = read_json(path, {"best_case": str}).get("best_case")
    if best is not None and str(best) not in cases:
        raise InputError(f"best_case {best!r} is not a case of parameters.csv ({', '.join(cases)})", place=path)
    return None if best is None else str(best)
