"""Calibration workbench for structural-dynamics models."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from calib.version import __version__

if TYPE_CHECKING:
    from calib.effect import Effect as Effect
    from calib.errors import EvaluationError as EvaluationError
    from calib.errors import InputError as InputError
    from calib.front.explained import Explained as Explained
    from calib.front.fit import Fit as Fit
    from calib.front.frf_test import FRFTest as FRFTest
    from calib.front.problem import Problem as Problem
    from calib.front.response_test import ResponseTest as ResponseTest
    from calib.front.sensitivity import Assessed as Assessed
    from calib.front.shown import Compared as Compared
    from calib.front.study import Study as Study
    from calib.front.test import ModalTest as ModalTest
    from calib.function import FunctionModel as FunctionModel
    from calib.measurement.modal import MeasuredModes as MeasuredModes
    from calib.measurement.modal import Sensor as Sensor
    from calib.measurement.read import read_modes as read_modes
    from calib.measurement.read_frf import read_frfs as read_frfs
    from calib.measurement.responses import read_responses as read_responses
    from calib.modal_analysis.identify import modes_from_frfs as modes_from_frfs
    from calib.space import LinearConstraint as LinearConstraint
    from calib.space import Parameter as Parameter
    from calib.space import ParameterSpace as ParameterSpace
    from calib.structure.modal_function import ModalFunctionModel as ModalFunctionModel
    from calib.structure.model import StructuralModel as StructuralModel


_PLACES = {
    "Assessed": "front.sensitivity",
    "Compared": "front.shown",
    "Effect": "effect",
    "EvaluationError": "errors",
    "Explained": "front.explained",
    "FRFTest": "front.frf_test",
    "Fit": "front.fit",
    "FunctionModel": "function",
    "InputError": "errors",
    "LinearConstraint": "space",
    "MeasuredModes": "measurement.modal",
    "ModalFunctionModel": "structure.modal_function",
    "ModalTest": "front.test",
    "Parameter": "space",
    "ParameterSpace": "space",
    "Problem": "front.problem",
    "ResponseTest": "front.response_test",
    "Sensor": "measurement.modal",
    "StructuralModel": "structure.model",
    "Study": "front.study",
    "modes_from_frfs": "modal_analysis.identify",
    "read_frfs": "measurement.read_frf",
    "read_modes": "measurement.read",
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
