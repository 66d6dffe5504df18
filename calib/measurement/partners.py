"""Partners of measured nodes among the nodes of a model, by distance: their numbers need not agree."""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf_units import LENGTHS
from calib.measurement.places import Point
from calib.measurement.rules import RULES

if TYPE_CHECKING:
    import pandas as pd
    from scipy.spatial import cKDTree

PARTNER_COLUMNS = (
    "node", "x", "y", "z", "partner", "partner_x", "partner_y", "partner_z", "distance", "limit", "remark",
)  # fmt: skip
_NEIGHBOURS = 9
"""Nearest nodes among which the next one at another place is looked for; nodes of meshes may coincide."""
_NAMED = 3
"""Nodes that one sentence names."""
_COINCIDE = 1e-6
"""Distance, over the size of the model, within which nodes coincide."""
_ROUNDED = 0.01
"""Distance over its limit that is not worth a word."""
_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class NodePartners:
    """Measured nodes with their partners on a model.

    Attributes
    ----------
    table : DataFrame
        One row a measured node: ``node, x, y, z`` (m); ``partner``, the number of the model node, and its place
        ``partner_x, partner_y, partner_z`` (m), missing where the model interpolates between nodes; ``distance`` and
        ``limit`` (m), missing on a model at one place; and ``remark``, empty where nothing is to be said.
    unit : str
        What the places seem to be given in, such as ``measured places in mm``, where they do not fit in m.
    warnings : tuple of str
        What is to be checked, a sentence each.
    """

    table: pd.DataFrame
    unit: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def of(self) -> dict[int, int]:
        """Model node of every measured node within its limit."""
        near = self.table[~(self.table["distance"] > self.table["limit"]) & self.table["partner"].notna()]
        return {int(node): int(partner) for node, partner in zip(near["node"], near["partner"], strict=True)}

    @property
    def sentence(self) -> str:
        """How far measured nodes and model are apart; empty without nodes."""
        if not len(self.table):
            return ""
        what = "nodes of the model" if self.table["partner"].notna().all() else "the model"
        worst = self._worst_first.iloc[0]
        if not worst["distance"] > _ROUNDED * np.nan_to_num(worst["limit"], nan=1.0):
            return f"{_nodes(len(self.table))} placed on {what} by distance, all where the model has them."
        most = f" of {_length(worst['limit'])}" if np.isfinite(worst["limit"]) else ""
        return (
            f"{_nodes(len(self.table))} placed on {what} by distance, "
            f"{_length(self.table['distance'].median())} off in the median; "
            f"measured node {worst['node']} is the farthest for "
            f"its limit, {_length(worst['distance'])}{most}."
        )

    @property
    def _worst_first(self) -> pd.DataFrame:
        """The table, the largest distance over its limit first."""
        share = np.nan_to_num((self.table["distance"] / self.table["limit"]).to_numpy())
        return self.table.iloc[np.argsort(-share, kind="stable")]

    def text(self, most: int = 40) -> str:
        """The table in lines of text, the worst for its limit first, of at most so many nodes."""
        import pandas as pd

        rows = self._worst_first.head(most)
        places = {axis: rows[axis].map("{:.4g}".format) for axis in _AXES}
        cells = pd.DataFrame({"node": rows["node"], **places, "partner": rows["partner"].map(_number)})
        for name in ("distance", "limit"):
            cells[name] = rows[name].map(_length)
        cells["remark"] = rows["remark"]
        more = f"\nand {len(self.table) - most} more nodes" if len(self.table) > most else ""
        return "\n".join(line.rstrip() for line in cells.to_string(index=False).splitlines()) + more

    def require(self, model: str) -> NodePartners:
        """Itself; InputError with the offsets where a measured node has no partner on the model of that name.

        Also where the places of model and measurement are in different units.
        """
        beyond = self.table[self.table["distance"] > self.table["limit"]]
        if not len(beyond) and not self.unit:
            return self
        remedy = "correct the coordinates, or state a larger limit in m (node_limit under [measurement], --node-limit)"
        if self.unit:
            remedy = (
                f"it looks like {self.unit}, or the other side in a wrong unit: check that of the measurement (tables "
                "are in m, universal files state theirs or need length_unit, --measured-length-unit) and that of the "
                "model (--units of an import, --length-unit of computed nodes)"
            )
        if not len(beyond):
            count = self.table["partner"].nunique()
            words = f"{_nodes(len(self.table))} crowded on {count} node{'s' * (count != 1)} of the model {model}"
            raise InputError(words, place="sensors", remedy=remedy, table=self.text())
        rows = beyond.sort_values("distance", ascending=False, kind="stable")
        lie = "lies" if len(beyond) == 1 else "lie"
        words = f"{len(beyond)} of {len(self.table)} measured nodes {lie} off the model {model}: {_offsets(rows)}"
        raise InputError(words, place=f"sensor {rows['node'].iloc[0]}", remedy=remedy, table=self.text())


