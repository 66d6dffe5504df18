"""What a model lacks, as a notebook asks it."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from calib.correlation.problem import ModalProblem
from calib.correlation.scatter import Floors
from calib.effect import Effect
from calib.errors import EvaluationError, InputError, ToleranceError
from calib.front.shown import Shown
from calib.front.test import UNSEEN, ModalTest, Model, ResponseTest, Test
from calib.function import FunctionModel
from calib.measurement.disagreements import COLUMNS
from calib.missing.explain import explain, require_modes
from calib.missing.refits import Settings
from calib.questions.explain import Side, answered
from calib.questions.explanation import Explanation, Told
from calib.questions.function_hypotheses import FunctionHypotheses
from calib.questions.hypotheses import ModalHypotheses
from calib.questions.modal_side import ModalSide
from calib.questions.plain_side import PlainSide
from calib.questions.reduction import WORTHWHILE_DOFS, Wanted
from calib.questions.scatter import in_words
from calib.settings import ExplainSettings, ReductionSettings
from calib.structure.atoms import atoms
from calib.structure.basis import Basis
from calib.structure.effect_basis import effect_basis
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.structure.variants import Variants

if TYPE_CHECKING:
    from calib.front.problem import Problem


@dataclass(frozen=True, eq=False, repr=False)
class Explained(Shown):
    """What the model lacks, how sure that is, and what to measure next.

    Attributes
    ----------
    problem : Problem
        That was asked.
    effects : tuple of Effect
        That were asked about.
    explanation : Explanation
        Everything that is told, with its tables.
    """

    problem: Problem
    effects: tuple[Effect, ...]
    explanation: Explanation

    @property
    def verdict(self) -> str:
        """One of the verdicts of `calib.missing.findings.Findings`, such as ``effect`` or ``nothing_detectable``."""
        return self.explanation.verdict

    @property
    def named(self) -> tuple[Effect, ...]:
        """Effects that the model lacks; empty where none may be named or several cannot be told apart."""
        credible = self.explanation.findings.credible if self.verdict in ("effect", "two_effects") else ()
        return tuple(e for e in self.effects if e.name in credible)

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

    def with_named(self) -> Problem:
        """The problem with what is named in its model; InputError where nothing is."""
        if not self.named:
            raise InputError(
                f"nothing is named: the verdict is {self.verdict}", place="explain",
                remedy="choose effects and add them by with_effects",
            )  # fmt: skip
        return self.problem.with_effects(self.named)

    def __repr__(self) -> str:
        return f"Explained({self.verdict}{''.join(f', {e.name}' for e in self.named)})"


def explained(problem: Problem, model: Model, test: Test, effects: tuple[Effect, ...], seed: int) -> Explained:
    """See `calib.front.problem.Problem.explain`."""
    started = time.perf_counter()
    side = _modal(model, test, effects, seed) if isinstance(test, ModalTest) else _plain(model, test, effects, seed)
    try:
        found = explain(side.hypotheses, Settings(seed=seed, budget=side.budget_of_fits))
    except EvaluationError as fault:
        raise InputError(
            f"the model cannot be fitted: {fault}", place="explain", remedy="check values, limits and supports"
        ) from fault
    return Explained(problem, effects, answered(side, found, lambda words: None, started))


def _told(test: Test, seed: int) -> Told:
    measured = test.modes if isinstance(test, ModalTest) else test.measured
    rows = [tuple(getattr(one, name) for name in COLUMNS) for one in measured.disagreements]
    assumed, claimed = in_words(test.assumed), "none" if test.accuracy is None else str(test.accuracy)
    notes = [] if test.accuracy is None else [f"Accuracy claimed, added to the scatter in squares: {claimed}."]
    notes += [f"Nobody stated it, so the explanation assumes, and rests on: {assumed}."] if assumed else []
    notes += [f"Check this repeat: {one.sentence}." for one in measured.disagreements]
    return Told(
        assumed, claimed, tuple(notes), pd.DataFrame(rows, columns=list(COLUMNS)), {}, seed, ExplainSettings().draws
    )


def _modal(model: Model, test: ModalTest, effects: tuple[Effect, ...], seed: int) -> Side:
    used = test.problem(model)
    require_modes(used.measured.n_modes)
    if isinstance(model, ModalFunctionModel):
        return ModalSide.of_function(model, used, test.whole_problem(model), effects, model.space, _told(test, seed))
    assert isinstance(model, StructuralModel)
    placed = [s for s in used.measured.sensors if s.point is not None]
    local = atoms(model, placed, model.space.values, float(used.measured.natural_freq.min()))
    plain = tuple(a.effect for a in local)
    large = model.n_dof >= WORTHWHILE_DOFS
    basis = _basis(model, used, effects, plain, seed) if large else None
    hypotheses = ModalHypotheses(used, Variants(model, effects, plain, basis), model.space, Floors())
    return ModalSide(model, used, test.whole_problem(model), hypotheses, local, _told(test, seed), reduced=large)


def _basis(
    model: StructuralModel, used: ModalProblem, effects: tuple[Effect, ...], local: tuple[Effect, ...], seed: int
) -> Basis | None:
    """A reduced basis of a large model with all that it may lack; None where none reaches the tolerance."""
    highest = used.freq_window[1] if used.freq_window else float(np.inf)
    wanted = Wanted(used.mode_count, highest, ReductionSettings().tolerance, seed)
    with suppress(ToleranceError):
        return effect_basis(model, wanted.trained(model, model.space), model.space, effects, local, seed)
    return None


def _plain(model: Model, test: ResponseTest, effects: tuple[Effect, ...], seed: int) -> Side:
    used = test.problem(model)
    assert isinstance(model, FunctionModel)
    hypotheses = FunctionHypotheses(model, used.targets, model.space, effects, used.repeats, shares=used.shares)
    return PlainSide(used, {UNSEEN: test.unseen}, hypotheses, _told(test, seed))
