"""The Python interface: problems and tests in memory give the results of a study in a folder."""

import doctest
import importlib
import re
import subprocess
import sys
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.analyses.calibrate import calibrate
from calib.analyses.compare import comparison_at
from calib.analyses.explain import explain
from calib.results.ledger import Ledger
from calib.results.results import Results
from models.five_mass_chain import five_mass_chain
from models.four_storey_rig import four_storey_rig

STUDIES = Path(__file__).resolve().parents[2] / "studies"
STOREYS = ("k1", "k2", "k3", "k4")
PUBLIC = sorted(set(calib.__all__) - {"__version__"})
CHAIN = ("k1", "k2", "k3", "k4", "k5", "damping")


@pytest.fixture(scope="module")
def rig():
    modes = calib.read_modes(STUDIES / "four_storey_rig/measured.csv", repeats=100, std_of="repeat")
    return calib.Problem(four_storey_rig(), calib.ModalTest(modes, mode_count=4))


@pytest.fixture(scope="module")
def chain():
    measured = calib.read_responses(STUDIES / "five_mass_chain/measured.csv")
    return calib.Problem(five_mass_chain(), calib.ResponseTest(measured)).keep(CHAIN)


@pytest.fixture(scope="module")
def library():
    return calib.Study.load(STUDIES / "five_mass_chain").loaded.library


@pytest.fixture(scope="module")
def explained(chain, library):
    return chain.explain(library)


# -- the same as a study -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_modes_are_compared_and_fitted_as_in_the_study(rig, tmp_path):
    study = calib.Study.load(STUDIES / "four_storey_rig").loaded
    own = comparison_at(study, study.model.space.values)
    assert rig.compare().table.equals(own.table)
    fit = rig.calibrate(STOREYS, starts=3)
    results = Results.at(tmp_path, "rig")
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        found = calibrate(study, results, ledger, method="gauss-newton").best.statistics
    assert fit.statistics.criterion == pytest.approx(found.criterion, abs=1e-3)
    told = found.verdicts(study.search_space, {}).set_index("parameter")
    np.testing.assert_allclose(fit.parameters["value"], told["value"], rtol=1e-3)
    np.testing.assert_allclose(fit.parameters["std"], told["std"], rtol=1e-3)
    assert fit.compare().table["freq_error"].abs().max() < 1e-3


@pytest.mark.medium
@pytest.mark.parametrize("discriminated", [False, True])
def test_a_parameter_is_identified_where_starts_that_fit_equally_well_agree(discriminated, unrendered, tmp_path):
    """Both roots of ``y = 1`` fit; only an accurate z discriminates between them."""
    space = calib.ParameterSpace((calib.Parameter("a", 0.5, -3.0, 3.0),))
    model = calib.FunctionModel("square", space, lambda v: {"y": v["a"] ** 2, "x": v["a"] ** 2, "z": 1 + 0.01 * v["a"]})
    measured = {"y": (1.0, 0.01), "x": (1.0, 0.01), "z": (1.01, 0.001 if discriminated else 0.1)}
    problem = calib.Problem(model, calib.ResponseTest(measured))
    assert problem.calibrate(starts=1).agreement.verdict == "one case"  # one start says nothing
    fit = problem.calibrate(starts=6)
    assert {np.sign(end.values["a"]) for end in fit.statistics.ends} == {-1.0, 1.0}
    assert fit.agreement.verdict == ("one case" if discriminated else "several solutions")
    assert fit.parameters.loc["a", "identified"] == discriminated
    assert fit.parameters.loc["a", "not_identified"] == ("" if discriminated else "solutions")
    fit.report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text("utf-8")
    assert f"{int(discriminated)} of 1 parameters are identified" in page
    assert ("not unique" in page) != discriminated


@pytest.mark.slow
def test_a_function_is_explained_as_in_the_study(chain, explained, tmp_path):
    study = calib.Study.load(STUDIES / "five_mass_chain").loaded
    found = explain(study, Results.at(tmp_path, "chain"))
    why = explained
    assert why.verdict == found.verdict == "effect"
    assert [e.name for e in why.named] == list(found.explanation.credible)
    mine, own = why.explanation.effects.set_index("name"), found.effects.set_index("name")
    np.testing.assert_allclose(mine["magnitude"], own["magnitude"], rtol=0.02)
    before = chain.calibrate(starts=1)
    after = why.with_named().calibrate(starts=1)
    assert before.statistics.fits is False and after.statistics.fits
    rms = [fit.errors.set_index("group").loc["left_out", "rms"] for fit in (before, after)]
    assert rms[1] < 0.5 * rms[0]


