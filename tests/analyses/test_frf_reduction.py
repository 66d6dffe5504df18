"""A study of FRFs on a reduced basis: trained once, certified, and told where full order differs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.analyses import reduction
from calib.analyses.explain import explain
from calib.analyses.hypotheses_of_study import adapter_of, basis_of
from calib.analyses.reduction import reduction_of
from calib.correlation import basis as requirements
from calib.correlation.basis import BasisRequirements
from calib.errors.errors import ToleranceError
from calib.hypotheses.library import local_perturbations
from calib.results.results import Results
from calib.structure.reduction.frf_target import TOLERANCE
from calib.structure.reduction.reduced import ReducedModel
from calib.study.loading import module_of
from calib.study.study import EvaluationSource, LoadedStudy

WORLD = module_of(Path(__file__).resolve().parents[2] / "tests/template/frf_chain.py")


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The chain with gains and accelerometers as nuisances; a basis serves a model of any size."""
    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", 2)
    folder = WORLD.write_study(tmp_path / "chain", ground=WORLD.HIDDEN)
    text = (folder / "study.toml").read_text()
    more = "nuisances = { gain = 1.0, accelerometer = 0.0002 }\nheld_out ="
    (folder / "study.toml").write_text(text.replace("held_out =", more))
    model = folder / "model.py"  # its effect bears the name of an accelerometer's mass
    model.write_text(model.read_text().replace('"mass_3"', '"heavier_3"'))
    return LoadedStudy.load(folder)


@pytest.fixture
def results(tmp_path):
    return Results.at(tmp_path / "results", "chain")


@pytest.mark.medium
def test_a_basis_is_trained_over_model_and_loads_but_not_over_gains(study, results):
    found = reduction_of(study, results)
    wanted = BasisRequirements.of(study.problem, 1e-5, 1)
    assert {"mass_1", "gain_1x"} < set(study.search_space.names)
    assert set(wanted.names) == {"k", "c", "m", "mass_1", "mass_3", "mass_4"}
    assert [p.name for p in wanted.within(study.search_space).parameters] == list(wanted.names)
    assert found.basis.names == ("k", "c", "m") and found.basis.tolerance == TOLERANCE
    key = found.basis.key
    assert wanted.key(study.model, study.search_space) == key
    assert replace(wanted, seed=2).key(study.model, study.search_space) != key
    other = replace(study.problem, measured=replace(study.problem.measured, std=2 * study.problem.measured.std))
    assert BasisRequirements.of(other, 1e-5, 1).key(study.model, study.search_space) != key


@pytest.mark.medium
def test_the_stored_basis_is_loaded_and_serves_workers(study, results, monkeypatch):
    found = reduction_of(study, results)
    monkeypatch.setattr(requirements, "train", lambda *a, **k: pytest.fail("it is there"))
    assert reduction_of(study, results).basis.digest == found.basis.digest
    values = study.search_space.complete({"k": 1.3e4, "gain_1x": 2.0, "mass_4": 0.0003})
    source = EvaluationSource.of(study, found.problem, found.path)
    assert source.fingerprint == found.problem.fingerprint != study.problem.fingerprint
    reduced, full = source()(values), study.problem.evaluate(values)
    assert reduced.keys() == full.keys()
    np.testing.assert_allclose(list(reduced.values()), list(full.values()), rtol=1e-3)
    assert {found.problem.fingerprint, study.problem.fingerprint} <= set(reduction.fingerprints(study, results))


def coarse(found, study):
    """The same reduction on a basis that lacks all but two of its vectors."""
    basis = replace(found.basis, vectors=found.basis.vectors[:, :2])
    return replace(found, problem=study.problem.reduced(basis))


@pytest.mark.medium
def test_a_point_that_the_basis_misses_is_estimated_seen_and_added(study, results):
    found = reduction_of(study, results)
    values = study.search_space.complete({"k": 7e3, "gain_1x": 2.0})
    assert found.error_at(values) <= TOLERANCE and not found.misses_at(values)
    assert found.after_case(values, results) is found
    poor = coarse(found, study)
    assert poor.error_at(values) > TOLERANCE and poor.misses_at(values)
    better = poor.after_case(values, results)
    assert better.basis.version == 2 and better.path.exists() and not better.misses_at(values)


