"""The picture of a first look at measured data: nodes, auto-MAC and complexity, mode indicators and coherence."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.report.comparison import STILL, draw_mac_matrix
from calib.report.scene import plot_coordinates, view_directions
from calib.report.style import BLUE, CASES, GREY, MEASURED, REST, legend_above, matrix_height, new_figure, own_axes

Tables = Mapping[str, pd.DataFrame]
_NUMBERED = 30
"""Nodes up to which each has its number in the picture."""
_ROOM = np.array([430.0, 180.0])
"""Width and height of the nodes in points of the page."""
_SENSORS = 20
"""Sensors of the lowest CoMAC, and channels, that the picture has room for."""
_CURVES = 6
"""Coherences that are told apart; of more the median and the range are drawn."""


def first_look_figure(tables: Tables) -> Figure:
    """Draw everything that a first look found, one panel a subject, in the order of reading.

    Parameters
    ----------
    tables : mapping from str to DataFrame
        Those of `calib.api.look.Look.tables`; what is not there or empty has no panel.
    """
    panels = [(draw, height) for draw, height in _panels(tables)]
    if not panels:
        return new_figure(1.0)
    figure = new_figure(sum(height for _, height in panels))
    every = figure.subplots(len(panels), 1, squeeze=False, height_ratios=[height for _, height in panels])[:, 0]
    for ax, (draw, _) in zip(every, panels, strict=True):
        draw(ax)
    return figure


def _panels(tables: Tables) -> list[tuple[Callable[[Axes], object], float]]:
    found: list[tuple[Callable[[Axes], object], float]] = []

    def add(name: str, draw: Callable[[pd.DataFrame, Axes], object], height: float) -> None:
        own = tables.get(name)
        if own is not None and len(own):
            found.append((lambda ax: draw(own, ax), height))

    nodes = tables.get("nodes")
    if nodes is not None and nodes[["x", "y", "z"]].notna().all(axis=1).sum() > 1:
        add("nodes", draw_nodes, 3.2)
    modes = tables.get("modes")
    if modes is not None and modes["mpc"].notna().any():
        add("auto_mac", _auto_mac, matrix_height(len(modes), len(modes)) + 0.3)
        add("modes", draw_complexity, 2.3)
    add("comac_repeats", draw_repeats_comac, 2.3)
    add("indicators", draw_indicators, 3.0)
    add("coherences", draw_coherences, 2.3)
    add("spectra", draw_indicators, 3.0)
    add("channels", draw_channels, 2.3)
    return found


def draw_nodes(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw measured nodes in space, with their numbers where they are few, and the directions of the axes.

    Parameters
    ----------
    table : DataFrame
        ``node, x, y, z`` (m); nodes without a place are left out.
    ax : Axes, optional
    """
    ax = own_axes(ax, 3.2)
    table = table[table[["x", "y", "z"]].notna().all(axis=1)]
    points = table[["x", "y", "z"]].to_numpy(dtype=float)
    seen = plot_coordinates(points) @ view_directions().T
    ax.plot(*seen.T, "o", color=MEASURED, markersize=4, gid="nodes")
    if len(table) <= _NUMBERED:
        numbers = [str(node) for node in table["node"]]
        for number, at, (dx, dy) in zip(numbers, seen, _beside(seen, numbers), strict=True):
            ax.annotate(number, at, (dx, dy), textcoords="offset points", fontsize=7.0, color=GREY, va="center",
                        ha="left" if dx > 0 else "right" if dx < 0 else "center")  # fmt: skip
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.12)
    ax.set_title(f"{len(table)} measured nodes")
    ax.set_axis_off()
    corner = ax.inset_axes((0.0, 0.02, 0.14, 0.4))
    for axis, tip in zip("xyz", plot_coordinates(np.eye(3)) @ view_directions().T, strict=True):
        corner.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": GREY, "linewidth": 0.8})
        corner.annotate(axis, 1.25 * tip, ha="center", va="center", fontsize=8, color=GREY)
    corner.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), aspect="equal")
    corner.set_axis_off()
    return ax


def _beside(points: np.ndarray, numbers: Sequence[str]) -> list[tuple[float, float]]:
    """Where the number of each point (n, 2) stands, in points of the page: on the first side that covers nothing."""
    scale = float((_ROOM / np.maximum(np.ptp(points, axis=0), 1e-9)).min())
    dots = points * scale
    taken, out = [(dot, np.array([4.0, 4.0])) for dot in dots], []
    for k, (dot, number) in enumerate(zip(dots, numbers, strict=True)):
        size = np.array([4.6 * len(number), 8.0])
        sides = [(4.0, 4.0), (-4.0, 4.0), (4.0, -4.0), (-4.0, -4.0), (0.0, 9.0), (0.0, -9.0)]
        boxes = [(dot + np.array([dx + np.sign(dx) * size[0] / 2, dy]), size) for dx, dy in sides]
        covered = [
            sum(bool(np.all(np.abs(middle - at) < (size + room) / 2)) for j, (at, room) in enumerate(taken) if j != k)
            for middle, _ in boxes
        ]
        best = int(np.argmin(covered))
        taken.append(boxes[best])
        out.append(sides[best])
    return out


def _auto_mac(table: pd.DataFrame, ax: Axes) -> Axes:
    ax = draw_mac_matrix(table, ax)
    ax.set(title="Auto-MAC of the measured shapes", xlabel="mode", ylabel="mode")
    return ax


