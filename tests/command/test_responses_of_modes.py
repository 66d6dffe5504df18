"""A study of scalar responses of a model with modes, from the command line: frequencies and damping of a data sheet."""

from __future__ import annotations

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.structure.effects.extend import extend
from calib.study.loading import module_of

MODEL = '''
import numpy as np

import calib
from calib.structure.affine import parameter
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition, extend

N = 5


def chain(damping=True):
    """Five masses of 10 kg in a row on springs, the first and the third of them unknown."""
    bars = np.eye(N) - np.eye(N, k=1)
    each = {f"k{k + 1}": np.outer(bars[:, k], bars[:, k]) for k in range(N)}
    known = {name: one if name in ("k1", "k3") else 4e4 * one for name, one in each.items()}
    return calib.StructuralModel.from_matrices(
        stiffness=known,
        mass=10.0 * np.eye(N),
        damping={"b": 1e3 * sum(each.values())} if damping else {},
        dofs=[(k + 1, "x") for k in range(N)],
        parameters=[
            calib.Parameter("k1", 30.0, 10.0, 90.0, "kN/m"),
            calib.Parameter("k3", 50.0, 10.0, 90.0, "kN/m"),
            *([calib.Parameter("b", 0.01, 0.001, 0.1, "-")] if damping else []),
        ],
    )


def _cable(at, build):
    magnitude = calib.Parameter(f"cable_{at}", 0.0, 0.0, 50.0, "kN/m", prior_sd=10.0)
    title = f"a cable at mass {at}"
    return calib.Effect(f"cable_{at}", title, "Nothing holds the masses.", "A cable.", magnitude, build)


def _held(at):
    name = f"cable_{at}"
    return lambda model: Addition(stiffness=(outer_term(name, [np.eye(N)[at - 1]], parameter(name)),))


def effects():
    return tuple(_cable(at, _held(at)) for at in (2, 4))


def of_a_solver():
    return tuple(_cable(at, lambda model: None) for at in (2, 4))


def wrong():
    return (_cable(5, _held(5)),)


def solver():
    """The same behind a function, which reads the parameters of effects itself."""
    whole = extend(chain(), effects())

    def modes(v):
        found = whole.modes(v, N)
        return {"natural_freq": found.natural_freq, "damping_ratio": found.damping_ratio, "shapes": found.shapes}

    sensors = [f"{k + 1}x" for k in range(N)]
    return calib.ModalFunctionModel("solver", chain().space, modes, sensors, n_modes=N, damped=True)
'''
TRUE = {"k1": 40.0, "k3": 45.0, "b": 0.02, "cable_2": 15.0}
STUDY = """
title = "Chain against a data sheet"
model = "model.py:{model}"
effects = "model.py:{effects}"

[measurement]
responses = "sheet.csv"

[held_out]
responses = ["damping_5"]

[sensitivity]
samples = 40

[calibration]
population = 8
generations = 3
"""
KINDS = {"matrices": ("chain", "effects"), "function": ("solver", "of_a_solver")}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """The model's file as a module, its folder and the measured sheet, with 1e-3 of noise on frequencies."""
    folder = tmp_path_factory.mktemp("sheet")
    (folder / "model.py").write_text(MODEL, encoding="utf-8")
    code = module_of(folder / "model.py")
    modes = extend(code.chain(), code.effects()).modes({**TRUE, "cable_4": 0.0}, 5)
    rng, sheet = np.random.default_rng(1), dict[str, tuple[float, float]]()
    for k in range(5):
        for kind, value, share in (("freq", modes.natural_freq, 1e-3), ("damping", modes.damping_ratio, 1e-2)):
            sd = share * float(value[k])
            sheet[f"{kind}_{k + 1}"] = (float(value[k]) + sd * rng.standard_normal(), sd)
    return SimpleNamespace(code=code, folder=folder, sheet=sheet)


def written(world, folder, model="chain", effects="effects", sheet=None, more=""):
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(world.folder / "model.py", folder)
    rows = [f"{name},{value!r},{sd!r}" for name, (value, sd) in (sheet or world.sheet).items()]
    (folder / "sheet.csv").write_text("\n".join(["response,value,std", *rows]) + "\n", encoding="utf-8")
    (folder / "study.toml").write_text(STUDY.format(model=model, effects=effects) + more, encoding="utf-8")


