"""Error of the mesh as an uncertain multiple of the change to a finer one: a term of the residual's covariance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.correlation.rules import RULES
from calib.errors.errors import EvaluationError, InputError
from calib.execution.tasks import each
from calib.problem.space import Parameter
from calib.results.fingerprint import digest_of
from calib.structure.geometry import Mesh
from calib.structure.modal_model import ModalModel
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.places import ModelPlace

if TYPE_CHECKING:
    import pandas as pd

    from calib.results.results import Results

GEOMETRY = ("mesh_points.csv", "mesh_elements.csv", "model_places.csv")
"""Files of `geometry_tables`."""


def geometry_tables(model: ModalModel) -> dict[str, pd.DataFrame]:
    """Return ``mesh_points``, ``mesh_elements`` and ``model_places`` of a model; none without coordinates."""
    if not model.mesh.placed.any():
        return {}
    return {
        "mesh_points": points_table(model.mesh),
        "mesh_elements": elements_table(model.mesh),
        "model_places": places_table(model.places),
    }


def write_geometry(results: Results, model: ModalModel) -> None:
    """Write `geometry_tables`; earlier ones go where there is nowhere to draw anything."""
    tables = geometry_tables(model)
    if not tables:
        results.remove(*GEOMETRY)
    for name, table in tables.items():
        results.write_table(name, table)


def points_table(mesh: Mesh) -> pd.DataFrame:
    """Return the points of a mesh with known coordinates, numbered from 0 among all: columns ``point, x, y, z`` (m)."""
    import pandas as pd

    return pd.DataFrame(mesh.points, columns=["x", "y", "z"]).rename_axis("point").reset_index()[mesh.placed]


def elements_table(mesh: Mesh) -> pd.DataFrame:
    """Return lines and faces between the points: columns ``group, a, b, c, d``; a line has no ``c`` and ``d``.

    Lines whose group has faces are left out, as edges of these faces, and so are elements with a point of unknown
    coordinates.
    """
    import pandas as pd

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
        Columns ``name, form, kind, parameters`` (names with semicolons between), ``x, y, z`` (m) and ``dx, dy, dz``
        (direction of a spring or damper).
    """
    import pandas as pd

    rows = [
        (p.name, p.form, p.kind, "; ".join(p.parameters), *p.place, *p.direction)
        for p in places
        if np.isfinite(p.place).all()
    ]
    return pd.DataFrame(rows, columns=["name", "form", "kind", "parameters", "x", "y", "z", "dx", "dy", "dz"])


NAME = "mesh_error"
"""Name of the multiple; that of one of several tests bears the name of the test."""


@dataclass(frozen=True, eq=False)
class MeshError:
    """What a finer mesh changes in the predictions at one point, times a multiple with a prior about 0.

    With the change ``d`` of the predictions and the standard deviation ``s`` of the multiple, the fitted multiple
    counts like the covariance ``s^2 d d^T`` added to that of the data: what the mesh may be off by is one correlated
    error of all data, with a known pattern and an unknown size. Richardson's extrapolation expects the multiple
    ``r^p/(r^p - 1)`` for elements r times smaller and predictions that converge with the order p (Roache 1994): 1.33
    for halved elements and p = 2, 1.07 for p = 4.

    Attributes
    ----------
    coarse, finer : StructuralModel
        The model and the same on a finer mesh, at full order; both have the same parameters.
    values : mapping from str to float
        Point at which they are compared, each parameter in its own unit.
    sd : float
        Standard deviation of the multiple.
    test : str
        Name of the test, where there are several.

    Raises
    ------
    InputError
        When the finer model has other parameters.
    """

    coarse: StructuralModel
    finer: StructuralModel
    values: Mapping[str, float]
    sd: float
    test: str = ""
    _kept: dict[object, Any] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        other = set(self.coarse.space.names) ^ set(self.finer.space.names)
        if other:
            raise InputError(
                f"only one of model and finer model has the parameter {sorted(other)[0]}", place="finer mesh",
                remedy="change the size of the elements alone",
            )  # fmt: skip

    @property
    def name(self) -> str:
        """Of the multiple."""
        return f"{NAME} in test {self.test}" if self.test else NAME

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the change of any prediction could."""
        known = self.coarse.fingerprint, self.finer.fingerprint, sorted(self.values.items())
        return digest_of(*known, self.sd, self.test)[:16]

    @property
    def parameter(self) -> Parameter:
        """The multiple, 0 for the mesh as it is, about 1 for the finer one."""
        words = "Error of the mesh, over the change to the finer one"
        reach = RULES.mesh_reach * self.sd
        return Parameter(self.name, 0.0, -reach, reach, "-", prior_sd=self.sd, description=words)

    def at(self, values: Mapping[str, float]) -> float:
        """The multiple among named values; 0 where it is missing."""
        return float(values.get(self.name, 0.0))

    def without(self, values: Mapping[str, float]) -> dict[str, float]:
        """Named values without the multiple."""
        return {name: value for name, value in values.items() if name != self.name}

    def others(self, names: Sequence[str]) -> list[str]:
        """The names without that of the multiple."""
        return [name for name in names if name != self.name]

    def own(self, model: StructuralModel) -> dict[str, float]:
        """The values of a model's parameters at the point."""
        return {name: value for name, value in self.values.items() if name in model.space}

    def modes(self, count: int) -> tuple[Modes, Modes]:
        """Modes of both meshes; InputError where the finer one cannot be solved."""
        if count not in self._kept:
            try:
                both = [(model, self.own(model)) for model in (self.coarse, self.finer)]
                found = each(_modes, count, both)
            except EvaluationError as fault:
                raise InputError(f"the finer model cannot be solved ({fault})", place="finer mesh") from None
            self._kept[count] = tuple(found)
        kept: tuple[Modes, Modes] = self._kept[count]
        return kept

    def functions(self, problem: Any) -> np.ndarray:
        """Change of the FRFs of an `FRFProblem`, (n_freq, n_responses, n_references), complex.

        InputError where the finer model has no such FRFs.
        """
        key = (problem.measured.fingerprint, tuple(sorted(n for n in problem.space.names if n in self.values)))
        if key not in self._kept:
            found = []
            for model in (self.coarse, self.finer):
                own = problem.of_mesh(model)
                values = {name: value for name, value in self.values.items() if name in own.space}
                try:
                    found.append(own.functions(values))
                except (EvaluationError, InputError) as fault:
                    raise InputError(f"the finer model has no such FRFs ({fault})", place="finer mesh") from None
            self._kept[key] = found[1] - found[0]
        change: np.ndarray = self._kept[key]
        return change


def _modes(count: int, at: tuple[StructuralModel, Mapping[str, float]]) -> Modes:
    model, values = at
    return model.modes(values, count)
