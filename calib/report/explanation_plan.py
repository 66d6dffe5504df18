"""The figures of an explanation: which there are, from which tables, and who draws them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pandas as pd

from calib.report.explanation import draw_confounding, ranked_effects_figure
from calib.report.frf import draw_frf_misfit
from calib.report.mesh import rest_lines
from calib.report.misfit import draw_pulls, where_it_fails_figure
from calib.report.responses import draw_response_misfit
from calib.report.scene import PLACE
from calib.report.shown import Folder
from calib.report.style import owner_of
from calib.report.tables import read_square, read_table
from calib.report.verification import draw_error_versions, draw_errors, next_measurement_figure
from calib.report.where import perturbation_map_figure, sensor_misfit_figure
from calib.report.why import why_figure


def plan_explanation(folder: Folder, add: Callable[..., None]) -> None:
    """Plan the figures of the search for a missing effect; a table without rows has no figure.

    Parameters
    ----------
    folder : Folder
    add : callable
        Takes name, caption, drawing function and tables of a figure.

    Raises
    ------
    InputError
        A table is damaged.
    """

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
    frfs = read("frf_misfit", ["stage", "function"], ["freq", "re", "im"])
    if frfs is not None:
        caption = "residuals of the FRFs after the fit, by function and band"
        add("frf_misfit", caption, lambda: owner_of(draw_frf_misfit(frfs, name=name)))
    elif kinds is not None:
        caption = "misfit beyond noise, by mode and kind of response"
        add("where_it_fails_sigma", caption, lambda: where_it_fails_figure(kinds, name=name), "misfit_kinds")
    left = read("response_misfit", ["stage", "response"], ["residual"])
    if left is not None:
        caption = "residuals of the responses after the fit"
        add("response_misfit", caption, lambda: owner_of(draw_response_misfit(left, name=name)))
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
        add("pulls", "parameter pulls", lambda: owner_of(draw_pulls(pulls, attempt=attempt)))
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
        signatures = read_square(path, "effect", may_be_empty=True)
        if not signatures.empty:
            caption = "correlation of the effects' signatures"
            add("confounding", caption, lambda: owner_of(draw_confounding(signatures, effects=effects)))
    if errors is not None:
        add(
            "errors_before_after", "errors before and after", lambda: owner_of(draw_errors(errors, name=name)), "errors"
        )
    both = read("added_errors", ["group", "stage"], ["rms", "expected", "p"])
    if both is not None:
        caption = "errors without and with the added effects, both models calibrated"
        add("added_errors", caption, lambda: owner_of(draw_errors(both, name=name)))
    versions = read("versions", ["group"], ["version", "rms", "expected"], complete=["version"], blank=["effects"])
    if versions is not None:
        caption = "errors over the versions of the model"
        add("errors_over_versions", caption, lambda: owner_of(draw_error_versions(versions)), "versions")
    gains = [f"{name}{end}" for name in ("gain", "ln_bayes") for end in ("", "_low", "_high")]
    candidates = read("next_measurement", ["measurement", "kind"], gains, unbounded=gains, blank=["effect"])
    if candidates is not None:
        add("next_measurement", "recommended measurements", lambda: next_measurement_figure(candidates))
