"""Figures that a folder plans are those of its tables, whatever other tables stand beside them."""

import ast
import inspect
import json

import pandas as pd
import pytest
from matplotlib.figure import Figure

from calib.report import draw, explanation_plan
from calib.report.draw import plan
from calib.report.drawing import bound
from calib.report.tables import CurrentFolder


@pytest.mark.parametrize("others", [(), ("sensitivity", "partial", "variance_share")])
def test_modes_with_an_added_effect_are_drawn_beside_a_sensitivity_analysis(tmp_path, others):
    stages = ("initial", "before", "after")
    errors = dict(zip(stages, (0.06, 0.01, -0.002), strict=True))
    columns = {"mode": ["m1", "m2"], "held_out": [False, True], "freq_kind": "damped", "freq_measured": [10.0, 20.0]}
    for stage, error in errors.items():
        columns |= {f"freq_{stage}": [10.0 * (1 + error), 20.0 * (1 - error)]}
        columns |= {f"error_{stage}": [error, -error], f"mac_{stage}": [0.9, 0.95]}
    pd.DataFrame(columns).to_csv(tmp_path / "added_modes.csv", index=False)
    (tmp_path / "added.json").write_text(json.dumps({"effects": [{"name": "prop"}]}))
    for name in others:
        table = pd.DataFrame({"parameter": ["k", "m"], "natural_freq_m1": [0.9, -0.4]})
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    (axes,) = plan(CurrentFolder(tmp_path, ()))["added_modes"].draw().axes
    drawn = {line.get_gid(): line.get_xdata().tolist() for line in axes.lines if line.get_gid() in stages}
    assert drawn == {stage: pytest.approx([100 * error, -100 * error]) for stage, error in errors.items()}


def test_a_drawing_keeps_its_data_whatever_its_variable_holds_later():
    def of(label):
        return Figure(label=label)

    drawings = {}
    for label in ("first", "second"):
        drawings[label] = bound(of, label)
    label = "other"
    assert {name: one().get_label() for name, one in drawings.items()} == {"first": "first", "second": "second"}


def test_axes_are_drawn_as_the_figure_that_they_are_in():
    figure = Figure()
    assert bound(figure.add_subplot, 2, 1, 1)() is figure and len(figure.axes) == 1


@pytest.mark.parametrize("module", [draw, explanation_plan])
def test_no_planned_drawing_reads_a_variable_when_it_is_drawn(module):
    tree = ast.parse(inspect.getsource(module))
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    inner = [node for outer in functions for node in ast.walk(outer) if node is not outer]
    assert functions and not [node for node in inner if isinstance(node, (ast.Lambda, ast.FunctionDef))]
