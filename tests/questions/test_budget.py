"""What the discretisation alone would look like."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.correlation.residual import ModalResidual
from calib.errors import InputError
from calib.missing.state import State, fitted
from calib.questions.budget import ALLOWED, Budget, budget_of, discretisation_budget
from calib.questions.library import modal_hypotheses
from calib.results import Results
from calib.space import ParameterSpace
from calib.structure.affine import AffineMatrix
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def settled(mast, tmp_path_factory):
    folder = tmp_path_factory.mktemp("budget")
    study = Study.load(mast.write_study(folder / "mast"))
    hypotheses, _ = modal_hypotheses(study, Results.at(folder / "results", "mast"))
    question = hypotheses.question(())
    return hypotheses, fitted(question, (), question.space.values)


def heavier(model, factor):
    """The model with more mass everywhere."""
    terms = tuple(replace(t, matrix=factor * t.matrix) for t in model.mass.terms)
    return replace(model, mass=AffineMatrix(model.n_dof, terms, model.mass.selected))


# -- small -------------------------------------------------------------------------------------------------------------


def test_the_same_mesh_makes_no_difference(settled):
    hypotheses, state = settled
    budget = discretisation_budget(hypotheses, state, hypotheses.variants.model)
    assert budget.largest < 1e-6 and budget.misfit < 1e-12
    assert "the discretisation hides and fakes nothing" in budget.sentence


def test_every_effect_and_every_local_change_is_scored_largest_first(settled, mast):
    hypotheses, state = settled
    table = discretisation_budget(hypotheses, state, mast.mast(0.1)).table
    assert list(table.columns) == ["candidate", "kind", "score"]
    by_kind = table.groupby("kind")["candidate"].agg(set).to_dict()
    assert by_kind == {
        "effect": {e.name for e in hypotheses.effects},
        "local change": {a.name for a in hypotheses.atoms},
    }
    assert len(table) == len(hypotheses.effects) + len(hypotheses.atoms)
    assert table["score"].abs().is_monotonic_decreasing


def test_a_finer_mesh_says_little_and_a_much_coarser_one_much(settled, mast):
    """Cubic beams with lumped or consistent masses err with the fourth power of their length or so."""
    hypotheses, state = settled
    sizes = [discretisation_budget(hypotheses, state, mast.mast(h)).largest for h in (0.1, 0.25, 1.0, 2.0)]
    assert sizes[0] < ALLOWED and sizes[1] < ALLOWED
    assert sizes[3] > 3 * sizes[2] > 3 * sizes[1]


def test_what_a_mesh_fakes_is_told_with_a_remedy(settled, mast):
    hypotheses, state = settled
    coarse = discretisation_budget(hypotheses, state, mast.mast(2.0))
    first = coarse.table.iloc[0]
    assert coarse.largest > ALLOWED and coarse.largest == abs(first["score"])
    assert f"scores of up to {coarse.largest:.2f} ({first['candidate']})" in coarse.sentence
    assert "refine the mesh" in coarse.sentence


def test_a_difference_that_a_candidate_describes_is_its_score(settled):
    """More mass everywhere is what the local change of the tube's mass is about."""
    hypotheses, state = settled
    budget = discretisation_budget(hypotheses, state, heavier(hypotheses.variants.model, 1.05))
    scores = budget.table.set_index("candidate")["score"]
    assert scores["mass of tube"] > ALLOWED
    half = discretisation_budget(hypotheses, state, heavier(hypotheses.variants.model, 1.025))
    assert half.table.set_index("candidate")["score"]["mass of tube"] == pytest.approx(
        0.5 * scores["mass of tube"], rel=0.1
    )


def test_there_is_no_noise_in_it(settled, mast):
    """A measurement with other noise but the same scatter has nearly the same budget, and none depends on a seed."""
    hypotheses, state = settled
    one = discretisation_budget(hypotheses, state, mast.mast(1.0)).table
    again = discretisation_budget(hypotheses, state, mast.mast(1.0)).table
    assert one.equals(again)
    measured = hypotheses.pair.problem.measured
    rng = np.random.default_rng(3)
    noisy = replace(measured, natural_freq=measured.natural_freq * (1 + 0.002 * rng.standard_normal(measured.n_modes)))
    other = replace(hypotheses, pair=ModalResidual(replace(hypotheses.pair.problem, measured=noisy)))
    there = discretisation_budget(other, state, mast.mast(1.0)).table
    joined = one.merge(there, on=["candidate", "kind"])
    np.testing.assert_allclose(joined["score_x"], joined["score_y"], atol=0.02 * one["score"].abs().max())


