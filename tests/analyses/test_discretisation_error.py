"""Scores due to the discretisation error alone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import InputError
from calib.hypotheses.discretisation_error import (
    discretisation_error,
    discretisation_error_of,
    frf_discretisation_error,
)
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.rules import RULES
from calib.measurement.frf import MeasuredFRFs
from calib.missing.facts import DiscretisationError
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.structure.affine import AffineMatrix
from calib.structure.effects.perturbations import perturbations
from calib.structure.effects.variants import Variants
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def settled(mast, tmp_path_factory):
    folder = tmp_path_factory.mktemp("discretisation")
    study = LoadedStudy.load(mast.write_study(folder / "mast"))
    hypotheses, _ = modal_hypotheses(study, Results.at(folder / "results", "mast"))
    fit_problem = hypotheses.fit_problem(())
    return hypotheses, least_squares_fit(fit_problem, (), fit_problem.space.values)


def heavier(model, factor):
    """The model with more mass everywhere."""
    terms = tuple(replace(t, matrix=factor * t.matrix) for t in model.mass.terms)
    return replace(model, mass=AffineMatrix(model.n_dof, terms, model.mass.selected))


@pytest.fixture(scope="module")
def settled_frfs(mast):
    """FRFs of the mast's own mesh: the fit is at the nominal values, whatever the mesh of the twin."""
    model, freq = mast.mast(), np.linspace(2.0, 60.0, 30)
    responses, known = mast.sensors(), np.full((30, 12, 1), 1.0 + 0j)
    measured = MeasuredFRFs(
        freq, responses, responses[-2:-1], "receptance", known, np.full(known.shape, np.nan), synthetic=True
    )
    own = FRFProblem(model, measured).functions(model.space.values)
    measured = replace(measured, values=own, std=0.01 * np.abs(own))
    priors = {"E": 6.0, "m_top": 8.0, "K_base": 0.4}
    space = model.space
    for name, sd in priors.items():
        space = space.replace(name, prior_sd=sd)
    local = perturbations(model, responses, model.space.values, 2.0)
    pair = FRFResidual(FRFProblem(model, measured))
    variants = Variants(model, mast.library(), tuple(p.effect for p in local), None)
    hypotheses = ModelHypotheses(pair, variants, space)
    fit_problem = hypotheses.fit_problem(())
    return hypotheses, least_squares_fit(fit_problem, (), fit_problem.space.values)


def test_frfs_of_the_same_mesh_have_no_discretisation_error(settled_frfs):
    hypotheses, fit = settled_frfs
    found = frf_discretisation_error(hypotheses, fit, hypotheses.variants.model)
    assert found.largest < 1e-6 and found.misfit < 1e-12
    assert set(found.table["candidate"]) == {
        *(e.name for e in hypotheses.effects),
        *(a.name for a in hypotheses.perturbations),
    }


@pytest.mark.medium
def test_frfs_see_the_mesh_the_more_the_coarser_it_is(settled_frfs, mast):
    hypotheses, fit = settled_frfs
    sizes = [frf_discretisation_error(hypotheses, fit, mast.mast(h)).largest for h in (0.1, 1.0, 2.0)]
    assert sizes[2] > 2 * sizes[1] > 4 * sizes[0] > 0


def test_frfs_of_a_finer_model_without_a_parameter_are_refused(settled_frfs, mast):
    hypotheses, fit = settled_frfs
    model = mast.mast()
    bare = replace(model, space=ParameterSpace(model.space.parameters[1:]))
    with pytest.raises(InputError, match="finer_options"):
        frf_discretisation_error(hypotheses, fit, bare)


# -- small -------------------------------------------------------------------------------------------------------------


def test_the_same_mesh_has_no_discretisation_error(settled):
    hypotheses, fit = settled
    found = discretisation_error(hypotheses, fit, hypotheses.variants.model)
    assert found.largest < 1e-6 and found.misfit < 1e-12
    assert "neither hides nor mimics an effect" in found.sentence


def test_every_effect_and_every_local_perturbation_is_scored_largest_first(settled, mast):
    hypotheses, fit = settled
    table = discretisation_error(hypotheses, fit, mast.mast(0.1)).table
    assert list(table.columns) == ["candidate", "kind", "score"]
    by_kind = table.groupby("kind")["candidate"].agg(set).to_dict()
    assert by_kind == {
        "effect": {e.name for e in hypotheses.effects},
        "local perturbation": {a.name for a in hypotheses.perturbations},
    }
    assert len(table) == len(hypotheses.effects) + len(hypotheses.perturbations)
    assert table["score"].abs().is_monotonic_decreasing


@pytest.mark.medium
def test_a_finer_mesh_gives_small_scores_and_a_much_coarser_one_large(settled, mast):
    """The eigenvalue error of cubic beam elements grows with about the fourth power of their length."""
    hypotheses, fit = settled
    sizes = [discretisation_error(hypotheses, fit, mast.mast(h)).largest for h in (0.1, 0.25, 1.0, 2.0)]
    assert sizes[0] < RULES.mesh_score and sizes[1] < RULES.mesh_score
    assert sizes[3] > 3 * sizes[2] > 3 * sizes[1]


def test_a_mesh_that_is_too_coarse_is_reported_with_a_remedy(settled, mast):
    hypotheses, fit = settled
    coarse = discretisation_error(hypotheses, fit, mast.mast(2.0))
    first = coarse.table.iloc[0]
    assert coarse.largest > RULES.mesh_score and coarse.largest == abs(first["score"])
    assert f"scores of up to {coarse.largest:.2f} ({first['candidate']})" in coarse.sentence
    assert "refine the mesh" in coarse.sentence


