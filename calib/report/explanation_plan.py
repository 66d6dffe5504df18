"""The figures of an explanation: which there are, from which tables, and who draws them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from calib.report.alike import alike_figure
from calib.report.answer import AnsweredPlace, answer_figure, answered_place
from calib.report.drawing import Drawing, bound, existing
from calib.report.explanation import draw_confounding, ranked_effects_figure
from calib.report.frf import draw_frf_misfit
from calib.report.mesh import rest_lines
from calib.report.misfit import draw_pulls, draw_suspects, where_it_fails_figure
from calib.report.numbers import magnitude_in_words
from calib.report.predictions import NUMBERS, draw_predictions
from calib.report.proposals import placed_proposals, proposals_figure
from calib.report.responses import draw_response_misfit
from calib.report.scene import PLACE
from calib.report.tables import Folder, read_results, read_square
from calib.report.verification import (
    STEP_ERRORS,
    draw_error_steps,
    draw_error_versions,
    draw_errors,
    next_measurement_figure,
)
from calib.report.where import perturbation_map_figure, sensor_misfit_figure
from calib.report.why import BY_TEST, why_figure
from calib.results.answer import in_prose, names_in_words


def plan_explanation(folder: Folder) -> Iterator[Drawing]:
    """The figures of the search for a missing effect; a table without rows has no figure.

    Raises
    ------
    InputError
        A table is damaged.
    """
    kinds = _read(folder, "misfit_kinds", ["stage", "mode", "kind"], ["chi2", "dof", "p"])
    errors = _read(folder, "errors", ["group", "stage"], ["rms", "expected", "p"])
    shifts = ["nominal", "value", "standardised", "limit"]
    pulls = _read(
        folder, "pulls", ["model", "parameter"], shifts, flags=["pulled"], blank=["unit"], unbounded=["standardised"]
    )
    more = [] if pulls is None else [m for m in dict.fromkeys(pulls["model"]) if m != "base"]
    name = in_prose(str(more[0])) if len(more) == 1 else ""
    attempt = any(t is not None and (t["stage"] == "attempt").any() for t in (kinds, errors))
    rest = rest_lines(folder)
    if rest is not None:
        yield from _answer(folder, rest, errors, attempt)
    yield from _misfits(folder, kinds, rest, name)
    yield from _suspects(folder)
    if pulls is not None:
        caption = "shifts of the parameters from their nominal values"
        yield Drawing("pulls", caption, bound(draw_pulls, pulls, attempt=attempt), ("pulls",))
    yield from _effects(folder, rest, attempt)
    if errors is not None:
        draw = bound(draw_errors, errors, name=name)
        yield Drawing("errors_before_after", "errors before and after", draw, ("errors",))
    flags = ["inside", "inside_unexplained"]
    labels = ["mode", "sensor", "part"]
    predicted = _read(
        folder, "unexplained_predictions", ["group", "kind"], NUMBERS, flags=flags, blank=labels, unbounded=NUMBERS
    )
    if predicted is not None:
        caption = "predictions of validation data"
        draw = bound(draw_predictions, predicted)
        yield Drawing("held_out_predictions", caption, draw, ("unexplained_predictions", "unexplained_errors"))
    both = _read(folder, "added_errors", ["group", "stage"], ["rms", "expected", "p"])
    if both is not None:
        caption = "errors without and with the added effects, both models calibrated"
        yield Drawing("added_errors", caption, bound(draw_errors, both, name=name), ("added_errors",))
    steps = _read(folder, "steps_errors", ["effects", "group"], ["step", "rms", "expected"])
    if steps is not None:
        caption = "errors with every effect that is taken in"
        yield Drawing(STEP_ERRORS, caption, bound(draw_error_steps, steps), ("steps_errors",))
    versions = _read(
        folder, "versions", ["group"], ["version", "rms", "expected"], complete=["version"], blank=["effects"]
    )
    if versions is not None:
        caption = "errors over the versions of the model"
        yield Drawing("errors_over_versions", caption, bound(draw_error_versions, versions), ("versions",))
    placed = _read(
        folder, "proposal_places", ["kind", "at"], ["rank", "evidence", *PLACE], flags=["fitted", "close"],
        complete=["rank", *PLACE],
    )  # fmt: skip
    if rest is not None and placed is not None and len(placed_proposals(placed)):
        caption = "proposed effects and their places"
        yield Drawing("proposals", caption, bound(proposals_figure, placed, rest), ("proposals", "proposal_places"))
    gains = [f"{name}{end}" for name in ("gain", "ln_bayes") for end in ("", "_low", "_high")]
    candidates = _read(
        folder, "next_measurement", ["measurement", "kind"], gains, unbounded=gains, blank=["effect"], flags=["told"],
        if_there=["told"],
    )  # fmt: skip
    if candidates is not None:
        draw = bound(next_measurement_figure, candidates)
        yield Drawing("next_measurement", "recommended measurements", draw, ("next_measurement",))


def _misfits(folder: Folder, kinds: pd.DataFrame | None, rest: np.ndarray | None, name: str) -> Iterator[Drawing]:
    """Residuals after the fit, and scores of local perturbations; ``name`` are the effects in the extended model."""
    frfs = _read(folder, "frf_misfit", ["stage", "function"], ["freq", "re", "im"])
    if frfs is not None:
        caption = "residuals of the FRFs after the fit, by function and band"
        yield Drawing("frf_misfit", caption, bound(draw_frf_misfit, frfs, name=name), ("frf_misfit",))
    elif kinds is not None:
        caption = "misfit beyond noise, by mode and kind of response"
        draw = bound(where_it_fails_figure, kinds, name=name)
        yield Drawing("where_it_fails_sigma", caption, draw, ("misfit_kinds",))
    left = _read(folder, "response_misfit", ["stage", "response"], ["residual"])
    if left is not None:
        caption = "residuals of the responses after the fit"
        yield Drawing("response_misfit", caption, bound(draw_response_misfit, left, name=name), ("response_misfit",))
    sensors = _read(folder, "sensor_misfit", ["stage", "mode", "sensor", "direction"], ["x", "y", "z", "re", "im"])
    if rest is not None and sensors is not None and (sensors["stage"] == "base").any():
        caption = "misfit at the sensors, calibrated base model"
        yield Drawing("sensor_misfit", caption, bound(sensor_misfit_figure, sensors, rest), ("sensor_misfit",))
    numbers = ["x", "y", "z", "score", "unabsorbed", "limit"]
    perturbations = _read(folder, "perturbations", ["perturbation", "kind"], numbers)
    if rest is not None and perturbations is not None:
        caption = "scores of local stiffness or mass changes: places to inspect, not causes"
        draw = bound(perturbation_map_figure, perturbations, rest)
        yield Drawing("perturbation_map", caption, draw, ("perturbations",))


def _sizes(effects: pd.DataFrame, names: Sequence[str]) -> dict[str, str]:
    """Fitted magnitude of each of these effects with its 95 % interval, in words; empty where ends are not known."""
    if not {"magnitude_low", "magnitude_high"} <= set(effects.columns):
        return {}
    rows = effects[effects["name"].isin(list(names)) & effects["magnitude"].notna()]
    return {str(r["name"]): magnitude_in_words(r, "95 %: ") for r in rows.to_dict("records")}


def read_place(folder: Folder, attempt: bool) -> AnsweredPlace | None:
    """Where the explanation in a folder points: at what is named, or at what an ``attempt`` tells; None at nothing.

    An attempt that is not believed points where the verdict does: at an effect like which something is missing, or at a
    place to look at.
    """
    sensors = _read(folder, "sensors", ["sensor"], [*PLACE])
    why = _why(folder, attempt)
    acts = _read(folder, "effect_places", ["effect"], [*PLACE])
    numbers = [*PLACE, "score", "limit"]
    local = _read(
        folder, "perturbations", ["perturbation"], numbers, blank=["sensor"], flags=["told"], if_there=["told"]
    )
    return answered_place(sensors, acts, why, local, attempt)


def _why(folder: Folder, attempt: bool) -> pd.DataFrame | None:
    """Change patterns of the effects that are told; None without any."""
    why = _read(folder, "why", ["effect"], ["signature"], blank=["sensor"])
    if why is None or not attempt:
        return why
    effects = _read(folder, "effects", ["name"], [], flags=["told"], if_there=["told"])
    told: Any = [] if effects is None or "told" not in effects else effects.loc[effects["told"].eq(True), "name"]
    own = why[why["effect"].isin(told)]
    return own if len(own) else None


def _answer(folder: Folder, rest: np.ndarray, errors: pd.DataFrame | None, attempt: bool) -> Iterator[Drawing]:
    """The place, and an error without and with what is named there."""
    found = read_place(folder, attempt)
    if found is None:
        return
    sensors = _read(folder, "sensors", ["sensor"], [*PLACE])
    both = _read(folder, "added_errors", ["group", "stage"], ["rms", "expected"])
    why = _why(folder, attempt)
    missing = [] if why is None else list(dict.fromkeys(map(str, why["effect"])))
    what = [f"something like {in_prose(name)}" if attempt else in_prose(name) for name in missing]
    ends = ["magnitude_low", "magnitude_high"]
    effects = _read(folder, "effects", ["name"], ["magnitude"], blank=["unit"], if_there=ends)
    sizes = {} if effects is None else {in_prose(name): own for name, own in _sizes(effects, missing).items()}
    shown = None if attempt else errors if both is None else both
    draw = bound(answer_figure, rest, found, what, sizes, sensors, shown)
    named = ["sensors", "effect_places", "why", "perturbations", "effects", "errors", "added_errors"]
    tables = existing(folder, named)
    of = f" for {'' if attempt else 'the '}{names_in_words(what)}" if len(found.acts) and what else ""
    yield Drawing("answer", f"where to look{of}", draw, tables)


def _suspects(folder: Folder) -> Iterator[Drawing]:
    """Scores of the faults that the measurement may have."""
    faults = _read(
        folder, "faults", ["fault", "kind"], ["score", "limit"], flags=["blamed"], blank=["sensor", "told"]
    )  # fmt: skip
    if faults is not None:
        caption = "scores of measurement errors"
        yield Drawing("suspects", caption, bound(draw_suspects, faults), ("faults",))


def _effects(folder: Folder, rest: np.ndarray | None, attempt: bool) -> Iterator[Drawing]:
    """Evidence for the effects of the library, what the named ones explain, and which are collinear."""
    evidence = [
        *("z", "unabsorbed", "magnitude", "magnitude_min", "plausible"),
        *("ln_bayes", "ln_bayes_third", "ln_bayes_triple", "model_probability"),
    ]
    effects = _read(
        folder, "effects", ["name", "title"], evidence, flags=["visible", "refitted", "credible"],
        blank=["unit", "implausible"], unbounded=["magnitude_min"],
    )  # fmt: skip
    parts = ["mode", "sensor", "part"]
    why = _read(folder, "why", ["effects", "effect", "kind"], ["residual", "signature", "left"], blank=parts)
    if why is not None:
        fitted = _read(folder, "why_parameters", ["effect", "parameter"], ["value"], blank=["description", "unit"])
        acts = _read(folder, "effect_places", ["effect"], PLACE, complete=PLACE)
        alike = _read(folder, "why_places", ["effect", "perturbation", "kind"], ["x", "y", "z", "correlation"])
        by_test = _read(folder, BY_TEST, ["effects"], ["rows", "before", "after", "share"], unique="effects")
        draw = bound(
            why_figure, why, effects=effects, parameters=fitted, by_test=by_test, attempt=attempt
        )  # fmt: skip
        caption = "residual of the model as it is, and change pattern of the effect"
        yield Drawing("why_this_effect", caption, draw, existing(folder, ["why", "why_parameters", BY_TEST]))
        if alike is not None and rest is not None and alike[[*PLACE, "correlation"]].notna().all(axis=1).any():
            draw = bound(alike_figure, alike, rest, effects=effects, acts=acts, attempt=attempt)
            tables = existing(folder, ["why_places", "effect_places"])
            yield Drawing("where_this_effect", "where local changes alter the data as the effect does", draw, tables)
    if effects is not None:
        yield Drawing("ranked_effects", "evidence for each effect", bound(ranked_effects_figure, effects), ("effects",))
    if (path := folder / "confounding.csv").exists():
        signatures = read_square(path, "effect", may_be_empty=True)
        if not signatures.empty:
            draw = bound(draw_confounding, signatures, effects=effects)
            yield Drawing("confounding", "correlation of the effects' change patterns", draw, ("confounding",))


def _read(folder: Folder, name: str, text: list[str], numbers: list[str], **more: Any) -> pd.DataFrame | None:
    """A table; None without the file or without rows in it."""
    path = folder / f"{name}.csv"
    table = read_results(path, text, numbers, may_be_empty=True, **more) if path.exists() else None
    return None if table is None or table.empty else table
