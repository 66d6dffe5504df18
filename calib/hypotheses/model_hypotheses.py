"""Hypotheses of a test of a model, be it of matrices or a function: effects and local perturbations."""

from __future__ import annotations

from typing import Any, TypeVar

from calib.hypotheses.function_hypotheses import function_hypotheses
from calib.hypotheses.hypotheses import ModelHypotheses, VariantPair
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.perturbations import Perturbation
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis

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
