"""Proposals that need a start or degrees of freedom of their own, other kinds of tests, and what cannot be tried."""

import numpy as np
import pytest

import calib
from calib.errors.errors import EvaluationError
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.structure import rules as model_rules
from tests.api.storeys import chain, frfs, measured, posed


@pytest.fixture(scope="module")
def softened():
    """A storey that has lost 60 % of its stiffness, far beyond what one step foresees."""
    return posed(stiffness=[(3, -0.6)]).explain([], seed=1)


@pytest.mark.slow
def test_a_damper_on_a_soft_mount_is_told_with_its_lag():
    test = calib.ModalTest(measured(count=4, lag=0.02), mode_count=5)
    first = calib.Problem(chain(), test).explain([], seed=1).propose().table.iloc[0]
    assert (first["kind"], first["at"], first["unit"]) == ("damper mount", "damper 2", "ms")
    assert first["lower"] <= 20.0 <= first["upper"]


@pytest.mark.slow
def test_a_loss_of_stiffness_far_beyond_one_step_is_not_told_as_damping(softened):
    first = softened.propose().table.iloc[0]
    assert (first["kind"], first["at"]) == ("stiffness", "storey 3")
    assert first["unit"] == "%" and first["lower"] <= -60.0 <= first["upper"]


@pytest.mark.slow
def test_a_change_beyond_the_plausible_size_is_fitted_from_there_too(softened, monkeypatch):
    seen, best_of = {}, Refits.best_of

    def watched(fits, names, starts, parent, *more):
        seen[names[-1]] = [start[names[-1]] for start in starts]
        return best_of(fits, names, starts, parent, *more)

    monkeypatch.setattr(Refits, "best_of", watched)
    softened.propose()
    first, *others = seen["stiffness_storey_3"]
    assert first == pytest.approx(-model_rules.RULES.relative) and others and min(others) < -model_rules.RULES.relative


@pytest.mark.medium
def test_ranks_and_equals_follow_one_threshold(softened):
    proposals = softened.propose().result.proposals
    evidence = np.array([p.evidence for p in proposals.ranked])
    equal = [p in proposals.close for p in proposals.ranked]
    assert equal == (evidence > evidence[0] - RULES.equal).tolist()
    for p in proposals.ranked:
        assert not {c.effect.name for c in p.alike} & {q.composed.effect.name for q in proposals.ranked}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "kinds", "at"),
    [
        ({"stiffness": [(3, -0.25)]}, {"stiffness"}, "storey 3"),
        ({"hung": (5, 150.0, 6.0)}, {"hung mass"}, "sensor 5x"),
    ],
)
def test_frfs_are_proposed_for_as_modes_are(changed, kinds, at):
    test = frfs(np.linspace(1.0, 16.0, 60), **changed)
    why = calib.Problem(chain(), calib.FRFTest(test)).explain([], seed=1)
    assert why.verdict in ("none_explains", "misfit_unlocated")
    first = why.propose().table.iloc[0]
    assert first["kind"] in kinds and first["at"] == at


@pytest.mark.slow
def test_a_mount_whose_mode_the_model_lacks_is_told(softened):
    """All modes of the chain were measured, and a damper on a spring adds none that oscillates."""
    proposed = softened.propose()
    lost = {one.title: one.reason for one in proposed.result.proposals.lost}
    assert lost["Soft mount of damper 2"].endswith("only 6 vibration modes, 7 were requested")
    assert any(words.startswith("Not fitted: soft mount of damper") for words in proposed.sentences)


@pytest.mark.slow
def test_what_cannot_be_solved_is_told(softened, monkeypatch):
    best_of = Refits.best_of

    def failing(fits, names, starts, parent, *more):
        if "stiffness_storey_3" in names:
            raise EvaluationError("no convergence")
        return best_of(fits, names, starts, parent, *more)

    monkeypatch.setattr(Refits, "best_of", failing)
    proposed = softened.propose()
    (lost,) = [one for one in proposed.result.proposals.lost if one.title == "Stiffness of storey 3"]
    assert lost.reason == "no convergence"
