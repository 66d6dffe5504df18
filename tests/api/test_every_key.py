"""Every key of study.toml has its place in Python, with the same default; what a folder alone needs is listed."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import pytest

import calib
from calib.api import arguments
from calib.measurement.frf import MeasuredFRFs
from calib.study import measurement_settings, search_settings, settings, solver_settings
from calib.study.solver import solver_model

FOLDER = (None, "")
"""A key about the files of a folder, the paths among them or the words on its page: Python has the objects."""
CALIBRATE, EXPLAIN = calib.Problem.calibrate, calib.Problem.explain

PLACES: dict[str, dict[str, tuple[Any, str]]] = {
    "StudySettings": {
        **dict.fromkeys(("title", "model_options", "depends_on", "decks", "deck_files", "base"), FOLDER),
        "model": (calib.Problem, "model"),
        "retry": (calib.retrying, "function"),
        "effects": (EXPLAIN, "effects"),
        "with_effects": (calib.Problem.with_effects, "effects"),
        "measurement": (calib.Problem, "tests"),
        "tests": (calib.Problem, "tests"),
        "held_out": (calib.ModalTest, "held_out"),
        "pairing": (calib.ModalTest, "threshold"),
        "adopted": (calib.ParameterSpace.freeze, "values"),
        "parameters": (calib.ParameterSpace, "parameters"),
        "constraints": (calib.ParameterSpace, "constraints"),
        "prior_correlation": (calib.ParameterSpace.correlated, "matrix"),
        "selection": (CALIBRATE, "parameters"),
        "reduction": (CALIBRATE, "reduction"),
        "sensitivity": (calib.Problem.sensitivity, "samples"),
        "calibration": (CALIBRATE, "keys"),
        "robustness": (calib.Fit.robustness, "keys"),
        "pareto": (calib.Fit.pareto, "keys"),
        "explain": (EXPLAIN, "keys"),
        "compute": (CALIBRATE, "executor"),
    },
    "MeasurementSettings": {
        "kind": (calib.read_frfs, "files"),
        "files": (calib.read_modes, "files"),
        **{key: (calib.read_modes, key) for key in ("shapes", "mode_names", "repeats", "std_of", "pooling")},
        **{key: (calib.read_frfs, key) for key in ("sensors", "quantity", "unit", "channels", "variables")},
        **{key: (calib.read_frfs, key) for key in ("length_unit", "estimator", "averages", "synthetic")},
        "band": (MeasuredFRFs.in_band, "low"),
        "lines": (MeasuredFRFs.lines_near_resonances, "widths"),
        "nuisances": (calib.FRFTest, "nuisances"),
        "responses": (calib.read_responses, "path"),
        **{key: (calib.ModalTest, key) for key in ("node_limit", "accuracy", "set_ups", "corrected")},
    },
    "NuisanceSettings": {
        "place": (calib.place_nuisances, "prior_sd"),
        **{key: (calib.channel_nuisances, key) for key in ("gain", "phase", "delay")},
        **{key: (calib.channel_nuisances, key) for key in ("accelerometer", "stinger", "resonance")},
    },
    "HeldOutSettings": {
        "modes": (calib.ModalTest, "held_out"),
        "sensors": (calib.FRFTest, "held_out"),
        "references": (calib.FRFTest, "held_out_references"),
        "bands": (calib.FRFTest, "held_out_bands"),
        "responses": (calib.ResponseTest, "held_out"),
    },
    "PairingSettings": {
        key: (calib.ModalTest, key) for key in ("mode_count", "threshold", "freq_window", "clusters", "override")
    },
    "TestSettings": {  # beside those of [measurement]
        "name": (calib.ModalTest, "name"),
        "set": (calib.ModalTest, "condition"),
        "held_out": (calib.ModalTest, "held_out"),
        "pairing": (calib.ModalTest, "threshold"),
        "model": (calib.Problem.join, "others"),
        "model_options": FOLDER,
        "effects": (EXPLAIN, "effects"),
    },
    "ParameterSettings": {
        "value": (calib.Parameter, "value"),
        "limits": (calib.Parameter, "lower"),
        "search": (calib.ParameterSpace.widen, "limits"),
        **{key: (calib.Parameter, key) for key in ("prior_sd", "scale", "prior", "needed")},
        "fixed": (calib.ParameterSpace.freeze, "values"),
    },
    "AdoptedSettings": {"study": FOLDER, "parameters": (calib.ParameterSpace.freeze, "values")},
    "ConstraintSettings": {
        **{key: (calib.LinearConstraint, key) for key in ("name", "coefficients", "unit")},
        "limits": (calib.LinearConstraint, "lower"),
    },
    "PriorCorrelationSettings": {
        "parameters": (calib.ParameterSpace.correlated, "names"),
        "matrix": (calib.ParameterSpace.correlated, "matrix"),
    },
    "RetrySettings": {key: (calib.retrying, key) for key in ("pattern", "times", "wait")},
    "ComputeSettings": {"executor": (CALIBRATE, "executor")},
    "SolverSettings": {key: (solver_model, key) for key in solver_settings.SolverSettings.model_fields},
    "SolverParameterSettings": {
        **{key: (calib.Parameter, key) for key in ("value", "unit", "prior_sd", "integer")},
        "limits": (calib.Parameter, "lower"),
        "powers": FOLDER,  # `calib import` of a study
    },
    "CaseSettings": {"name": FOLDER, "seed": (CALIBRATE, "cases")},
}
"""Where each key stands in Python: what takes it, and by which argument."""
BY_NAME = {
    "SensitivitySettings": set(inspect.signature(calib.Problem.sensitivity).parameters),
    "RobustnessSettings": set(arguments.RobustnessKeys.__annotations__),
    "ParetoSettings": set(arguments.ParetoKeys.__annotations__),
    # A function in this process cannot be ended; `cases` is an argument of its own.
    "CalibrationSettings": set(arguments.CalibrationKeys.__annotations__) | {"time_limit", "cases"},
    # The finer mesh is a model, not options of one.
    "ExplainSettings": set(arguments.ExplainKeys.__annotations__) | {"finer_options"},
    "ReductionSettings": set(search_settings.ReductionSettings.model_fields),  # a mapping of its keys
}
"""Sections whose keys are arguments of the same names, read into the same settings."""

OTHER_DEFAULTS = {
    ("ParameterSettings", "scale"),  # what the model states
    ("ComputeSettings", "executor"),  # a command has processes of its own, a script this one
}


def sections() -> dict[str, type[measurement_settings.Section]]:
    found: dict[str, type[measurement_settings.Section]] = {}
    for module in (settings, measurement_settings, search_settings, solver_settings):
        for name, one in vars(module).items():
            if isinstance(one, type) and issubclass(one, measurement_settings.Section):
                found[name] = one
    return {name: one for name, one in found.items() if one is not measurement_settings.Section}


def test_every_section_of_a_study_is_looked_at():
    assert set(sections()) == set(PLACES) | set(BY_NAME)


@pytest.mark.parametrize("name", sorted(sections()))
def test_every_key_is_an_argument(name):
    keys = set(sections()[name].model_fields)
    if name in BY_NAME:
        assert keys <= BY_NAME[name], keys - BY_NAME[name]
        return
    if name == "TestSettings":
        keys -= set(measurement_settings.MeasurementSettings.model_fields)
    assert keys == set(PLACES[name])
    for key, (place, argument) in PLACES[name].items():
        if place is not None:
            assert argument in inspect.signature(place).parameters, f"{name}.{key}: {place} takes no {argument}"


@pytest.mark.parametrize("name", sorted(PLACES))
def test_an_argument_of_the_same_name_has_the_same_default(name):
    """Of sections read into settings, `test_without_arguments_the_settings_are_those_of_a_bare_file` tells it."""
    for key, field in sections()[name].model_fields.items():
        place, argument = PLACES[name].get(key, FOLDER)
        if place is None or argument != key or field.is_required():
            continue
        own, given = inspect.signature(place).parameters[key].default, field.get_default(call_default_factory=True)
        if own is inspect.Parameter.empty or isinstance(given, measurement_settings.Section):
            continue  # it must be given; the keys of a section are looked at one by one
        if is_dataclass(place):  # a mapping is made for each object
            (of,) = (one for one in fields(place) if one.name == key)
            own = own if of.default_factory is MISSING else of.default_factory()
        if (name, key) not in OTHER_DEFAULTS:
            assert own == given or not (own or given), (name, key, own, given)  # no names, no files, None


def test_without_arguments_the_settings_are_those_of_a_bare_file():
    bare = settings.StudySettings.model_validate(
        {"title": "Bare", "model": "model.py:model", "measurement": {"responses": "measured.csv"}}
    )
    own = arguments.DEFAULTS
    for found in (
        arguments.calibration_settings(own, {}, None, None, None),
        arguments.explain_settings(own, {}, None),
        arguments.robustness_settings(own, {}),
        arguments.pareto_settings(own, {}),
    ):
        for section in ("calibration", "explain", "reduction", "sensitivity", "robustness", "pareto", "compute"):
            assert getattr(found, section) == getattr(bare, section), section


KEYS = {
    "calibration": {"weight_freq": 2.0, "population": 8, "method": "genetic", "varies": ["k"]},
    "explain": {"alpha": 0.2, "refits": 3, "merge": 0.5, "samples": 4, "seed": 7, "mesh_sd": 0.5},
    "reduction": {"use": False, "tolerance": 1e-4, "seed": 9},
    "robustness": {"samples": 20, "seed": 3, "limits": {"u": [0.0, 1.0]}},
    "pareto": {"population": 8, "generations": 3, "objectives": {"a": ["u"], "b": ["v"]}},
}


@pytest.mark.parametrize("section", KEYS)
def test_arguments_are_read_into_the_settings_that_a_file_is_read_into(section):
    file = {"title": "Bare", "model": "m.py:m", "measurement": {"responses": "u.csv"}, section: KEYS[section]}
    read = getattr(settings.StudySettings.model_validate(file), section)
    own, keys = arguments.DEFAULTS, KEYS[section]
    found = {
        "calibration": lambda: arguments.calibration_settings(own, keys, None, None, None),
        "explain": lambda: arguments.explain_settings(own, keys, None),
        "reduction": lambda: arguments.explain_settings(own, {}, keys),
        "robustness": lambda: arguments.robustness_settings(own, keys),
        "pareto": lambda: arguments.pareto_settings(own, keys),
    }[section]()
    assert getattr(found, section) == read
