"""Figures and the report of a fit show its tables."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import calib
from calib.report.numbers import fixed, significant
from models.four_storey_rig import four_storey_rig

STUDIES = Path(__file__).resolve().parents[2] / "studies"


@pytest.fixture(scope="module")
def fit():
    modes = calib.read_modes(STUDIES / "four_storey_rig/measured.csv", repeats=100, std_of="repeat")
    return calib.Problem(four_storey_rig(), calib.ModalTest(modes, mode_count=4)).calibrate(
        ["k1", "k2", "k3", "k4"], starts=1
    )


def test_bars_are_the_errors_of_the_tables(fit):
    ax = Figure().add_subplot()
    assert fit.figure("frequency_errors", ax) is ax
    before, after = (ax.containers[k].datavalues for k in (0, 1))
    np.testing.assert_allclose(before, 100 * fit.problem.compare().table["freq_error"])
    np.testing.assert_allclose(after, 100 * fit.compare().table["freq_error"], atol=1e-9)


def test_parameters_are_drawn_between_their_limits(fit):
    ax = fit.figure("parameters")
    p = fit.problem.space.free
    dots = [line for line in ax.lines if line.get_marker() == "o"]
    drawn = {round(float(x), 9) for line in dots for x in np.asarray(line.get_xdata())}
    assert {round((fit.values[q.name] - q.lower) / (q.upper - q.lower), 9) for q in p} <= drawn


@pytest.mark.slow
def test_the_report_holds_every_value(fit, tmp_path):
    (page,) = fit.report(tmp_path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    text = page.read_text()
    told = fit.parameters
    assert all(name in text for name in told.index)
    assert all(significant(value, 5) in text for value in told["value"])
    ((model, test),) = fit.problem.pairs
    assert f"{model.name} ({test.pair(model).fingerprint})" in text and f"calib {calib.__version__}" in text
    assert "Analyses not run" not in text and not re.search(r"""(src|href)=["']http""", text)


@pytest.mark.medium
def test_several_tests_have_one_report(unrendered, tmp_path):
    space = calib.ParameterSpace((calib.Parameter("k", 3.0, 1.0, 9.0),))
    model = calib.FunctionModel("spring", space, lambda v: {"u": 1 / v["k"], "w": v["k"] ** 2})
    tests = [calib.ResponseTest({"u": (0.25, 0.001), "w": (16.0, 0.1)}, name=name) for name in ("a", "b")]
    fit = calib.Problem(model, tests).calibrate(starts=1)
    (path,) = fit.report(str(tmp_path / "page.html"))
    assert [p.name for p in tmp_path.iterdir()] == [path.name] == ["page.html"]
    text = path.read_text()
    assert text.count("<caption>Identifiability of the parameters</caption>") == 1
    sections = re.findall(r'<section id="([^"]+)"', text)
    assert sections[:5] == ["afterwards", "calibrated", "evidence", "test1-test", "test2-test"]
    assert len(ids := re.findall(r' id="([^"]+)"', text)) == len(set(ids))
    rms = fit.errors.set_index(["test", "group"])["rms"]
    for name in ("a", "b"):
        assert f"{name} {fixed(rms[name, 'fit'], 2)} σ" in text[: text.index("<section")]
    with pytest.raises(calib.InputError):
        fit.figure("parameters")
    assert fit.figure("parameters", test="b") is not None
    with pytest.raises(calib.InputError):
        fit.figure("frequency_errors", test="b")


@pytest.mark.medium
def test_what_cannot_be_drawn_or_written_is_refused(fit, unrendered, tmp_path):
    for name in ("nothing", "mac"):  # no shapes were measured
        with pytest.raises(calib.InputError):
            fit.figure(name)
    with pytest.raises(calib.InputError):
        fit.report(tmp_path / "nowhere/report.html")


def test_a_comparison_draws_the_figures_that_it_names(fit):
    found = fit.problem.compare()
    assert found.figures == ("frequency_errors",)  # no shapes were measured
    assert found.lines["Evidence"].endswith(".figure(name) draws frequency_errors")
    (bars,) = found.figure("frequency_errors").containers
    np.testing.assert_allclose(bars.datavalues, 100 * found.table["freq_error"])
    for name in ("mac", "parameters"):
        with pytest.raises(calib.InputError):
            found.figure(name)
    with pytest.raises(calib.InputError, match="no test 'other'"):
        found.figure("frequency_errors", test="other")


@pytest.fixture(scope="module")
def stiff_chain():
    """Three masses on springs, and modes of a chain whose first spring is stiffer, at two of the masses."""
    stiffness = [np.outer(row, row) for row in (np.eye(3) - np.eye(3, k=-1))]

    def modes(first, rows=(0, 1, 2)):
        squares, shapes = np.linalg.eigh(1e3 * (first * stiffness[0] + stiffness[1] + stiffness[2]))
        return np.sqrt(squares) / (2 * np.pi), shapes[list(rows)]

    parameters = [calib.Parameter("k", 1.0, 0.5, 3.0, "kN/m")]
    model = calib.StructuralModel.from_matrices(
        stiffness={"first": (stiffness[0], "k"), "others": 1e3 * (stiffness[1] + stiffness[2])}, mass=np.eye(3),
        dofs=[(n, "x") for n in (1, 2, 3)], parameters=parameters, name="chain",
    )  # fmt: skip
    freq, shapes = modes(1.4, (0, 2))
    measured = calib.modes(freq, shapes, sensors=["1x", "3x"], freq_std=0.001 * freq, shape_std=0.01)
    return calib.Problem(model, calib.ModalTest(measured)).compare(), (freq, shapes), modes(1.0, (0, 2))


@pytest.mark.medium
def test_the_figures_of_a_comparison_show_frequencies_and_shapes(stiff_chain):
    found, (freq, shapes), (own_freq, own_shapes) = stiff_chain
    assert len(found.figures) == 6 and all(found.figure(name) is not None for name in found.figures)
    (bars,) = found.figure("frequency_errors").containers
    np.testing.assert_allclose(bars.datavalues, 100 * (own_freq / freq - 1), rtol=1e-6)
    mac = (shapes.T @ own_shapes) ** 2 / np.outer((shapes**2).sum(0), (own_shapes**2).sum(0))
    np.testing.assert_allclose(found.figure("mac_matrix").images[0].get_array(), mac, atol=1e-6)
