"""The studies of the tire: their twins are other tires than the fitted one, and the mesh correction is what it says."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.errors.errors import InputError
from calib.measurement.responses import read_responses
from calib.study.loading import module_of
from calib.study.study_text import read_settings
from models.tire.effects import tire_effects
from models.tire.mesh_correction import mesh_corrected, mesh_factors, read_factors
from models.tire.model import parameters, tire_on_ground

ROOT = Path(__file__).resolve().parents[1]
STUDY = ROOT / "studies/hidden_tire"
TRUTH = json.loads((ROOT / "tests/truth/hidden_tire.json").read_text("utf-8"))
NOMINAL = {p.name: p.value for p in parameters()}


@pytest.fixture(scope="module")
def make():
    return module_of(STUDY / "make_twin.py")


def test_measurements_scatter_about_the_responses_of_the_twin(make):
    for pressure, exact in TRUTH["responses"].items():
        measured = read_responses(STUDY / f"measured/{pressure}_kPa.csv")
        assert set(measured.targets) == set(make.MEASURED) and set(measured.counts.values()) == {make.REPEATS}
        for name, (value, _) in measured.targets.items():
            scatter = make.SCATTER[name.split("_")[0]] / np.sqrt(make.REPEATS)
            assert abs(value / exact[name] - 1) < 4.5 * scatter, name


def test_the_twin_is_finer_and_its_parameters_are_not_nominal(make):
    settings = read_settings(STUDY / "study.toml")
    assert make.MESH > make.study.FINE > make.study.COARSE
    free = [p for p in parameters() if p.name in settings.selection]
    assert len(free) == 5 and all(TRUTH["parameters"][p.name] != p.value for p in free)
    assert len(TRUTH["effects"]) == 1 and TRUTH["visible"] > make.VISIBLE[0]


@pytest.mark.parametrize("design", ["belt", "tread_layer", "soft_bead", "thin_sidewall", "halpin_tsai", "crown_mass"])
def test_designs_of_the_twin_are_like_the_effects_and_not_the_same(make, design):
    """Away from the places where it acts the wall is as without it; stiffness or mass differ from the library's."""
    effect = {e.name: e for e in make.tire_effects()}[design]
    size = {effect.name: effect.plausible} | {q.name: q.value for q in effect.nuisance}
    plain, built = (make.Truth(NOMINAL, designs).tire() for designs in ({}, size))
    library = replace(make.tire_of(NOMINAL | size), profile=built.profile)
    s = np.linspace(0.01, 0.99, 99) * built.profile.length

    def both(tire):
        return np.concatenate([tire.stiffness(s).ravel() / 1e6, tire.areal_density(s)])

    base, own, listed = both(plain), both(built), both(library)
    changed = own - base
    assert np.abs(changed).max() > 0 and not np.allclose(own, listed, rtol=1e-3, atol=1e-9)
    alike = changed @ (listed - base) / np.linalg.norm(changed) / np.linalg.norm(listed - base)
    assert 0.7 < alike < 0.9999


def test_an_inner_ply_that_lies_outermost_leaves_its_share_of_the_coupling(make):
    """Thicknesses t - a, t, t, t, a of plies that alternate: B16 is 1 - 2 a / t of that of four equal ones."""
    s = np.linspace(0.02, 0.3, 7)
    plain, built = (make.Truth(NOMINAL, d).tire().stiffness(s) for d in ({}, {"uncoupled": 0.6}))
    np.testing.assert_allclose(built[:, 0, 5], 0.4 * plain[:, 0, 5], rtol=1e-9)
    np.testing.assert_allclose(built[:, :3, :3], plain[:, :3, :3], rtol=1e-9, atol=1e-6 * plain[0, 0, 0])


def test_the_dead_part_of_the_pressure_has_a_potential_and_varies_over_the_section(make):
    plain, built = (make.Truth(NOMINAL, d).tire().wall(11, 8).volume.curvature for d in ({}, {"dead_pressure": 0.5}))
    assert abs(built - built.T).max() < 1e-12 * abs(built).max()
    kept = built.diagonal() / plain.diagonal()
    assert 0.4 < kept.min() < 0.45 < 0.55 < kept.max() < 0.6


@pytest.mark.parametrize("design", ["apex", "one_sidewall", "wandering_cords"])
def test_designs_outside_the_library_change_the_wall(make, design):
    s = np.linspace(0.01, 0.33, 40)
    plain, built = (make.Truth(NOMINAL, d).tire() for d in ({}, {design: make.SIZES[design][1]}))
    assert not np.allclose(plain.stiffness(s), built.stiffness(s), rtol=0.01)


