"""Three-dimensional panels of a structure: lines, circles, numbers, axes and colour bar."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

from calib.report.style import BLACK, DENSE, DPI, figure_width, in_column
from calib.report.svg import hover

PLACE = ["x", "y", "z"]
FOOT = 0.8
"""Height in inches of the strip for legends below the panels."""
HEADING = 0.2
"""Height in inches of the title above a panel."""
_SECOND = 0.14
"""Height in inches of its second line."""
BAR = 0.55
"""Height in inches of a colour bar with its label, which in a column stands over that strip."""
_MANY_ROWS = 5
"""Panels of a long low structure up to which each is as wide as a column."""
_ELEVATION, _AZIMUTH = 24.0, -58.0
_FILLED = 0.94
_LOW = 0.45
"""Height over width of the view below which a structure counts as long and low."""
_LEADER = 16.0
"""Length in points of the line to a number."""
_DIGIT = np.array([6.0, 8.0])
"""Width and height in points of a digit of a number."""
_POINTED = 13.0
"""Diameter in points of the area that shows words under the mouse."""
_NEAR = 6
"""Decimals of coordinates, in metres, at which two places are one."""
_axes: ContextVar[str] = ContextVar("axes", default="")
_SIDES = re.compile(r"\b([xyz]) (?:to the )?(front|rear|left|right)\b")
"""How the axes of a model name the sides of it, as in ``x to the front, y up, z to the left``."""
_BEYOND = 0.07
"""Length of the arrow to a side over the diagonal of the model."""
_BESIDE = np.array([4.0, 7.0])
"""Points between an arrow and the name of its side, across and up."""


def over_strip(height: float) -> float:
    """Height in inches that a foot needs for what a page has room for at the right of the axes."""
    return height if in_column() else 0.0


@contextlib.contextmanager
def upright(axes: str) -> Iterator[None]:
    """Let what is drawn stand as its axes say: z points upwards where they name ``z up``, otherwise y does."""
    before = _axes.set(axes)
    try:
        yield
    finally:
        _axes.reset(before)


def plot_coordinates(points: np.ndarray) -> np.ndarray:
    """Transform (x longitudinal, y up, z transverse) to the plot's (x, -z, y), also right-handed; see `upright`.

    Parameters
    ----------
    points : ndarray (..., 3)
    """
    if "z up" in _axes.get():
        return np.asarray(points)
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def side_arrows(points: np.ndarray) -> dict[str, np.ndarray]:
    """Return an arrow (2, 3) that leaves the points (n, 3) to every side that the axes name, such as ``front``.

    One that rises in the view stands at the top of the points, another at their bottom: both are then outside them.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    length, up = _BEYOND * float(np.linalg.norm(high - low)), int(np.argmax(plot_coordinates(np.eye(3))[:, 2]))
    arrows = {}
    for axis, side in _SIDES.findall(_axes.get()):
        k = PLACE.index(axis)
        start = (low + high) / 2
        rises = float(view_directions()[1] @ plot_coordinates(np.eye(3)[k])) > 0.0
        start[up], start[k] = (high if rises else low)[up], high[k] + length / 2
        arrows[side] = np.array([start, start + length * np.eye(3)[k]])
    return arrows


def mark_sides(ax: Axes3D, arrows: Mapping[str, np.ndarray]) -> None:
    """Draw arrows from `side_arrows` with the names of their sides; the panel is already framed."""
    for side, arrow in arrows.items():
        x, y, _ = proj_transform(*plot_coordinates(arrow).T, ax.get_proj())
        (start, end) = np.column_stack([x, y])
        looks = {"arrowstyle": "-|>", "linewidth": 1.0, "color": BLACK, "shrinkA": 0.0, "shrinkB": 0.0}
        ax.annotate("", end, xytext=start, annotation_clip=False, arrowprops=looks)
        way = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
        ax.annotate(
            side, end, xytext=_BESIDE * way, textcoords="offset points", annotation_clip=False, fontsize=8.5,
            ha="left" if way[0] > 0 else "right", va="center",
        )  # fmt: skip


