"""The reduced basis that a test needs of its model: what it must represent, and how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calib.correlation.frf.problem import FRFProblem
from calib.correlation.modal.problem import ModalProblem
from calib.execution.stage import Progress, silent
from calib.problem.effect import Effect
from calib.problem.parameter import Parameter
from calib.problem.space import ParameterSpace
from calib.structure.effects.perturbations import Perturbation
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.cache import basis_key
from calib.structure.reduction.effect_basis import effect_basis, frf_effect_basis
from calib.structure.reduction.frf_target import FRFTarget
from calib.structure.reduction.growth import Target
from calib.structure.reduction.training import train

WORTHWHILE_DOFS = 300
"""Degrees of freedom below which a model is fast enough at full order."""
WORTHWHILE_MODES = 25
"""Number of modes up to which that holds; of more, the limit grows in proportion."""

Reducible = ModalProblem | FRFProblem
"""Problems that a reduced basis serves."""


@dataclass(frozen=True)
class BasisRequirements:
    """What a basis must represent, and how well.

    Attributes
    ----------
    target : Target
        Modes, or FRFs with the loads of their test.
    names : tuple of str
        Parameters over which it must do so.
    seed : int
    """

    target: Target
    names: tuple[str, ...]
    seed: int

    @classmethod
    def of(cls, problem: Reducible, tolerance: float, seed: int) -> BasisRequirements:
        """The requirements of a problem at full order.

        Of modes all, up to the end of the frequency window, with ``tolerance`` as the relative error of an eigenvalue;
        of FRFs all that are in use, with `calib.structure.reduction.frf_target.TOLERANCE`.
        """
        return cls(problem.basis_target(tolerance), problem.basis_names, seed)

    def key(self, model: StructuralModel, space: ParameterSpace) -> str:
        """Hash of everything that a basis depends on: model, target, limits, constraints and seed.

        Measured values are not among it, except for the standard deviations of FRFs, the unit of their target's error.
        """
        one, own = self.target, self.within(space)
        wanted = one.count, one.freq_max, one.damping_max, one.tolerance, one.request, self.seed
        return basis_key(model, wanted, [parameter_key(p) for p in own.parameters], own.constraints)

    def within(self, space: ParameterSpace) -> ParameterSpace:
        """Those parameters of a search over which the basis is trained: gains of channels, say, are not."""
        own = tuple(p for p in space.parameters if p.name in self.names)
        return ParameterSpace(own, space.constraints) if len(own) < len(space.parameters) else space

    def trained(self, model: StructuralModel, space: ParameterSpace, progress: Progress = silent) -> Basis:
        """A basis of the model alone; EvaluationError when it cannot be solved at some training point."""
        return train(model, self.within(space), self.target, seed=self.seed, progress=progress)

    def with_effects(
        self,
        model: StructuralModel,
        basis: Basis,
        space: ParameterSpace,
        effects: Sequence[Effect],
        local: Sequence[Perturbation],
        progress: Progress = silent,
        at: Mapping[str, float] | None = None,
    ) -> Basis:
        """The next version of a basis, for effects and local perturbations; see `effect_basis`."""
        if isinstance(self.target, FRFTarget):
            return frf_effect_basis(model, basis, self.within(space), effects, self.target, self.seed, progress)
        return effect_basis(model, basis, space, effects, local, self.seed, progress, at)


def parameter_key(p: Parameter) -> tuple[object, ...]:
    """What of a parameter a basis depends on: neither its prior nor any words."""
    return p.name, p.value, p.lower, p.upper, p.unit, p.distribution, p.integer


def is_large(model: StructuralModel, count: int) -> bool:
    """Whether a basis saves time for so many modes: smaller models are fast enough at full order.

    A basis has several vectors for each mode and parameter, so that one of many modes is nearly as large as the model.
    """
    return model.n_dof >= WORTHWHILE_DOFS * max(1.0, count / WORTHWHILE_MODES)