@pytest.mark.medium
def test_a_basis_is_enriched_in_memory_where_held_parameters_leave_what_it_represents(study, results):
    found = reduction_of(study, results)
    values = study.search_space.complete({"k": 7e3, "gain_1x": 2.0})
    assert found.covering([values]) is found
    few = replace(found.basis, vectors=found.basis.vectors[:, :2])
    poor = replace(found, problem=study.problem.reduced(few), basis=few)
    better = poor.covering([values])
    assert better.error_at(values) <= TOLERANCE and better.basis.size > poor.basis.size
    assert better.path is None and [path.name for path in results.path.glob("basis_*.npz")] == ["basis_v1.npz"]


@pytest.mark.slow
def test_an_explanation_on_the_basis_is_that_at_full_order(study, results):
    answer = explain(study, results)
    assert list(results.path.glob("basis_effects_*.npz"))
    assert answer.figures["basis_error"] < TOLERANCE
    effects = answer.effects.set_index("name")
    assert answer.explanation.verdict == "effect" and answer.explanation.credible == ("ground_2",)
    full = explain(
        replace(study, settings=study.settings.model_copy(
            update={"reduction": study.settings.reduction.model_copy(update={"use": False})}
        )), results,
    )  # fmt: skip
    assert full.figures["basis_error"] == 0.0
    same = full.effects.set_index("name")
    np.testing.assert_allclose(effects["magnitude"], same["magnitude"], rtol=2e-3)
    errors, exact = (one.errors.set_index(["group", "stage"])["rms"] for one in (answer, full))
    np.testing.assert_allclose(errors, exact, rtol=0.02)


def adapter_on(study, results, vectors, monkeypatch):
    """The adapter of the study on so many vectors of its basis."""
    local = local_perturbations(study.model, [study.problem.measured], study.search_space.values)
    basis = basis_of(study, results, local)
    poor = replace(basis, vectors=basis.vectors[:, :vectors])
    monkeypatch.setattr("calib.analyses.hypotheses_of_study.basis_of", lambda *a: poor)
    return adapter_of(study, results, lambda *a: None, local)


@pytest.mark.slow
def test_held_out_data_and_the_error_of_the_basis_are_at_full_order(study, results, monkeypatch):
    adapter = adapter_on(study, results, 2, monkeypatch)
    measuring = adapter._measuring(())
    assert isinstance(adapter.hypotheses.fit_problem(()).pair.problem.model, ReducedModel)
    assert measuring.problem.model.n_dof == WORLD.N
    values = study.search_space.values
    fit = type("Fit", (), {})
    candidate = type("Candidate", (), {"names": (), "fit": fit})
    fit.values, fit.residual = values, adapter.hypotheses.fit_problem(()).pair.residual(values)
    off = np.abs(measuring.residual(values) - fit.residual).max()
    assert off > 1.0 and adapter.basis_error([candidate], 2.0) == pytest.approx(
        np.abs(measuring.residual(values) / 2 - fit.residual).max()
    )


def test_without_a_basis_the_full_model_is_used_and_the_notes_say_so(study, results, monkeypatch):
    def unreached(*a, **k):
        raise ToleranceError("not reached", place="here")

    monkeypatch.setattr(requirements, "train", unreached)
    adapter = adapter_of(study, results, lambda *a: None, ())
    assert adapter.hypotheses.variants.basis is None
    assert any("reduced basis" in note for note in adapter.notes())
    small = replace(study, settings=study.settings.model_copy(
        update={"reduction": study.settings.reduction.model_copy(update={"use": False})}
    ))  # fmt: skip
    assert not any("reduced basis" in n for n in adapter_of(small, results, lambda *a: None, ()).notes())
