"""State behind an analysis, as digests of measurement, model and settings, and the version of calib."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from calib.analyses.provenance.recorded_rules import rules_of
from calib.results.version import __version__
from calib.study.several import AnyStudy
from calib.study.study import Study
from calib.study.study_file import StudyFile

PARTS = ("measurement", "model", "settings", "rules", "code")
"""Parts of the state of an analysis; ``files`` beside them names what changed in the first two."""

_NAMES_OF_FILES = {"files", "shapes", "sensors", "responses"}

RECORDED = ("measured.csv", "sensors.csv", "repeat_disagreements.csv", "assumptions.csv", "parameter_space.csv")
"""Tables that every analysis overwrites."""


ORTHOGONALITY = ("cross_orthogonality", "self_orthogonality", "expansion", "expanded_shapes")
"""Tables of `calib.correlation.modal.expansion`, without their stage."""


def _of_stages(*stages: str) -> tuple[str, ...]:
    kinds = (
        "comparison", "frf", "frf_lines", "where_it_fails", "mac", "comac", "shapes", "model_modes", "deflection",
        *ORTHOGONALITY,
    )  # fmt: skip
    return tuple(f"{kind}_{stage}.csv" for kind in kinds for stage in stages)


GEOMETRY = ("mesh_points.csv", "mesh_elements.csv", "model_places.csv")
"""Files of `calib.correlation.mesh_error.geometry_tables`."""
ADDED = ("added.json", "added_errors.csv", "added_parameters.csv", "added_modes.csv", "comparison_added.csv",
         "frf_added.csv", "frf_lines_added.csv", "where_it_fails_added.csv")  # fmt: skip
"""Files of `calib.analyses.added`, removed with the calibration or the explanation that they rest on."""
PROPOSED = ("proposals.csv", "proposal_places.csv", "proposals.json")
"""Files of `calib.analyses.propose`, removed with the explanation that they rest on."""
_MEASURES = ("sensitivity", "partial", "variance_share", "selection", "sensitivity_samples", "input_correlation")
_CALIBRATED = ("parameters", "points", "suspects_calibrated", "verdicts", "posterior_correlation", "confounded",
               "unseen_directions", "predictions", "convergence", "modes", "responses", "data_errors",
               "versions")  # fmt: skip
EXPLAINED = ("effects", "why", "why_parameters", "why_places", "reduction_by_test", "test_differences",
              "effect_places", "accuracy", "explained_fits", "suspects_explained", "faults", "perturbations",
              "confounding", "pulls", "candidate_fits", "misfit_kinds", "sensor_misfit", "response_misfit",
              "frf_misfit", "unpaired", "errors", "next_measurement", "discretisation",
              "steps", "steps_errors", "steps_rejected", "unexplained", "unexplained_predictions",
              "unexplained_errors", "richer", "richer_errors", "found_places", "versions")  # fmt: skip
WRITES: Mapping[str, tuple[str, ...]] = {
    "compare": (*RECORDED, *GEOMETRY, *_of_stages("before"), "sensor_check.csv"),
    "sensitivity": (*RECORDED, *(f"{name}.csv" for name in _MEASURES)),
    "sensitivity --method morris": (*RECORDED, "morris.csv"),
    "sensitivity --method sobol": (*RECORDED, "sobol.csv"),
    "calibrate": (
        *RECORDED, *GEOMETRY, *_of_stages("after"), *(f"{kind}_{stage}.csv" for kind in ("model_modes", "deflection")
        for stage in ("initial", "before")), *(f"{name}.csv" for name in _CALIBRATED), "summary.json",
    ),
    "explain": (
        *RECORDED, *GEOMETRY, *(f"{name}.csv" for name in EXPLAINED), "explanation.json", "added.json",
    ),
    "propose": (*RECORDED, *PROPOSED),
    "extend": (*RECORDED, *ADDED),
}  # fmt: skip
"""All tables that an analysis may write; a shared table belongs to the latest analysis."""


def made_from(study: AnyStudy, analysis: str) -> dict[str, Any]:
    """Present state that an analysis would be made from.

    Parameters
    ----------
    study : Study or JointStudy
        With the selection of the analysis.
    analysis : str
        One of `WRITES`.

    Returns
    -------
    dict
        A digest for each of `PARTS` (of ``code`` the version); ``files``: digests of the files that the study names,
        except its own, by their paths as written there; ``stated``: digests of the entries on model and settings in
        its own file; ``selected``: the parameters of the search; ``taken``: values adopted from an earlier study. The
        last three are available without running the study's code (see `made_from_on_paper`).
    """
    models, settings = [], []
    for one in study.studies:
        problem, given = one.problem, one.settings
        models.append(_digest(problem.model_fingerprint, one.model.space, given.with_effects))
        settings.append(_digest(given.pairing.model_dump(), *_SETTINGS[analysis.partition(" ")[0]](one)))
    adopted = study.settings.adopted
    return {
        "measurement": _measured(study, analysis),
        "model": models[0] if len(models) == 1 else _digest(*models),
        "settings": settings[0] if len(settings) == 1 else _digest(*settings),
        "rules": _digest(rules_of(analysis)),
        "code": __version__,
        "files": {name: digest for one in study.studies for name, digest in one.read_files.items()},
        "stated": _stated(study, analysis),
        "selected": list(study.search_space.free_names),
        "taken": {} if adopted is None else {name: study.adopted.get(name) for name in adopted.parameters},
    }


def made_from_on_paper(
    study: StudyFile,
    analysis: str,
    then: Mapping[str, Any],
    selected: Sequence[str] | None,
    found: Sequence[Mapping[str, float]] = (),
) -> dict[str, Any]:
    """Present state that an analysis would be made from, determined without running the study's code.

    The recorded digests of model and settings are kept as long as the code files, the entries of the study's file, the
    selection, and the adopted values are unchanged. Other changes outside the study's folder are not detected.

    Parameters
    ----------
    study : StudyFile
    analysis : str
    then : mapping
        The recorded state; see `made_from`.
    selected : sequence of str or None
        Present selection of the sensitivity analysis; None where the study names its selection, or there is none.
    found : sequence of mapping from parameter name to value
        Present results of the earlier study, any of which may be adopted; empty without any.
    """
    files, stated = dict(study.file_digests), _stated(study, analysis)
    old, said = then.get("files", {}), then.get("stated", {})
    needed = study.settings.depends_on
    code = [n for n in {**old, **files} if (n.endswith(".py") or n in needed) and old.get(n) != files.get(n)]
    of_effects = {function.rpartition(":")[0] for function in study.settings.libraries}
    uses_effects = analysis in ("explain", "propose", "extend")
    of_model = [name for name in code if name not in of_effects or study.settings.with_effects]
    taken = then.get("taken", {})
    same_values = not found or any(_agree(taken, values) for values in found)
    same_model = not of_model and said.get("model") == stated["model"] and same_values
    same_settings = said.get("settings") == stated["settings"] and not (uses_effects and code)
    if analysis == "calibrate" and selected is not None:
        same_settings = same_settings and sorted(then.get("selected", ())) == sorted(selected)
    return {
        "measurement": _measured(study, analysis),
        "model": then.get("model") if same_model else "changed",
        "settings": then.get("settings") if same_settings else "changed",
        "rules": _digest(rules_of(analysis)),
        "code": __version__,
        "files": files,
        "taken": taken if same_values else {**taken, **found[0]},
    }


def _agree(taken: Mapping[str, float], values: Mapping[str, float]) -> bool:
    """Whether values are equal to the ten digits that tables keep."""
    return all(math.isclose(values[name], taken[name], rel_tol=1e-9) for name in {*taken} & {*values})


def measurement_digest(study: StudyFile) -> str:
    """Digest of all measured data, and of which are held out."""
    if study.settings.several:
        return _digest(*(measurement_digest(part) for part in study.parts))
    whole = study.measurement()
    data = {k: v for k, v in study.settings.measurement.model_dump().items() if k not in _NAMES_OF_FILES}
    return _digest(whole.content, data, study.settings.held_out.model_dump())


def _measured(study: StudyFile, analysis: str) -> str:
    """Digest of the data behind an analysis: for one of several tests fitted together, those of all tests."""
    own = measurement_digest(study)
    if not study.test or analysis.partition(" ")[0] not in _TOGETHER:
        return own
    whole = StudyFile.read(study.file)
    tests = [test.model_dump(exclude=_NAMES_OF_FILES) for test in whole.settings.tests]
    return _digest(own, measurement_digest(whole), tests)


_TOGETHER = ("calibrate", "explain", "extend")
"""Analyses of all tests together."""


def changed(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences between two states, in words; empty where they are equal."""
    parts = [part for part in PARTS if then.get(part) != now.get(part)]
    old, new = then.get("files", {}), now["files"]
    files = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    out = [name for name in files if {"measurement", "model"} & set(parts)]
    if then.get("taken", {}) != now["taken"]:
        out.append("the values adopted from another study")
    if {"measurement", "model"} & set(parts) and not out:
        out.append("the measurement" if "measurement" in parts else "the model or its parameters")
    out += ["the settings in the study file"] * ("settings" in parts)
    out += ["the rules of calib"] * ("rules" in parts)
    return out + [f"calib itself ({then.get('code', 'unknown')}, now {now['code']})"] * ("code" in parts)


