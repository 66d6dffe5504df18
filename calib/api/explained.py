"""Explained: the result of `Problem.explain`, which tests whether and which physical effects the models lack."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeAlias

import pandas as pd

from calib.analyses.added import to_add
from calib.analyses.explain import explain_tests, require_usable
from calib.analyses.propose import RANKED
from calib.analyses.provenance.record import check_repeats, disagreements_table
from calib.analyses.uncertainty import in_words, notes_on
from calib.api.display import Shown
from calib.api.model_error import EXACT, ModelError, finer_of
from calib.api.progress import in_python
from calib.api.proposed import Proposed, proposed
from calib.api.protocols import Effects, Finer, P, PosedProblem
from calib.errors.arguments import integer, objects
from calib.errors.errors import InputError
from calib.experiment.modal import Test, under
from calib.hypotheses.joint import together
from calib.hypotheses.library import local_perturbations
from calib.missing.discrepancy import TABLE as PARAMETERS
from calib.missing.facts import MeasurementFacts
from calib.missing.findings import ExplanationResult
from calib.missing.predictions import TABLE as PREDICTIONS
from calib.missing.test import Adapter
from calib.problem.effect import Effect
from calib.study.loading import require_distinct
from calib.study.settings import ExplainSettings

Library: TypeAlias = Mapping[str, tuple[Effect, ...]]
"""Effects by the name of the model that may lack them."""


@dataclass(frozen=True, eq=False, repr=False)
class Explained(Shown, Generic[P]):
    """Verdict on missing effects, its evidence, and the recommended next measurement.

    Attributes
    ----------
    problem : Problem
        The problem that was explained.
    effects : mapping from str to tuple of Effect
        The tested effects, by the name of the model that may lack them.
    explanation : ExplanationResult
        All results, with their tables.
    seed : int
        Of its random numbers.
    error : ModelError
        Stated errors of the models.

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
    seed: int = 1
    error: ModelError = EXACT

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
        return {model: tuple(e for e in own if e.name in names) for model, own in self.effects.items()}

    @property
    def lines(self) -> Mapping[str, str]:
        """What is missing, how sure that is, where to look and what to measure next, and where the evidence is."""
        count = len(self.explanation.notes)
        notes = f" with {count} note{'s' * (count != 1)}" if count else ""
        wider = [name for name in ("intervals", "predictions") if len(getattr(self, name))]
        rest = ", ".join([f".sentences{notes}", ".table", ".errors", *(f".{name}" for name in wider)])
        return {**self.explanation.answer.labelled, "Evidence": f"{rest}; all in .explanation"}

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
        """The problem with the named effects in its models; InputError where none is named."""
        if not self.named:
            raise InputError(
                f"nothing is named: the verdict is {self.verdict}", place="explain",
                remedy="choose effects and add them by with_effects",
            )  # fmt: skip
        return self.problem.with_effects(self._named)

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
        adapter = together(_adapters(self.problem, self.effects, self.seed, self.error))
        family = [one for own in self.effects.values() for effect in own for one in effect.family]
        taken = [name for one in family for name in one.names]
        return proposed(self.problem, adapter, self.explanation.explanation, taken, rank, progress)

    def __repr__(self) -> str:
        return f"Explained({self.verdict}{''.join(f', {e.name}' for e in self.named)})"


def explained(
    problem: P, effects: Effects, seed: int, progress: bool, fixed_sd: str | None, finer: Finer, mesh_sd: float | None
) -> Explained[P]:
    """See `calib.api.problem.Problem.explain`."""
    library, seed = library_of(problem, effects), integer(seed, 0, "seed")
    known = [(model, library.get(model.name, ())) for model, _ in problem.by_model]
    for model, own in known:
        require_distinct(own, model, "effects")
    require_usable(known, "effects")
    models = [model for model, _ in known]
    error = ModelError(fixed_sd, finer_of(models, finer), mesh_sd)
    started = time.perf_counter()
    with in_python("explain", progress) as told:
        adapter = together(_adapters(problem, library, seed, error))
        settings = ExplainSettings().model_copy(update={"seed": seed})
        answer = explain_tests(adapter, settings, "explain", started, error.supposed, told)
        notes = (*answer.notes, *error.notes(models, problem.unselected))
        return Explained(problem, library, replace(answer, notes=notes), seed, error)


def library_of(problem: PosedProblem, effects: Effects) -> Library:
    """Effects by the name of the model; a plain sequence is for the first. InputError for an unknown model."""
    known = [model.name for model, _ in problem.by_model]
    if not isinstance(effects, Mapping):
        return {known[0]: objects(effects, Effect, "effects")}
    for name in effects:
        if name not in known:
            raise InputError(
                f"no model is named {name!r}", place="effects", remedy=f"the models are {', '.join(known)}"
            )
    return {name: objects(own, Effect, f"effects of {name}") for name, own in effects.items()}


def _adapters(problem: PosedProblem, effects: Library, seed: int, error: ModelError = EXACT) -> dict[str, Adapter]:
    """Adapters by name of the test; all tests of one model share its local perturbations."""
    groups = problem.by_model
    out: dict[str, Adapter] = {}
    for given, tests in groups:
        model = error.of(given, problem.unselected)
        own, several = effects.get(model.name, ()), len(tests) > 1 or len(groups) > 1
        measured = [data for test in tests for data in test.sensed]
        local = local_perturbations(model, measured, model.space.values, model.name if len(groups) > 1 else "")
        for test in tests:
            held, facts = under(model, test.name, test.condition), _facts(test, seed)
            adapter = test.adapter(held, own, local, facts, test.name if several else "")
            out[test.name] = error.within(adapter, model, test, several)
    return out


def _facts(test: Test, seed: int) -> MeasurementFacts:
    assumed, claimed = in_words(test.assumed), test.claimed
    notes = (*notes_on(claimed, assumed), *check_repeats(test))
    table = disagreements_table(test)
    return MeasurementFacts(assumed, claimed, notes, table, {}, seed, ExplainSettings().samples)
