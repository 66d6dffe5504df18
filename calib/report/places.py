"""The model's springs, dampers, masses and supports, and the parameter that each one is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from string import ascii_uppercase
from typing import Any, cast

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path
from matplotlib.transforms import Affine2D
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from calib.report import scene
from calib.report.mesh import FACE, MeshTables, pieces, point_coordinates, seen_places
from calib.report.numbers import counted
from calib.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, REST, VERMILLION, figure_width

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
DIRECTION = ["dx", "dy", "dz"]
_SHORTEST = 0.4
"""Least length of a mark that is seen end on, over that of one across the view."""
_APART = 0.45
"""Of the length of a mark: distance of a damper from the spring at its place."""
_TURNS = 36
"""Directions into which marks are turned, over half a turn."""
_MOST_NUMBERS = 48
"""Most pieces that are all numbered; of more, one of each kind."""
_NEAR, _ROOM, _SMALL = 0.1, 0.02, 0.3
"""Of the diagonal of the model: distance between neighbours of a group, room about it, and its largest diagonal."""
_CROWD = 8
"""Fewest springs and dampers of a group."""
_MOST_KNOTS = 3
_INSET = 3.2
"""Height of the panels of groups, in inches."""
_COLUMNS = 3
"""Most columns of the key."""
_LETTER = 0.061
"""Mean width of a letter of the key, in inches."""


def draw_places(
    mesh: MeshTables,
    table: pd.DataFrame,
    ax: Axes3D | None = None,
    keys: Mapping[str, int] | None = None,
    title: str = "",
) -> Axes3D:
    """Draw the mesh in grey and a mark at every spring, damper, mass, support and part that a parameter scales.

    Parameters
    ----------
    mesh : MeshTables
    table : DataFrame
        Columns ``name, form, kind, parameters`` (names with semicolons between, empty for what is fixed), ``x, y, z``
        (m), and where known ``dx, dy, dz``, the direction in which a spring or damper stands; else it is upright.
    ax : Axes3D, optional
    keys : mapping from str to int, optional
        Number of each parameter; by default `numbered_parameters` of the table.
    title : str

    Returns
    -------
    Axes3D
        Lines with the form as gid, one for each direction; what no parameter scales is grey. A number is that of
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
                own |= {"linestyle": "none", "gid": f"fixed {form}" if still else form, "zorder": 3 if still else 4}
                beside = _beside(some, table) if form == "damper" else np.zeros(len(some), dtype=bool)
                for key, alike in some.groupby([_turns(some), beside]):
                    turned, apart = cast(tuple[tuple[float, float], bool], key)
                    at = scene.plot_coordinates(alike[scene.PLACE].to_numpy(dtype=float)).T
                    ax.plot(*at, **{**own, "marker": _marker(form, turned, _APART if apart else 0.0)})
    at = table[scene.PLACE].to_numpy(dtype=float)
    scene.frame_panel(ax, np.concatenate([rest[np.unique(parts.corners)], at]), title)
    scene.number_points(ax, at, _numbers(table, numbered_parameters(table) if keys is None else keys))
    scene.hover_places(ax, at, _words(table))
    return ax


def _turns(table: pd.DataFrame) -> pd.Series:
    """How the mark of each piece stands in the view: degrees from upright, and length over that of one across it."""
    way = table.reindex(columns=DIRECTION).to_numpy(dtype=float)
    seen = scene.plot_coordinates(np.where(np.isfinite(way), way, [0.0, 0.0, 0.0])) @ scene.view_directions().T
    length = np.linalg.norm(seen, axis=1)
    step = 180.0 / _TURNS
    angle = np.where(length > 0, np.degrees(np.arctan2(-seen[:, 0], seen[:, 1])), 0.0)
    stands = zip((step * np.round(angle / step) % 180.0).tolist(), np.round(length, 1).tolist(), strict=True)
    return pd.Series([(a, max(size, _SHORTEST) if size else 1.0) for a, size in stands], table.index, dtype=object)


def _beside(dampers: pd.DataFrame, table: pd.DataFrame) -> np.ndarray:
    """Which dampers have a spring at their place, (n,): they are drawn beside it."""
    springs = set(map(tuple, table.loc[table["form"] == "spring", scene.PLACE].to_numpy(dtype=float).tolist()))
    return np.array([tuple(at) in springs for at in dampers[scene.PLACE].to_numpy(dtype=float).tolist()])


def _marker(form: str, stands: tuple[float, float], aside: float = 0.0) -> MarkerStyle | str:
    """The mark of a form as it stands, see `_turns`, moved aside by that share of its length."""
    mark, (angle, length) = MARKS[form]["marker"], stands
    if isinstance(mark, str):
        return mark
    return MarkerStyle(mark, transform=Affine2D().scale(1.0, length).translate(aside, 0.0).rotate_deg(angle))


def numbered_parameters(table: pd.DataFrame) -> dict[str, int]:
    """Number of each parameter of a table of `draw_places`, from 1, in the order of their first places."""
    names = (name for cell in table["parameters"] for name in _names(cell))
    return {name: k for k, name in enumerate(dict.fromkeys(names), start=1)}


def _names(cell: str) -> list[str]:
    """The parameters in a cell of the table."""
    return cell.split("; ") if cell else []