@pytest.mark.slow
def test_a_missing_effect_of_a_structure_is_named_and_added(tmp_path):
    from models.railway import bogie_effects, bogie_on_rig

    folder = STUDIES / "hidden_bogie"
    settings = calib.Study.load(folder).loaded.settings
    modes = calib.read_modes(str(folder / "measured/*.uff"), sensors=folder / "measured/sensors.csv", synthetic=True)
    test = calib.ModalTest(
        modes,
        held_out=(*settings.held_out.modes, *settings.held_out.sensors),
        clusters=settings.pairing.clusters,
        mode_count=12,
        freq_window=(1.0, 50.0),
    )
    problem = calib.Problem(bogie_on_rig(), test).keep(settings.selection)
    why = problem.explain(bogie_effects())
    assert why.verdict == "effect" and [e.name for e in why.named] == ["brake_unit"]
    row = why.table.set_index("name").loc["brake_unit"]
    assert row["magnitude_low"] < 60 < row["magnitude_high"]
    better = why.with_named().calibrate(starts=1)
    before, after = (fit.errors.set_index("group") for fit in (problem.calibrate(starts=1), better))
    assert after.loc["held_out_sensors", "rms"] < 0.6 * before.loc["held_out_sensors", "rms"]
    assert after.loc["held_out_sensors", "p"] > 0.05 and before.loc["held_out_sensors", "p"] < 1e-6


# -- several tests -----------------------------------------------------------------------------------------------------


def oscillator():
    names = (("k", 30.0, 1.0, 100.0, "kN/m"), ("m", 7.0, 1.0, 50.0, "kg"), ("load", 0.0, 0.0, 50.0, "kg"))
    space = calib.ParameterSpace(tuple(calib.Parameter(*p) for p in names))
    return calib.FunctionModel("oscillator", space, lambda v: {"w2": 1e3 * v["k"] / (v["m"] + v["load"])})


@pytest.mark.medium
def test_conditions_hold_for_their_test_only():
    tests = [
        calib.ResponseTest({"w2": (1e3 * 40 / (10 + x), 1.0)}, name=f"{x}", condition={"load": x}) for x in (0, 25)
    ]
    problem = calib.Problem(oscillator(), tests)
    assert problem.space.names == ("k", "m")
    fit = problem.calibrate(starts=1)
    assert (fit.values["k"], fit.values["m"]) == pytest.approx((40, 10), rel=1e-3)
    assert fit.compare().table["model"].to_numpy() == pytest.approx([4000, 8000 / 7], rel=1e-3)
    assert set(fit.errors["test"]) == {"0", "25"}
    alone = calib.Problem(oscillator(), tests[0]).calibrate(starts=1)
    assert fit.parameters["std"]["k"] < 0.1 * alone.parameters["std"]["k"]


def test_a_condition_holds_in_its_test_where_another_test_leaves_the_parameter_free():
    empty = calib.ResponseTest({"w2": (4000.0, 4.0)}, name="empty", condition={"load": 0.0})
    loaded = calib.ResponseTest({"w2": (8000 / 7, 1.0)}, name="loaded")
    fit = calib.Problem(oscillator(), [empty, loaded]).calibrate(starts=1)
    assert fit.values["load"] > 1.0
    assert fit.compare().table["model"].to_numpy() == pytest.approx([4000, 8000 / 7], rel=1e-3)
    assert fit.errors.set_index(["test", "group"]).loc[("empty", "fit"), "rms"] < 0.1


def test_parameters_that_are_not_kept_hold_one_value_in_all_joined_problems():
    first = calib.Problem(oscillator(), calib.ResponseTest({"w2": (4000.0, 4.0)}, name="free", condition={"load": 0.0}))
    space = calib.ParameterSpace((calib.Parameter("m", 8.0, 1.0, 50.0, "kg"),))
    scale = calib.FunctionModel("scale", space, lambda v: {"weight": v["m"]})
    joint = calib.Problem.join(first, calib.Problem(scale, calib.ResponseTest({"weight": (10.0, 0.01)}, name="scale")))
    fit = joint.calibrate(["k"], starts=1)
    assert fit.values["m"] == 7.0 and fit.values["k"] == pytest.approx(28.0, rel=1e-3)
    assert fit.compare().table.set_index("test")["model"]["scale"] == 7.0