def hold_nothing_out(file):
    file.write_text(file.read_text("utf-8").replace('["damping_5"]', "[]"), encoding="utf-8")


@pytest.fixture(scope="module", params=["matrices", pytest.param("function", marks=pytest.mark.slow)])
def ran(request, world, asked, no_drawing, tmp_path_factory):
    """Results of every analysis in a folder, and the same problem in memory."""
    folder = tmp_path_factory.mktemp(request.param)
    model, effects = KINDS[request.param]
    written(world, folder / "chain", model, effects)
    with no_drawing():
        said = {v: asked(folder, v, "chain") for v in ("compare", "sensitivity", "calibrate", "explain")}
    code = world.code
    problem = calib.Problem(getattr(code, model)(), calib.ResponseTest(world.sheet, held_out=["damping_5"]))
    return SimpleNamespace(
        said=said, problem=problem, effects=getattr(code, effects)(), of=folder / "results/chain", kind=request.param
    )


@pytest.mark.medium
def test_the_folder_compares_the_numbers_that_a_notebook_does(ran):
    stored = pd.read_csv(ran.of / "comparison_before.csv").set_index("response")
    told = ran.problem.compare().table.set_index("response")
    assert list(stored.index) == [f"{kind}_{k}" for k in range(1, 6) for kind in ("freq", "damping")][:-1]
    np.testing.assert_allclose(stored["model"], told["model"], rtol=1e-5)
    np.testing.assert_allclose(stored["error_in_std"], told["error_in_std"], rtol=1e-4)


@pytest.mark.medium
def test_every_parameter_matters_to_some_number(ran):
    chosen = pd.read_csv(ran.of / "selection.csv").set_index("parameter")
    assert set(chosen.index[chosen["selected"]]) == {"k1", "k3", "b"}


@pytest.mark.medium
def test_the_search_and_least_squares_end_where_a_notebook_does(ran):
    fitted = pd.read_csv(ran.of / "verdicts.csv").set_index("parameter")["value"]
    found = ran.problem.calibrate(starts=1, progress=False).values
    for name in ("k1", "k3", "b"):
        assert fitted[name] == pytest.approx(found[name], rel=2e-3)


@pytest.mark.medium
def test_the_missing_cable_is_named_and_held_out_damping_agrees(ran):
    answer = json.loads((ran.of / "explanation.json").read_text("utf-8"))
    assert answer["verdict"] == "effect" and answer["credible_set"] == ["cable_2"]
    told = ran.problem.explain(ran.effects, progress=False)
    assert told.verdict == "effect" and [e.name for e in told.named] == ["cable_2"]
    row = pd.read_csv(ran.of / "effects.csv").set_index("name").loc["cable_2"]
    expected = told.table.set_index("name").loc["cable_2"]
    np.testing.assert_allclose(row["z"], expected["z"], rtol=2e-3)  # the folder begins at its calibration
    assert abs(row["magnitude"] - TRUE["cable_2"]) < 1.0
    errors = pd.read_csv(ran.of / "errors.csv").set_index(["stage", "group"])
    assert errors.loc[("after", "held_out_responses"), "p"] > 0.01
    assert "about 1" in ran.said["explain"]


@pytest.mark.medium
def test_local_perturbations_are_those_of_matrices_or_of_responses(ran):
    names = set(pd.read_csv(ran.of / "perturbations.csv")["perturbation"])
    told = set(ran.problem.explain(ran.effects, progress=False).explanation.tables["perturbations"]["perturbation"])
    assert names == told
    assert ("stiffness of k3" in names) == (ran.kind == "matrices")


COUNTING = """

def counted():
    from dataclasses import replace
    from pathlib import Path

    model = solver()

    def modes(v):
        with Path(__file__).with_name("calls.txt").open("a") as file:
            file.write(".")
        return model.function(v)

    return replace(model, function=modes)
"""


