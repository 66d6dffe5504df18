"""State behind an analysis: its measurement, model, settings and rules, and the code of calib that computed it.

One rule holds for all results. Other measured data, another model, other settings or other rules make them stale: they
are not shown, and nothing else rests on them. Other code of calib is told beside them. Evaluations in a ledger stay
valid in both cases, since their key holds what their values depend on.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

from calib.correlation import fault_rules as faults
from calib.correlation import rules as comparison
from calib.correlation import standard_deviations
from calib.correlation.mesh_error import GEOMETRY
from calib.hypotheses import rules as analyses
from calib.inference import rules as inference
from calib.measurement import rules as reading
from calib.missing import rules as missing
from calib.problem import degrees_of_freedom, parameter
from calib.results.code_digest import code_digest
from calib.sensitivity import rules as sensitivity
from calib.structure import rules as models
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile

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


ADDED = ("added.json", "added_errors.csv", "added_parameters.csv", "added_modes.csv", "comparison_added.csv",
         "frf_added.csv", "frf_lines_added.csv", "where_it_fails_added.csv")  # fmt: skip
"""Files of `calib.analyses.added`, removed with the calibration or the explanation that they rest on."""
SAMPLES = "posterior_samples"
"""Table of samples of the posterior, which `calib.analyses.robustness` takes up."""
INTERVALS = ("intervals.csv", "profiles.csv", "posterior_intervals.csv", f"{SAMPLES}.csv")
"""Files of `calib.analyses.intervals`, removed with the calibration that they rest on."""
ROBUSTNESS = ("robustness.csv", "robustness_samples.csv")
"""Files of `calib.analyses.robustness`, removed with the calibration or the samples that they rest on."""
PARETO = ("pareto.csv", "pareto_objectives.csv")
"""Files of `calib.analyses.pareto`, removed with the calibration beside which they stand."""
PROPOSED = ("proposals.csv", "proposal_places.csv", "proposals.json")
"""Files of `calib.analyses.propose`, removed with the explanation that they rest on."""
_MEASURES = ("sensitivity", "partial", "variance_share", "selection", "sensitivity_samples", "input_correlation",
             "prognosis", "prognosis_inputs")  # fmt: skip
_CALIBRATED = ("parameters", "points", "errors_by_case", "suspects_calibrated", "verdicts", "posterior_correlation",
               "confounded", "unseen_directions", "predictions", "convergence", "modes", "responses", "data_errors",
               "considered", "unexplained_calibrated", "versions")  # fmt: skip
EXPLAINED = ("effects", "why", "why_parameters", "why_places", "reduction_by_test", "test_differences",
              "effect_places", "accuracy", "accuracy_by_kind", "explained_fits", "suspects_explained", "faults",
              "perturbations", "confounding", "pulls", "candidate_fits", "misfit_kinds", "sensor_misfit",
              "response_misfit", "frf_misfit", "unpaired", "errors", "next_measurement", "test_order", "discretisation",
              "steps", "steps_errors", "steps_rejected", "unexplained", "unexplained_predictions",
              "unexplained_errors", "richer", "richer_errors", "found_places", "versions")  # fmt: skip
WRITES: Mapping[str, tuple[str, ...]] = {
    "compare": (*RECORDED, *GEOMETRY, *_of_stages("before"), "sensor_check.csv", "node_partners.csv",
                "undamped.csv"),
    "sensitivity": (*RECORDED, *(f"{name}.csv" for name in _MEASURES)),
    "refine": (*RECORDED, "proposed_runs.csv", "refined.csv"),
    "sensitivity --method morris": (*RECORDED, "morris.csv"),
    "sensitivity --method sobol": (*RECORDED, "sobol.csv"),
    "calibrate": (
        *RECORDED, *GEOMETRY, *_of_stages("after"), *(f"{kind}_{stage}.csv" for kind in ("model_modes", "deflection")
        for stage in ("initial", "before")), *(f"{name}.csv" for name in _CALIBRATED), "summary.json",
    ),
    "explain": (
        *RECORDED, *GEOMETRY, *(f"{name}.csv" for name in EXPLAINED), "explanation.json", "added.json",
    ),
    "intervals": (*RECORDED, *INTERVALS),
    "robustness": (*RECORDED, *ROBUSTNESS),
    "pareto": (*RECORDED, *PARETO),
    "propose": (*RECORDED, *PROPOSED),
    "extend": (*RECORDED, *ADDED),
}  # fmt: skip
"""All tables that an analysis may write; a shared table belongs to the latest analysis."""


def made_from(study: StudyFile, analysis: str) -> dict[str, Any]:
    """Present state that an analysis would be made from.

    Parameters
    ----------
    study : StudyFile
        With its code run (`calib.study.study.LoadedStudy`, `calib.study.several.JointStudy`) or only read.
    analysis : str
        One of `WRITES`.

    Returns
    -------
    dict
        Digests of ``measurement``, ``rules`` and ``stated``, the entries on model and settings in the study's file;
        ``files``: digests of all files that it names and of its code, by path; ``sources``: those of them that decide
        on the model of this analysis. Only where the code was run: digests of ``model`` and, for an analysis that uses
        them, ``effects``; ``taken``: values adopted from an earlier study.
    """
    tests: tuple[LoadedStudy, ...] = getattr(study, "studies", ())
    files = {name: digest for one in tests for name, digest in one.read_files.items()} if tests else study.file_digests
    state = {
        "measurement": _measured(study, analysis),
        "rules": _digest(rules_of(analysis)),
        "stated": _stated(study, analysis),
        "files": dict(files),
        "sources": _sources(study, analysis, files),
    }
    if not tests:
        return state
    built = [_digest(one.problem.model_fingerprint, one.model.space, one.settings.with_effects) for one in tests]
    adopted, values = study.settings.adopted, tests[0].adopted
    state["model"] = built[0] if len(built) == 1 else _digest(*built)
    state["taken"] = {} if adopted is None else {name: values.get(name) for name in adopted.parameters}
    if _uses_effects(analysis):
        state["effects"] = _digest(*map(_effects, tests))
    return state


def _sources(study: StudyFile, analysis: str, files: Mapping[str, str]) -> list[str]:
    """Files of code, and others that decide on the model; without effects where the analysis uses none."""
    given = study.settings
    of_effects = {function.rpartition(":")[0] for function in given.libraries}
    unused = set() if given.with_effects or _uses_effects(analysis) else of_effects
    return [name for name in files if (name.endswith(".py") or name in given.model_files) and name not in unused]


def _effects(study: LoadedStudy) -> str:
    """Digest of all effects that an explanation may test, and of what is known of adopted values."""
    known = [(e.name, e.parameters, e.grid) for e in study.library]
    return _digest(known, study.library_digest, study.adopted_sd)


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
    if not study.test or _verb(analysis) not in _TOGETHER:
        return own
    whole = StudyFile.read(study.file)
    tests = [test.model_dump(exclude=_NAMES_OF_FILES) for test in whole.settings.tests]
    return _digest(own, measurement_digest(whole), tests)


_TOGETHER = ("calibrate", "intervals", "robustness", "pareto", "explain", "extend")
"""Analyses of all tests together."""


def state_differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Differences between two states, in words; empty where they are equal.

    Files of code stand for model and effects where the code was not run.
    """
    old, new = then.get("files", {}), now["files"]
    files = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    code = [name for name in files if name in {*then.get("sources", ()), *now["sources"]}]
    parts = {part for part in ("measurement", "model", "effects", "selected", "rules") if _differs(part, then, now)}
    stated = {part for part in now["stated"] if _differs(part, then.get("stated", {}), now["stated"])}
    measurement = "measurement" in parts
    model = "model" in parts or "model" in stated or ("model" not in now and code)
    taken = "taken" in now and not agree(then.get("taken", {}), now["taken"])
    out = files if measurement else code if model else []
    out = [*out, *["the values adopted from another study"] * taken]
    if (measurement or model) and not out:
        out = ["the measurement" if measurement else "the model or its parameters"]
    settings = "settings" in stated or {"effects", "selected"} & parts
    return [*out, *["the settings in the study file"] * bool(settings), *["the rules of calib"] * ("rules" in parts)]