def test_a_difference_that_a_candidate_describes_shows_in_its_score(settled):
    """More mass everywhere is nearly the local perturbation of the tube's mass."""
    hypotheses, fit = settled
    found = discretisation_error(hypotheses, fit, heavier(hypotheses.variants.model, 1.05))
    scores = found.table.set_index("candidate")["score"]
    assert scores["mass of tube"] > RULES.mesh_score
    half = discretisation_error(hypotheses, fit, heavier(hypotheses.variants.model, 1.025))
    assert half.table.set_index("candidate")["score"]["mass of tube"] == pytest.approx(
        0.5 * scores["mass of tube"], rel=0.1
    )


@pytest.mark.medium
def test_there_is_no_noise_in_it(settled, mast):
    """Other noise of the same standard deviation gives nearly the same scores, and no score depends on a seed."""
    hypotheses, fit = settled
    one = discretisation_error(hypotheses, fit, mast.mast(1.0)).table
    again = discretisation_error(hypotheses, fit, mast.mast(1.0)).table
    assert one.equals(again)
    measured = hypotheses.pair.problem.measured
    rng = np.random.default_rng(3)
    noisy = replace(measured, natural_freq=measured.natural_freq * (1 + 0.002 * rng.standard_normal(measured.n_modes)))
    other = replace(hypotheses, pair=ModalResidual(replace(hypotheses.pair.problem, measured=noisy)))
    there = discretisation_error(other, fit, mast.mast(1.0)).table
    joined = one.merge(there, on=["candidate", "kind"])
    np.testing.assert_allclose(joined["score_x"], joined["score_y"], atol=0.02 * one["score"].abs().max())


def test_twice_the_standard_deviation_halves_the_scores(settled, mast):
    hypotheses, fit = settled
    measured = hypotheses.pair.problem.measured
    wide = replace(measured, freq_std=10 * measured.freq_std, shape_std=10 * measured.shape_std)
    wider = replace(wide, freq_std=2 * wide.freq_std, shape_std=2 * wide.shape_std)
    flat = ParameterSpace(tuple(replace(p, prior_sd=1e4 * p.prior_width) for p in hypotheses.space.parameters))
    tables = [
        discretisation_error(
            replace(hypotheses, pair=ModalResidual(replace(hypotheses.pair.problem, measured=m)), space=flat),
            fit, mast.mast(2.0),
        ).table.set_index("candidate")["score"]
        for m in (wide, wider)
    ]  # fmt: skip
    np.testing.assert_allclose(tables[0].loc[tables[1].index], 2 * tables[1], rtol=0.02, atol=1e-3)


def test_a_finer_model_that_is_another_model_is_refused(settled, mast):
    hypotheses, fit = settled
    finer = mast.mast(0.1)
    extra = replace(finer, space=ParameterSpace((*finer.space.parameters, replace(finer.space["E"], name="E2"))))
    with pytest.raises(InputError, match="the finer model cannot be solved") as fault:
        discretisation_error(hypotheses, fit, extra)
    assert fault.value.place == "finer_options"
    swapped = finer.modes(fit.values, 12)
    shapes = finer.sensor_rows(hypotheses.pair.problem.measured.sensors) @ swapped.shapes
    with pytest.raises(InputError, match="does not have the modes that were measured"):
        discretisation_error_of(hypotheses, fit, swapped, shapes[::-1] * (-1.0) ** np.arange(len(shapes))[:, None])


def test_without_candidates_the_largest_score_is_zero():
    import pandas as pd

    assert DiscretisationError(pd.DataFrame(columns=["candidate", "kind", "score"]), 0.0, 1.0).largest == 0.0


# -- the bogie ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_noise_free_twin_gives_small_scores(twin_maker, with_basis, tmp_path):
    """Finer mesh, distributed masses and sensors off by up to 5 mm: all scores are at most 1."""
    truth = json.loads((ROOT / "tests/truth/hidden_bogie_none.json").read_text("utf-8"))["parameters"]
    study = LoadedStudy.load(ROOT / "studies/hidden_bogie_none")
    hypotheses, _ = modal_hypotheses(study, with_basis(Results.at(tmp_path, study.name)))
    twin, layout = twin_maker.specimen().fine, study.measured.sensors
    modes = twin.modes(truth, study.problem.mode_count)
    fit_problem = hypotheses.fit_problem(())
    names = tuple(p.name for p in fit_problem.space.free if not p.integer)
    fit = LinearisedFit(
        (), fit_problem, names, fit_problem.space.complete(truth), fit_problem.residual(truth),
        -fit_problem.jacobian(truth, names), np.array([fit_problem.space[n].prior_width for n in names]),
        np.zeros(len(names)),
    )  # fmt: skip

    def error_with(places):
        used = [s for s in places if s.name in {known.name for known in layout}]
        assert [s.name for s in used] == [s.name for s in layout]
        return discretisation_error_of(hypotheses, fit, modes, twin.sensor_rows(used) @ modes.shapes)

    nominal = twin_maker.blind.twin.sensors()
    for places in (nominal, twin_maker.blind.twin.moved(nominal, np.random.default_rng(1))):
        found = error_with(places)
        assert found.largest <= RULES.mesh_score, found.sentence
        assert len(found.table) == 16 + len(hypotheses.perturbations) and len(hypotheses.perturbations) > 100
    wrong = [replace(s, point=(s.point[0] + 0.15, *s.point[1:])) if s.name == "102y" else s for s in nominal]
    assert error_with(wrong).misfit > 4 * found.misfit  # sensor positions matter
