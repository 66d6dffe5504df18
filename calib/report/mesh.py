"""The mesh of a model as shells and beams: visible pieces, connected bodies, and drawing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from calib.errors.errors import InputError
from calib.report.scene import PLACE, plot_coordinates, view_directions
from calib.report.tables import Folder, read_results

FACE, BORDER, LINE = 0, 1, 2


class MeshTables(NamedTuple):
    """Tables of a mesh.

    Attributes
    ----------
    points : DataFrame
        Columns ``point`` (its number) and ``x, y, z`` (m).
    elements : DataFrame
        Columns ``group`` and ``a, b, c, d`` (numbers of points); a line has no ``c`` and ``d``.
    """

    points: pd.DataFrame
    elements: pd.DataFrame


class Pieces(NamedTuple):
    """Faces, borders and lines of a mesh, as they are drawn.

    Attributes
    ----------
    corners : ndarray (n, 4), int
        Rows of the table of points; a line runs to its end and back.
    kind : ndarray (n,), int
        `FACE`, `BORDER` (edge of a shell, of an opening or of a group of faces) or `LINE`.
    group : ndarray (n,) of str
    """

    corners: np.ndarray
    kind: np.ndarray
    group: np.ndarray

    @property
    def strokes(self) -> np.ndarray:
        """Lines and borders as pairs of points, (n, 2) rows of the table of points."""
        return self.corners[self.kind != FACE, :2]

    def some(self, which: np.ndarray) -> Pieces:
        """Return the pieces selected by ``which``."""
        return Pieces(self.corners[which], self.kind[which], self.group[which])


def read_mesh(folder: Folder) -> MeshTables | None:
    """Read ``mesh_points.csv`` and ``mesh_elements.csv`` of a folder; None where one of them is missing."""
    points, elements = folder / "mesh_points.csv", folder / "mesh_elements.csv"
    if not points.exists() or not elements.exists():
        return None
    numbers = ["point", *PLACE]
    mesh = MeshTables(
        read_results(points, [], numbers, complete=numbers),
        read_results(elements, ["group"], ["a", "b", "c", "d"], complete=["a", "b"], may_be_empty=True),
    )
    check_mesh(mesh, elements)
    return mesh


def rest_lines(folder: Folder) -> np.ndarray | None:
    """Return lines of a folder's mesh at rest, borders of shells included, (n, 2, 3) in metres; None without a mesh."""
    mesh = read_mesh(folder)
    return None if mesh is None else point_coordinates(mesh)[pieces(mesh).strokes]


def check_mesh(mesh: MeshTables, path: Path) -> None:
    """Raise InputError, naming the file of elements, where an element refers to a point that is not in the table."""
    numbers = mesh.elements[["a", "b", "c", "d"]].to_numpy(dtype=float)
    unknown = ~np.isin(numbers, mesh.points["point"].to_numpy(dtype=float)) & ~np.isnan(numbers)
    if unknown.any():
        row, column = np.argwhere(unknown)[0]
        raise InputError(
            f"there is no point {numbers[row, column]:g} in mesh_points.csv",
            place=f"{path}, line {row + 2}",
            remedy="run the study again to write it anew",
        )


def point_coordinates(mesh: MeshTables) -> np.ndarray:
    """Return the points, (n_points, 3) in metres."""
    return mesh.points[PLACE].to_numpy(dtype=float)


def seen_places(mesh: MeshTables) -> np.ndarray:
    """Return the points that are drawn, those of `pieces`, (n, 3) in metres."""
    return point_coordinates(mesh)[np.unique(pieces(mesh).corners)]


def motions(mesh: MeshTables, deflection: pd.DataFrame) -> np.ndarray:
    """Return the motion of every point, (n_points, 3), from columns ``point, u, v, w``; 0 where the table has none."""
    moved = deflection.set_index("point")[["u", "v", "w"]].reindex(mesh.points["point"])
    return moved.fillna(0.0).to_numpy(dtype=float)