def _differs(part: str, then: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    """Whether a part that is known now was another one."""
    return part in now and then.get(part) != now[part]


def agree(taken: Mapping[str, float], values: Mapping[str, float]) -> bool:
    """Whether adopted values are equal to the ten digits that tables keep."""
    return all(math.isclose(values[name], taken[name], rel_tol=1e-9) for name in {*taken} & {*values})


_MODEL = ("model", "model_options", "with_effects", "adopted", "parameters", "constraints", "tests")
_OF_CALIBRATION = ("pairing", "selection", "calibration", "reduction")
_OF_EXPLANATION = (*_OF_CALIBRATION, "explain", "effects")
_STATED: Mapping[str, tuple[str, ...]] = {
    "compare": ("pairing",),
    "sensitivity": ("pairing", "sensitivity"),
    "refine": ("pairing", "sensitivity"),
    "calibrate": _OF_CALIBRATION,
    "intervals": _OF_CALIBRATION,
    "robustness": (*_OF_CALIBRATION, "robustness"),
    "pareto": (*_OF_CALIBRATION, "pareto"),
    "explain": _OF_EXPLANATION,
    "propose": _OF_EXPLANATION,
    "extend": _OF_EXPLANATION,
}
"""Keys of a study's file that an analysis depends on beside those of its model."""


def _stated(study: StudyFile, analysis: str) -> dict[str, str]:
    """Digests of the entries of a study's file on its model, and on everything else that an analysis depends on."""
    given = study.settings.model_dump()
    parts = {"model": _MODEL, "settings": _STATED[_verb(analysis)]}
    file = study.settings.calibration.start_file
    content = [study.file_digests.get(file)] if file and "calibration" in parts["settings"] else []
    beside = {"model": [], "settings": content}
    return {part: _digest(*(given[key] for key in keys), *beside[part]) for part, keys in parts.items()}


def _uses_effects(analysis: str) -> bool:
    return "effects" in _STATED[_verb(analysis)]


def _verb(analysis: str) -> str:
    """An analysis without its method."""
    return analysis.partition(" ")[0]


def _digest(*things: Any) -> str:
    return hashlib.sha256(json.dumps([repr(thing) for thing in things]).encode()).hexdigest()[:16]


# -- rules and code of calib -------------------------------------------------------------------------------------------

_COMPARED = ("reading", "degrees_of_freedom", "floors", "comparison")
# A calibration tests its fit, single data and held-out data as an explanation does.
_FITTED = (*_COMPARED, "faults", "models", "limits", "inference", "missing", "analyses")
_USED: Mapping[str, tuple[str, ...]] = {
    "compare": (*_COMPARED, "analyses"),
    "sensitivity": (*_COMPARED, "sensitivity", "prognosis"),
    "refine": (*_COMPARED, "sensitivity", "prognosis"),
    "calibrate": _FITTED,
    "intervals": _FITTED,
    "robustness": _FITTED,
    "pareto": _FITTED,
    "explain": _FITTED,
    "propose": _FITTED,
    "extend": _FITTED,
}


def every_rule() -> dict[str, Any]:
    """All objects of rules in force, frozen dataclasses, by the name that `record.json` has for them."""
    return {
        "reading": reading.RULES,
        "degrees_of_freedom": degrees_of_freedom.RULES,
        "floors": standard_deviations.USUAL,
        "comparison": comparison.RULES,
        "faults": faults.RULES,
        "models": models.RULES,
        "sensitivity": sensitivity.RULES,
        "prognosis": sensitivity.PROGNOSIS,
        "limits": parameter.RULES,
        "inference": inference.RULES,
        "analyses": analyses.RULES,
        "missing": missing.RULES,
    }


def rules_of(analysis: str) -> dict[str, Any]:
    """Rules that an analysis depends on, by name.

    Parameters
    ----------
    analysis : str
        One of `WRITES`.
    """
    every = every_rule()
    return {name: every[name] for name in _USED[_verb(analysis)]}


_MODULES: Mapping[str, tuple[str, ...]] = {
    "compare": ("calib.analyses.compare",),
    "sensitivity": ("calib.analyses.sensitivity", "calib.analyses.screening"),
    "refine": ("calib.analyses.refine",),
    "calibrate": ("calib.analyses.calibrate",),
    "intervals": ("calib.analyses.intervals",),
    "robustness": ("calib.analyses.robustness",),
    "pareto": ("calib.analyses.pareto",),
    "explain": ("calib.analyses.explain",),
    "propose": ("calib.analyses.propose",),
    "extend": ("calib.analyses.extend", "calib.analyses.added"),
}


def code_of(analysis: str) -> str:
    """Digest of the code of calib that an analysis runs.

    Rules count by themselves, and what compares states decides no result.
    """
    of_rules = {name for rules in every_rule().values() if (name := type(rules).__module__).endswith("rules")}
    return code_digest(*_MODULES[_verb(analysis)], apart={__name__, f"{__package__}.stale", *of_rules})
