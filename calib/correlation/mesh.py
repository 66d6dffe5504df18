"""Tables of a model's mesh, for figures of its modes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from calib.structure.geometry import Mesh
from calib.structure.modal_model import ModalModel
from calib.structure.places import ModelPlace


def geometry_tables(model: ModalModel) -> dict[str, pd.DataFrame]:
    """Return ``mesh_points``, ``mesh_elements`` and ``model_places`` of a model; none without coordinates."""
    if not model.mesh.placed.any():
        return {}
    return {
        "mesh_points": points_table(model.mesh),
        "mesh_elements": elements_table(model.mesh),
        "model_places": places_table(model.places),
    }


def points_table(mesh: Mesh) -> pd.DataFrame:
    """Return the points of a mesh with known coordinates, numbered from 0 among all: columns ``point, x, y, z`` (m)."""
    return pd.DataFrame(mesh.points, columns=["x", "y", "z"]).rename_axis("point").reset_index()[mesh.placed]


def elements_table(mesh: Mesh) -> pd.DataFrame:
    """Return lines and faces between the points: columns ``group, a, b, c, d``; a line has no ``c`` and ``d``.

    Lines whose group has faces are left out, as edges of these faces, and so are elements with a point of unknown
    coordinates.
    """
    shells = set(mesh.face_groups)
    alone = np.array([group not in shells for group in mesh.groups], dtype=bool)
    lines = pd.DataFrame(np.reshape(mesh.lines, (-1, 2))[alone], columns=["a", "b"]).astype("Int64")
    lines.insert(0, "group", [group for group in mesh.groups if group not in shells])
    faces = pd.DataFrame(mesh.faces, columns=["a", "b", "c", "d"]).astype("Int64")
    faces.insert(0, "group", list(mesh.face_groups))
    table = pd.concat([lines, faces], ignore_index=True).reindex(columns=["group", "a", "b", "c", "d"])
    lost = np.flatnonzero(~mesh.placed)
    return table[~table[["a", "b", "c", "d"]].isin(lost).any(axis=1)].reset_index(drop=True) if len(lost) else table


def places_table(places: Iterable[ModelPlace]) -> pd.DataFrame:
    """Return pieces of a model that have coordinates.

    Returns
    -------
    DataFrame
        Columns ``name, form, kind, parameters`` (names with semicolons between) and ``x, y, z`` (m).
    """
    rows = [(p.name, p.form, p.kind, "; ".join(p.parameters), *p.place) for p in places if np.isfinite(p.place).all()]
    return pd.DataFrame(rows, columns=["name", "form", "kind", "parameters", "x", "y", "z"])