@pytest.mark.medium
def test_joined_problems_share_parameters_by_name():
    first = calib.Problem(oscillator(), calib.ResponseTest({"w2": (4000.0, 4.0)}, name="free", condition={"load": 0.0}))
    scale = calib.FunctionModel(
        "scale", calib.ParameterSpace((calib.Parameter("m", 7.0, 1.0, 50.0, "kg"),)), lambda v: {"weight": v["m"]}
    )
    second = calib.Problem(scale, calib.ResponseTest({"weight": (10.0, 0.01)}, name="scale"))
    joint = calib.Problem.join(first, second)
    fit = joint.calibrate(starts=1)
    assert (fit.values["k"], fit.values["m"]) == pytest.approx((40, 10), rel=1e-3)
    assert fit.parameters["std"]["m"] == pytest.approx(0.01, rel=0.01)
    held = joint.calibrate(["k"], starts=1)
    assert held.values["m"] == 7.0 and list(held.parameters.index) == ["k"]
    assert calib.Problem.join(second, first).calibrate(starts=1).values["k"] == pytest.approx(fit.values["k"], rel=1e-5)


def test_held_out_data_check_a_fit(chain):
    ((_, test),) = chain.pairs
    names = [n for n in test.measured.targets if n.startswith("f")][:2]
    own = calib.Problem(chain.model, replace(test, held_out=tuple(names)))
    fit = own.calibrate(starts=1)
    groups = fit.errors.set_index("group")
    assert groups.loc["held_out_responses", "rows"] == 2
    assert len(own.fit_problem.rows) == len(test.measured.targets) - 2
    assert not set(names) & {row.sensor for row in own.fit_problem.rows}


def test_an_accuracy_that_comes_with_the_modes_is_told(rig):
    modes = replace(rig.tests.modes, accuracy=rig.tests.modes.accuracy.of("1 %"))
    own, given = calib.ModalTest(modes, mode_count=4), calib.ModalTest(rig.tests.modes, accuracy="1 %", mode_count=4)
    assert own.claimed == given.claimed and "1 %" in own.claimed and rig.tests.claimed == ""


# -- what is shown, and what is refused --------------------------------------------------------------------------------


def test_results_print_their_table_with_every_number(rig):
    found = rig.compare()
    for text in (str(found), found._repr_html_()):
        assert all(f"{value:.3f}" in text for value in found.table["natural_freq_model"])
    fit = rig.statistics_at({})
    assert all(name in str(fit) for name in fit.parameters.index)
    assert "<table" in fit._repr_html_() and "\n" not in repr(fit) + repr(rig) + repr(found)


@pytest.mark.medium
def test_an_explanation_prints_its_answer_first(explained):
    answer, lines = explained.explanation.answer, str(explained).split("\n")
    assert [line[10:] for line in lines[:3]] == [answer.found, answer.sure, answer.then]
    assert all(hasattr(explained, name) for name in re.findall(r"\.(\w+)", lines[3]))
    html = explained._repr_html_()
    assert escape(answer.found) in html and "<table" in html


def test_a_condition_outside_the_limits_is_refused():
    test = calib.ResponseTest({"w2": (4000.0, 4.0)}, name="wild", condition={"load": 1e4})
    with pytest.raises(calib.InputError, match=r"condition of test wild: load = 10000 .* is outside its limits 0 to "):
        calib.Problem(oscillator(), test).compare()


@pytest.mark.parametrize(
    "wrong",
    [
        lambda rig, chain: calib.Problem(rig.model, []),
        lambda rig, chain: calib.Problem(rig.model, chain.tests),
        lambda rig, chain: calib.Problem(chain.model, rig.tests),
        lambda rig, chain: calib.Problem(rig.model, [rig.tests, rig.tests]),
        lambda rig, chain: calib.Problem(rig.model, replace(rig.tests, condition={"speed": 1.0})),
        lambda rig, chain: calib.Problem(rig.model, replace(rig.tests, held_out=("M9",))),
        lambda rig, chain: calib.Problem(rig.model, replace(rig.tests, mode_count=2)),
        lambda rig, chain: calib.Problem(chain.model, replace(chain.tests, held_out=("g1",))),
        lambda rig, chain: replace(rig.tests, accuracy="lots"),
        lambda rig, chain: rig.keep(["k9"]),
        lambda rig, chain: rig.calibrate(["k9"], starts=1),
        lambda rig, chain: rig.explain({"tower": []}),
        lambda rig, chain: calib.read_modes("nowhere/*.uff"),
    ],
)
def test_what_does_not_fit_together_is_refused(rig, chain, wrong):
    with pytest.raises(calib.InputError):
        wrong(rig, chain)


