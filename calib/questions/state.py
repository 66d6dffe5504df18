"""What an answer was made from, in digests: measurement, model, settings and the version of calib."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any

from calib import __version__
from calib.correlation.problem import ModalProblem
from calib.study import Study

PARTS = ("measurement", "model", "settings", "code")
"""Of which an answer is made; ``files`` beside them tells what has changed in the first two."""

_NAMES_OF_FILES = {"files", "shapes", "sensors", "responses"}

RECORDED = ("measured.csv", "sensors.csv", "repeat_disagreements.csv", "assumptions.csv", "parameter_space.csv")
"""What every question writes anew."""


def _of_stages(*stages: str) -> tuple[str, ...]:
    kinds = ("comparison", "where_it_fails", "mac", "comac", "shapes", "model_modes", "deflection")
    return tuple(f"{kind}_{stage}.csv" for kind in kinds for stage in stages)


_MESH = ("mesh_points.csv", "mesh_elements.csv")
_ADDED = ("added.json", "added_errors.csv", "added_parameters.csv", "added_modes.csv")
_MEASURES = ("sensitivity", "partial", "influence", "selection", "sensitivity_samples", "input_correlation")
_CALIBRATED = ("parameters", "verdicts", "confounded", "unseen_directions", "predictions", "convergence", "modes",
               "responses", "data_errors", "versions")  # fmt: skip
_EXPLAINED = ("effects", "atoms", "confounding", "strain", "tried", "misfit_kinds", "sensor_misfit", "response_misfit",
              "unpaired", "errors", "next_measurement", "discretisation", "versions")  # fmt: skip
WRITES: Mapping[str, tuple[str, ...]] = {
    "compare": (*RECORDED, *_MESH, *_of_stages("before"), "sensor_check.csv"),
    "sensitivity": (*RECORDED, *(f"{name}.csv" for name in _MEASURES)),
    "sensitivity --method morris": (*RECORDED, "morris.csv"),
    "sensitivity --method sobol": (*RECORDED, "sobol.csv"),
    "calibrate": (
        *RECORDED, *_MESH, *_of_stages("after"), *(f"{kind}_{stage}.csv" for kind in ("model_modes", "deflection")
        for stage in ("initial", "before")), *(f"{name}.csv" for name in _CALIBRATED), "summary.json",
    ),
    "explain": (*RECORDED, *(f"{name}.csv" for name in _EXPLAINED), "explanation.json", "added.json"),
    "extend": (*RECORDED, *_ADDED),
}  # fmt: skip
"""Every table that a question may write; the one that was asked last has written it."""


def made_from(study: Study, question: str) -> dict[str, Any]:
    """What an answer would be made from now.

    Parameters
    ----------
    study : Study
        With the selection that the question is asked with.
    question : str
        One of `WRITES`.

    Returns
    -------
    dict
        A digest for each of `PARTS` (of ``code`` the version), and ``files``: digests of the files that the study
        names, its own apart, by their paths as the study writes them.
    """
    given, problem = study.settings, study.problem
    data = {k: v for k, v in given.measurement.model_dump().items() if k not in _NAMES_OF_FILES}
    measured = study.whole.fingerprint if study.whole is not None else sorted(study.whole_targets.items())
    model = problem.model.fingerprint if isinstance(problem, ModalProblem) else problem.fingerprint
    return {
        "measurement": _digest(measured, data, given.withheld.model_dump()),
        "model": _digest(model, study.model.space, given.with_effects),
        "settings": _digest(given.pairing.model_dump(), *_SETTINGS[question.partition(" ")[0]](study)),
        "code": __version__,
        "files": {name: hashlib.sha256(path.read_bytes()).hexdigest()[:16] for name, path in study.named_files.items()},
    }


def changed(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two of these, in words; nothing where both are of one state."""
    parts = [part for part in PARTS if then.get(part) != now.get(part)]
    old, new = then.get("files", {}), now["files"]
    files = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    out = [name for name in files if {"measurement", "model"} & set(parts)]
    if {"measurement", "model"} & set(parts) and not out:
        out.append("the measurement" if "measurement" in parts else "the model or its parameters")
    out += ["the settings in the study file"] * ("settings" in parts)
    return out + [f"calib itself ({then.get('code', 'unknown')}, now {now['code']})"] * ("code" in parts)


def _of_calibration(study: Study) -> tuple[Any, ...]:
    given = study.settings
    return study.search_space, given.calibration.model_dump(), given.reduction.model_dump(), study.adopted_sd


def _of_explanation(study: Study) -> tuple[Any, ...]:
    effects = [(e.name, e.parameters, e.grid) for e in study.library]
    own = [digest for name, digest in _code(study).items()]
    return (*_of_calibration(study), study.settings.explain.model_dump(), effects, own)


def _code(study: Study) -> dict[str, str]:
    files = {name: path for name, path in study.named_files.items() if path.suffix == ".py"}
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}


_SETTINGS: Mapping[str, Callable[[Study], tuple[Any, ...]]] = {
    "compare": lambda study: (),
    "sensitivity": lambda study: (study.sensitivity_space, study.settings.sensitivity.model_dump()),
    "calibrate": _of_calibration,
    "explain": _of_explanation,
    "extend": _of_explanation,
}


def _digest(*things: Any) -> str:
    return hashlib.sha256(json.dumps([repr(thing) for thing in things]).encode()).hexdigest()[:16]
