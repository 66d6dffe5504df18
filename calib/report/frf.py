"""Figures of FRFs: overlays of measured and model functions, and their criteria by function and by line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calib.report import style
from calib.report.numbers import fixed
from calib.report.svg import hover_cells, hover_points

OVERLAID = 6
"""Functions of which amplitude and phase are drawn."""
_STAGES: dict[str, dict[str, Any]] = {
    "before": {"color": style.BEFORE, "marker": "s", "linestyle": "--"},
    "after": {"color": style.AFTER, "marker": "o", "linestyle": "-"},
    "added": {"color": style.WITH, "marker": "D", "linestyle": "-"},
}
"""Look of each stage."""
_LINEAR_BELOW = 1.0
"""Standard deviations up to which an axis of errors is linear: below, they are noise."""

_BANDS = 24
"""Bands of the matrix of residuals."""
_GAP = 3.0
"""Distance of two lines, over the usual one, from which no curve joins them."""

Tables = Mapping[str, pd.DataFrame]
"""Tables by stage: ``before`` and ``after`` calibration, ``added`` with added effects."""


def overlay_figure(overlays: Tables, functions: Tables, *, effects: str = "") -> Figure:
    """Draw amplitude and phase of the functions that agree least, measured and of the model at each stage.

    Parameters
    ----------
    overlays : mapping from stage to DataFrame
        Columns ``response, reference, freq`` (Hz) and ``measured_re, measured_im, model_re, model_im``.
    functions : mapping from stage to DataFrame
        Columns ``response, reference, frac`` and, for the axis, ``unit``.
    effects : str
        Names of added effects, for the legend.

    Returns
    -------
    Figure
        Amplitudes on a logarithmic axis, phases in degrees below them; the smallest FRAC of the latest stage first.
    """
    latest = list(functions.values())[-1]
    shown = [name for name in ("response", "reference", "unit") if name in latest]
    chosen = latest.sort_values("frac", kind="stable").head(OVERLAID)[shown].to_dict("records")
    columns = 2 if len(chosen) > 1 else 1
    rows = -(-len(chosen) // columns)
    figure = style.new_figure(0.6 + 2.0 * rows)
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=(3, 1) * rows)
    for k, one in enumerate(chosen):
        amplitude = figure.add_subplot(grid[2 * (k // columns), k % columns])
        phase = figure.add_subplot(grid[2 * (k // columns) + 1, k % columns], sharex=amplitude)
        own = {stage: _of(table, one["response"], one["reference"]) for stage, table in overlays.items()}
        _overlay(amplitude, phase, own, effects)
        name = f"{one['response']}/{one['reference']}"
        amplitude.text(0.98, 0.04, name, transform=amplitude.transAxes, ha="right", va="bottom", fontweight="bold")
        amplitude.tick_params(labelbottom=False)
        if k % columns == 0:
            amplitude.set_ylabel(f"|H|, {one['unit']}" if "unit" in one else "|H|")
            phase.set_ylabel("phase (°)")
        if k >= len(chosen) - columns:
            phase.set_xlabel("frequency (Hz)")
        if k < columns:
            # Room for the legend, which would widen its column: two lines for three stages, in a column one for each.
            lines = 1 + len(overlays) if style.in_column() else 1 if len(overlays) < 3 else 2
            amplitude.set_title("\n".join(" " * lines))
        if k == 0:
            style.legend_above(amplitude)
            amplitude.get_legend().set_in_layout(False)  # type: ignore[union-attr]
    return figure


def _gaps(table: pd.DataFrame) -> pd.DataFrame:
    """The table with an empty row wherever lines are missing, so that no curve bridges a band that is left out."""
    freq = table["freq"].to_numpy(float)
    if len(freq) < 3:
        return table
    step = np.diff(freq)
    after = np.flatnonzero(step > _GAP * np.median(step))
    empty = pd.DataFrame(np.nan, index=table.index[after] + 0.5, columns=["freq"])
    return pd.concat([table, empty]).sort_index(kind="stable")


def _of(table: pd.DataFrame, response: str, reference: str) -> pd.DataFrame:
    own = table[(table["response"] == response) & (table["reference"] == reference)].sort_values("freq")
    return _gaps(own.reset_index(drop=True))


def _overlay(amplitude: Axes, phase: Axes, own: Tables, effects: str) -> None:
    test = next(iter(own.values()))
    measured = test["measured_re"].to_numpy(float) + 1j * test["measured_im"].to_numpy(float)
    dots: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 3, "color": style.BLACK, "rasterized": True}
    amplitude.plot(test["freq"], np.abs(measured), label="measured", zorder=3, **dots)
    phase.plot(test["freq"], np.degrees(np.angle(measured)), zorder=3, **dots)
    for table, look in _looked(own, effects):
        model = table["model_re"].to_numpy(float) + 1j * table["model_im"].to_numpy(float)
        look |= {"marker": "", "linewidth": 1.2}
        amplitude.plot(table["freq"], np.abs(model), **look)
        phase.plot(table["freq"], np.degrees(np.angle(model)), **look)
    amplitude.set_yscale("log")
    amplitude.grid(axis="y")
    phase.set_yticks([-180, 0, 180])
    phase.set_ylim(-200, 200)


def _looked(tables: Tables, effects: str) -> Iterator[tuple[pd.DataFrame, dict[str, Any]]]:
    """Every stage's table with the look of its stage and its words for the legend."""
    for stage, table in tables.items():
        yield table, {**_STAGES[stage], "label": style.stage_words(stage, effects)}