@pytest.mark.medium
def test_without_a_named_effect_none_is_added(explained, library):
    again = explained.with_named().explain(library)  # what the model has already is left out
    assert again.verdict == "nothing_detectable" and again.named == ()
    assert set(again.table["name"]) == {e.name for e in library} - {e.name for e in explained.named}
    with pytest.raises(calib.InputError):
        again.with_named()


# -- names -------------------------------------------------------------------------------------------------------------


def test_every_public_name_is_there_and_documented():
    assert len(calib.__all__) <= 36 and len(set(calib.__all__)) == len(calib.__all__)
    for name in calib.__all__:
        assert getattr(calib, name) is not None
        assert name == "__version__" or getattr(calib, name).__doc__
    with pytest.raises(AttributeError):
        calib.nothing  # noqa: B018


def test_importing_the_package_imports_nothing_else():
    told = "import sys, calib; print(sorted(m for m in sys.modules if m.split('.')[0] in ('numpy', 'scipy', 'pandas')))"
    found = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_every_public_name_has_an_example():
    finder = doctest.DocTestFinder(recurse=False)
    for name in PUBLIC:
        (found,) = finder.find(getattr(calib, name), name)
        assert found.examples and "Examples\n" in found.docstring, name


OPTIONAL = {"calib.modal_analysis.ambient": "pyoma2"}
"""Library of an extra that the examples of a module need."""


@pytest.mark.parametrize("module", dict.fromkeys(getattr(calib, name).__module__ for name in PUBLIC))
def test_examples_of_docstrings_hold(undrawn, module):
    if module in OPTIONAL:
        pytest.importorskip(OPTIONAL[module])
    failed, count = doctest.testmod(importlib.import_module(module))
    assert count and not failed


# -- short displays ----------------------------------------------------------------------------------------------------


def test_measurements_spaces_and_models_print_short():
    modes = calib.read_modes(STUDIES / "four_storey_rig/measured.csv", repeats=100, std_of="repeat")
    model = four_storey_rig()
    for one, lines in ((modes, modes.n_modes + 2), (model.space, len(model.space.parameters) + 1), (model, 1)):
        text = str(one)
        assert len(text.split("\n")) == lines and len(text) < 100 * lines
    assert all(name in str(modes) for name in modes.names)
    assert [p.name for p in model.space] == list(model.space.names)


def test_modes_are_made_from_arrays_in_one_line():
    made = calib.modes([8.0, 27.0], [[0.4, 1.0j], [0.8, 0.5]], sensors=["1x", (2, "x")], damping=[0.01, 0.02])
    assert [s.name for s in made.sensors] == ["1x", "2x"] and made.names == ("1", "2")
    np.testing.assert_allclose(abs(made.shapes).max(axis=0), 1.0)
    np.testing.assert_allclose(made.damped_freq, [8.0 * (1 - 1e-4) ** 0.5, 27.0 * (1 - 4e-4) ** 0.5])
    assert np.isnan(made.freq_std).all() and calib.modes([8.0]).has_shapes is False
    for wrong in (
        lambda: calib.modes([8.0], [[1.0]]), lambda: calib.modes([8.0], [[1.0, 2.0]], sensors=["1x"]),
        lambda: calib.modes([8.0], damping=[0.01, 0.02]), lambda: calib.modes([8.0], [[1.0]], sensors=["x"]),
        lambda: calib.modes([[8.0]]),
    ):  # fmt: skip
        with pytest.raises(calib.InputError):
            wrong()


@pytest.mark.parametrize(("name", "most"), [("Problem", 180), ("Study", 215)])
def test_a_public_name_loads_what_it_needs_alone(name, most):
    """Analyses, tables and figures are imported by the call that needs them: the first line of a notebook is quick."""
    code = f"import sys, calib; calib.{name}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert 0 < sum(module.startswith("calib") for module in loaded) <= most
    assert not {"pandas", "pyuff", "scipy.stats", "matplotlib", "rich"}.intersection(loaded)
