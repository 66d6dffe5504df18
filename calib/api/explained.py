"""Explained: the result of `Problem.explain`, which tests whether and which physical effects the models lack."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeAlias, cast

import pandas as pd

from calib.analyses.added import to_add
from calib.analyses.explain import explanation_of
from calib.analyses.propose import RANKED
from calib.analyses.provenance.places import tasks_shared
from calib.analyses.provenance.stored import with_passing
from calib.api.arguments import explain_settings
from calib.api.display import Displayed
from calib.api.entries.entry import Entry
from calib.api.pairs import including, is_generic, lacking_effects, reporting
from calib.api.proposed import Proposed, proposed
from calib.api.protocols import Candidates, Finer, P
from calib.errors.arguments import objects
from calib.errors.errors import InputError
from calib.execution.executor import AnyExecutor, injected
from calib.missing.discrepancy import TABLE as PARAMETERS
from calib.missing.findings import ExplanationResult
from calib.missing.predictions import TABLE as PREDICTIONS
from calib.problem.effect import Effect
from calib.results.ledger import Ledger
from calib.results.results import as_stored
from calib.structure.model import StructuralModel
from calib.study.measurement_settings import GENERIC
from calib.study.settings import ExplainSettings, StudySettings

Library: TypeAlias = Mapping[str, tuple[Effect, ...]]
"""Effects by the name of the model that may lack them."""


@dataclass(frozen=True, eq=False, repr=False)
class Explained(Displayed, Generic[P]):
    """Verdict on missing effects, its evidence, and the recommended next measurement.

    Attributes
    ----------
    problem : Problem
        The problem that was explained.
    effects : mapping from str to tuple of Effect
        The tested effects, by the name of the model that may lack them.
    explanation : ExplanationResult
        All results, with their tables.
    settings : StudySettings
        With those of its analysis.
    finer : mapping from str to StructuralModel
        Models on a finer mesh, by the name of the model.

    Examples
    --------
    The load of a spring that hardens, measured at four deflections; its model has one stiffness only:

    >>> import calib
    >>> space = calib.ParameterSpace((calib.Parameter("k", 10.0, 5.0, 20.0, "kN/m"),))
    >>> model = calib.FunctionModel("spring", space, lambda v: {f"load_{d}": v["k"] * d for d in (1, 2, 3, 4)})
    >>> hardening = calib.Effect(
    ...     "cubic", "hardening", "Its stiffness is constant.", "Coils that touch.",
    ...     calib.Parameter("cubic", 0.0, -1.0, 1.0, prior_sd=0.2),
    ...     lambda model: lambda v: {f"load_{d}": v["k"] * d + v["cubic"] * d**3 for d in (1, 2, 3, 4)},
    ... )
    >>> test = calib.ResponseTest({f"load_{d}": (10.2 * d + 0.1 * d**3, 0.1) for d in (1, 2, 3, 4)})
    >>> calib.Problem(model, test).explain([hardening])
    Explained(effect, cubic)
    """

    problem: P
    effects: Library
    explanation: ExplanationResult
    settings: StudySettings
    finer: Mapping[str, StructuralModel]

    @property
    def verdict(self) -> str:
        """Verdict, see `calib.missing.explanation.Explanation`: ``effect``, ``nothing_detectable`` and others."""
        return self.explanation.verdict

    @property
    def named(self) -> tuple[Effect, ...]:
        """Effects that the model lacks; empty where none is named or several are indistinguishable."""
        return tuple({e.name: e for own in self._named.values() for e in own}.values())

    @property
    def _named(self) -> Library:
        added = to_add(self.explanation.explanation)
        names = () if added is None else added.names
        every = {model: [one for e in own for one in e.family] for model, own in self.effects.items()}
        return {model: tuple(e for e in own if e.name in names) for model, own in every.items()}

    @property
    def lines(self) -> Mapping[str, str]:
        """What is missing, how sure that is, where to look and what to measure next, and where the evidence is."""
        count = len(self.explanation.notes)
        notes = f" with {count} note{'s' * (count != 1)}" if count else ""
        wider = [name for name in ("intervals", "predictions") if len(getattr(self, name))]
        rest = ", ".join([f".sentences{notes}", ".table", ".errors", *(f".{name}" for name in wider)])
        return {**self.explanation.answer.labelled, "Evidence": f"{rest}; all in .explanation"}

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        from calib.api.entries.explained import explained_entries

        return explained_entries(self.problem.study(self.settings, self.effects, self.finer), self.explanation)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict with its evidence, then notes."""
        return (*self.explanation.sentences, *self.explanation.notes)

    @property
    def table(self) -> pd.DataFrame:
        """One row per effect, best first."""
        columns = ["name", "z", "ln_bayes", "magnitude", "magnitude_low", "magnitude_high", "unit", "credible"]
        return self.explanation.effects[columns]

    @property
    def errors(self) -> pd.DataFrame:
        """Errors before and after by group of data, in standard deviations."""
        return self.explanation.errors

    @property
    def intervals(self) -> pd.DataFrame:
        """Fitted parameters with 95 % intervals, of the fit alone and with a misfit that nothing explains.

        Columns as in ``unexplained.csv``; empty where the misfit is explained.
        """
        return self.explanation.tables.get(PARAMETERS, pd.DataFrame())

    @property
    def predictions(self) -> pd.DataFrame:
        """Held-out values with 95 % intervals of their predictions, likewise; as in ``unexplained_predictions.csv``."""
        return self.explanation.tables.get(PREDICTIONS, pd.DataFrame())

    def with_named(self) -> P:
        """The problem with the named effects in its models; InputError where none is named.

        Its calibration starts at the fit of this explanation, among others.
        """
        if not self.named:
            raise InputError(
                f"nothing is named: the verdict is {self.verdict}", place="explain",
                remedy="choose effects and add them by with_effects",
            )  # fmt: skip
        chosen = to_add(self.explanation.explanation)
        made: P = including(cast(Any, self.problem), self._named, {} if chosen is None else chosen.fit.values)
        return made

    def propose(self, rank: int = RANKED, *, progress: bool = True) -> Proposed:
        """Compose effects that explain what none of the library does, from local perturbations of the model.

        Where the verdict leaves no misfit open, or no place stands out, there are none, and the result says why.

        Parameters
        ----------
        rank : int
            Proposals that are kept.
        progress : bool
            Whether to show progress on a terminal or in a notebook.

        Raises
        ------
        InputError
            For a problem of several models.
        """
        study = self.problem.study(self.settings, self.effects, self.finer)
        return proposed(study, self.explanation.explanation, rank, progress)

    def __repr__(self) -> str:
        return f"Explained({self.verdict}{''.join(f', {e.name}' for e in self.named)})"