def axis_vectors(directions: Iterable[str]) -> np.ndarray:
    """Return the unit vector of each direction ``x, y, z``, (n, 3); zero for any other, such as a rotation."""
    return np.array([[float(name == axis) for axis in PLACE] for name in directions]).reshape(-1, 3)


def view_directions() -> np.ndarray:
    """Return the plot directions that the view shows to the right and upwards, (2, 3)."""
    azimuth, elevation = math.radians(_AZIMUTH), math.radians(_ELEVATION)
    return np.array(
        [
            [-math.sin(azimuth), math.cos(azimuth), 0.0],
            [-math.sin(elevation) * math.cos(azimuth), -math.sin(elevation) * math.sin(azimuth), math.cos(elevation)],
        ]
    )


def plot_lines(ax: Axes3D, segments: np.ndarray, **looks: object) -> None:
    """Draw segments (n, 2, 3) as one line with gaps: fast, and its data can be read back."""
    gap = np.full((len(segments), 1, 3), np.nan)
    path = plot_coordinates(np.concatenate([segments, gap], axis=1).reshape(-1, 3))
    ax.plot(*path.T, **looks)


def largest_drawn(points: np.ndarray, thickness: float = math.inf) -> float:
    """Return the drawn length of the largest motion, in metres: a tenth of the diagonal of the points' box (n, 3).

    A hollow body moves by at most 40 % of its thickness (metres); otherwise it would appear to leave its supports.
    """
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    return min(0.1 * (diagonal or 1.0), 0.4 * thickness)


def motion_scale(points: np.ndarray, motions: np.ndarray, thickness: float = math.inf) -> float:
    """Return the factor that draws the largest of the motions (n, 3) with the length of `largest_drawn`."""
    largest = float(np.linalg.norm(motions, axis=1).max(initial=0.0))
    return largest_drawn(points, thickness) / largest if largest > 0.0 else 0.0


