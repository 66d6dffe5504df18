"""A model loaded by the test itself: masses of accelerometers, and stiffness of an exciter's stinger to the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.errors.errors import InputError
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, parameter
from calib.structure.effects.attach import outer_term
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel


@dataclass(frozen=True, eq=False)
class Load:
    """Point masses, or springs to the ground, of one parameter.

    Attributes
    ----------
    parameter : Parameter
        Mass or stiffness of each.
    kind : {"mass", "stiffness"}
    rows : ndarray (n_rows, n_dof)
        Motions on which they act, over the degrees of freedom of the full model.
    """

    parameter: Parameter
    kind: Literal["mass", "stiffness"]
    rows: np.ndarray


def with_loads(model: StructuralModel | ReducedModel, loads: Sequence[Load]) -> StructuralModel | ReducedModel:
    """The model with loads, whose parameters follow its own.

    A reduced model keeps its basis: the change of a shape by a load is of first order in the load, and the error of a
    frequency by leaving it out of the basis of second order.

    Raises
    ------
    InputError
        When the model has a parameter of a load's name.
    """
    if not loads:
        return model
    for load in loads:
        if load.parameter.name in model.space:
            raise InputError(
                f"the model has a parameter {load.parameter.name!r} already", place=model.name, remedy="rename it"
            )
    if isinstance(model, ReducedModel):
        whole = _loaded(model.model, loads)
        return ReducedModel(whole, model.basis.carried(whole.space, whole.n_dof), model)
    return _loaded(model, loads)


def _loaded(model: StructuralModel, loads: Sequence[Load]) -> StructuralModel:
    def matrix(own: AffineMatrix, kind: str) -> AffineMatrix:
        terms = [
            outer_term(x.parameter.name, list(x.rows), parameter(x.parameter.name)) for x in loads if x.kind == kind
        ]
        return replace(own, terms=(*own.terms, *terms))

    parameters = (*model.space.parameters, *(load.parameter for load in loads))
    return replace(
        model,
        space=ParameterSpace(parameters, model.space.constraints),
        stiffness=matrix(model.stiffness, "stiffness"),
        mass=matrix(model.mass, "mass"),
    )
