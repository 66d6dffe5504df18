"""User functions run in a child process, where effects act as in this one."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from calib.analyses.provenance.isolation import ChildFunction, KnownThere, isolated
from calib.analyses.provenance.places import open_evaluator
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import WORKER_DIED
from calib.structure.effects.perturbations import scaling_by_function
from calib.structure.function_model import extend_function
from calib.study.loading import with_effects
from calib.study.study import LoadedStudy


@pytest.mark.slow
def test_effects_act_in_the_child_as_in_this_process(sums):
    here = LoadedStudy.load(sums)
    there = isolated(here)
    point = {"a": 2.0, "b": 0.5}
    assert there.problem.evaluate(point) == here.problem.evaluate(point)
    (effect,), (own,) = there.candidates, here.candidates
    more = {"bend": 0.4, "bend_at": 1.5, "bend_scale": 2.0}
    extended, expected = extend_function(there.model, [effect]), extend_function(here.model, [own])
    assert extended.function is there.problem.function and extended.space == expected.space
    assert extended.function(point | more) == expected.function(point | more)


@pytest.mark.slow
def test_a_part_that_the_function_scales_acts_in_the_child_too(sums):
    file = sums / "model.py"
    text = file.read_text().replace(
        'lambda v: {"s": v["a"] + v["b"]})',
        'lambda v: {"s": (1 + v.get("mass of a", 0.0)) * v["a"] + v["b"]}, parts=[ScaledPart("a", "mass")])',
    )
    assert "parts" in text
    file.write_text("from calib.structure.function_parts import ScaledPart\n" + text)
    study = isolated(LoadedStudy.load(sums))
    extended = extend_function(study.model, [scaling_by_function(part) for part in study.model.parts])
    point = {"a": 2.0, "b": 0.5}
    assert extended.function(point | {"mass of a": 0.25}) == {"s": 3.0}
    assert study.problem.evaluate(point) == {"s": 2.5}
    (effect,) = study.candidates
    both = extend_function(extended, [effect])
    more = {"mass of a": 0.25, "bend": 0.4, "bend_at": 1.5, "bend_scale": 2.0}
    assert both.function(point | more)["s"] == pytest.approx(4.2)


@pytest.mark.slow
def test_a_function_and_its_effects_run_in_one_other_process(sums):
    file = sums / "model.py"
    text = file.read_text().replace('{"s": v["a"] + v["b"]}', '{"s": float(os.getpid())}')
    text = text.replace('model.function(v)["s"] + v["bend"] * v["bend_at"] * v["bend_scale"]', "float(os.getpid())")
    file.write_text("import os\n" + text)
    study = isolated(LoadedStudy.load(sums))
    point = {"a": 1.0, "b": 1.0, "bend": 0.1, "bend_at": 1.0, "bend_scale": 2.0}
    pids = {study.problem.evaluate({"a": 1.0, "b": 1.0})["s"]}
    pids.add(extend_function(study.model, study.candidates).function(point)["s"])
    with open_evaluator(study, None, 3) as evaluator:
        pids |= {outcome.responses["s"] for outcome in evaluator.evaluate([{"a": float(k)} for k in range(3)])}
    assert len(pids) == 1 and os.getpid() not in pids


@pytest.mark.slow
def test_an_effect_that_ends_the_process_is_a_failed_point(sums):
    file = sums / "model.py"
    file.write_text("import os\n" + file.read_text().replace('model.function(v)["s"]', "os._exit(1)"))
    study = isolated(LoadedStudy.load(sums))
    extended = extend_function(study.model, study.candidates)
    with pytest.raises(EvaluationError, match=WORKER_DIED):
        extended.function({"a": 1.0, "b": 1.0, "bend": 0.1, "bend_at": 1.0, "bend_scale": 2.0})
    assert study.problem.evaluate({"a": 1.0, "b": 1.0}) == {"s": 2.0}


def test_an_invalid_effect_is_refused_before_any_evaluation(sums):
    study = isolated(LoadedStudy.load(sums))
    (effect,) = study.candidates
    wrong = replace(effect, build=KnownThere(lambda: None))  # it takes no model
    with pytest.raises(InputError, match="bend"):
        with_effects(study.model, [wrong], "here")
    broken = replace(effect, build=KnownThere(lambda model: 5))
    with pytest.raises(InputError, match="it builds int"):
        with_effects(study.model, [broken], "here")


def test_models_of_matrices_stay_in_this_process():
    study = LoadedStudy.load(Path(__file__).parents[2] / "studies/four_storey_rig")
    assert isolated(study) is study


def test_the_child_is_the_one_worker(sums):
    study = isolated(LoadedStudy.load(sums))
    assert isinstance(study.problem.function, ChildFunction)
    with open_evaluator(study, 1, 10) as evaluator:
        assert evaluator is study.problem.function.evaluator
