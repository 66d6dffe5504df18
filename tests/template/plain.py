"""A study of a function of two parameters, for tests of what happens around a model."""

from pathlib import Path

TWO = '(Parameter("a", 2.0, 1.0, 3.0), Parameter("b", 2.0, 1.0, 3.0))'
MODEL = """
import numpy as np
from calib.structure.function_model import FunctionModel
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace

SPACE = ParameterSpace(SPACE_OF)

FUNCTION

def model():
    return FunctionModel("plain", SPACE, answer)
"""
STUDY = """
title = "Plain"
model = "model.py:model"
selection = SELECTION
[measurement]
responses = "measured.csv"
"""


def write(
    folder: Path,
    function: str,
    asked: str,
    space: str = TWO,
    selection: str = '["a", "b"]',
    **measured: tuple[float, float],
) -> Path:
    """Write the study into a new folder, and return that.

    Parameters
    ----------
    folder : Path
    function : str
        Source of a function ``answer(values)``.
    asked : str
        What follows in ``study.toml``: analyses, held-out responses.
    space : str
        Source of what a `ParameterSpace` is made of.
    selection : str
        Value of that key.
    **measured : tuple of float
        Of each response, value and standard deviation.
    """
    folder.mkdir()
    (folder / "model.py").write_text(MODEL.replace("SPACE_OF", space).replace("FUNCTION", function.strip()))
    (folder / "study.toml").write_text(STUDY.replace("SELECTION", selection) + asked.lstrip())
    rows = "".join(f"{response},{value},{std}\n" for response, (value, std) in measured.items())
    (folder / "measured.csv").write_text(f"response,value,std\n{rows}")
    return folder
