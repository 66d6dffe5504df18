"""Figures of metamodels that a user names: against the model, and over two inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from calib.analyses.sensitivity import Sensitivity, response_units, runs_of
from calib.api.figures import file_name, write_named
from calib.errors.errors import InputError
from calib.report.metamodel import CELLS, draw_residuals, surface_figure
from calib.report.numbers import labels_with_units
from calib.report.style import owner_of, save, style
from calib.sensitivity.prognosis import Metamodel
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_metamodels(
    found: Any, study: LoadedStudy, folder: Path, residuals: Sequence[str], surfaces: Sequence[tuple[str, str, str]]
) -> tuple[Path, ...]:
    """Draw the named metamodels of a sensitivity analysis into its folder.

    Parameters
    ----------
    found : Sensitivity
    study : LoadedStudy
    folder : Path
        Where ``residuals_<response>.png`` and ``surface_<response>_<x>_<y>.png`` go.
    residuals : sequence of str
        Responses.
    surfaces : sequence of (str, str, str)
        A response and two inputs each.

    Raises
    ------
    InputError
        For an unknown name, or a response without a metamodel.
    """
    if not isinstance(found, Sensitivity):
        raise InputError("it has no metamodels", place=f"method {found.method}", remedy="use the method 'ranks'")
    title, own = f"{study.settings.title}: metamodel", found.prognosis
    units, designs = response_units(study, [one.response for one in own.models]), _computed(study, found.sampled)
    drawn = [(f"residuals_{file_name(r)}", partial(_figure, own[r], designs, None, units)) for r in residuals]
    for r, x, y in surfaces:
        drawn.append(
            (
                f"surface_{file_name(r)}_{file_name(x)}_{file_name(y)}",
                partial(_figure, own[r], designs, (x, y), units),
            )
        )
    return write_named(drawn, title, study.synthetic, folder)


def draw_metamodel(
    one: Metamodel, study: AnyStudy, designs: pd.DataFrame, path: Path, inputs: tuple[str, str] | None
) -> Path:
    """Draw one metamodel into a PNG file; see `draw_metamodels`."""
    with style():
        figure = _figure(one, _computed(study, designs), inputs, response_units(study, [one.response]))
        (written,) = save(figure, path.with_suffix(""))
    return written


def _computed(study: AnyStudy, sampled: pd.DataFrame) -> pd.DataFrame:
    """The designs that were computed: the samples, or the runs of a table, whose samples are predicted."""
    runs = runs_of(study)
    return sampled if runs is None else runs.points[runs.values.notna().any(axis=1)]


def _figure(one: Metamodel, designs: pd.DataFrame, inputs: tuple[str, str] | None, units: Mapping[str, str]) -> Figure:
    if one.model is None:
        raise InputError(f"it has no metamodel ({one.kind})", place=f"response {one.response}")
    if inputs is None:
        table, unit = pd.DataFrame({"true": one.true, "predicted": one.predicted}), units.get(one.response, "")
        return owner_of(draw_residuals(table, one.response, unit=unit))
    names = one.space.free_names
    unknown = [name for name in inputs if name not in names]
    if unknown or inputs[0] == inputs[1]:
        what = f"{unknown[0]!r} is no input" if unknown else f"{inputs[0]!r} is named twice"
        remedy = f"choose two of {', '.join(names)}"
        raise InputError(what, place=f"surface of {one.response}", remedy=remedy)
    x, y = (np.array([one.space[name].at(place) for place in np.linspace(0.0, 1.0, CELLS)]) for name in inputs)
    points = np.tile([p.value for p in one.space.free], (CELLS**2, 1)).astype(float)
    points[:, names.index(inputs[0])], points[:, names.index(inputs[1])] = (a.ravel() for a in np.meshgrid(x, y))
    grid = pd.DataFrame({name: points[:, names.index(name)] for name in inputs}).assign(**{one.response: one(points)})
    units = {**units, **{p.name: p.unit for p in one.space.free}}
    labels = labels_with_units(units)
    return surface_figure(grid, designs, *inputs, one.response, labels, [p.name for p in one.space.free if p.is_log])
