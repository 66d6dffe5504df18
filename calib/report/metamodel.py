"""Figures of metamodels: coefficients of prognosis, predicted against computed values, and response surfaces."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.report import style
from calib.report.sensitivity import draw_sensitivity

TOTAL = "all inputs"
"""Row of the total coefficient of prognosis."""
CELLS = 41
"""Points of a surface along each input."""


def draw_prognosis(total: pd.DataFrame, inputs: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the coefficients of prognosis of every input and response as a matrix, the total in the last row.

    Parameters
    ----------
    total : DataFrame
        Columns ``response`` and ``cop``.
    inputs : DataFrame
        Columns ``response``, ``parameter`` and ``cop``.
    ax : Axes, optional
    """
    responses = list(total["response"])
    matrix = inputs.pivot(index="parameter", columns="response", values="cop")
    matrix = matrix.loc[list(dict.fromkeys(inputs["parameter"])), responses]
    matrix.loc[TOTAL] = total.set_index("response")["cop"]
    table = matrix.rename_axis(index="parameter").reset_index()
    ax = draw_sensitivity(table, ax, threshold=0.01, label="coefficient of prognosis (–)", signed=False)
    ax.axhline(len(table) - 1.5, color=style.BLACK, linewidth=1.2)
    return ax


def draw_residuals(table: pd.DataFrame, response: str, ax: Axes | None = None, *, unit: str = "") -> Axes:
    """Draw the values of a response that its metamodel predicts by cross-validation against those of the model.

    Parameters
    ----------
    table : DataFrame
        Columns ``true`` and ``predicted``: each design, predicted without its own fold.
    response : str
    ax : Axes, optional
    unit : str
        Of the response; empty where it is unknown.
    """
    true, predicted = (table[name].to_numpy(dtype=float) for name in ("true", "predicted"))
    ax = style.own_axes(ax, 4.2)
    ends = [min(true.min(), predicted.min()), max(true.max(), predicted.max())]
    ax.plot(ends, ends, color=style.GREY, linewidth=1.0, label="equal")
    ax.scatter(true, predicted, s=14, color=style.BLUE, alpha=0.7, linewidths=0, gid="designs", label="designs")
    missed = float(((true - predicted) ** 2).sum() / ((true - true.mean()) ** 2).sum())
    rms = float(np.sqrt(((true - predicted) ** 2).mean()))
    ax.set_title(f"{len(true)} designs; CoP {max(0.0, 1 - missed):.3f}, rms error {rms:.3g}", loc="left", fontsize=9)
    after = f" ({unit})" if unit not in ("", "-") else ""
    ax.set_xlabel(f"{response}, model{after}")
    ax.set_ylabel(f"{response}, metamodel, cross-validated{after}")
    ax.grid(True)
    return ax


def surface_figure(
    grid: pd.DataFrame,
    designs: pd.DataFrame,
    x: str,
    y: str,
    response: str,
    labels: Mapping[str, str] = MappingProxyType({}),
    log: Collection[str] = (),
) -> Figure:
    """Draw a response over two inputs, all others at their nominal values: as a slice with contours and in space.

    Parameters
    ----------
    grid : DataFrame (n_x * n_y, 3)
        Columns ``x``, ``y`` and ``response``, every value of ``x`` with every one of ``y``.
    designs : DataFrame
        Columns ``x`` and ``y`` of the computed designs, whose other inputs differ.
    x, y, response : str
        Columns.
    labels : mapping from str to str
        Labels of columns, such as with their units.
    log : collection of str
        Inputs with a logarithmic axis; in space their decimal logarithms are drawn.
    """
    table = grid.pivot(index=y, columns=x, values=response)
    across, up = np.meshgrid(table.columns.to_numpy(dtype=float), table.index.to_numpy(dtype=float))
    height: Any = table.to_numpy(dtype=float)
    figure = style.new_figure(3.4)
    flat = figure.add_subplot(1, 2, 1)
    image = flat.contourf(across, up, height, levels=14, cmap="viridis")
    flat.scatter(designs[x], designs[y], s=4, color="white", linewidths=0, alpha=0.7, gid="designs")
    flat.set(xlabel=labels.get(x, x), ylabel=labels.get(y, y), xlim=(across.min(), across.max()))
    flat.set(ylim=(up.min(), up.max()), xscale="log" if x in log else "linear", yscale="log" if y in log else "linear")
    flat.set_title(f"white: {len(designs)} designs, at any other inputs", loc="left", fontsize=8)
    figure.colorbar(image, ax=flat, label=labels.get(response, response))
    space: Any = figure.add_subplot(1, 2, 2, projection="3d")
    across, up = (np.log10(at) if name in log else at for name, at in ((x, across), (y, up)))
    space.plot_surface(across, up, height, cmap="viridis", linewidth=0.2, edgecolor=style.GREY)
    for name, write in ((x, space.set_xlabel), (y, space.set_ylabel)):
        write(("log10 of " if name in log else "") + labels.get(name, name), labelpad=6)
    space.set_title(labels.get(response, response), fontsize=9)
    space.tick_params(labelsize=7)
    space.locator_params(nbins=4)
    return figure
