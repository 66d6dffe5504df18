"""Finer meshes of the models of a problem, which tell the error of their own."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from calib.errors.arguments import objects
from calib.errors.errors import InputError
from calib.structure.model import StructuralModel
from calib.study.settings import ExplainSettings


def require_finer_mesh(
    settings: ExplainSettings, finer: Mapping[str, StructuralModel], pairs: Collection[tuple[Any, Any]]
) -> None:
    """InputError where an error of the mesh is stated without any finer mesh, or one is given for a test without.

    ``pairs`` are the models with their tests.
    """
    for model, test in pairs:
        if model.name in finer and not test.shows_mesh:
            raise InputError(f"the test {test.name} of the model {model.name} has no mesh", place="explain, finer")
    if settings.mesh_sd is not None and not finer:
        raise InputError(
            "mesh_sd states an error of the mesh, but no finer mesh is given", place="explain, mesh_sd",
            remedy="give the model on a finer mesh as finer",
        )  # fmt: skip


def finer_of(models: Collection[Any], meshes: object) -> dict[str, StructuralModel]:
    """Finer meshes by the name of the model; a single one is of the first model. InputError for an unknown name."""
    names = [model.name for model in models]
    if meshes is None:
        return {}
    if not isinstance(meshes, Mapping):
        return {names[0]: objects([meshes], StructuralModel, "explain, finer")[0]}
    for name in meshes:
        if name not in names:
            raise InputError(
                f"no model is named {name!r}", place="explain, finer", remedy=f"the models are {', '.join(names)}"
            )
    return {name: objects([model], StructuralModel, f"finer of {name}")[0] for name, model in meshes.items()}