def node_partners(
    measured: Mapping[int, Point], model: Mapping[int, Point], limit: float | None = None
) -> NodePartners:
    """The nearest model node of every measured node.

    The largest distance allowed is the larger of two lengths: `RULES.partner_size` of the size of the model, since a
    tape measure and the height of a sensor do not depend on the mesh, and `RULES.partner_spacing` of the distance from
    the partner to the next node: on a line of nodes, another one would be nearer beyond.

    Parameters
    ----------
    measured, model : mapping from node to place in m
        In the same axes.
    limit : float, optional
        Largest distance of all nodes instead, m.

    Raises
    ------
    InputError
        Where the model has no node, or a limit is not positive. `NodePartners.require` raises beyond the limit.

    Examples
    --------
    >>> from calib.measurement.partners import node_partners
    >>> found = node_partners({1: (0.0, 0.0, 0.0), 2: (0.98, 0.0, 0.01)}, {k: (0.1 * k, 0.0, 0.0) for k in range(11)})
    >>> found.of
    {1: 0, 2: 10}
    """
    import pandas as pd

    if not model:
        raise InputError("no node has coordinates", place="model", remedy="give the coordinates of its nodes")
    require_limit(limit)
    labels, nodes = np.array(list(model)), np.array(list(measured), dtype=int)
    places, points = (np.array(list(own.values()), dtype=float).reshape(-1, 3) for own in (model, measured))
    found = _Nearest.of(points, places, limit)
    table = partner_table(nodes, points, found.distance, found.limit)
    table["partner"] = pd.array(labels[found.index], dtype="Int64")
    table[["partner_x", "partner_y", "partner_z"]] = places[found.index]
    after = np.where(found.ambiguous, labels[found.after], 0)
    own = labels[found.index] == nodes
    moved = (own.mean() > 0.5) & ~own & np.isin(nodes, labels) if len(own) else own
    shared = table["partner"].duplicated(keep=False).to_numpy()
    remarks: list[list[str]] = [[words] if words else [] for words in table["remark"]]
    for k, row in enumerate(remarks):
        if found.ambiguous[k]:
            row.append(f"node {after[k]} is as near")
        if shared[k]:
            row.append("shares its partner")
        if moved[k]:
            away = float(np.linalg.norm(np.array(model[int(nodes[k])]) - points[k]))
            row.append(f"the model's own node {nodes[k]} is {_length(away)} away")
    table["remark"] = [", ".join(row) for row in remarks]
    between = np.linalg.norm(places[found.after] - places[found.index], axis=1)
    matters = found.ambiguous & ((between > size_limit(places)) | (between <= _COINCIDE * found.size))
    return NodePartners(table, found.unit, _warnings(table, matters, after, moved))


