"""A test of modes and one of FRFs of one chain, whose model lacks a spring; synthetic measurements."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.hypotheses_of_study import adapter_of, adapters_for
from calib.command import cli
from calib.errors.errors import InputError
from calib.hypotheses.joint import joined_adapter
from calib.report.figures import Figures
from calib.report.html.study_results import StudyResults
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.several import load

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
TAPPED = """
[[tests]]
name = "tapped"
files = ["modes.csv"]
shapes = ["shapes.csv"]
sensors = "sensors.csv"
synthetic = true
held_out = { modes = ["m4"] }

"""


def write_modes(folder, seed=5, ground=0.0):
    """Modes of the chain as tables, one repeat after the other."""
    measured = [WORLD.modes(seed + k, repeats=2, ground=ground) for k in range(4)]
    modes, shapes = ["mode,freq,freq_kind,damping,repeat"], ["mode,node,direction,re,im,repeat"]
    for k, own in enumerate(measured):
        for j, name in enumerate(own.names):
            modes.append(f"{name},{own.natural_freq[j]:.9g},natural,{own.damping_ratio[j]:.9g},r{k}")
            for sensor, entry in zip(own.sensors, own.shapes[:, j], strict=True):
                shapes.append(f"{name},{sensor.node},x,{entry.real:.9g},{entry.imag:.9g},r{k}")
    (folder / "modes.csv").write_text("\n".join(modes) + "\n")
    (folder / "shapes.csv").write_text("\n".join(shapes) + "\n")


def write_study(folder):
    WORLD.write_study(folder, ground=WORLD.HIDDEN)
    write_modes(folder, ground=WORLD.HIDDEN)
    text = (folder / "study.toml").read_text()
    (folder / "study.toml").write_text(text.replace("[sensitivity]", TAPPED + "[sensitivity]"))
    return folder


@pytest.fixture(scope="module")
def both():
    """The right model, fitted to both tests."""
    frfs = WORLD.measured(3, share=0.1, floor=0.02)
    tests = [calib.FRFTest(frfs, name="shaken"), calib.ModalTest(WORLD.modes(5), name="tapped")]
    return calib.Problem(WORLD.chain(), tests).calibrate(starts=1, progress=False)


@pytest.mark.medium
def test_the_information_of_all_tests_is_the_sum_of_theirs(both):
    """By hand from the derivatives of each test at the joint fit, the prior counted once."""
    names, space = list(both.parameters.index), both.problem.space
    prior = np.diag([1 / space[n].prior_width ** 2 for n in names])
    parts = {test: part.jacobian(both.values, names) for test, part in both.problem.fit_problem.parts.items()}
    told = both.std_by_test.pivot(index="parameter", columns="test", values="std").loc[names]
    birge = both.statistics.birge
    whole = prior.copy()
    for test, slope in parts.items():
        own = slope.T @ slope / birge**2
        whole += own
        np.testing.assert_allclose(told[test], np.sqrt(np.diag(np.linalg.inv(prior + own))), rtol=1e-6)
    np.testing.assert_allclose(told["all tests"], np.sqrt(np.diag(np.linalg.inv(whole))), rtol=1e-6)
    np.testing.assert_allclose(told["all tests"], both.parameters["std"], rtol=1e-12)
    assert (told["all tests"] < 0.98 * told[["shaken", "tapped"]].min(axis=1)).all()


@pytest.mark.medium
def test_labels_of_all_tests_keep_the_columns_that_each_brings(both):
    joint, parts = both.problem.fit_problem, both.problem.fit_problem.parts
    labels = joint.labels
    for test, own in {name: part.labels for name, part in parts.items()}.items():
        shown = labels[labels["test"] == test].reset_index(drop=True)
        brought = [name for name in own.columns if name not in ("mode", "sensor")]
        assert (
            len(own) == len(parts[test].rows) and shown[brought].to_numpy().tolist() == own[brought].to_numpy().tolist()
        )
        assert [row.own for row in joint.rows if row.test == test] == list(parts[test].rows)
    frfs = labels[labels["test"] == "shaken"]
    assert set(frfs["part"]) == {"re", "im"} and frfs["freq"].tolist() == [r.freq for r in parts["shaken"].rows]
    assert set(labels.loc[labels["test"] == "tapped", "freq"]) == {""}
    assert labels["sensor"].tolist() == [row.sensor for row in joint.rows]


@pytest.mark.medium
def test_lines_of_frfs_reach_the_pattern_of_an_effect_beside_modes(both):
    adapter = joined_adapter(adapters_for(both.problem.study()))
    base = adapter.hypotheses.fit_problem(())
    table = adapter.labels().astype(object).fillna("")
    assert len(table) == len(base.rows) and table["test"].tolist() == [row.test for row in base.rows]
    assert table["freq"].tolist() == [getattr(row.own, "freq", "") for row in base.rows]


def test_one_test_is_not_compared_with_itself(both):
    alone = calib.Problem(WORLD.chain(), calib.ModalTest(WORLD.modes(5)))
    assert alone.statistics_at(both.values).std_by_test.empty


# -- as a study --------------------------------------------------------------------------------------------------------


def test_a_study_with_tests_of_its_own_takes_no_held_out_data_of_its_base(tmp_path):
    below = tmp_path / "below"
    below.mkdir()
    (below / "model.py").write_text(
        "import calib\n\n\ndef line():\n"
        '    space = calib.ParameterSpace((calib.Parameter("a", 1.0, 0.5, 2.0),))\n'
        '    return calib.FunctionModel("line", space, lambda v: {"y": v["a"], "z": 2 * v["a"]})\n'
    )
    (below / "y.csv").write_text("response,value,std\ny,1.1,0.01\nz,2.2,0.01\n")
    (below / "study.toml").write_text(
        'title = "A line"\nmodel = "model.py:line"\n[measurement]\nresponses = "y.csv"\n'
        '[held_out]\nresponses = ["z"]\n[pairing]\nthreshold = 0.4\n'
    )
    above = tmp_path / "above"
    above.mkdir()
    each = "".join(f'[[tests]]\nname = "{name}"\nresponses = "../below/y.csv"\n' for name in ("one", "two"))
    (above / "study.toml").write_text('base = "../below"\n' + each)
    study = load(above)
    assert [one.test for one in study.studies] == ["one", "two"]
    assert all(set(one.problem.targets) == {"y", "z"} and not one.unseen for one in study.studies)


@pytest.mark.medium
def test_a_study_may_name_parameters_of_a_test_itself(tmp_path):
    """As an extended study does, which begins where the explanation ended."""
    study = write_study(tmp_path / "chain")
    text = (study / "study.toml").read_text()
    text = text.replace("held_out = { sensors", "nuisances = { gain = 1.0 }\nheld_out = { sensors")
    for name, known in (("gain_1x in test shaker", True), ("gain_1x in test tapped", False)):
        begin = f'starts = 1\nbegin_at = {{ "{name}" = 1.5 }}'
        (study / "study.toml").write_text(text.replace("starts = 1", begin))
        if known:
            assert load(study).search_space[name].prior_sd == 1.0
        else:
            with pytest.raises(InputError, match=name):
                load(study)


@pytest.mark.medium
def test_faults_of_channels_of_the_same_name_belong_to_their_tests(tmp_path):
    """In Python and as a study: another test has its own cables."""
    frfs = WORLD.measured(3, share=0.1, floor=0.02)
    problem = calib.Problem(WORLD.chain(), [calib.FRFTest(frfs, name=name) for name in ("before", "after")])
    first, second = adapters_for(problem.study()).values()
    names = [{f.name for f in one.hypotheses.faults} for one in (first, second)]
    assert "gain_1x in test before" in names[0] and "cross_talk_3x_1x in test after" in names[1]
    assert names[0] & names[1] == {"mass of the accelerometers"}  # of the one model that both tests have
    shaker = load(write_study(tmp_path / "chain")).studies[0]
    assert shaker.test == "shaker"
    adapter = adapter_of(shaker, Results.at(tmp_path / "results", "chain"), lambda *a: None, ())
    assert "gain_1x in test shaker" in {f.name for f in adapter.hypotheses.faults}


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Results of a whole quick run, figures left out."""
    root = tmp_path_factory.mktemp("both")
    study = write_study(root / "chain")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.report.figures.Figures.save", lambda figures, *given: [])
        patch.setattr("calib.report.figures.svg_text", lambda figure, name: f"<svg><!-- {name} --></svg>")
        command = ["run", str(study), "--quick", "--workers", "1", "--results", str(root / "results")]
        assert cli.execute(command) == 0
    return root / "results"