def frame_scene(ax: Axes3D, points: np.ndarray, heading: float = 0.0) -> None:
    """Set a parallel view with equal scales that fills the panel below a heading of that height in inches."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 0.02 * float((high - low).max() or 1.0))
    seen = view_directions()
    off_centre = (seen @ points.T).max(axis=1) / 2 + (seen @ points.T).min(axis=1) / 2 - seen @ (low + high) / 2
    middle = (low + high) / 2 + off_centre @ seen
    for set_limits, m, s in zip((ax.set_xlim, ax.set_ylim, ax.set_zlim), middle, size, strict=True):
        set_limits(m - s / 2, m + s / 2)
    ax.set_proj_type("ortho")
    ax.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    ax.set_axis_off()
    ax.set_box_aspect(size)
    # Measure the view at this zoom in the square in which a 3-D panel is drawn, then fill the panel itself.
    x, y, _ = proj_transform(*points.T, ax.get_proj())
    filled = np.ptp(ax.transAxes.inverted().transform(ax.transData.transform(np.column_stack([x, y]))), axis=0)
    panel = ax.get_position(original=True)
    width, height = np.array([panel.width, panel.height]) * ax.figure.get_size_inches()
    room = np.array([width, height - 2 * heading]) / min(width, height)
    ax.set_box_aspect(size, zoom=_FILLED * float((room / np.maximum(filled, 1e-9)).min()))
    for artist in (*ax.lines, *ax.collections):
        artist.set_clip_on(False)


def new_scene(height: float, foot: float = FOOT) -> Figure:
    """Return an empty figure whose panels fill it above a foot, both heights in inches."""
    figure = Figure(figsize=(figure_width(), height), dpi=DPI)
    figure.subplots_adjust(left=0.0, right=1.0, top=1.0, bottom=foot / height, wspace=0.0, hspace=0.0)
    return figure


def new_axes(ax: Axes3D | None) -> Axes3D:
    """Return the given Axes, or the only ones of a new figure, ready for circles over lines."""
    if ax is None:
        figure = Figure(figsize=(5.0, 4.2), dpi=DPI)
        ax = cast(Axes3D, figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d"))
    # Otherwise all lines are drawn over all circles.
    ax.computed_zorder = False
    return ax


def draw_dots(ax: Axes3D, points: np.ndarray, values: np.ndarray, norm: Normalize, colours: str, gid: str) -> None:
    """Draw circles coloured by their values, with an area that grows with the absolute value.

    Parameters
    ----------
    ax : Axes3D
    points : ndarray (n, 3)
        Metres.
    values : ndarray (n,)
    norm : Normalize
        Values at the ends of the colour map.
    colours : str
        Name of the colour map.
    gid : str
        Identifier of the drawn circles.
    """
    area = 8.0 + 110.0 * np.abs(values) / max(abs(norm.vmin or 0.0), abs(norm.vmax or 0.0))
    looks = {"edgecolors": BLACK, "linewidths": 0.5, "depthshade": False, "clip_on": False, "zorder": 4}
    looks["rasterized"] = len(values) > DENSE
    ax.scatter(*plot_coordinates(points).T, c=values, s=area, cmap=colours, norm=norm, gid=gid, **looks)


def frame_panel(ax: Axes3D, points: np.ndarray, title: str, lines: int = 1) -> None:
    """Fill the panel below so many lines with the view of points (n, 3), in metres, and write the title above it."""
    frame_scene(
        ax, plot_coordinates(points) if len(points) else np.zeros((1, 3)), heading=HEADING + _SECOND * (lines - 1)
    )
    ax.text2D(0.5, 1.0, title, transform=ax.transAxes, ha="center", va="top", fontsize=8.5)


def number_points(
    ax: Axes3D, points: np.ndarray, numbers: Mapping[int, int | str], radii: np.ndarray | None = None
) -> None:
    """Number some of the points, each on the side with most room inside the panel.

    Parameters
    ----------
    ax : Axes3D
        Already framed.
    points : ndarray (n, 3)
        Points that a number must not cover, metres.
    numbers : mapping from int to int or str
        Row of `points`, and what to write beside it.
    radii : ndarray (n,), optional
        Of the marks at the points, in points; by default these are small.
    """
    if not numbers:
        return
    ax.apply_aspect()
    x, y, _ = proj_transform(*plot_coordinates(points).T, ax.get_proj())
    flat = np.column_stack([x, y])
    seen = ax.transData.transform(flat)
    turns = np.arange(12) * math.pi / 6.0
    around = np.column_stack([np.cos(turns), np.sin(turns)])
    box = ax.get_position(original=True).transformed(ax.get_figure(root=True).transFigure)
    taken, sizes = seen, np.zeros_like(seen)
    if radii is not None:
        sizes += radii[:, None] * DPI / 72.0
    for k, number in numbers.items():
        half = 0.5 * np.array([_DIGIT[0] * len(str(number)), _DIGIT[1]])
        offsets = around * (_LEADER + half - 0.5 * _DIGIT)
        ends, half = seen[k] + offsets * DPI / 72.0, half * DPI / 72.0
        room = np.linalg.norm(np.maximum(np.abs(ends[:, None] - taken) - half - sizes, 0.0), axis=2).min(axis=1)
        inside = [box.contains(*(end - half)) and box.contains(*(end + half)) for end in ends]
        best = int(np.argmax(np.where(inside, room, room - 1e3)))
        taken, sizes = np.vstack([taken, ends[best]]), np.vstack([sizes, half])
        ax.annotate(
            str(number),
            flat[k],
            xytext=offsets[best],
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8.5,
            fontweight="bold",
            zorder=6,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "linewidth": 0.7, "shrinkA": 1.0, "shrinkB": 2.0},
        )


def hover_places(ax: Axes3D, points: np.ndarray, words: Sequence[str]) -> None:
    """Give places their words under the mouse, one text for each of the points (n, 3) in metres; one place has all."""
    together: dict[tuple[float, ...], list[str]] = {}
    for place, text in zip(plot_coordinates(points).round(_NEAR).tolist(), words, strict=True):
        together.setdefault(tuple(place), []).append(text)
    # One line each: a collection in space sorts its points by depth, but not their words.
    for place, texts in together.items():
        looks = {"color": "none", "markersize": _POINTED, "clip_on": False, "zorder": 6}
        (area,) = ax.plot(*([x] for x in place), "o", gid="words", **looks)
        hover(area, "\n".join(texts))


def seen_size(points: np.ndarray, room: float) -> tuple[float, float]:
    """Return width and height of the view of points (n, 3) with some room in total, everything in metres.

    What has no extent, such as a model at one point, takes half as much height as width.
    """
    wide, high = np.ptp(plot_coordinates(points) @ view_directions().T, axis=0) + room if len(points) else (0.0, 0.0)
    width = float(wide) or 1.0
    return width, float(high) or 0.5 * width


def panel_grid(
    count: int,
    points: np.ndarray,
    thickness: float = math.inf,
    *,
    pairs: bool = False,
    foot: float = FOOT,
    lines: int = 1,
) -> tuple[Figure, list[SubplotSpec]]:
    """Return a figure with cells for panels that all show the same moving points (n, 3), with titles, above a foot.

    Long low structures take two columns, others three, so that the structure stays large; ``pairs`` of panels stand
    beside each other, of other structures two in a row. A column of a page has room for one or two abreast. For the
    thickness see `largest_drawn`.
    """
    wide, high = seen_size(points, 2 * largest_drawn(points, thickness))
    columns = 1 if count == 1 else 2 if count in (2, 4) or high < _LOW * wide else 3
    if pairs:
        columns = 2 if count == 2 or high < _LOW * wide else 4
    if in_column():
        columns = 1 if count == 1 or (not pairs and high < _LOW * wide and count <= _MANY_ROWS) else 2
    rows = math.ceil(count / columns)
    panel = figure_width() / columns
    # The square of a 3-D panel starts at its top edge only while the panel is not taller than wide.
    height = rows * min(panel * max(high / wide, 0.3) + 2 * (HEADING + _SECOND * (lines - 1)), panel) + foot
    figure = new_scene(height, foot)
    grid = figure.add_gridspec(rows, columns)
    return figure, [grid[k // columns, k % columns] for k in range(count)]


def show_axes(figure: Figure) -> None:
    """Draw the directions of the axes in the lower left corner."""
    height = float(figure.get_size_inches()[1])
    corner = cast(
        Axes3D,
        figure.add_axes((0.1 / figure_width(), 0.04 / height, 0.75 / figure_width(), 0.68 / height), projection="3d"),
    )
    arrows = np.eye(3)
    plot_lines(corner, np.stack([0.0 * arrows, arrows], axis=1), color=BLACK, linewidth=1.0)
    for name, (x, y, z) in zip("xyz", plot_coordinates(1.35 * arrows), strict=True):
        corner.text(x, y, z, name, fontsize=8.5, ha="center", va="center")
    frame_scene(corner, plot_coordinates(1.4 * np.concatenate([0.0 * arrows, arrows])))


def colour_bar(figure: Figure, colours: ScalarMappable, label: str, ticks: Sequence[float] | None = None) -> None:
    """Draw a colour bar in the lower right corner, in a column over the axes; by default with Matplotlib's ticks."""
    width, height = figure.get_size_inches().tolist()
    low = (FOOT + 0.4 if in_column() else 0.5) / height
    ax = figure.add_axes((1.0 - 3.1 / width, low, 2.9 / width, 0.12 / height), label="colours")
    figure.colorbar(colours, cax=ax, orientation="horizontal", label=label, ticks=ticks)


def legend_in_foot(figure: Figure, handles: Sequence[Artist], abreast: int, low: float = 0.06, **looks: Any) -> None:
    """Put a legend in the lower right corner, so high in inches; in a column over the axes."""
    width, height = figure.get_size_inches().tolist()
    at = (0.1 / width, FOOT / height) if in_column() else (0.99, low / height)
    corner: Any = "lower left" if in_column() else "lower right"
    figure.legend(handles=handles, loc=corner, bbox_to_anchor=at, ncols=abreast, borderaxespad=0.0, **looks)


def write_size(figure: Figure, points: np.ndarray) -> None:
    """Write the size of the box around points (n, 3), in metres, beside the directions of the axes."""
    size = " × ".join(f"{s:.3g}" for s in np.ptp(points, axis=0))
    height = float(figure.get_size_inches()[1])
    figure.text(1.05 / figure_width(), 0.09 / height, f"model {size} m (x × y × z)", fontsize=8.5, va="bottom")