def partner_table(nodes: np.ndarray, points: np.ndarray, distance: np.ndarray, limit: np.ndarray) -> pd.DataFrame:
    """`PARTNER_COLUMNS` without partners, for a model that interpolates between nodes.

    Parameters
    ----------
    nodes : ndarray (n_measured,), int
    points : ndarray (n_measured, 3)
        m.
    distance, limit : ndarray (n_measured,)
        m.
    """
    import pandas as pd

    table = pd.DataFrame({"node": nodes, **{axis: points[:, k] for k, axis in enumerate(_AXES)}})
    table["partner"] = pd.array([pd.NA] * len(nodes), dtype="Int64")
    table[["partner_x", "partner_y", "partner_z"]] = np.nan
    table = table.assign(distance=distance, limit=np.where(np.isfinite(limit), limit, np.nan))
    table["remark"] = np.where(table["distance"] > table["limit"], "beyond its limit", "").astype(object)
    return table[list(PARTNER_COLUMNS)]


def require_limit(limit: float | None) -> None:
    """InputError for a limit that is no positive length."""
    if limit is not None and not (np.isfinite(limit) and limit > 0):
        raise InputError(f"it is {limit!r:.40}", place="node_limit", remedy="give the largest distance in m, above 0")


def size_limit(places: np.ndarray) -> float:
    """Largest distance of a measured node from a model with nodes (n_nodes, 3), by its size alone, m.

    Infinite for a model at one place, such as a single rigid body, whose size is not known.
    """
    size = float(np.ptp(places, axis=0).max(initial=0.0)) if len(places) else 0.0
    return RULES.partner_size * size if size > 0 else np.inf


@dataclass(frozen=True, eq=False)
class _Nearest:
    """Nearest nodes of points, by index among the nodes; arrays are (n_points,).

    Attributes
    ----------
    index, after : ndarray, int
        The nearest node and the one after it; the first of nodes that coincide.
    distance, limit : ndarray
        m.
    ambiguous : ndarray, bool
        Whether the one after it is as near.
    size : float
        Largest extent of the nodes, m.
    unit : str
        As in `NodePartners`.
    """

    index: np.ndarray
    after: np.ndarray
    distance: np.ndarray
    limit: np.ndarray
    ambiguous: np.ndarray
    size: float
    unit: str

    @classmethod
    def of(cls, points: np.ndarray, places: np.ndarray, limit: float | None) -> _Nearest:
        from scipy.spatial import cKDTree

        tree, size = cKDTree(places), float(np.ptp(places, axis=0).max(initial=0.0))
        count = min(_NEIGHBOURS, len(places))
        far, found = (np.reshape(own, (len(points), count)) for own in tree.query(points, k=count))
        if count == 1:
            index, after = found[:, 0], found[:, 0]
        else:  # of nodes at one place the first one, whichever the tree finds first
            tied = far <= far[:, :1] + _COINCIDE * size
            index = np.where(tied, found, len(places)).min(axis=1, initial=len(places))
            after = np.where(found[:, 0] == index, found[:, 1], found[:, 0])
            after = np.where(tied.sum(axis=1) > 1, after, found[:, 1])
        distance = np.linalg.norm(places[index] - points, axis=1)
        between = np.linalg.norm(places[after] - places[index], axis=1)
        nearer = np.linalg.norm(places[after] - points, axis=1) - distance
        ambiguous = (after != index) & (nearer <= RULES.partner_ambiguous * between + _COINCIDE * size)
        allowed = _limits(tree, places[index], size, limit)
        unit = _unit(points, places, tree, allowed, index, distance, limit)
        return cls(index, after, distance, allowed, ambiguous, size, unit)


def _limits(tree: cKDTree, at: np.ndarray, size: float, limit: float | None) -> np.ndarray:
    """Largest distance from each of some nodes (n, 3) of a tree, m."""
    if limit is not None:
        return np.full(len(at), float(limit))
    count = min(_NEIGHBOURS, tree.n)
    far = np.reshape(tree.query(at, k=count)[0], (len(at), count))
    spacing = np.where(far > _COINCIDE * size, far, np.inf).min(axis=1, initial=np.inf)
    spacing = np.where(np.isfinite(spacing), spacing, 0.0)
    # rounding of a point in the middle between two nodes puts it beyond neither
    return np.asarray(np.maximum(size_limit(tree.data), RULES.partner_spacing * spacing + _COINCIDE * size))