def _stated(study: StudyFile, analysis: str) -> dict[str, str]:
    """Digests of the entries of a study's file on its model, and on everything else that an analysis depends on."""
    given = study.settings.model_dump()
    sections = _STATED[analysis.partition(" ")[0]]
    return {part: _digest(*(given[key] for key in keys)) for part, keys in (("model", _MODEL), ("settings", sections))}


def _of_calibration(study: Study) -> tuple[Any, ...]:
    given = study.settings
    return (
        study.search_space, given.calibration.model_dump(), given.reduction.model_dump(), study.adopted_sd,
    )  # fmt: skip


def _of_explanation(study: Study) -> tuple[Any, ...]:
    effects = [(e.name, e.parameters, e.grid) for e in study.library]
    own = [digest for name, digest in study.read_files.items() if name.endswith(".py")]
    return (*_of_calibration(study), study.settings.explain.model_dump(), effects, study.library_digest, own)


_SETTINGS: Mapping[str, Callable[[Study], tuple[Any, ...]]] = {
    "compare": lambda study: (),
    "sensitivity": lambda study: (study.sensitivity_space, study.settings.sensitivity.model_dump()),
    "calibrate": _of_calibration,
    "explain": _of_explanation,
    "propose": _of_explanation,
    "extend": _of_explanation,
}


_MODEL = ("model", "model_options", "with_effects", "adopted", "parameters", "constraints", "tests")
_STATED_OF_CALIBRATION = ("pairing", "selection", "calibration", "reduction")
_STATED: Mapping[str, tuple[str, ...]] = {
    "compare": ("pairing",),
    "sensitivity": ("pairing", "sensitivity"),
    "calibrate": _STATED_OF_CALIBRATION,
    "explain": (*_STATED_OF_CALIBRATION, "explain", "effects"),
    "propose": (*_STATED_OF_CALIBRATION, "explain", "effects"),
    "extend": (*_STATED_OF_CALIBRATION, "explain", "effects"),
}
"""Keys of the study's file that replace `_SETTINGS` where no code is run."""


def _digest(*things: Any) -> str:
    return hashlib.sha256(json.dumps([repr(thing) for thing in things]).encode()).hexdigest()[:16]
