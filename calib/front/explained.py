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
from calib.correlation.scatter import Floors
from calib.effect import Effect
from calib.errors import InputError, ToleranceError
from calib.front.asked import Asked, Effects, P
from calib.front.shown import Shown
from calib.front.test import ModalTest, ResponseTest, Test, under
from calib.function import FunctionModel
from calib.given import objects, whole
from calib.questions.explain import answered, decided
from calib.questions.explanation import Explanation, Told
from calib.questions.function_hypotheses import FunctionHypotheses
from calib.questions.hypotheses import ModalHypotheses
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
        own = effects.get(model.name, ())
        of = model.name if len(groups) > 1 else ""
        several = len(tests) > 1 or len(groups) > 1
        if isinstance(model, ModalFunctionModel):
            asked = [test for test in tests if isinstance(test, ModalTest)]
            out |= {test.name: _function(model, test, own, seed, several) for test in asked}
        elif isinstance(model, StructuralModel):
            modal = [test for test in tests if isinstance(test, ModalTest)]
            local = local_changes(model, [test.used for test in modal], model.space.values, of)
            out |= {test.name: _modal(model, test, own, local, seed) for test in modal}
        else:
            plain = [test for test in tests if isinstance(test, ResponseTest)]
            out |= {test.name: _plain(model, test, own, seed, several) for test in plain}
    return out


def _told(test: Test, seed: int) -> Told:
    measured = test.modes if isinstance(test, ModalTest) else test.measured
    assumed, claimed = in_words(test.assumed), test.claimed
    notes = (*notes_on(claimed, assumed), *check_repeats(measured))
    table = disagreements_table(measured)
    return Told(assumed, claimed or "none", notes, table, {}, seed, ExplainSettings().draws)


def _modal(
    model: StructuralModel, test: ModalTest, effects: tuple[Effect, ...], local: tuple[Atom, ...], seed: int
) -> Side:
    held = under(model, test.name, test.condition)
    used = test.problem(held)
    assert isinstance(held, StructuralModel)
    plain = tuple(a.effect for a in local)
    large = model.n_dof >= WORTHWHILE_DOFS
    basis = _basis(held, used, effects, plain, seed) if large else None
    space = held.space.without(dict(test.condition))
    hypotheses = ModalHypotheses(used, Variants(held, effects, plain, basis), space, Floors())
    return ModalSide(held, used, test.whole_problem(held), hypotheses, local, _told(test, seed), reduced=large)


def _basis(
    model: StructuralModel, used: ModalProblem, effects: tuple[Effect, ...], local: tuple[Effect, ...], seed: int
) -> Basis | None:
    """A reduced basis of a large model with all that it may lack; None where none reaches the tolerance."""
    highest = used.freq_window[1] if used.freq_window else float(np.inf)
    wanted = Wanted(used.mode_count, highest, ReductionSettings().tolerance, seed)
    with suppress(ToleranceError):
        return effect_basis(model, wanted.trained(model, model.space), model.space, effects, local, seed)
    return None


def _function(
    model: ModalFunctionModel, test: ModalTest, effects: tuple[Effect, ...], seed: int, several: bool
) -> Side:
    held = under(model, test.name, test.condition)
    assert isinstance(held, ModalFunctionModel)
    space, told = held.space.without(dict(test.condition)), _told(test, seed)
    used, whole = test.problem(held), test.whole_problem(held)
    return ModalSide.of_function(held, used, whole, effects, space, told, test.name if several else "")


def _plain(model: FunctionModel, test: ResponseTest, effects: tuple[Effect, ...], seed: int, several: bool) -> Side:
    held = under(model, test.name, test.condition)
    assert isinstance(held, FunctionModel)
    used = test.problem(held)
    hypotheses = FunctionHypotheses(
        held, used.targets, held.space.without(dict(test.condition)), effects, used.repeats, shares=used.shares,
        test=test.name if several else "",
    )  # fmt: skip
    return PlainSide(used, {WITHHELD_RESPONSES: test.unseen}, hypotheses, _told(test, seed))
