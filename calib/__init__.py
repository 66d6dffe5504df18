"""Calibration workbench for structural-dynamics models."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from calib.results.version import __version__

if TYPE_CHECKING:
    from calib.api.display import Compared as Compared
    from calib.api.explained import Explained as Explained
    from calib.api.fit import Fit as Fit
    from calib.api.problem import Problem as Problem
    from calib.api.sensitivity import Assessed as Assessed
    from calib.api.study import Study as Study
    from calib.errors.errors import EvaluationError as EvaluationError
    from calib.errors.errors import InputError as InputError
    from calib.experiment.frf import FRFTest as FRFTest
    from calib.experiment.modal import ModalTest as ModalTest
    from calib.experiment.response import ResponseTest as ResponseTest
    from calib.measurement.arrays import modes as modes
    from calib.measurement.files.read import read_modes as read_modes
    from calib.measurement.files.read_frf import read_frfs as read_frfs
    from calib.measurement.modal import MeasuredModes as MeasuredModes
    from calib.measurement.modal import Sensor as Sensor
    from calib.measurement.responses import read_responses as read_responses
    from calib.modal_analysis.identify import modes_from_frfs as modes_from_frfs
    from calib.problem.effect import Effect as Effect
    from calib.problem.space import LinearConstraint as LinearConstraint
    from calib.problem.space import Parameter as Parameter
    from calib.problem.space import ParameterSpace as ParameterSpace
    from calib.structure.function_model import FunctionModel as FunctionModel
    from calib.structure.modal_function import ModalFunctionModel as ModalFunctionModel
    from calib.structure.model import StructuralModel as StructuralModel


_PLACES = {
    "Assessed": "api.sensitivity",
    "Compared": "api.display",
    "Effect": "problem.effect",
    "EvaluationError": "errors.errors",
    "Explained": "api.explained",
    "FRFTest": "experiment.frf",
    "Fit": "api.fit",
    "FunctionModel": "structure.function_model",
    "InputError": "errors.errors",
    "LinearConstraint": "problem.space",
    "MeasuredModes": "measurement.modal",
    "ModalFunctionModel": "structure.modal_function",
    "ModalTest": "experiment.modal",
    "Parameter": "problem.space",
    "ParameterSpace": "problem.space",
    "Problem": "api.problem",
    "ResponseTest": "experiment.response",
    "Sensor": "measurement.modal",
    "StructuralModel": "structure.model",
    "Study": "api.study",
    "modes": "measurement.arrays",
    "modes_from_frfs": "modal_analysis.identify",
    "read_frfs": "measurement.files.read_frf",
    "read_modes": "measurement.files.read",
    "read_responses": "measurement.responses",
}
"""Module of each public name. It is imported on first use: ``calib --version`` needs none."""

__all__ = ["__version__", *_PLACES]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'calib' has no attribute {name!r}")
    return getattr(import_module(f"calib.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