def pieces(mesh: MeshTables) -> Pieces:
    """Return faces, their borders, and lines; a line along the edge of faces, such as a stiffener, is not drawn.

    A mesh without elements, such as one that comes with another program's matrices, is drawn as its points: each is a
    line of zero length.
    """
    if mesh.elements.empty:
        alone = np.repeat(np.arange(len(mesh.points))[:, None], 4, axis=1)
        return Pieces(alone, np.full(len(alone), LINE), np.full(len(alone), "points"))
    corners, group = element_corners(mesh), mesh.elements["group"].to_numpy(dtype=str)
    of_face = mesh.elements["c"].notna().to_numpy()
    faces = corners[of_face]
    edges = element_edges(faces)
    owner = np.repeat(group[of_face], 4)
    border, its_group = _borders(edges, owner)
    known = {*map(tuple, edges.tolist())}
    ends = np.sort(corners[~of_face, :2], axis=1)
    free = np.array([tuple(pair) not in known for pair in ends.tolist()], dtype=bool)
    lines, line_group = corners[~of_face][free], group[~of_face][free]
    counts = [len(faces), len(border), len(lines)]
    return Pieces(
        np.concatenate([faces, border[:, [0, 1, 1, 0]], lines]),
        np.repeat([FACE, BORDER, LINE], counts),
        np.concatenate([group[of_face], its_group, line_group]),
    )


def thickness(mesh: MeshTables) -> float:
    """Return the middle one of the three extents of all faces, in metres; infinite where there are none."""
    faces = element_corners(mesh)[mesh.elements["c"].notna().to_numpy()]
    return float(np.sort(np.ptp(point_coordinates(mesh)[faces.ravel()], axis=0))[1]) if len(faces) else math.inf


def element_corners(mesh: MeshTables) -> np.ndarray:
    """Return rows of the table of points at the corners of every element, (n_elements, 4); a line is run to and fro."""
    row = pd.Series(np.arange(len(mesh.points)), index=mesh.points["point"].to_numpy(dtype=int))
    a, b, c, d = (mesh.elements[name].to_numpy(dtype=float) for name in "abcd")
    numbers = np.column_stack([a, b, np.where(np.isnan(c), b, c), np.where(np.isnan(d), a, d)]).astype(int)
    return row.loc[numbers.ravel()].to_numpy(dtype=int).reshape(-1, 4)


def element_edges(corners: np.ndarray) -> np.ndarray:
    """Return the four edges of every element, (4 n, 2), the smaller row first, from its corners (n, 4)."""
    return np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)


def _borders(edges: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (n, 2) of one face alone or between two groups, once each, and the group on one side."""
    unique, first, inverse = np.unique(edges, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    count = np.bincount(inverse, minlength=len(unique))
    between = np.zeros(len(unique), dtype=bool)
    between[inverse[owner != owner[first[inverse]]]] = True
    outer = (count == 1) | between
    return unique[outer], owner[first[outer]]


def bodies(parts: Pieces, count: int) -> np.ndarray:
    """Number the connected bodies: pieces that share points belong to one body, (n,) int.

    Parameters
    ----------
    parts : Pieces
    count : int
        Number of points of the mesh.
    """
    start, end = np.repeat(parts.corners[:, 0], 3), parts.corners[:, 1:].ravel()
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(count, count))
    return connected_components(graph, directed=False)[1][parts.corners[:, 0]]


def draw_pieces(
    ax: Axes3D,
    vertices: np.ndarray,
    kinds: np.ndarray,
    faces: np.ndarray,
    edges: np.ndarray,
    widths: np.ndarray,
    gid: str,
) -> None:
    """Draw flat pieces so that near ones hide far ones.

    Parameters
    ----------
    ax : Axes3D
    vertices : ndarray (n, 4, 3)
        Corners in metres; a line runs to its end and back.
    kinds : ndarray (n,), int
        `FACE`, `BORDER` or `LINE`.
    faces, edges : ndarray (n, 4)
        Colours as red, green, blue and opacity.
    widths : ndarray (n,)
        Line widths of the edges, in points.
    gid : str
        Identifier of the drawn collection.
    """
    if not len(vertices):
        return
    towards = np.cross(*view_directions())
    shown = plot_coordinates(vertices)
    # Borders are shifted towards the viewer to cover their faces; a parallel view shows nothing else of the shift.
    sizes = np.linalg.norm(shown[:, 2] - shown[:, 0], axis=1)[kinds == FACE]
    shown = (
        shown + np.where(kinds == BORDER, 0.4 * np.median(sizes) if len(sizes) else 0.0, 0.0)[:, None, None] * towards
    )
    # The Axes sort pieces and colours by depth but not widths, so everything is sorted beforehand.
    order = np.argsort((shown @ towards).mean(axis=1), kind="stable")
    collection = Poly3DCollection(
        shown[order], facecolors=faces[order], edgecolors=edges[order], linewidths=widths[order],
        zorder=2, gid=gid, joinstyle="round", capstyle="round",
    )  # fmt: skip
    ax.add_collection3d(collection)