@pytest.mark.slow
def test_a_point_of_a_function_is_kept_as_modes_and_solved_once(world, asked, no_drawing, tmp_path):
    """Its key does not depend on what was measured: another sheet is compared at points that are known."""
    few = {name: world.sheet[name] for name in ("freq_1", "freq_2", "damping_1")}
    calls = []
    for sheet in (world.sheet, few):
        written(world, tmp_path / "chain", "counted", "of_a_solver", sheet)
        with (tmp_path / "chain/model.py").open("a", encoding="utf-8") as file:
            file.write(COUNTING)
        if sheet is few:
            hold_nothing_out(tmp_path / "chain/study.toml")
        with no_drawing():
            assert "40 samples" in asked(tmp_path, "sensitivity", "chain")
        calls.append(len((tmp_path / "chain/calls.txt").read_text("utf-8")))
    assert 40 <= calls[0] <= 43 and calls[1] - calls[0] <= 2  # a known point is checked


@pytest.mark.slow
def test_one_of_several_tests_may_be_a_sheet(world, asked, no_drawing, tmp_path):
    """Modes with their shapes, and the damping ratios of another source."""
    written(world, tmp_path / "chain")
    modes = world.code.chain().modes({"k1": 40.0, "k3": 45.0, "b": 0.02}, 5)
    rows = [f"{k + 1},{f:.6f},{2e-3 * f:.6f},natural" for k, f in enumerate(modes.natural_freq)]
    (tmp_path / "chain/modes.csv").write_text("\n".join(["mode,freq,freq_std,freq_kind", *rows]) + "\n")
    rows = [f"damping_{k + 1},{z:.8f},{1e-2 * z:.8f}" for k, z in enumerate(modes.damping_ratio)]
    (tmp_path / "chain/sheet.csv").write_text("\n".join(["response,value,std", *rows]) + "\n")
    (tmp_path / "chain/study.toml").write_text(
        'title = "Two sources"\nmodel = "model.py:chain"\n\n'
        '[[tests]]\nname = "tapped"\nfiles = ["modes.csv"]\n\n[[tests]]\nname = "sheet"\nresponses = "sheet.csv"\n\n'
        "[sensitivity]\nsamples = 40\n\n[calibration]\npopulation = 8\ngenerations = 3\n"
    )
    with no_drawing():
        asked(tmp_path, "sensitivity", "chain")
        asked(tmp_path, "calibrate", "chain")
    fitted = pd.read_csv(tmp_path / "results/chain/verdicts.csv").set_index("parameter")["value"]
    assert fitted["k1"] == pytest.approx(40.0, rel=5e-3) and fitted["b"] == pytest.approx(0.02, rel=2e-2)


@pytest.mark.slow
def test_proposals_of_matrices_need_no_sensor(world, asked, no_drawing, tmp_path):
    """No mode was measured: the band of the model's own modes sizes what is composed."""
    written(world, tmp_path / "chain", "chain", "wrong")
    with no_drawing():
        asked(tmp_path, "explain", "chain")
        said = asked(tmp_path, "propose", "chain")
    table = pd.read_csv(tmp_path / "results/chain/proposals.csv")
    assert "stiffness" in set(table["kind"]) and "Proposed" in said


@pytest.mark.parametrize(
    ("sheet", "words"),
    [
        ({"freq_1": (3.4, 0.01), "mass": (50.0, 1.0)}, "has no response 'mass'"),
        ({"freq_1": (3.4, 0.01), "freq_6": (30.0, 1.0)}, "freq_6 is beyond the 5 modes"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(world, tmp_path, capsys, monkeypatch, sheet, words):
    monkeypatch.chdir(tmp_path)
    written(world, tmp_path / "chain", "chain", sheet=sheet)
    hold_nothing_out(tmp_path / "chain/study.toml")
    assert cli.execute(["compare", "chain"]) == 2
    said = capsys.readouterr().err
    assert words in said and "study.toml, line" in said


def test_a_function_of_numbers_alone_takes_no_modes(world, tmp_path, capsys, monkeypatch):
    """The refusal that is left: a `FunctionModel` has no modes."""
    monkeypatch.chdir(tmp_path)
    written(world, tmp_path / "chain", "plain")
    plain = 'calib.FunctionModel("plain", chain().space, lambda v: {"freq_1": v["k1"]})'
    with (tmp_path / "chain/model.py").open("a", encoding="utf-8") as file:
        file.write(f"\n\ndef plain():\n    return {plain}\n")
    file = tmp_path / "chain/study.toml"
    file.write_text(file.read_text("utf-8").replace('responses = "sheet.csv"', 'files = ["sheet.csv"]'))
    assert cli.execute(["compare", "chain"]) == 2
    assert "is compared with measured scalar responses" in capsys.readouterr().err