def _unit(
    points: np.ndarray, places: np.ndarray, tree: cKDTree, allowed: np.ndarray, index: np.ndarray,
    distance: np.ndarray, limit: float | None,
) -> str:  # fmt: skip
    """In which other unit places fit that do not fit in m: most within their limits, on as many nodes as there are.

    Of several units the one in which measurement and model are most alike in size.
    """
    n_places = len(np.unique(points, axis=0))
    fits = np.mean(distance <= allowed) if len(points) else 1.0
    if fits >= RULES.partner_share and len(np.unique(index)) >= RULES.partner_share * n_places:
        return ""
    size = float(np.ptp(places, axis=0).max(initial=0.0))
    extent = float(np.ptp(points, axis=0).max(initial=0.0)) or float(np.abs(points).max(initial=0.0))
    found = []
    for unit, metres in LENGTHS.items():
        for factor, whose in ((metres, "measured places"), (1 / metres, "places of the model")):
            far, at = tree.query(points * factor)
            near = far <= _limits(tree, places[at], size, limit)
            if factor != 1 and near.mean() >= RULES.partner_share and len(np.unique(at)) >= n_places * near.mean():
                found.append((abs(np.log(extent * factor / size)) if size and extent else 0.0, f"{whose} in {unit}"))
    in_words = min(found)[1] if found else ""
    return re.sub(" in (in|ft)$", lambda own: {"in": " in inches", "ft": " in feet"}[own[1]], in_words)


def _warnings(table: pd.DataFrame, ambiguous: np.ndarray, after: np.ndarray, moved: np.ndarray) -> tuple[str, ...]:
    """Sentences on what is to be checked among nodes that are within their limits."""
    out = []
    if ambiguous.any():
        said = [f"node {r['node']} (nodes {r['partner']} and {n})" for r, n in _rows(table, ambiguous, after)]
        out.append(f"Two model nodes are as near to {_few(said)}: the first one is taken.")
    twice = table[table["partner"].duplicated(keep=False)]
    if len(twice):
        groups = [f"{', '.join(map(str, own))} (node {at})" for at, own in twice.groupby("partner")["node"]]
        out.append(f"Measured nodes share one model node, where they move alike: {_few(groups, '; ')}.")
    if moved.any():
        said = [f"node {r['node']} (on node {r['partner']})" for r, _ in _rows(table, moved, after)]
        out.append(
            f"Most measured nodes lie on the model node of their number, but not {_few(said)}: check coordinates and "
            "numbers."
        )
    share = table["distance"] / table["limit"]
    far = ((share > RULES.partner_told) & (share <= 1)).to_numpy()
    if far.any():
        said = [f"node {r['node']} by {_length(r['distance'])} of {_length(r['limit'])}" for r, _ in
                _rows(table, far, after)]  # fmt: skip
        out.append(f"Nearly as far off the model as is allowed: {_few(said)}. Check the coordinates.")
    return tuple(out)


def _rows(table: pd.DataFrame, chosen: np.ndarray, after: np.ndarray) -> list[tuple[dict[Hashable, Any], int]]:
    return list(zip(table[chosen].to_dict("records"), after[chosen].tolist(), strict=True))


def _few(said: Sequence[str], between: str = ", ") -> str:
    more = f" and {len(said) - _NAMED} more" if len(said) > _NAMED else ""
    return between.join(said[:_NAMED]) + more


def _offsets(rows: pd.DataFrame) -> str:
    """The first rows of a table of partners in words."""
    import pandas as pd

    return _few(
        [
            f"node {r['node']} by {_length(r['distance'])}"
            + ("" if pd.isna(r["partner"]) else f" from node {r['partner']}")
            + f" (limit {_length(r['limit'])})"
            for r in rows.to_dict("records")
        ],
        "; ",
    )


def _nodes(count: int) -> str:
    return f"{count} measured node{' is' if count == 1 else 's are'}"


def _number(node: Any) -> str:
    import pandas as pd

    return "" if pd.isna(node) else str(node)


def _length(metres: float) -> str:
    """A length in words."""
    return f"{1e3 * metres:.3g} mm" if metres < 1 else f"{metres:.3g} m"
