"""What a test asks of a function about missing effects, be it of plain responses or of modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from calib.effect import Effect
from calib.function import FunctionModel
from calib.questions.function_atoms import modal_function_atoms, response_atoms
from calib.questions.function_variants import FunctionVariants, kept
from calib.questions.hypotheses import ModelHypotheses, VariantPair
from calib.space import ParameterSpace
from calib.structure.atoms import Atom
from calib.structure.modal_function import ModalFunctionModel

P = TypeVar("P", bound=VariantPair)


def function_hypotheses(
    model: FunctionModel | ModalFunctionModel,
    pair: P,
    effects: tuple[Effect, ...],
    space: ParameterSpace | None = None,
    test: str = "",
) -> tuple[ModelHypotheses[P], tuple[Atom, ...]]:
    """All that a function may lack, against a test of it, and its local changes.

    No point is asked twice of the function: whatever is told of a decision finds the answers that it has had.

    Parameters
    ----------
    model : FunctionModel or ModalFunctionModel
    pair : ResponseResidual or ModalResidual
        The test of that model.
    effects : tuple of Effect
        Named candidates.
    space : ParameterSpace, optional
        Parameters of the model, without those that the test's condition holds; free are those that a calibration would
        fit. By default the model's own.
    test : str
        Told with changes that are of one test only, where there are several.
    """
    own = model.space if space is None else space
    held = [p for p in model.space.parameters if p.name not in own]
    whole = ParameterSpace((*own.parameters, *held), own.constraints)
    names, atoms = [p.name for p in held], tuple[Atom, ...]()
    given: Any = replace(model, space=whole)
    asked = kept(given)
    if isinstance(model, ModalFunctionModel):
        atoms = modal_function_atoms(model, whole, pair.problem.measured.sensors, test, names)
    else:
        measured = {name: value for name, (value, _) in pair.problem.targets.items()}
        atoms = response_atoms(whole, measured, test, names)
    variants = FunctionVariants(asked, effects, tuple(a.effect for a in atoms))
    return ModelHypotheses(pair.with_model(asked), variants, own), atoms
