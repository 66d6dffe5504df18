"""The figures of a results folder: which there are, from which tables, and who draws them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.errors import InputError
from calib.named_values import read_json
from calib.report.calibration import draw_convergence, draw_searches
from calib.report.comparison import comparison_figure, draw_comac, draw_mac_matrix
from calib.report.correlation import INDUCED, INPUTS, MOST_IN_MATRIX, POSTERIOR, STRONG, draw_correlation
from calib.report.explanation import draw_confounding, ranked_effects_figure
from calib.report.frequencies import draw_frequencies, stages_of_added
from calib.report.frf import draw_frac, draw_frf_lines, overlay_figure
from calib.report.frf_tables import kind_of, read_stages
from calib.report.mesh import read_mesh, rest_lines
from calib.report.misfit import draw_pulls, where_it_fails_figure
from calib.report.model import face_groups, model_figure
from calib.report.modes import model_modes_figure, pages
from calib.report.parameters import draw_parameters
from calib.report.places import places_figure
from calib.report.responses import draw_response_misfit, draw_responses
from calib.report.scene import PLACE
from calib.report.sensitivity import MEASURES, draw_selection, draw_sensitivity
from calib.report.shapes import mode_shapes_figure
from calib.report.shown import Folder
from calib.report.style import stage_words
from calib.report.tables import read_table
from calib.report.verification import draw_error_versions, draw_errors, next_measurement_figure
from calib.report.where import perturbation_map_figure, sensor_misfit_figure
from calib.report.why import why_figure
from calib.report.worst import draw_worst

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


def plan(folder: Folder) -> dict[str, Drawing]:
    """Every figure for which a results folder has the tables, by name; all tables are read, nothing is drawn.

    Raises
    ------
    InputError
        A table is damaged.
    """
    drawings: dict[str, Drawing] = {}

    def add(name: str, caption: str, draw: Callable[[], Figure], *tables: str) -> None:
        drawings[name] = Drawing(name, caption, draw, tables or (name,))

    effects = added_effects(folder)
    stages = (*_STAGES, *([_ADDED] if effects else []))
    compared = {stage: _comparison(folder / f"comparison_{stage}.csv") for stage in stages}
    before, after, noise = compared["before"], compared["after"], _noise_mac(folder / "summary.json")
    if before is not None or after is not None:
        add(
            "comparison", "model against measurement",
            lambda: comparison_figure(before, after, noise, added=compared.get(_ADDED), effects=effects),
            *_there(folder, "comparison", stages),
        )  # fmt: skip
    for stage in _STAGES:
        if (errors := _scalar_comparison(folder / f"comparison_{stage}.csv")) is not None:
            both = (errors, None) if stage == "before" else (None, errors)
            add(
                f"responses_{stage}",
                f"errors of the responses, {stage_words(stage, effects)}",
                lambda both=both: _owner(draw_responses(*both, effects=effects)),  # type: ignore[misc]
                f"comparison_{stage}",
            )
    _plan_frfs(folder, stages, effects, add)
    for stage in _STAGES:
        path = folder / f"mac_{stage}.csv"
        if path.exists():
            mac = read_table(path, ["mode"], others_are_numbers=True)
            words = stage_words(stage, effects)
            add(path.stem, f"MAC, {words}", lambda mac=mac: _owner(draw_mac_matrix(mac)))  # type: ignore[misc]
    sensors = {stage: _comac(folder / f"comac_{stage}.csv") for stage in _STAGES}
    if any(table is not None for table in sensors.values()):
        add("comac", "CoMAC of the sensors",
            lambda: _owner(draw_comac(sensors["before"], sensors["after"], effects=effects)),
            *_there(folder, "comac", _STAGES))  # fmt: skip
    _plan_modes(folder, compared, effects, add)
    if (every := _every_mode(folder / "modes.csv")) is not None:
        add("modes", "damped frequencies of all measured modes", lambda every=every: _owner(draw_frequencies(every)))  # type: ignore[misc]
    if effects and (every := _every_mode(folder / "added_modes.csv")) is not None:
        caption = f"damped frequencies of all measured modes, without and with {effects}"
        looks = stages_of_added(effects)
        add("added_modes", caption, lambda every=every: _owner(draw_frequencies(every, looks=looks)))  # type: ignore[misc]
    worst = {stage: _failing(folder / f"where_it_fails_{stage}.csv") for stage in stages}
    if any(worst[stage] is not None for stage in _STAGES):
        add(
            "where_it_fails", "the worst comparisons",
            lambda: _owner(draw_worst(worst["before"], worst["after"], added=worst.get(_ADDED), effects=effects)),
            *_there(folder, "where_it_fails", stages),
        )  # fmt: skip
    for name, (caption, looks) in _MATRICES.items():
        path = folder / f"{name}.csv"
        if path.exists():
            matrix = read_table(path, ["parameter"], others_are_numbers=True)
            add(name, caption, lambda matrix=matrix, looks=looks: _owner(draw_sensitivity(matrix, **looks)))  # type: ignore[misc]
    path = folder / "input_correlation.csv"
    if path.exists():
        inputs = _square(path)
        if len(inputs) > 1:
            caption = "correlation induced by constraints"
            add(
                "input_correlation", caption,
                lambda: _owner(draw_correlation(inputs, threshold=INDUCED, label=INPUTS)),
            )  # fmt: skip
    path = folder / "selection.csv"
    if path.exists():
        numbers = [name for measure in MEASURES for name in (f"max_{measure}", f"{measure}_floor")]
        flags = ["measured", "selected"]
        chosen = read_table(path, ["parameter"], numbers, flags=flags)
        add("selection", "selection of parameters", lambda: _owner(draw_selection(chosen)))
    path = folder / "parameters.csv"
    if path.exists():
        found = read_table(
            path,
            ["case", "parameter", "unit"],
            ["value", "ratio", "spread"],
            complete=["ratio"],
            flags=["on_bound", "stable", "identified", "search_on_bound"],
            if_there=["lower", "upper", "std", "search_value", "search_on_bound"],
        )
        best = _best_case(folder / "summary.json", list(dict.fromkeys(found["case"])))
        space = folder / "parameter_space.csv"
        known = read_table(space, ["parameter"], ["value", "prior_sd"]) if space.exists() else None
        add("parameters", "calibrated parameters", lambda: _owner(draw_parameters(found, None, best, known)))
        if found["case"].nunique() > 1 or ("search_value" in found and found["search_value"].notna().any()):
            add("searches", "ends of the searches", lambda: _owner(draw_searches(found, best_case=best)), "parameters")
    path = folder / "posterior_correlation.csv"
    if path.exists():
        posterior = _square(path, may_be_empty=True)
        if len(posterior) > 1:
            add(
                "posterior_correlation", "posterior correlation of the parameters",
                lambda: _owner(
                    draw_correlation(posterior, threshold=STRONG, label=POSTERIOR, most_in_matrix=MOST_IN_MATRIX)
                ),
            )  # fmt: skip
    path = folder / "convergence.csv"
    if path.exists():
        misfit = ["best", "mean"]
        runs = read_table(path, ["case"], ["generation", *misfit], complete=["generation"], unbounded=misfit)
        add("convergence", "convergence of the search", lambda: _owner(draw_convergence(runs)))
    _plan_explanation(folder, add)
    return drawings


def _plan_frfs(folder: Folder, stages: Sequence[str], effects: str, add: Callable[..., None]) -> None:
    """Figures of FRFs."""
    lines = read_stages(folder, "frf_lines", stages)
    overlays, functions = read_stages(folder, "frf", stages), read_stages(folder, "comparison", stages)
    if overlays and functions:
        add(
            "frf_overlays", "FRFs that agree least, measured and of the model",
            lambda: overlay_figure(overlays, functions, effects=effects), *_there(folder, "frf", stages),
        )  # fmt: skip
        add(
            "frac", "FRAC of every function",
            lambda: _owner(draw_frac(functions, effects=effects)), *_there(folder, "comparison", stages),
        )  # fmt: skip
    if lines:
        add(
            "frf_lines", "errors of the FRFs along the frequency axis",
            lambda: _owner(draw_frf_lines(lines, effects=effects)), *_there(folder, "frf_lines", stages),
        )  # fmt: skip


def _plan_modes(
    folder: Folder, compared: dict[str, pd.DataFrame | None], effects: str, add: Callable[..., None]
) -> None:
    """Figures of the mesh: the model, its modes, and measured shapes over them."""
    mesh = read_mesh(folder)
    if mesh is None:
        return
    shapes = {stage: _shapes(folder / f"shapes_{stage}.csv") for stage in _STAGES}
    placed = next((table for table in shapes.values() if table is not None), None)
    sensors = None if placed is None else placed[placed["mode"] == placed["mode"].iloc[0]]
    if sensors is not None or face_groups(mesh):  # a mesh of lines alone is drawn with its modes
        add("model", "the model", lambda: model_figure(mesh, sensors), "mesh_points", "mesh_elements")
    path = folder / "model_places.csv"
    if path.exists():
        marks = read_table(
            path, ["name", "form"], PLACE, complete=PLACE, blank=["kind", "parameters"], may_be_empty=True
        )
        if len(marks):
            add(
                "model_places", "springs, masses and supports of the model, and its parameters",
                lambda: places_figure(mesh, marks), "model_places",
            )  # fmt: skip
    for stage in ("initial", *_STAGES):  # the first is before the calibration of an earlier study too
        words = "before any calibration" if stage == "initial" else stage_words(stage, effects)
        moved, listed = folder / f"deflection_{stage}.csv", folder / f"model_modes_{stage}.csv"
        if not moved.exists() or not listed.exists():
            continue
        columns, found = ["point", "u", "v", "w"], ["damped_freq", "damping_ratio"]
        motion = read_table(moved, ["mode"], columns, complete=columns, may_be_empty=True)
        modes = read_table(listed, ["mode"], found, complete=["damped_freq"], may_be_empty=True)
        for page, some in pages(modes).items():
            add(
                f"model_modes_{stage}{page}",
                f"modes of the model, {words}: damped frequency",
                lambda some=some, motion=motion: model_modes_figure(some, motion, mesh),
                f"model_modes_{stage}",
            )
        measured = shapes.get(stage)
        if measured is not None:
            add(
                f"mode_shapes_{stage}",
                f"mode shapes, {words}: measured/model",
                lambda measured=measured, motion=motion, facts=compared[stage]: mode_shapes_figure(
                    measured, motion, mesh, facts
                ),
                f"shapes_{stage}",
            )


def _every_mode(path: Path) -> pd.DataFrame | None:
    """Table of all measured modes; None without the file or without rows in it."""
    if not path.exists():
        return None
    kinds = ("damped_freq", "error", "mac")
    wanted = [f"{kind}_{stage}" for kind in kinds for stage in _STAGES]
    table = read_table(
        path, ["mode"], ["damped_freq_measured", *wanted], flags=["held_out"], may_be_empty=True,
        if_there=[f"{kind}_initial" for kind in kinds],
    )  # fmt: skip
    return table if len(table) else None


def _shapes(path: Path) -> pd.DataFrame | None:
    return read_table(path, ["mode", "direction"], ["x", "y", "z", "measured_re"]) if path.exists() else None


def _plan_explanation(folder: Folder, add: Callable[..., None]) -> None:
    """Figures of the search for a missing effect; a table without rows has no figure."""

    def read(name: str, text: list[str], numbers: list[str], **more: Any) -> pd.DataFrame | None:
        path = folder / f"{name}.csv"
        table = read_table(path, text, numbers, may_be_empty=True, **more) if path.exists() else None
        return None if table is None or table.empty else table

    kinds = read("misfit_kinds", ["stage", "mode", "kind"], ["chi2", "dof", "p"])
    errors = read("errors", ["group", "stage"], ["rms", "expected", "p"])
    shifts = ["nominal", "value", "standardised", "limit"]
    pulls = read("pulls", ["model", "parameter"], shifts, flags=["pulled"], blank=["unit"], unbounded=["standardised"])
    more = [] if pulls is None else [m for m in dict.fromkeys(pulls["model"]) if m != "base"]
    name = more[0] if len(more) == 1 else ""
    attempt = any(t is not None and (t["stage"] == "attempt").any() for t in (kinds, errors))
    if kinds is not None:
        caption = "misfit beyond noise, by mode and kind of response"
        add("where_it_fails_sigma", caption, lambda: where_it_fails_figure(kinds, name=name), "misfit_kinds")
    left = read("response_misfit", ["stage", "response"], ["residual"])
    if left is not None:
        caption = "residuals of the responses after the fit"
        add("response_misfit", caption, lambda: _owner(draw_response_misfit(left, name=name)))
    rest = rest_lines(folder)
    sensors = read("sensor_misfit", ["stage", "mode", "sensor", "direction"], ["x", "y", "z", "re", "im"])
    if rest is not None and sensors is not None and (sensors["stage"] == "base").any():
        caption = "misfit at the sensors, calibrated base model"
        add("sensor_misfit", caption, lambda: sensor_misfit_figure(sensors, rest))
    perturbations = read("perturbations", ["perturbation", "kind"], ["x", "y", "z", "score", "unabsorbed", "limit"])
    if rest is not None and perturbations is not None:
        add(
            "perturbation_map",
            "scores of local perturbations: places to inspect, not causes",
            lambda: perturbation_map_figure(perturbations, rest),
            "perturbations",
        )
    if pulls is not None:
        add("pulls", "parameter pulls", lambda: _owner(draw_pulls(pulls, attempt=attempt)))
    evidence = [
        *("z", "unabsorbed", "magnitude", "magnitude_min", "plausible"),
        *("ln_bayes", "ln_bayes_third", "ln_bayes_triple", "model_probability"),
    ]
    effects = read(
        "effects", ["name", "title"], evidence, flags=["visible", "refitted", "credible"],
        blank=["unit", "implausible"], unbounded=["magnitude_min"],
    )  # fmt: skip
    why = read(
        "why", ["effects", "effect", "kind"], ["residual", "signature", "left"], blank=["mode", "sensor", "part"]
    )
    if why is not None:
        fitted = read("why_parameters", ["effect", "parameter"], ["value"], blank=["description", "unit"])
        acts = read("effect_places", ["effect"], PLACE, complete=PLACE)
        alike = read("why_places", ["effect", "perturbation", "kind"], ["x", "y", "z", "correlation"])
        add(
            "why_this_effect",
            "residual of the base model and signature of the effect",
            lambda: why_figure(
                why, alike, rest, effects=effects, parameters=fitted, acts=acts, attempt=attempt
            ),
            *(name for name in ("why", "why_parameters", "why_places") if (folder / f"{name}.csv").exists()),
        )  # fmt: skip
    if effects is not None:
        add("ranked_effects", "evidence for each effect", lambda: ranked_effects_figure(effects), "effects")
    if (path := folder / "confounding.csv").exists():
        signatures = _square(path, "effect", may_be_empty=True)
        if not signatures.empty:
            caption = "correlation of the effects' signatures"
            add("confounding", caption, lambda: _owner(draw_confounding(signatures, effects=effects)))
    if errors is not None:
        add("errors_before_after", "errors before and after", lambda: _owner(draw_errors(errors, name=name)), "errors")
    both = read("added_errors", ["group", "stage"], ["rms", "expected", "p"])
    if both is not None:
        caption = "errors without and with the added effects, both models calibrated"
        add("added_errors", caption, lambda: _owner(draw_errors(both, name=name)))
    versions = read("versions", ["group"], ["version", "rms", "expected"], complete=["version"], blank=["effects"])
    if versions is not None:
        caption = "errors over the versions of the model"
        add("errors_over_versions", caption, lambda: _owner(draw_error_versions(versions)), "versions")
    gains = [f"{name}{end}" for name in ("gain", "ln_bayes") for end in ("", "_low", "_high")]
    candidates = read("next_measurement", ["measurement", "kind"], gains, unbounded=gains, blank=["effect"])
    if candidates is not None:
        add("next_measurement", "recommended measurements", lambda: next_measurement_figure(candidates))


def _comparison(path: Path) -> pd.DataFrame | None:
    if not path.exists() or kind_of(path) != "modes":
        return None
    numbers = ["natural_freq_measured", "natural_freq_model", "freq_error", "mac"]
    return read_table(path, ["mode"], numbers, complete=["natural_freq_measured"], unique="mode")


def _square(path: Path, key: str = "parameter", may_be_empty: bool = False) -> pd.DataFrame:
    table = read_table(path, [key], others_are_numbers=True, unique=key, may_be_empty=may_be_empty)
    if len(table) and table[key].tolist() != [c for c in table.columns if c != key]:
        raise InputError(
            f"rows and columns do not name the same {key}s",
            place=path,
            remedy="run the study again to write it anew",
        )
    return table


def _there(folder: Folder, name: str, stages: Sequence[str]) -> list[str]:
    """Names of the tables of each stage."""
    return [f"{name}_{stage}" for stage in stages if (folder / f"{name}_{stage}.csv").exists()]


def _scalar_comparison(path: Path) -> pd.DataFrame | None:
    if not path.exists() or kind_of(path) != "responses":
        return None
    return read_table(path, ["response"], ["measured", "model", "error", "error_in_std"], unique="response")


def _failing(path: Path) -> pd.DataFrame | None:
    """The comparisons with a standard deviation; None without the file or any."""
    if not path.exists():
        return None
    table = read_table(path, ["kind", "what"], ["in_std"], may_be_empty=True)
    return table if table["in_std"].notna().any() else None


def _comac(path: Path) -> pd.DataFrame | None:
    return read_table(path, ["sensor"], ["comac"], if_there=["motion"]) if path.exists() else None


def added_effects(folder: Folder) -> str:
    """Names of the effects that were added after an explanation, joined by " + "; empty where there are none."""
    path = folder / "added.json"
    effects = read_json(path, {"effects": [{"name": str}]}).get("effects", []) if path.exists() else []
    return " + ".join(str(effect["name"]) for effect in effects)


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


def _owner(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    assert figure is not None  # these Axes were created in one
    return figure