def draw_frac(functions: Tables, ax: Axes | None = None, *, effects: str = "") -> Axes:
    """Draw the FRAC of every function at each stage, the smallest of the latest stage first.

    Parameters
    ----------
    functions : mapping from stage to DataFrame
        Columns ``response, reference, frac``.
    ax : Axes, optional
    effects : str
        Names of added effects, for the legend.

    Returns
    -------
    Axes
        Dots from 0 to 1; 1 for functions that are proportional to the measured ones.
    """
    named = {
        stage: table.assign(name=table["response"] + "/" + table["reference"]) for stage, table in functions.items()
    }
    latest = list(named.values())[-1] if named else pd.DataFrame({"name": [], "frac": []})
    names = latest.sort_values("frac", kind="stable")["name"].tolist()
    ax = style.own_axes(ax, 1.2 + 0.2 * max(len(names), 1))
    places = np.arange(len(names))
    for table, look in _looked(named, effects):
        own = table.set_index("name")["frac"].reindex(names).to_numpy(float)
        ax.plot(own, places, markersize=5, **look | {"linestyle": ""})
        hover_points(ax, own, places, [f"{n}: {fixed(v, 3)}" for n, v in zip(names, own, strict=True)])
    ax.set_yticks(places, names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlim(-0.02, 1.02)
    ax.set_xlabel("FRAC (–)")
    ax.grid(axis="x")
    style.legend_above(ax)
    return ax


def draw_frf_lines(lines: Tables, ax: Axes | None = None, *, effects: str = "") -> Axes:
    """Draw the error of every line at each stage, over all functions.

    Parameters
    ----------
    lines : mapping from stage to DataFrame
        Columns ``freq`` (Hz) and ``in_std``, the root mean square error in standard deviations.
    ax, effects
        As for `draw_frac`.

    Returns
    -------
    Axes
        Linear up to one standard deviation and logarithmic above; the dashed line at 1 is a right model.
    """
    ax = style.own_axes(ax, 3.0)
    for table, look in _looked(lines, effects):
        shown = _gaps(table)
        look |= {"linestyle": "-", "linewidth": 0.8, "markersize": 2.5, "rasterized": len(shown) > style.DENSE}
        ax.plot(shown["freq"], shown["in_std"], **look)
    ax.axhline(1.0, color=style.GREY, linestyle="--", linewidth=1.0)
    ax.set_yscale("symlog", linthresh=_LINEAR_BELOW)
    ax.set_ylim(0.0, ax.get_ylim()[1] * 1.3)  # marks of the largest errors are whole
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("frequency (Hz)")
    ax.set_ylabel(f"rms error (standard deviations;\nlinear up to {_LINEAR_BELOW:g})")
    ax.grid(axis="y")
    style.legend_above(ax)
    return ax


def draw_frf_misfit(table: pd.DataFrame, ax: Axes | None = None, *, name: str = "") -> Axes:
    """Draw the residuals after the fit by function and band, of the latest model.

    Parameters
    ----------
    table : DataFrame
        Columns ``stage`` (``base``, ``explained`` or ``attempt``), ``function``, ``freq`` (Hz), and ``re, im``, the
        residuals of real and imaginary part in standard deviations.
    ax : Axes, optional
    name : str
        Effects in the extended model, for the title.

    Returns
    -------
    Axes
        Colours are root mean squares over the lines of a band, 1 for a right model; bands have equal numbers of lines.
    """
    stage = str(table["stage"].iloc[-1])
    own = table[table["stage"] == stage]
    lines = np.unique(own["freq"].to_numpy(float))
    bands = np.array_split(lines, min(_BANDS, len(lines)))
    starts = np.array([band[0] for band in bands])
    square = 0.5 * (own["re"].to_numpy(float) ** 2 + own["im"].to_numpy(float) ** 2)
    band_of = np.searchsorted(starts, own["freq"].to_numpy(float), side="right") - 1
    mean = pd.DataFrame({"function": own["function"], "band": band_of, "square": square})
    rms = mean.pivot_table(index="function", columns="band", values="square", sort=False) ** 0.5
    rms = rms.loc[rms.max(axis=1).sort_values(ascending=False, kind="stable").index]
    values = rms.reindex(columns=range(len(bands))).to_numpy(float)
    ax = style.own_axes(ax, style.matrix_height(*values.shape))
    ax.imshow(np.ones_like(values), cmap="Greys", norm=Normalize(0.0, 7.0), aspect="auto")
    image = ax.imshow(values, cmap="OrRd", norm=Normalize(0.0, max(3.0, float(np.nanmax(values)))), aspect="auto")
    ends = [f"{band[0]:.4g} to {band[-1]:.4g} Hz" for band in bands]
    hover_cells(ax, [[f"{f}, {band}: {fixed(v, 2)}" for band, v in zip(ends, row, strict=True)]
                     for f, row in zip(rms.index, values, strict=True)])  # fmt: skip
    ax.set_yticks(range(len(rms)), rms.index.astype(str))
    every = max(1, len(bands) // 8)
    ax.set_xticks(range(0, len(bands), every), [f"{starts[k]:.3g}" for k in range(0, len(bands), every)])
    style.separate_cells(ax, *values.shape)
    ax.set_xlabel("first line of the band (Hz)")
    ax.set_title(style.added(stage, name).replace(": ", ":\n"))
    style.bar_beside(ax, image, "rms residual (standard deviations)")
    return ax
