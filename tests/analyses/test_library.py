"""Hypotheses of a study, and the reduced basis that is stored for them."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.analyses.reduction import reduction_of
from calib.correlation import basis as requirements
from calib.correlation.modal.problem import ModalProblem
from calib.errors.errors import EvaluationError, InputError
from calib.results.results import Results
from calib.structure.reduction.cache import BasisCache, using
from calib.study.study import LoadedStudy


@pytest.fixture
def study(mast, tmp_path):
    return LoadedStudy.load(mast.write_study(tmp_path / "mast", {"platform": 20.0}))


@pytest.fixture
def results(tmp_path):
    return Results.at(tmp_path / "results", "mast")


@pytest.fixture
def small_pays(monkeypatch):
    """Uses a basis even for a small model, and records the trainings for effects."""
    trained = []
    train = requirements.effect_basis
    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", 10)
    monkeypatch.setattr(requirements, "effect_basis", lambda *a: trained.append(a) or train(*a))
    return trained


def bases(results):
    return sorted(results.path.glob("basis_effects_*.npz"))


def test_a_small_model_needs_no_basis(study, results):
    hypotheses, local = modal_hypotheses(study, results)
    assert hypotheses.variants.basis is None and bases(results) == []
    assert hypotheses.effects == study.candidates
    own = [a.effect for a in local]
    assert hypotheses.perturbations == tuple(e for e in own if not e.of_measurement)
    assert [e.name for e in own if e.of_measurement] == ["mass of the accelerometers"]
    assert hypotheses.space is study.search_space and hypotheses.pair.problem is study.problem


def test_candidates_share_one_test_of_one_model(study, results):
    """Of hundreds of candidates each would else locate all sensors, and ask whether its model is damped."""
    hypotheses, local = modal_hypotheses(study, results)
    plain = [e.name for e in hypotheses.effects if not hypotheses.variants.added((e.name,))]
    names = [*plain, *(one.effect.name for one in local[:3])]
    assert len({id(hypotheses.fit_problem((name,)).pair) for name in names}) == 1 < len(names)
    assert hypotheses.fit_problem(()).pair is not hypotheses.fit_problem((names[0],)).pair  # without a `base`
    known = dict(hypotheses._fit_problems)
    assert hypotheses.linear_start(("no such effect",), {}) is None  # modes have none: no model is made for it
    assert hypotheses._fit_problems == known


def test_local_perturbations_are_at_every_part_and_every_used_sensor(study, results):
    perturbations = [a for a in modal_hypotheses(study, results)[1] if not a.effect.of_measurement]
    assert {a.effect.name for a in perturbations if not a.sensor} == {
        "stiffness of tube", "stiffness of base", "mass of tube", "mass of antenna",
    }  # fmt: skip
    for sensor in study.measured.sensors:
        assert [a.kind for a in perturbations if a.sensor == sensor.name] == ["stiffness", "mass"]
    used = study.measured.without((), ("3x", "3z"))
    fewer = replace(study, problem=replace(study.problem, measured=used))
    assert {"3x", "3z"}.isdisjoint({a.sensor for a in modal_hypotheses(fewer, results)[1]})


@pytest.mark.slow
def test_effects_in_the_model_are_not_candidates(study, results, mast):
    path = study.file
    path.write_text(path.read_text().replace("selection =", 'with_effects = ["lamp"]\nselection =', 1))
    hypotheses, _ = modal_hypotheses(LoadedStudy.load(path), results)
    assert [e.name for e in hypotheses.effects] == ["platform", "guy", "stuck_base"]
    assert "lamp" in hypotheses.variants.model.space


@pytest.mark.medium
def test_the_basis_is_trained_once_and_kept(study, results, small_pays):
    progress = []
    first, _ = modal_hypotheses(study, results, lambda stage, *more: progress.append(stage))
    stages = ["reduced basis for the effects", "training the reduced basis", "training the basis for the effects"]
    assert [stage for stage in dict.fromkeys(progress) if stage in stages] == stages
    assert len(small_pays) == 1 and len(bases(results)) == 1
    again, _ = modal_hypotheses(LoadedStudy.load(study.file), results)
    assert len(small_pays) == 1
    np.testing.assert_array_equal(first.variants.basis.vectors, again.variants.basis.vectors)


@pytest.mark.medium
def test_the_stored_basis_agrees_with_the_model_itself(study, results, small_pays):
    on_basis, _ = modal_hypotheses(study, results)
    full = replace(on_basis, variants=replace(on_basis.variants, basis=None))
    values = study.search_space.values
    names = [p.name for p in study.search_space.free] + [e.name for e in on_basis.effects]
    for effects in ((), ("platform",), ("guy", "stuck_base")):
        there = {**values, **dict.fromkeys(effects, 1.0)}
        one, other = (h.fit_problem(effects) for h in (on_basis, full))
        assert np.abs(one.residual(there) - other.residual(there)).max() < 0.02
        slope = other.jacobian(there, names)
        assert np.abs(one.jacobian(there, names) - slope).max() < 0.02 * np.abs(slope).max()


@pytest.mark.medium
def test_the_basis_of_a_search_is_reused_and_left_unchanged(study, results, small_pays, monkeypatch, own_cache):
    modal_hypotheses(study, results)
    trained = []
    monkeypatch.setattr(requirements, "train", lambda *a, **k: trained.append(a))
    assert reduction_of(study, results).basis.version == 1 and not trained
    bases(results)[0].unlink()
    shutil.rmtree(own_cache)
    modal_hypotheses(study, results)
    assert len(small_pays) == 2 and not trained


@pytest.mark.medium
@pytest.mark.parametrize(
    "change",
    ["limits", *(pytest.param(name, marks=pytest.mark.slow) for name in ("model", "modes", "tolerance", "effects"))],
)
def test_changed_requirements_need_another_basis(study, results, small_pays, change):
    modal_hypotheses(study, results)
    (before,) = bases(results)
    if change == "limits":
        other = replace(study, search_space=study.search_space.replace("E", upper=220.0))
    elif change == "modes":
        other = replace(study, problem=replace(study.problem, mode_count=9))
    elif change == "tolerance":
        reduction = study.settings.reduction.model_copy(update={"tolerance": 3e-4})
        other = replace(study, settings=study.settings.model_copy(update={"reduction": reduction}))
    elif change == "effects":
        other = replace(study, library=study.library[:2])
    else:
        assert isinstance(study.problem, ModalProblem)
        heavier = replace(study.model, mass=study.model.mass.__class__(study.model.n_dof, study.model.mass.terms[:1]))
        other = replace(study, model=heavier, problem=replace(study.problem, model=heavier))
    modal_hypotheses(other, results)
    assert len(small_pays) == 2
    (after,) = bases(results)  # the old one is deleted
    assert after.name != before.name


@pytest.mark.medium
def test_the_basis_does_not_depend_on_the_measurement(study, results, small_pays, mast, tmp_path):
    modal_hypotheses(study, results)
    again = LoadedStudy.load(mast.write_study(tmp_path / "again", seed=7))
    other, _ = modal_hypotheses(again, results)
    assert other.pair.problem.measured is again.measured
    assert len(small_pays) == 1 and len(bases(results)) == 1


@pytest.mark.medium
@pytest.mark.parametrize(
    "content", [b"rubbish", *(pytest.param(content, marks=pytest.mark.slow) for content in (b"", None))]
)
def test_a_damaged_basis_is_trained_anew(study, results, small_pays, content, own_cache):
    modal_hypotheses(study, results)
    (path,) = bases(results)
    key = path.stem.removeprefix("basis_effects_")
    for file in (path, own_cache / f"basis_{key}.npz"):
        file.write_bytes(file.read_bytes()[:200] if content is None else content)
    with using(None) as notes:
        found, _ = modal_hypotheses(study, results)
    assert len(small_pays) == 2 and found.variants.basis is not None
    assert len(notes) == 1 and key in notes[0]
    with using(None) as notes:
        modal_hypotheses(study, results)
    assert len(small_pays) == 2 and notes == []
    assert BasisCache(own_cache).find(key).digest == found.variants.basis.digest


def test_the_user_may_switch_the_basis_off(study, results, small_pays):
    reduction = study.settings.reduction.model_copy(update={"use": False})
    other = replace(study, settings=study.settings.model_copy(update={"reduction": reduction}))
    assert modal_hypotheses(other, results)[0].variants.basis is None
    assert small_pays == [] and bases(results) == []


@pytest.mark.parametrize(("module", "training"), [(requirements, "effect_basis"), (requirements, "train")])
def test_a_basis_that_cannot_be_trained_is_reported_with_a_remedy(
    study, results, small_pays, monkeypatch, module, training
):
    def fails(*a, **k):
        raise EvaluationError("the matrix is singular")

    monkeypatch.setattr(module, training, fails)
    with pytest.raises(InputError, match="no reduced basis can be trained: the matrix is singular") as fault:
        modal_hypotheses(study, results)
    assert "use = false" in fault.value.remedy and bases(results) == []
