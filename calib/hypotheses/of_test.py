"""The reduced basis of a large model of a test in memory, which represents its effects and local perturbations."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from calib.correlation.basis import BasisRequirements, Reducible, is_large
from calib.errors.errors import ToleranceError
from calib.hypotheses.library import effects_basis
from calib.problem.effect import Effect
from calib.structure.effects.perturbations import Perturbation
from calib.structure.reduction.basis import Basis
from calib.study.settings import ReductionSettings


def basis_for(
    model: Any, used: Reducible, effects: tuple[Effect, ...], local: tuple[Perturbation, ...], seed: int
) -> tuple[Basis | None, bool]:
    """A reduced basis of a large model with all effects and perturbations, and whether the model is large.

    None where it is not, or the tolerance is not reached.
    """
    if (whole := model.reducible) is None or not is_large(whole):
        return None, False
    wanted = BasisRequirements.of(used, ReductionSettings().tolerance, seed)
    with suppress(ToleranceError):
        return effects_basis(model, used.space, effects, local, wanted), True
    return None, True
