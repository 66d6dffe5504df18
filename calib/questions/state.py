"""What an answer was made from, in digests: measurement, model, settings and the version of calib."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from calib.correlation.problem import ModalProblem
from calib.inference import rules as inference
from calib.missing import rules as missing
from calib.several import AnyStudy
from calib.study import Study
from calib.study_file import StudyFile
from calib.version import __version__

PARTS = ("measurement", "model", "settings", "code")
"""Of which an answer is made; ``files`` beside them tells what has changed in the first two."""

_NAMES_OF_FILES = {"files", "shapes", "sensors", "responses"}

RECORDED = ("measured.csv", "sensors.csv", "repeat_disagreements.csv", "assumptions.csv", "parameter_space.csv")
"""What every question writes anew."""


def _of_stages(*stages: str) -> tuple[str, ...]:
    kinds = ("comparison", "where_it_fails", "mac", "comac", "shapes", "model_modes", "deflection")
    return tuple(f"{kind}_{stage}.csv" for kind in kinds for stage in stages)


_MESH = ("mesh_points.csv", "mesh_elements.csv")
ADDED = ("added.json", "added_errors.csv", "added_parameters.csv", "added_modes.csv")
"""What `calib.questions.added` tells; it rests on a calibration and an explanation and ends with either."""
_MEASURES = ("sensitivity", "partial", "influence", "selection", "sensitivity_samples", "input_correlation")
_CALIBRATED = ("parameters", "points", "suspects_calibrated", "verdicts", "confounded", "unseen_directions",
               "predictions", "convergence", "modes", "responses", "data_errors", "versions")  # fmt: skip
_EXPLAINED = ("effects", "accuracy", "explained_fits", "suspects_explained", "atoms", "confounding", "strain", "tried",
              "misfit_kinds", "sensor_misfit", "response_misfit", "unpaired", "errors", "next_measurement",
              "discretisation", "versions")  # fmt: skip
WRITES: Mapping[str, tuple[str, ...]] = {
    "compare": (*RECORDED, *_MESH, *_of_stages("before"), "sensor_check.csv"),
    "sensitivity": (*RECORDED, *(f"{name}.csv" for name in _MEASURES)),
    "sensitivity --method morris": (*RECORDED, "morris.csv"),
    "sensitivity --method sobol": (*RECORDED, "sobol.csv"),
    "calibrate": (
        *RECORDED, *_MESH, *_of_stages("after"), *(f"{kind}_{stage}.csv" for kind in ("model_modes", "deflection")
        for stage in ("initial", "before")), *(f"{name}.csv" for name in _CALIBRATED), "summary.json",
    ),
    "explain": (
        *RECORDED, *_MESH, *(f"{name}.csv" for name in _EXPLAINED), "explanation.json", "added.json",
    ),
    "extend": (*RECORDED, *ADDED),
}  # fmt: skip
"""Every table that a question may write; the one that was asked last has written it."""


def made_from(study: AnyStudy, question: str) -> dict[str, Any]:
    """What an answer would be made from now.

    Parameters
    ----------
    study : Study or JointStudy
        With the selection that the question is asked with.
    question : str
        One of `WRITES`.

    Returns
    -------
    dict
        A digest for each of `PARTS` (of ``code`` the version); ``files``: digests of the files that the study names,
        its own apart, by their paths as the study writes them; ``stated``: digests of what its own file says of model
        and settings, ``selected``: the parameters of the search, and ``taken``: values that an earlier study has
        found. The last three are all that can be told without running the study's code (see `made_from_on_paper`).
    """
    models, settings = [], []
    for one in study.studies:
        problem, given = one.problem, one.settings
        model = problem.model.fingerprint if isinstance(problem, ModalProblem) else problem.fingerprint
        models.append(_digest(model, one.model.space, given.with_effects))
        settings.append(_digest(given.pairing.model_dump(), *_SETTINGS[question.partition(" ")[0]](one)))
    adopted = study.settings.adopted
    return {
        "measurement": _measured(study, question),
        "model": models[0] if len(models) == 1 else _digest(*models),
        "settings": settings[0] if len(settings) == 1 else _digest(*settings),
        "code": __version__,
        "files": {name: digest for one in study.studies for name, digest in one.read_files.items()},
        "stated": _stated(study, question),
        "selected": list(study.search_space.free_names),
        "taken": {} if adopted is None else {name: study.adopted.get(name) for name in adopted.parameters},
    }


def made_from_on_paper(
    study: StudyFile,
    question: str,
    then: Mapping[str, Any],
    selected: Sequence[str] | None,
    found: Sequence[Mapping[str, float]] = (),
) -> dict[str, Any]:
    """What an answer would be made from now, as far as it can be told without running the study's code.

    The digests of model and settings that an answer has are taken as they are as long as the files with code, what
    the study's file says, the selection, and the values taken over from an earlier study are the same. Of a change
    outside the study's folder nothing else is seen.

    Parameters
    ----------
    study : StudyFile
    question : str
    then : mapping
        What the answer was made from: see `made_from`.
    selected : sequence of str or None
        What the sensitivity analysis selects now; None where the study names its selection, or nothing is known.
    found : sequence of mapping from parameter name to value
        What the earlier study's answers hold now, any of which may be taken over; empty where there is none.
    """
    files, stated = dict(study.file_digests), _stated(study, question)
    old, said = then.get("files", {}), then.get("stated", {})
    needed = study.settings.depends_on
    code = [n for n in {**old, **files} if (n.endswith(".py") or n in needed) and old.get(n) != files.get(n)]
    of_effects = (study.settings.effects or "").rpartition(":")[0]
    asks_effects = question in ("explain", "extend")
    of_model = [name for name in code if name != of_effects or study.settings.with_effects]
    taken = then.get("taken", {})
    same_values = not found or any(_agree(taken, values) for values in found)
    same_model = not of_model and said.get("model") == stated["model"] and same_values
    same_settings = said.get("settings") == stated["settings"] and not (asks_effects and code)
    if question == "calibrate" and selected is not None:
        same_settings = same_settings and sorted(then.get("selected", ())) == sorted(selected)
    return {
        "measurement": _measured(study, question),
        "model": then.get("model") if same_model else "changed",
        "settings": then.get("settings") if same_settings else "changed",
        "code": __version__,
        "files": files,
        "taken": taken if same_values else {**taken, **found[0]},
    }


def _agree(taken: Mapping[str, float], values: Mapping[str, float]) -> bool:
    """Whether values are the same, as far as tables tell that keep ten digits."""
    return all(math.isclose(values[name], taken[name], rel_tol=1e-9) for name in {*taken} & {*values})


def measurement_digest(study: StudyFile) -> str:
    """Digest of everything that was measured, and of what is withheld."""
    if study.settings.several:
        return _digest(*(measurement_digest(part) for part in study.parts))
    whole, responses = study.measurement()
    data = {k: v for k, v in study.settings.measurement.model_dump().items() if k not in _NAMES_OF_FILES}
    targets = {} if responses is None else responses.targets
    measured = sorted(targets.items()) if whole is None else whole.fingerprint
    return _digest(measured, data, study.settings.withheld.model_dump())


def _measured(study: StudyFile, question: str) -> str:
    """Digest of what a question rests on: of one of several tests that are fitted together all the others too."""
    own = measurement_digest(study)
    if not study.test or question.partition(" ")[0] not in _TOGETHER:
        return own
    whole = StudyFile.read(study.file)
    tests = [test.model_dump(exclude=_NAMES_OF_FILES) for test in whole.settings.tests]
    return _digest(own, measurement_digest(whole), tests)


_TOGETHER = ("calibrate", "explain", "extend")
"""Questions that are asked of all tests together."""


def changed(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two of these, in words; nothing where both are of one state."""
    parts = [part for part in PARTS if then.get(part) != now.get(part)]
    old, new = then.get("files", {}), now["files"]
    files = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    out = [name for name in files if {"measurement", "model"} & set(parts)]
    if then.get("taken", {}) != now["taken"]:
        out.append("the values that it takes over from another study")
    if {"measurement", "model"} & set(parts) and not out:
        out.append("the measurement" if "measurement" in parts else "the model or its parameters")
    out += ["the settings in the study file"] * ("settings" in parts)
    return out + [f"calib itself ({then.get('code', 'unknown')}, now {now['code']})"] * ("code" in parts)