@pytest.mark.medium
def test_factors_are_the_finer_mesh_over_the_coarse_one():
    coarse, fine = (tire_on_ground(*mesh, (10.0,), (), (1,), derivatives=False) for mesh in ((11, 10), (15, 12)))
    corrected = mesh_corrected(coarse, mesh_factors(coarse, fine, (100.0, 200.0)))
    for pressure in (100.0, 200.0):
        at = NOMINAL | {"pressure": pressure}
        assert corrected.function(at) == pytest.approx(fine.function(at), rel=1e-12)


def test_derivatives_are_corrected_as_their_responses_are():
    coarse = tire_on_ground(11, 10, (10.0,), (), ())
    factors = mesh_factors(coarse, coarse, (200.0,))[["load_10"]] * 2.0
    plain, corrected = coarse.function(NOMINAL), mesh_corrected(coarse, factors).function(NOMINAL)
    for name in ("load_10", "d(load_10)/d(E_cord)"):
        assert corrected[name] == pytest.approx(2 * plain[name])
    assert corrected["d(growth_crown)/d(E_cord)"] == plain["d(growth_crown)/d(E_cord)"]


@pytest.mark.parametrize(
    "text", ["load_5\n1.0\n", "pressure,load_5\n100,much\n", "pressure,load_5\n100,-1\n", "pressure\n"]
)
def test_tables_of_factors_that_are_none_are_refused(tmp_path, text):
    file = tmp_path / "mesh.csv"
    file.write_text(text, "utf-8")
    with pytest.raises(InputError, match=r"mesh\.csv"):
        read_factors(file)


@pytest.mark.slow
def test_the_factors_of_the_study_are_those_of_its_meshes(make):
    """The finer one is that of the option, which the error of the mesh is taken from."""
    study = make.study
    coarse = tire_on_ground(*study.COARSE, study.DEFLECTIONS, (), study.ORDERS, derivatives=False)
    again = mesh_factors(coarse, study.tire(corrected=False), (200.0,))
    kept = read_factors(STUDY / "mesh.csv")
    for name in kept:
        assert again.loc[200.0, name] == pytest.approx(kept.loc[200.0, name], rel=2e-5), name


@pytest.mark.slow
def test_a_tire_that_lacks_nothing_is_calibrated(tmp_path):
    """Within its standard deviations of the true values; held-out loads and frequencies agree."""
    assert cli.execute(["calibrate", str(ROOT / "studies/tire_contact"), "--results", str(tmp_path)]) == 0
    truth = json.loads((ROOT / "tests/truth/tire_contact.json").read_text("utf-8"))["parameters"]
    summary = json.loads((tmp_path / "tire_contact/summary.json").read_text("utf-8"))
    assert summary["p_fit"] > 0.01
    lines = (tmp_path / "tire_contact/parameters.csv").read_text("utf-8").splitlines()
    head = lines[0].split(",")
    rows = [dict(zip(head, line.split(","), strict=False)) for line in lines[1:]]
    assert len(rows) == 5
    for row in rows:
        assert abs(float(row["value"]) - truth[row["parameter"]]) < 2 * float(row["std"]), row["parameter"]
    # The error of the mesh, common to all pressures: without it the crown angle is three standard deviations off.
    held = pd.read_csv(tmp_path / "tire_contact/considered.csv").set_index("parameter")
    assert held.loc["mesh_error", "adds_to"] == "crown_angle" and held.loc["mesh_error", "matters"]
    found = next(float(row["value"]) for row in rows if row["parameter"] == "crown_angle")
    assert abs(found - truth["crown_angle"]) > 2.5 * held.loc["mesh_error", "std_without"]


@pytest.mark.whole
def test_the_hidden_effect_is_named_from_two_pressures():
    """The study asks at four; its README states what it finds there."""
    settings = read_settings(STUDY / "study.toml")
    tests = [
        calib.ResponseTest(
            calib.read_responses(STUDY / one.responses), name=one.name, condition=one.set, accuracy=one.accuracy
        )
        for one in settings.tests
        if one.set["pressure"] in (100.0, 200.0)
    ]
    why = calib.Problem(module_of(STUDY / "model.py").tire(), tests).calibrate(starts=1).explain(list(tire_effects()))
    assert why.verdict == "effect" and [effect.name for effect in why.named] == TRUTH["effects"]
    low, high = why.table.set_index("name").loc[TRUTH["effects"][0], ["magnitude_low", "magnitude_high"]]
    assert low < TRUTH["magnitudes"][TRUTH["effects"][0]] < high
