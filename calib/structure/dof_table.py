"""Rows of matrices of another code: node and direction of each, and coordinates of the nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import DIRECTIONS

if TYPE_CHECKING:
    import pandas as pd

Layers: TypeAlias = Literal["mean"]
"""How rows that are named alike move their node: ``"mean"`` of the first and the last of them."""

Dofs: TypeAlias = "pd.DataFrame | Iterable[Any] | np.ndarray"
"""A table ``node, direction[, x, y, z]``, pairs, or numbers such as 11.03; or several tables, one of each run."""

_PACKED = ((10, "12.3 for direction 3 of node 12, as CalculiX does"), (100, "12.03, as SDT does"))
"""Forms of one number that names node and direction: its fraction times this is the direction."""
_EXACT = 0.01
"""Distance from an integer that the direction in such a number may have by rounding."""


@dataclass(frozen=True)
class DofTable:
    """Node and direction of each row of the matrices, and coordinates of the nodes.

    Attributes
    ----------
    node : ndarray (n_dof,), int
        Index into ``labels``; -1 for a row of no node.
    direction : ndarray (n_dof,), int
        0..5 for ux, uy, uz, rx, ry, rz; -1 for a row of no node.
    labels : tuple of int
        Node labels, length n_nodes.
    points : ndarray (n_nodes, 3)
        m; NaN where no coordinates are given.
    """

    node: np.ndarray
    direction: np.ndarray
    labels: tuple[int, ...]
    points: np.ndarray

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return len(self.node)

    @property
    def expansion(self) -> sp.csr_array:
        """Nodal motions over the degrees of freedom, (6 * n_nodes, n_dof).

        Where several rows bear one name, the layers of a shell, the node moves as the mean of the first and the last.
        """
        rows = np.flatnonzero(self.node >= 0)
        motion = 6 * self.node[rows] + self.direction[rows]
        outer = np.zeros(len(rows))
        first = np.unique(motion, return_index=True)[1]
        last = len(rows) - 1 - np.unique(motion[::-1], return_index=True)[1]
        np.add.at(outer, first, 0.5)
        np.add.at(outer, last, 0.5)
        out = sp.csr_array((outer, (motion, rows)), shape=(6 * len(self.labels), self.n_dof))
        out.eliminate_zeros()
        return out

    @property
    def repeated(self) -> np.ndarray:
        """Rows that bear the name of an earlier one, (n_repeated,), int."""
        import pandas as pd

        again = pd.MultiIndex.from_arrays([self.node, self.direction]).duplicated()
        return np.flatnonzero(again & (self.node >= 0))

    def words(self, k: int) -> str:
        """Name of a degree of freedom in messages."""
        if self.node[k] < 0:
            return f"row {k + 1} (of no node)"
        return f"row {k + 1} (node {self.labels[self.node[k]]}, {DIRECTIONS[self.direction[k]]})"

    def scaled(self, metres: float) -> DofTable:
        """The same with coordinates that were given in another unit of length."""
        return replace(self, points=self.points * metres)

    @staticmethod
    def of(given: Dofs, name: str, layers: Layers | None = None) -> DofTable:
        """Read the rows' names, in their order.

        Parameters
        ----------
        given : DataFrame, iterable or array
            A table ``node, direction[, x, y, z]``; pairs of node and direction; or numbers that name both, 12.3 or
            12.03 for direction 3 of node 12. Numbers may be doubles, as files of MATLAB have them. A row without node,
            None or NaN, is internal to the code, such as the amplitude of a component mode: no sensor lies there. A
            list of tables is one of each run of a code, which must agree row by row.
        name : str
            Of the model.
        layers : {"mean"}, optional
            What several rows of one name mean.

        Raises
        ------
        InputError
            When a column is missing, a direction is unknown, a row is named twice without ``layers``, a node has two
            positions, or the tables of two runs differ.
        """
        import pandas as pd

        place = f"model {name}, dofs"
        if layers not in (None, "mean"):
            raise InputError(
                f"it is {layers!r:.40}", place=f"model {name}, layers", remedy='give "mean", or leave it out'
            )
        if isinstance(given, list | tuple) and given and all(isinstance(one, pd.DataFrame) for one in given):
            return _of_runs([DofTable.of(one, name, layers) for one in given], place)
        table = given if isinstance(given, pd.DataFrame) else _table(given, place)
        for column in ("node", "direction"):
            if column not in table:
                raise InputError(f"the column {column!r} is missing", place=place, remedy="name node and direction")
        named = table["node"].notna().to_numpy() & (table["node"].astype(str).str.strip() != "").to_numpy()
        direction = np.array(
            [_direction(d, k, place) if named[k] else -1 for k, d in enumerate(table["direction"])], dtype=int
        )
        numbers = pd.to_numeric(table["node"], errors="coerce").to_numpy(dtype=float)
        wrong = np.flatnonzero(named & ~(np.isfinite(numbers) & (numbers == np.round(numbers))))
        if len(wrong):
            k = int(wrong[0])
            raise InputError(
                f"the node of row {k + 1} is {table['node'].iloc[k]!r}", place=place, remedy="give integers"
            )
        if not named.any():
            raise InputError("no row names a node", place=place, remedy="name node and direction of each")
        labels, at = np.unique(numbers[named].astype(int), return_inverse=True)
        node = np.full(len(named), -1)
        node[named] = at
        out = DofTable(node, direction, tuple(labels.tolist()), _points(table, node, len(labels), labels, place))
        again = out.repeated
        if len(again) and layers is None:
            k = int(again[0])
            more = f", as are {len(again) - 1} other rows" if len(again) > 1 else ""
            raise InputError(
                f"{DIRECTIONS[direction[k]]} of node {labels[node[k]]} is named twice{more}",
                place=f"{place}, row {k + 1}",
                remedy='name every row once; layers="mean" is for shells that CalculiX has made solids',
            )
        return out


def _of_runs(tables: Sequence[DofTable], place: str) -> DofTable:
    """The table of the first of several runs; InputError where the rows of another one differ."""
    first = tables[0]
    for run, other in enumerate(tables[1:], start=2):
        if other.n_dof != first.n_dof:
            raise InputError(
                f"run 1 has {first.n_dof} rows, and run {run} has {other.n_dof}", place=place,
                remedy="keep mesh and supports as they are from run to run",
            )  # fmt: skip
        for k in range(first.n_dof):
            if first.words(k) != other.words(k):
                raise InputError(
                    f"{first.words(k)} of run 1 is {other.words(k)} of run {run}", place=place,
                    remedy="keep mesh and options of the code from run to run: their matrices cannot be subtracted",
                )  # fmt: skip
    return first


def _table(given: Any, place: str) -> pd.DataFrame:
    """Pairs, or numbers that name node and direction, as a table."""
    import pandas as pd

    rows = [given] if isinstance(given, str | Mapping) or not isinstance(given, Iterable) else list(given)
    packed = [_number(row) for row in rows]
    if rows and all(one is not None for one in packed):
        return _unpacked(np.array(packed, dtype=float), place)
    return pd.DataFrame(two_columns(rows, place, "(node, direction)"), columns=["node", "direction"])


def _number(row: Any) -> float | None:
    """A row that is one number, which may stand alone in an array; None for any other."""
    if isinstance(row, np.ndarray) and row.size == 1:
        row = row.item()
    return float(row) if isinstance(row, int | float | np.number) and not isinstance(row, bool) else None


def _unpacked(packed: np.ndarray, place: str) -> pd.DataFrame:
    """Node and direction of numbers such as 12.3 or 12.03: the digits of all rows decide which form they have."""
    import pandas as pd

    node, known = np.floor(packed), []
    for form, _ in _PACKED:
        direction = form * (packed - node)
        whole = np.round(direction)
        known.append((np.abs(direction - whole) < _EXACT) & (whole >= 1) & (whole <= len(DIRECTIONS)))
        if known[-1].all():
            return pd.DataFrame({"node": node.astype(int), "direction": whole.astype(int)})
    k = int(np.argmin(max(known, key=np.sum)))
    forms = ", or ".join(words for _, words in _PACKED)
    raise InputError(
        f"row {k + 1} is {packed[k]:.10g}", place=place, remedy=f"name node and direction, or write {forms}"
    )


_NAMES = {
    name: k
    for names in (
        DIRECTIONS, ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ"), ("U1", "U2", "U3", "UR1", "UR2", "UR3"),
        ("T1", "T2", "T3", "R1", "R2", "R3"),
    )
    for k, name in enumerate(names)
}  # fmt: skip
"""Directions by their names here, in ANSYS, in Abaqus and in Nastran."""


def _direction(given: object, k: int, place: str) -> int:
    if isinstance(given, str) and (name := given.strip()) in _NAMES:
        return _NAMES[name]
    try:
        number = float(given)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = np.nan
    if not isinstance(given, bool) and number in range(1, len(DIRECTIONS) + 1):
        return int(number) - 1
    remedy = f"one of {', '.join(DIRECTIONS)}, 1 to 6, or UX, U1 or T1 and so on"
    if number == 0:
        remedy = (
            "0 marks a scalar point (Nastran's SPOINT), such as the amplitude of a component mode: keep the row, "
            "and leave its node and direction empty (None); no sensor lies there"
        )
    raise InputError(f"the direction of row {k + 1} is {given!r}", place=place, remedy=remedy)


def two_columns(given: object, place: str, of: str) -> list[tuple[Any, Any]]:
    """Rows of two entries each; InputError for anything else."""
    rows: list[Any] = list(given) if isinstance(given, Iterable) and not isinstance(given, str | Mapping) else [given]
    for k, row in enumerate(rows):
        if isinstance(row, str) or not isinstance(row, Sequence | np.ndarray) or len(row) != 2:
            raise InputError(f"row {k + 1} is {row!r:.40}", place=place, remedy=f"give pairs {of}")
    return [(row[0], row[1]) for row in rows]


def _points(table: pd.DataFrame, node: np.ndarray, count: int, labels: np.ndarray, place: str) -> np.ndarray:
    import pandas as pd

    out = np.full((count, 3), np.nan)
    given = [c for c in "xyz" if c in table]
    if not given:
        return out
    if len(given) < 3:
        raise InputError(f"only {', '.join(given)} of the coordinates", place=place, remedy="give x, y and z in m")
    rows = table[["x", "y", "z"]].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    if np.any(np.isnan(rows) & table[["x", "y", "z"]].notna().to_numpy()):
        raise InputError("a coordinate is not a number", place=place, remedy="give x, y and z in m")
    node, rows = node[node >= 0], rows[node >= 0]
    out[node] = rows
    apart = np.flatnonzero(np.abs(out[node] - rows).max(axis=1) > 0)
    if len(apart):
        raise InputError(f"node {labels[node[apart[0]]]} has two positions", place=place, remedy="give each node one")
    return out
