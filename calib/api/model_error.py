"""Stated errors of the models of a problem: parameters that are held at uncertain values, and the mesh."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from calib.analyses.uncertain import freed, uncertain_words
from calib.errors.arguments import number, objects
from calib.errors.errors import InputError
from calib.experiment.modal import Model, Test, under
from calib.hypotheses.mesh_term import mesh_words, with_mesh_error
from calib.missing.test import Adapter
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel
from calib.study.settings import ExplainSettings


@dataclass(frozen=True, eq=False)
class ModelError:
    """What the models of a problem may be off by, beside the effects that they may lack.

    Attributes
    ----------
    fixed_sd : str or None
        As in `calib.study.settings.ExplainSettings`.
    finer : mapping from str to StructuralModel
        By the name of the model the same on a finer mesh.
    mesh_sd : float or None
        As in `calib.study.settings.ExplainSettings`.

    Raises
    ------
    InputError
        For a share or a multiple out of range, and for a multiple without any finer mesh.
    """

    fixed_sd: str | None = None
    finer: Mapping[str, StructuralModel] = field(default_factory=dict)
    mesh_sd: float | None = None

    def __post_init__(self) -> None:
        if self.fixed_sd is not None:
            try:
                ExplainSettings(fixed_sd=self.fixed_sd)
            except ValueError:
                raise InputError(
                    f"fixed_sd is {self.fixed_sd!r}", place="explain, fixed_sd",
                    remedy="give a share of the nominal values, from above 0 to '20 %', such as '3 %'",
                ) from None  # fmt: skip
        if self.mesh_sd is None:
            return
        if not 0 < number(self.mesh_sd, "explain, mesh_sd") <= 10:
            raise InputError(
                f"mesh_sd is {self.mesh_sd:g}", place="explain, mesh_sd",
                remedy="give a multiple of the change to the finer mesh, from above 0 to 10, such as 1.33",
            )  # fmt: skip
        if not self.finer:
            raise InputError(
                "mesh_sd states an error of the mesh, but no finer mesh is given", place="explain, mesh_sd",
                remedy="give the model on a finer mesh as finer",
            )  # fmt: skip

    def of(self, model: Model, unselected: Collection[str]) -> Model:
        """A model with those of its unselected parameters free that are uncertain."""
        if self.fixed_sd is None:
            return model
        return replace(model, space=freed(model.space, self._uncertain(model, unselected), self.fixed_sd))

    def within(self, adapter: Adapter, model: Model, test: Test, several: bool) -> Adapter:
        """The adapter of a test of a model with the error of its mesh, and with the scores that are due to it."""
        if model.name not in self.finer:
            return adapter
        finer: Any = under(self.finer[model.name], test.name, test.condition)
        if not adapter.on_mesh:
            raise InputError(f"the test {test.name} of the model {model.name} has no mesh", place="explain, finer")
        own: Any = adapter
        adapter = replace(own, finer=lambda: finer)
        return adapter if self.mesh_sd is None else with_mesh_error(adapter, finer, self.mesh_sd, several * test.name)

    def notes(self, models: Collection[Model], unselected: Collection[str]) -> tuple[str, ...]:
        """Which unselected parameters are uncertain and which are exact, in words."""
        if self.fixed_sd is None:
            return ()
        names = dict.fromkeys(p.name for model in models for p in self._uncertain(model, unselected))
        return (uncertain_words(self.fixed_sd, list(names), [n for n in unselected if n not in names]),)

    @property
    def supposed(self) -> tuple[str, ...]:
        """What the covariance of the residual has beside the measurement, in sentences."""
        return mesh_words(self.mesh_sd)

    @staticmethod
    def _uncertain(model: Model, unselected: Collection[str]) -> tuple[Parameter, ...]:
        own = (p for p in model.space.parameters if p.name in unselected)
        return tuple(p for p in own if not p.integer and p.value != 0)


EXACT = ModelError()
"""Models that lack nothing but effects."""


def finer_of(models: Collection[Model], given: object) -> dict[str, StructuralModel]:
    """Finer meshes by the name of the model; a single one is of the first model. InputError for an unknown name."""
    names = [model.name for model in models]
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        return {names[0]: objects([given], StructuralModel, "explain, finer")[0]}
    for name in given:
        if name not in names:
            raise InputError(
                f"no model is named {name!r}", place="explain, finer", remedy=f"the models are {', '.join(names)}"
            )
    return {name: objects([model], StructuralModel, f"finer of {name}")[0] for name, model in given.items()}
