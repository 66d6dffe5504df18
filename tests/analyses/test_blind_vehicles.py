"""The blind studies of the whole vehicle: the truth is read only after the verdict is written.

They share one model and so one reduced basis, whose training takes most of the time.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.explain import explain
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
VERDICTS = {
    "hidden_effect": "effect",
    "hidden_none": "nothing_detectable",
    "hidden_outside": "none_explains",
    "hidden_two": "two_effects",
    "hidden_noise": "noise_underestimated",
}
NAMED = ("hidden_effect", "hidden_two")
HUNG, SAG = "hung_converter", 1.3
pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def results_of(tmp_path_factory):
    """Folder of results of a study, with the basis that an earlier one trained."""
    root = tmp_path_factory.mktemp("vehicles")

    def make(name):
        kept, results = list(root.glob("*/basis_effects_*.npz"))[:1], Results.at(root, name)
        for basis in kept:
            shutil.copy(basis, results.path)
        return results

    return make


@pytest.fixture(scope="module")
def explained(blindly, results_of):
    """The folder of results of each study, explained once."""
    done = {}

    def make(name):
        if name not in done:
            done[name] = blindly(name, results_of(name))
        return done[name]

    return make


@pytest.fixture(scope="module")
def unit_on_mounts(tmp_path_factory):
    """A study of a vehicle whose converter is a rigid body on four mounts, lower and of other dimensions than assumed.

    Its mesh is finer, each mount is modelled in the mesh, and its parameters are drawn like those of the others.
    """
    folder = tmp_path_factory.mktemp("study") / "unit_on_mounts"
    twin = module_of(ROOT / "studies/hidden_effect/make_twin.py")
    rebuilt = module_of(ROOT / "tests/models/railway/rebuilt_vehicle.py")
    specimen, rng = twin.specimen(), np.random.default_rng(5)
    values = specimen.draw(rng)
    unit = {HUNG: SAG, f"{HUNG}_drop": 0.25, f"{HUNG}_sideways": 0.7, f"{HUNG}_damping": 0.04}
    model = rebuilt.hung(unit, 2, HUNG, "traction converter", (2.2, 0.8, 1.7), distributed=True)
    names, modes, shapes = specimen.seen(model, 6, values, rng)
    assert names == specimen.modes
    twin.blind.twin.write_measurement(folder / "measured", names, modes, shapes, specimen.layout, rng, "vehicle test")
    shutil.copy(specimen.file, folder)
    return LoadedStudy.load(folder)


def summary_of(folder):
    return json.loads((folder / "explanation.json").read_text("utf-8"))


def truth(name):
    return json.loads((ROOT / f"tests/truth/{name}.json").read_text("utf-8"))


@pytest.mark.parametrize("name", VERDICTS)
def test_the_verdict_is_right(explained, name):
    summary = summary_of(explained(name))
    assert summary["verdict"] == VERDICTS[name]
    named = truth(name)["effects"] if name in NAMED else []
    assert set(summary["credible_set"]) == set(named)


@pytest.mark.parametrize("name", NAMED)
def test_magnitudes_are_found(explained, name):
    """Within 10 % of the truth, or within the interval where that is wider."""
    folder = explained(name)
    found, hidden = summary_of(folder)["chosen_values"], truth(name)["magnitudes"]
    effects = pd.read_csv(folder / "effects.csv").set_index("name")
    for effect, magnitude in hidden.items():
        row = effects.loc[effect]
        inside = name == "hidden_effect" and row["magnitude_low"] <= magnitude <= row["magnitude_high"]
        assert inside or found[effect] == pytest.approx(magnitude, rel=0.1)


@pytest.mark.parametrize("name", NAMED)
def test_held_out_data_are_predicted_better_and_to_the_noise(explained, name):
    errors = pd.read_csv(explained(name) / "errors.csv").set_index(["group", "stage"])
    rms, expected, p = errors["rms"], errors["expected"], errors["p"]
    assert rms["held_out_sensors", "after"] <= 1.10 * expected["held_out_sensors", "after"]
    assert p["held_out_modes", "after"] > 0.01
    for group in ("held_out_sensors", "held_out_modes", "left_out", "fit"):
        assert rms[group, "after"] < rms[group, "before"]


def test_an_effect_outside_the_library_is_located(explained):
    """The local perturbation with the largest score is within a wheelbase of the changed springs."""
    folder = explained("hidden_outside")
    assert truth("hidden_outside")["effects"] == ["stiff_rear_primary"]
    perturbations = pd.read_csv(folder / "perturbations.csv")
    best = perturbations.loc[perturbations["score"].abs().idxmax()]
    names = [f"stiffness of front bogie, primary springs rear {side}" for side in ("left", "right")]
    springs = perturbations[perturbations["perturbation"].isin(names)]
    assert len(springs) == 2 and (springs["x"] - best["x"]).abs().max() < 2.6


def test_an_understated_standard_deviation_is_reported_with_its_factor(explained):
    summary = summary_of(explained("hidden_noise"))
    assert truth("hidden_noise")["noise"] == 2.0 and 1.8 < summary["noise_scale"] < 2.2


def test_a_unit_that_rocks_on_its_mounts_is_named_with_its_sag(unit_on_mounts, results_of):
    results = results_of(unit_on_mounts.name)
    explain(unit_on_mounts, results)
    summary, effects = summary_of(results.path), pd.read_csv(results.path / "effects.csv").set_index("name")
    assert summary["verdict"] == "effect" and summary["credible_set"] == [HUNG]
    assert effects.loc[HUNG, "magnitude_low"] < SAG < effects.loc[HUNG, "magnitude_high"]
    assert summary["chosen_values"][HUNG] == pytest.approx(SAG, rel=0.1)


@pytest.mark.parametrize("name", VERDICTS)
def test_the_cost_the_basis_and_the_mesh_are_within_bounds(explained, name):
    summary = summary_of(explained(name))
    again = 115 * (summary["noise_scale"] != 1)  # a second decision, with a larger standard deviation
    assert 0 < summary["evaluations"] <= (225 if summary["begun_anew"] else 150) + again
    assert 0 < summary["basis_error"] <= 0.05
    assert 0 < summary["discretisation"] <= 1.0