def draw_complexity(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the mean phase deviation of every mode as bars, with its phase collinearity above them.

    Parameters
    ----------
    table : DataFrame
        ``mode, mpc`` (0 to 1) and ``mpd`` (degrees); NaN where unknown.
    ax : Axes, optional
    """
    ax = own_axes(ax, 2.3)
    at, mpd = np.arange(len(table)), table["mpd"].to_numpy(dtype=float)
    ax.bar(at, np.nan_to_num(mpd), 0.6, color=BLUE)
    for k, (own, deviation) in enumerate(zip(table["mpc"], mpd, strict=True)):
        if math.isfinite(own) and len(table) <= _SENSORS:
            ax.annotate(f"{own:.3f}", (k, deviation), (0, 2), textcoords="offset points", ha="center", fontsize=7.5)
    ax.set_xticks(at, table["mode"].astype(str), rotation=90 if len(table) > 8 else 0)
    ax.set_ylim(0.0, max(5.0, 1.2 * float(np.nanmax(mpd, initial=0.0))))
    ax.set(xlabel="mode", ylabel="phase deviation\nMPD (degrees)", title="Complexity: above the bars the MPC")
    ax.grid(axis="y")
    return ax


def draw_repeats_comac(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the sensors of the lowest CoMAC between repeats, grey where noise alone lowers it.

    Parameters
    ----------
    table : DataFrame
        ``sensor, comac``, worst first, and ``motion``, over the largest of the mode.
    ax : Axes, optional
    """
    ax = own_axes(ax, 2.3)
    rows = table.head(_SENSORS)
    still = rows["motion"] < STILL
    ax.bar(np.arange(len(rows)), rows["comac"].to_numpy(dtype=float), 0.6, color=np.where(still, REST, BLUE).tolist())
    ax.set_xticks(np.arange(len(rows)), rows["sensor"].astype(str), rotation=90 if len(rows) > 8 else 0)
    ax.set_ylim(0.0, 1.08)
    which = f"the {len(rows)} lowest of {len(table)} sensors" if len(table) > len(rows) else "all sensors"
    which += "; grey hardly move" * bool(still.any())
    ax.set(xlabel="sensor", ylabel="CoMAC (–)", title=f"CoMAC of the repeats with the first: {which}")
    ax.grid(axis="y")
    return ax


def draw_indicators(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw mode indicator functions over frequency: peaks of the first are modes, of the second too where two coincide.

    Parameters
    ----------
    table : DataFrame
        ``freq`` (Hz), ``cmif_1, cmif_2, ...`` and perhaps ``mif`` (0 to 1), on an axis of its own.
    ax : Axes, optional
    """
    ax = own_axes(ax, 3.0)
    names = [name for name in table.columns if name.startswith("cmif_")]
    for k, name in enumerate(names[:_CURVES]):
        size = table[name].to_numpy(dtype=float)
        size = np.where(size > 1e-12 * np.nanmax(size, initial=0.0), size, np.nan)
        ax.semilogy(table["freq"], size, color=CASES[k], linewidth=1.0, label=f"CMIF {k + 1}")
    ax.set(xlabel="frequency (Hz)", ylabel="singular value")
    if "mif" in table:
        beside = ax.twinx()
        beside.plot(table["freq"], table["mif"], color=REST, linewidth=0.9, label="MIF")
        beside.set(ylim=(0.0, 1.02), ylabel="MIF (–)")
        beside.spines["right"].set_visible(True)
        ax.set_zorder(beside.get_zorder() + 1)
        ax.patch.set_visible(False)
        legend_above(ax, [*ax.get_lines(), *beside.get_lines()])
    elif len(names) > 1:
        legend_above(ax)
    ax.grid()
    return ax


def draw_coherences(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the coherence of every function over frequency; of many the median and the range.

    Parameters
    ----------
    table : DataFrame
        ``freq`` (Hz) and one column a function, such as ``12z/3z``; NaN where unknown.
    ax : Axes, optional
    """
    ax = own_axes(ax, 2.3)
    own = table.drop(columns="freq")
    if own.shape[1] <= _CURVES:
        for k, name in enumerate(own):
            ax.plot(table["freq"], own[name], color=CASES[k], linewidth=0.9, label=name)
    else:
        low, middle, high = (own.quantile(q, axis=1) for q in (0.0, 0.5, 1.0))
        ax.fill_between(table["freq"], low, high, color=REST, alpha=0.6, linewidth=0, label="least to largest")
        ax.plot(table["freq"], middle, color=BLUE, linewidth=1.0, label=f"median of {own.shape[1]} functions")
    legend_above(ax)
    ax.set(xlabel="frequency (Hz)", ylabel="coherence (–)", ylim=(0.0, 1.03))
    ax.grid()
    return ax


def draw_channels(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the rms and the peak of every channel of records, on a logarithmic axis.

    Parameters
    ----------
    table : DataFrame
        ``sensor, rms, peak`` (SI); of several records the largest is drawn.
    ax : Axes, optional
    """
    ax = own_axes(ax, 2.3)
    rows = table.groupby("sensor", sort=False)[["rms", "peak"]].max().head(2 * _SENSORS)
    at = np.arange(len(rows))
    for name, marker, colour in (("peak", "_", GREY), ("rms", "o", BLUE)):
        sizes = rows[name].to_numpy(dtype=float)
        ax.plot(at, sizes, linestyle="none", markersize=5, label=name, marker=marker, color=colour)
    ax.set_yscale("log")
    ax.set_xticks(at, rows.index.astype(str), rotation=90 if len(rows) > 8 else 0)
    ax.set(xlabel="channel", ylabel="motion (SI)")
    legend_above(ax)
    ax.grid(axis="y")
    return ax