def explained(
    problem: P,
    effects: Candidates,
    keys: Mapping[str, Any],
    finer: Finer,
    reduction: bool | Mapping[str, Any] | None,
    progress: bool,
    begin: Mapping[str, float] | None = None,
    executor: AnyExecutor | None = None,
) -> Explained[P]:
    """See `calib.api.problem.Problem.explain`."""
    models, library = [model for model, _ in problem.by_model], lacking_effects(problem, effects)
    settings = explain_settings(problem.settings, keys, reduction)
    settings = settings.model_copy(update={"effects": GENERIC if is_generic(effects) else None})
    refined = {name: mesh for name, mesh in getattr(problem, "finer", {}).items() if isinstance(mesh, StructuralModel)}
    meshes = finer_of(models, finer) or refined
    if meshes or any(test.shows_mesh for _, test in problem.pairs):  # else it does not count, which is told
        require_finer_mesh(settings.explain, meshes, problem.pairs)
    study = problem.study(settings, library, meshes)
    # As a study, which begins at stored values: bases trained 1e-10 apart differ within their tolerance.
    begin = None if begin is None else as_stored(begin)
    with (
        injected(executor) as workers, reporting("explain", progress) as step, Ledger.in_memory() as passing,
    ):  # fmt: skip
        if workers is None:
            _, answer = explanation_of(study, step, begin=begin)
        else:
            with tasks_shared(workers):
                shared = study.each(lambda one: with_passing(one, passing, workers))
                _, answer = explanation_of(shared, step, begin=begin)
    return Explained(problem, library, answer, settings, meshes)


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
