"""Hypotheses of a test in memory: its model with effects and local perturbations, on a reduced basis if it is large."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, TypeVar

from calib.analyses.function_hypotheses import function_hypotheses
from calib.analyses.hypotheses import ModelHypotheses, VariantPair
from calib.analyses.library import effects_basis
from calib.analyses.reduction import WORTHWHILE_DOFS, Reducible, Wanted
from calib.effect import Effect
from calib.errors import ToleranceError
from calib.settings import ReductionSettings
from calib.space import ParameterSpace
from calib.structure.basis import Basis
from calib.structure.model import StructuralModel
from calib.structure.perturbations import Perturbation
from calib.structure.variants import Variants

P = TypeVar("P", bound=VariantPair)


def hypotheses(
    model: Any,
    pair: P,
    effects: tuple[Effect, ...],
    local: tuple[Perturbation, ...],
    space: ParameterSpace,
    name: str,
    basis: Basis | None = None,
) -> tuple[ModelHypotheses[P], tuple[Perturbation, ...]]:
    """Hypotheses of a model against its test, and its local perturbations.

    Those of matrices are given as ``local``, since all tests of the model share them; a function has its own, which
    bear the ``name`` of the test where there are several.
    """
    if not isinstance(model, StructuralModel):
        return function_hypotheses(model, pair, effects, space, name)
    return ModelHypotheses(pair, Variants(model, effects, tuple(a.effect for a in local), basis), space), local


def basis_for(
    model: Any, used: Reducible, effects: tuple[Effect, ...], local: tuple[Perturbation, ...], seed: int
) -> tuple[Basis | None, bool]:
    """A reduced basis of a large model with all effects and perturbations, and whether the model is large.

    None where it is not, or the tolerance is not reached.
    """
    if not isinstance(model, StructuralModel) or model.n_dof < WORTHWHILE_DOFS:
        return None, False
    wanted = Wanted.of(used, ReductionSettings().tolerance, seed)
    with suppress(ToleranceError):
        return effects_basis(model, used.space, effects, local, wanted), True
    return None, True