@pytest.mark.slow
def test_a_spring_is_named_by_both_tests_together_and_held_out_errors_of_each_fall(ran):
    errors = pd.read_csv(ran / "chain/quick/data_errors.csv").set_index(["test", "group"])
    added = {t: pd.read_csv(ran / f"chain.{t}/quick/added_errors.csv") for t in ("shaker", "tapped")}
    held_out = {"shaker": {"held_out_sensors", "held_out_references", "held_out_bands"}, "tapped": {"held_out_modes"}}
    for test, table in added.items():
        wide = table.pivot(index="group", columns="stage", values="rms")
        assert {g for g in wide.index if g.startswith("held_out")} == held_out[test]
        assert (wide["after"] < 0.1 * wide["before"]).all()
        np.testing.assert_allclose(errors.loc[test].loc[wide.index, "rms"], wide["before"], rtol=1e-6)
    effects = pd.read_csv(ran / "chain/quick/effects.csv").set_index("name")
    low, high = effects.loc["ground_2", ["magnitude_low", "magnitude_high"]]
    assert low < WORLD.HIDDEN < high and effects.index[effects["credible"]].tolist() == ["ground_2"]
    stds = pd.read_csv(ran / "chain_extended/quick/std_by_test.csv").pivot(
        index="parameter", columns="test", values="std"
    )
    assert "ground_2" in stds.index and (stds["all tests"] < stds[["shaker", "tapped"]].min(axis=1)).all()


@pytest.mark.slow
def test_each_page_has_what_its_kind_of_test_offers(ran):
    plans = {t: Figures(ran / f"chain.{t}/quick", "", True).plan for t in ("shaker", "tapped")}
    assert {"frf_lines", "frac", "frf_misfit"} <= set(plans["shaker"]) and "mac_after" not in plans["shaker"]
    assert {"mac_after", "comac", "sensor_misfit"} <= set(plans["tapped"]) and "frac" not in plans["tapped"]
    for test, kind in (("shaker", "frf"), ("tapped", "modes")):
        assert StudyResults(ran / f"chain.{test}/quick", "", True).kind == kind
        assert not (ran / f"chain.{test}/quick/report.html").exists()  # the tests have one together
    page = (ran / "chain/quick/report.html").read_text("utf-8")
    assert page.count("from the data of each test alone") == 1
    assert all(any(f'id="test{k}-{name}"' in page for k in (1, 2)) for name in ("frf_misfit", "comac"))
