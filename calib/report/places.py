"""The model's springs, dampers, masses and supports, and the parameter that each one is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report import scene
from calib.report.mesh import FACE, MeshTables, pieces, point_coordinates, seen_places
from calib.report.numbers import counted
from calib.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, REST, VERMILLION, WIDTH

_SPRING = Path([(0, -1), (0, -0.65), (0.5, -0.5), (-0.5, -0.2), (0.5, 0.1), (-0.5, 0.4), (0, 0.6), (0, 1)])
_CUP, _ROD = [(-0.5, 0.1), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.1)], [(0, -0.5), (0, -1)]
_DAMPER = Path(
    [*_CUP, *_ROD, (-0.4, 0.0), (0.4, 0.0), (0, 0.0), (0, 1)],
    [*(Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO), *(Path.MOVETO, Path.LINETO) * 3],
)
MARKS: dict[str, dict[str, Any]] = {
    "spring": {"marker": _SPRING, "markersize": 13, "markerfacecolor": "none", "markeredgewidth": 1.3, "color": BLUE},
    "damper": {"marker": _DAMPER, "markersize": 13, "markerfacecolor": "none", "markeredgewidth": 1.3, "color": GREEN},
    "mass": {"marker": "s", "markersize": 5.5, "color": VERMILLION, "markeredgecolor": "white"},
    "support": {"marker": "^", "markersize": 8, "color": PURPLE, "markeredgecolor": "white"},
    "part": {"marker": "D", "markersize": 5.5, "color": ORANGE, "markeredgecolor": "white"},
}
"""Look of each form."""
_WORDS = {"spring": "spring", "damper": "damper", "mass": "lumped mass", "support": "support", "part": "beam, shell"}
_MOST_NUMBERS = 48
"""Most pieces that are all numbered; of more, one of each kind."""
_COLUMNS = 3
"""Most columns of the key."""
_LETTER = 0.061
"""Mean width of a letter of the key, in inches."""


def draw_places(mesh: MeshTables, table: pd.DataFrame, ax: Axes3D | None = None) -> Axes3D:
    """Draw the mesh in grey and a mark at every spring, damper, mass, support and part that a parameter scales.

    Parameters
    ----------
    mesh : MeshTables
    table : DataFrame
        Columns ``name, form, kind, parameters`` (names with semicolons between, empty for what is fixed) and
        ``x, y, z`` (m).
    ax : Axes3D, optional

    Returns
    -------
    Axes3D
        One line for each form, with the form as gid; what no parameter scales is grey. A number is that of
        `numbered_parameters`. Name, form and parameters appear under the mouse.
    """
    ax = scene.new_axes(ax)
    parts, rest = pieces(mesh), point_coordinates(mesh)
    scene.plot_lines(ax, rest[parts.strokes], color=REST, linewidth=0.8, gid="mesh", zorder=1)
    inner = parts.corners[parts.kind == FACE]
    scene.plot_lines(ax, rest[inner[:, :2]], color=REST, linewidth=0.15, gid="faces", zorder=1)
    fixed = table["parameters"].eq("")
    small = {} if len(table) <= _MOST_NUMBERS * 2 else {"markersize": 5, "markeredgewidth": 0.7}
    for form, look in MARKS.items():
        for still in (True, False):
            some = table[(table["form"] == form) & (fixed == still)]
            if len(some):
                own = {**look, **small, **({"color": GREY, "alpha": 0.55} if still and form != "support" else {})}
                at = scene.plot_coordinates(some[scene.PLACE].to_numpy(dtype=float)).T
                ax.plot(*at, linestyle="none", gid=f"fixed {form}" if still else form, zorder=3 if still else 4, **own)
    at = table[scene.PLACE].to_numpy(dtype=float)
    scene.frame_panel(ax, np.concatenate([rest[np.unique(parts.corners)], at]), "")
    scene.number_points(ax, at, _numbers(table))
    scene.hover_places(ax, at, _words(table))
    return ax


def numbered_parameters(table: pd.DataFrame) -> dict[str, int]:
    """Number of each parameter of a table of `draw_places`, from 1, in the order of their first places."""
    names = (name for cell in table["parameters"] for name in _names(cell))
    return {name: k for k, name in enumerate(dict.fromkeys(names), start=1)}


def _names(cell: str) -> list[str]:
    """The parameters in a cell of the table."""
    return cell.split("; ") if cell else []


def places_figure(mesh: MeshTables, table: pd.DataFrame) -> Figure:
    """Draw the places with a key of numbers and marks; for the arguments see `draw_places`."""
    rest = seen_places(mesh)
    keys = numbered_parameters(table)
    fixed = table["parameters"].eq("")
    forms = [form for form in MARKS if ((table["form"] == form) & (~fixed | (form == "support"))).any()]
    shown = [f"{k}  {name}: {_forms_of(table, name)}" for name, k in keys.items()]
    room = _LETTER * max(map(len, shown), default=0) + 0.1
    columns = max(1, min(_COLUMNS, int((WIDTH - 0.2) / room)))
    rows = math.ceil(len(keys) / columns)
    foot = scene.FOOT + 0.17 * rows + 0.1
    wide, high = scene.seen_size(rest, 0.1 * float(np.linalg.norm(np.ptp(rest, axis=0))))
    figure = scene.new_scene(min(WIDTH * high / wide, 5.6) + foot, foot)
    height = float(figure.get_size_inches()[1])
    draw_places(mesh, table, figure.add_subplot(projection="3d"))
    for column in range(columns):
        lines = shown[column * rows : (column + 1) * rows]
        figure.text(
            (0.15 + column * (WIDTH - 0.2) / columns) / WIDTH, (foot - 0.05) / height, "\n".join(lines), va="top",
            fontsize=8.5, linespacing=1.3,
        )  # fmt: skip
    handles = [Line2D([], [], linestyle="none", label=_WORDS[form], **MARKS[form]) for form in forms]
    if (fixed & (table["form"] != "support")).any():
        handles.append(
            Line2D(
                [],
                [],
                linestyle="none",
                marker="s",
                markersize=5.5,
                color=GREY,
                label="no parameter (grey)",
            )
        )
    figure.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(0.99, 0.06 / height), ncols=3, borderaxespad=0.0
    )  # fmt: skip
    scene.show_axes(figure)
    scene.write_size(figure, rest)
    return figure


def _forms_of(table: pd.DataFrame, name: str) -> str:
    """What a parameter is: ``4 springs``."""
    own = table[[name in _names(cell) for cell in table["parameters"]]]
    counts = own["form"].value_counts()
    words = []
    for form in MARKS:
        if form not in counts:
            continue
        if form == "part":
            of = dict.fromkeys(own.loc[own["form"] == "part", "kind"])
            words.append(f"{' and '.join(of)} of {counted(int(counts[form]), 'part')}")
        else:
            many = "es" if form == "mass" else "s"
            words.append(f"{counts[form]} {_WORDS[form]}{many if counts[form] > 1 else ''}")
    return ", ".join(words)


def _words(table: pd.DataFrame) -> list[str]:
    """What each piece is: ``upper rod front left: spring, K_rod_upper``."""
    forms = np.where(table["form"] == "part", table["kind"] + " of a part", table["form"].map(_WORDS))
    scaled = [", ".join(_names(cell)) or "fixed" for cell in table["parameters"]]
    held = table["form"] == "support"
    return [
        form if still else f"{name}: {form}, {by}"
        for name, form, by, still in zip(table["name"], forms, scaled, held, strict=True)
    ]


def _numbers(table: pd.DataFrame) -> dict[int, int | str]:
    """Row of each place to number, and what to write there."""
    keys = numbered_parameters(table)
    rows = np.flatnonzero(table["parameters"].ne("") & ~table.duplicated([*scene.PLACE, "parameters"]))
    if len(rows) > _MOST_NUMBERS:
        rows = rows[~table.iloc[rows].duplicated(["form", "parameters"]).to_numpy()]
    return {k: "+".join(map(str, sorted(keys[n] for n in _names(table["parameters"].iloc[k])))) for k in rows.tolist()}
