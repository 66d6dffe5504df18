"""Hypotheses on missing effects of a function of scalar responses or of modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from calib.hypotheses.function_perturbations import modal_function_perturbations, response_perturbations
from calib.hypotheses.function_variants import FunctionVariants, kept
from calib.hypotheses.hypotheses import ModelHypotheses, VariantPair
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.perturbations import Perturbation
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel

P = TypeVar("P", bound=VariantPair)


def function_hypotheses(
    model: FunctionModel | ModalFunctionModel,
    pair: P,
    effects: tuple[Effect, ...],
    space: ParameterSpace,
    test: str = "",
) -> tuple[ModelHypotheses[P], tuple[Perturbation, ...]]:
    """Hypotheses of a function against its test, and its local perturbations.

    The function is called once per point: its values are cached.

    Parameters
    ----------
    model : FunctionModel or ModalFunctionModel
    pair : ResponseResidual or ModalResidual
        The test of that model; of one of modes either.
    effects : tuple of Effect
        Named candidates.
    space : ParameterSpace
        Parameters of the model, without those that the test's condition holds; free are those that a calibration would
        fit.
    test : str
        Name of the test, where there are several; appended to perturbations of this test only.
    """
    held = [p for p in model.space.parameters if p.name not in space]
    whole = ParameterSpace((*space.parameters, *held), space.constraints)
    names, perturbations = [p.name for p in held], tuple[Perturbation, ...]()
    given: Any = replace(model, space=whole)
    cached = kept(given)
    if isinstance(model, ModalFunctionModel):
        perturbations = modal_function_perturbations(model, whole, test, names)
    else:
        measured = {name: value for name, (value, _) in pair.problem.targets.items()}
        perturbations = response_perturbations(whole, measured, test, names, model.parts)
    variants = FunctionVariants(cached, effects, tuple(a.effect for a in perturbations))
    return ModelHypotheses(pair.with_model(cached), variants, space), perturbations