def places_figure(mesh: MeshTables, table: pd.DataFrame) -> Figure:
    """Draw the places with a key of numbers and marks; for the arguments see `draw_places`.

    A few groups of springs that are small in the whole, such as bogies, are drawn beside it, each in a panel.
    """
    rest = seen_places(mesh)
    keys, knots = numbered_parameters(table), _knots(table, rest)
    fixed = table["parameters"].eq("")
    forms = [form for form in MARKS if ((table["form"] == form) & (~fixed | (form == "support"))).any()]
    shown = [f"{k}  {name}: {_forms_of(table, name)}" for name, k in keys.items()]
    room = _LETTER * max(map(len, shown), default=0) + 0.1
    columns = max(1, min(_COLUMNS, int((figure_width() - 0.2) / room)))
    rows = math.ceil(len(keys) / columns)
    foot = scene.FOOT + 0.17 * rows + 0.1 + scene.over_strip(0.45)
    wide, high = scene.seen_size(rest, 0.1 * float(np.linalg.norm(np.ptp(rest, axis=0))))
    inset = min(_INSET, figure_width() / max(len(knots), 1))
    heights = [min(figure_width() * high / wide, 5.6), *([inset] if knots else [])]
    figure = scene.new_scene(sum(heights) + foot, foot)
    height = float(figure.get_size_inches()[1])
    grid = figure.add_gridspec(len(heights), max(len(knots), 1), height_ratios=heights)
    inside = np.logical_or.reduce([np.zeros(len(table), dtype=bool), *knots])
    whole = draw_places(mesh, table[~inside], figure.add_subplot(grid[0, :], projection="3d"), keys)
    letters = dict(enumerate(ascii_uppercase[: len(knots)]))
    at = table[scene.PLACE].to_numpy(dtype=float)
    scene.number_points(whole, np.array([_middle(at[own]) for own in knots]), letters)
    for k, own in enumerate(knots):
        panel = figure.add_subplot(grid[1, k], projection="3d")
        draw_places(_within(mesh, at[own]), table[own], panel, keys, letters[k])
    for column in range(columns):
        lines = shown[column * rows : (column + 1) * rows]
        figure.text(
            (0.15 + column * (figure_width() - 0.2) / columns) / figure_width(), (foot - 0.05) / height,
            "\n".join(lines), va="top", fontsize=8.5, linespacing=1.3,
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
    scene.legend_in_foot(figure, handles, 3)
    scene.show_axes(figure)
    scene.write_size(figure, rest)
    return figure


def _knots(table: pd.DataFrame, rest: np.ndarray) -> list[np.ndarray]:
    """Groups of pieces that would lie over each other in a drawing of the points ``rest``, each as flags of the rows.

    A group is what stands about springs and dampers no further from each other than `_NEAR` of the whole diagonal.
    """
    at = table[scene.PLACE].to_numpy(dtype=float)
    size = float(np.linalg.norm(np.ptp(rest, axis=0)))
    acting = np.flatnonzero(table["form"].isin(["spring", "damper"]))
    if len(acting) < _CROWD or not size > 0:
        return []
    pairs = cKDTree(at[acting]).query_pairs(_NEAR * size, output_type="ndarray")
    joined = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(acting),) * 2)
    count, group = connected_components(joined, directed=False)
    found = []
    for k in range(count):
        own = at[acting[group == k]]
        low, high = own.min(axis=0) - _ROOM * size, own.max(axis=0) + _ROOM * size
        if len(own) >= _CROWD and np.linalg.norm(high - low) <= _SMALL * size:
            found.append(((at >= low) & (at <= high)).all(axis=1))
    found.sort(key=lambda own: float(scene.view_directions()[0] @ scene.plot_coordinates(_middle(at[own]))))
    return found if len(found) <= _MOST_KNOTS else []


def _middle(points: np.ndarray) -> np.ndarray:
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _within(mesh: MeshTables, points: np.ndarray) -> MeshTables:
    """The elements of a mesh that lie within the box of some points (n, 3), with a tenth of its diagonal about it."""
    room = 0.1 * float(np.linalg.norm(np.ptp(points, axis=0)))
    place = mesh.points[scene.PLACE].to_numpy(dtype=float)
    inside = ((place >= points.min(axis=0) - room) & (place <= points.max(axis=0) + room)).all(axis=1)
    out = mesh.points.loc[~inside, "point"].tolist()
    return mesh._replace(elements=mesh.elements[~mesh.elements[["a", "b", "c", "d"]].isin(out).any(axis=1)])


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


def _numbers(table: pd.DataFrame, keys: Mapping[str, int]) -> dict[int, int | str]:
    """Row of each place to number, and what to write there; pieces of one form at one place have one label."""
    rows = np.flatnonzero(table["parameters"].ne("") & ~table.duplicated([*scene.PLACE, "parameters"]))
    if len(rows) > _MOST_NUMBERS:
        rows = rows[~table.iloc[rows].duplicated(["form", "parameters"]).to_numpy()]
    some = table.iloc[rows].assign(row=rows)
    out = dict[int, int | str]()
    for _, alike in some.groupby(["form", *scene.PLACE], sort=False):
        numbers = {keys[name] for cell in alike["parameters"] for name in _names(cell)}
        out[int(alike["row"].iloc[0])] = "+".join(map(str, sorted(numbers)))
    return out