def test_twice_the_scatter_halves_the_budget(settled, mast):
    hypotheses, state = settled
    measured = hypotheses.pair.problem.measured
    wide = replace(measured, freq_std=10 * measured.freq_std, shape_std=10 * measured.shape_std)
    wider = replace(wide, freq_std=2 * wide.freq_std, shape_std=2 * wide.shape_std)
    flat = ParameterSpace(tuple(replace(p, prior_sd=1e4 * p.prior_width) for p in hypotheses.space.parameters))
    tables = [
        discretisation_budget(
            replace(hypotheses, pair=ModalResidual(replace(hypotheses.pair.problem, measured=m)), space=flat),
            state, mast.mast(2.0),
        ).table.set_index("candidate")["score"]
        for m in (wide, wider)
    ]  # fmt: skip
    np.testing.assert_allclose(tables[0].loc[tables[1].index], 2 * tables[1], rtol=0.02, atol=1e-3)


def test_a_finer_model_that_is_another_model_is_refused(settled, mast):
    hypotheses, state = settled
    finer = mast.mast(0.1)
    extra = replace(finer, space=ParameterSpace((*finer.space.parameters, replace(finer.space["E"], name="E2"))))
    with pytest.raises(InputError, match="the finer model cannot be solved") as told:
        discretisation_budget(hypotheses, state, extra)
    assert told.value.place == "finer_options"
    swapped = finer.modes(state.values, 12)
    shapes = finer.sensor_rows(hypotheses.pair.problem.measured.sensors) @ swapped.shapes
    with pytest.raises(InputError, match="does not have the modes that were measured"):
        budget_of(hypotheses, state, swapped, shapes[::-1] * (-1.0) ** np.arange(len(shapes))[:, None])


def test_no_candidates_have_no_largest_score():
    import pandas as pd

    assert Budget(pd.DataFrame(columns=["candidate", "kind", "score"]), 0.0).largest == 0.0


# -- the bogie ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_twin_without_noise_shows_nothing(twin_maker, with_basis, tmp_path):
    """Finer mesh, distributed masses and sensors off by up to 5 mm: scores of at most 1, whatever one looks for."""
    truth = json.loads((ROOT / "tests/truth/hidden_bogie_none.json").read_text("utf-8"))["parameters"]
    study = Study.load(ROOT / "studies/hidden_bogie_none")
    hypotheses, _ = modal_hypotheses(study, with_basis(Results.at(tmp_path, study.name)))
    twin, layout = twin_maker.specimen().fine, study.measured.sensors
    modes = twin.modes(truth, study.problem.mode_count)
    question = hypotheses.question(())
    names = tuple(p.name for p in question.space.free if not p.integer)
    state = State(
        (), question, names, question.space.complete(truth), question.residual(truth),
        -question.jacobian(truth, names), np.array([question.space[n].prior_width for n in names]),
        np.zeros(len(names)),
    )  # fmt: skip

    def budget(places):
        used = [s for s in places if s.name in {known.name for known in layout}]
        assert [s.name for s in used] == [s.name for s in layout]
        return budget_of(hypotheses, state, modes, twin.sensor_rows(used) @ modes.shapes)

    nominal = twin_maker.blind.twin.sensors()
    for places in (nominal, twin_maker.blind.twin.moved(nominal, np.random.default_rng(1))):
        found = budget(places)
        assert found.largest <= ALLOWED, found.sentence
        assert len(found.table) == 16 + len(hypotheses.atoms) and len(hypotheses.atoms) > 100
    wrong = [replace(s, point=(s.point[0] + 0.15, *s.point[1:])) if s.name == "102y" else s for s in nominal]
    assert budget(wrong).misfit > 4 * found.misfit  # what the sensors' places do is seen
