"""What a model lacks, as a notebook asks it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import ModalProblem
from calib.effect import Effect
from calib.errors import InputError, ToleranceError
from calib.front.asked import Asked, Effects, P
from calib.front.shown import Shown
from calib.front.test import ModalTest, Model, ResponseTest, Test, under
from calib.function import FunctionModel
from calib.given import objects, whole
from calib.questions.explain import answered, decided
from calib.questions.explanation import Explanation, Told
from calib.questions.function_hypotheses import function_hypotheses
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.joint_side import together
from calib.questions.library import local_changes
from calib.questions.modal_side import ModalSide
from calib.questions.plain_side import PlainSide
from calib.questions.record import check_repeats, disagreements_table
from calib.questions.reduction import WORTHWHILE_DOFS, Wanted
from calib.questions.scatter import in_words, notes_on
from calib.questions.side import Side
from calib.questions.verify import WITHHELD_RESPONSES
from calib.settings import ExplainSettings, ReductionSettings
from calib.structure.atoms import Atom
from calib.structure.basis import Basis
from calib.structure.effect_basis import effect_basis
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.structure.variants import Variants

Library: TypeAlias = Mapping[str, tuple[Effect, ...]]
"""Effects by the name of the model that may lack them."""


@dataclass(frozen=True, eq=False, repr=False)
class Explained(Shown, Generic[P]):
    """What the model lacks, how sure that is, and what to measure next.

    Attributes
    ----------
    problem : Problem
        That was asked.
    effects : mapping from str to tuple of Effect
        That were asked about, by the name of the model that may lack them.
    explanation : Explanation
        Everything that is told, with its tables.
    """

    problem: P
    effects: Library
    explanation: Explanation

    @property
    def verdict(self) -> str:
        """One of the verdicts of `calib.missing.findings.Findings`, such as ``effect`` or ``nothing_detectable``."""
        return self.explanation.verdict

    @property
    def named(self) -> tuple[Effect, ...]:
        """Effects that the model lacks; empty where none may be named or several cannot be told apart."""
        return tuple({e.name: e for own in self._named.values() for e in own}.values())

    @property
    def _named(self) -> Library:
        credible = self.explanation.findings.credible if self.verdict in ("effect", "two_effects") else ()
        return {model: tuple(e for e in own if e.name in credible) for model, own in self.effects.items()}

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict with what supports it, then what a reader must know."""
        return (*self.explanation.sentences, *self.explanation.notes)

    @property
    def table(self) -> pd.DataFrame:
        """One row an effect, best first."""
        return self.explanation.effects[["name", "z", "ln_bayes", "phi", "phi_low", "phi_high", "unit", "credible"]]

    @property
    def errors(self) -> pd.DataFrame:
        """Errors before and after by group of data, in units of the scatter."""
        return self.explanation.errors

    def with_named(self) -> P:
        """The problem with what is named in its model; InputError where nothing is."""
        if not self.named:
            raise InputError(
                f"nothing is named: the verdict is {self.verdict}", place="explain",
                remedy="choose effects and add them by with_effects",
            )  # fmt: skip
        return self.problem.with_effects(self._named)

    def __repr__(self) -> str:
        return f"Explained({self.verdict}{''.join(f', {e.name}' for e in self.named)})"


def explained(problem: P, effects: Effects, seed: int) -> Explained[P]:
    """See `calib.front.problem.Problem.explain`."""
    library, seed = library_of(problem, effects), whole(seed, 0, "seed")
    started = time.perf_counter()
    side = together(_sides(problem, library, seed))
    found = decided(side, ExplainSettings().model_copy(update={"seed": seed}), "explain")
    return Explained(problem, library, answered(side, found, lambda words: None, started))


def library_of(problem: Asked, effects: Effects) -> Library:
    """Effects by the name of the model, by default of the first; InputError for a name that no model has."""
    known = [model.name for model, _ in problem.by_model]
    if not isinstance(effects, Mapping):
        return {known[0]: objects(effects, Effect, "effects")}
    for name in effects:
        if name not in known:
            raise InputError(
                f"no model is named {name!r}", place="effects", remedy=f"the models are {', '.join(known)}"
            )
    return {name: objects(own, Effect, f"effects of {name}") for name, own in effects.items()}


def _sides(problem: Asked, effects: Library, seed: int) -> dict[str, Side]:
    """What each test asks of its model; all tests of one model ask about the same local changes of it."""
    groups = problem.by_model
    out: dict[str, Side] = {}
    for model, tests in groups:
        own, several = effects.get(model.name, ()), len(tests) > 1 or len(groups) > 1
        local: tuple[Atom, ...] = ()
        if isinstance(model, StructuralModel):
            measured = [test.used for test in tests if isinstance(test, ModalTest)]
            local = local_changes(model, measured, model.space.values, model.name if len(groups) > 1 else "")
        out |= {test.name: _side(model, test, own, local, seed, several) for test in tests}
    return out


def _side(
    model: Model, test: Test, effects: tuple[Effect, ...], local: tuple[Atom, ...], seed: int, several: bool
) -> Side:
    """What one test asks; its name is told with changes that are of it alone where there are several."""
    held, told = under(model, test.name, test.condition), _told(test, seed)
    space, name = held.space.without(dict(test.condition)), test.name if several else ""
    if isinstance(test, ResponseTest):
        assert isinstance(held, FunctionModel)
        plain, asked = function_hypotheses(held, test.pair(held), effects, space, name)
        return PlainSide(plain, asked, told, {WITHHELD_RESPONSES: test.unseen})
    pair, whole = test.pair(held), test.whole_problem(held)
    if isinstance(held, ModalFunctionModel):
        modal, asked = function_hypotheses(held, pair, effects, space, name)
        return ModalSide(modal, asked, told, whole)
    assert isinstance(held, StructuralModel)
    changes, large = tuple(a.effect for a in local), held.n_dof >= WORTHWHILE_DOFS
    basis = _basis(held, pair.problem, effects, changes, seed) if large else None
    modal = ModelHypotheses(pair, Variants(held, effects, changes, basis), space)
    return ModalSide(modal, local, told, whole, reduced=large)


def _told(test: Test, seed: int) -> Told:
    measured = test.modes if isinstance(test, ModalTest) else test.measured
    assumed, claimed = in_words(test.assumed), test.claimed
    notes = (*notes_on(claimed, assumed), *check_repeats(measured))
    table = disagreements_table(measured)
    return Told(assumed, claimed or "none", notes, table, {}, seed, ExplainSettings().draws)


def _basis(
    model: StructuralModel, used: ModalProblem, effects: tuple[Effect, ...], local: tuple[Effect, ...], seed: int
) -> Basis | None:
    """A reduced basis of a large model with all that it may lack; None where none reaches the tolerance."""
    highest = used.freq_window[1] if used.freq_window else float(np.inf)
    wanted = Wanted(used.mode_count, highest, ReductionSettings().tolerance, seed)
    with suppress(ToleranceError):
        return effect_basis(model, wanted.trained(model, model.space), model.space, effects, local, seed)
    return None