def _stated(study: StudyFile, question: str) -> dict[str, str]:
    """Digests of what a study's file says of its model, and of all else that a question depends on."""
    given = study.settings.model_dump()
    sections = _STATED[question.partition(" ")[0]]
    return {part: _digest(*(given[key] for key in keys)) for part, keys in (("model", _MODEL), ("settings", sections))}


def _of_calibration(study: Study) -> tuple[Any, ...]:
    given = study.settings
    return (
        study.search_space, given.calibration.model_dump(), given.reduction.model_dump(), study.adopted_sd,
        inference.RULES,
    )  # fmt: skip


def _of_explanation(study: Study) -> tuple[Any, ...]:
    effects = [(e.name, e.parameters, e.grid) for e in study.library]
    own = [digest for name, digest in study.read_files.items() if name.endswith(".py")]
    return (*_of_calibration(study), study.settings.explain.model_dump(), effects, study.library_digest, own,
            missing.RULES)  # fmt: skip


_SETTINGS: Mapping[str, Callable[[Study], tuple[Any, ...]]] = {
    "compare": lambda study: (),
    "sensitivity": lambda study: (study.sensitivity_space, study.settings.sensitivity.model_dump()),
    "calibrate": _of_calibration,
    "explain": _of_explanation,
    "extend": _of_explanation,
}


_MODEL = ("model", "model_options", "with_effects", "adopted", "parameters", "constraints", "tests")
_STATED_OF_CALIBRATION = ("pairing", "selection", "calibration", "reduction")
_STATED: Mapping[str, tuple[str, ...]] = {
    "compare": ("pairing",),
    "sensitivity": ("pairing", "sensitivity"),
    "calibrate": _STATED_OF_CALIBRATION,
    "explain": (*_STATED_OF_CALIBRATION, "explain", "effects"),
    "extend": (*_STATED_OF_CALIBRATION, "explain", "effects"),
}
"""Keys of the study's file that stand for `_SETTINGS` where no code is run."""


def _digest(*things: Any) -> str:
    return hashlib.sha256(json.dumps([repr(thing) for thing in things]).encode()).hexdigest()[:16]
