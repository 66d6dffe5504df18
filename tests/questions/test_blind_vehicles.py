"""The blind studies of the whole vehicle: what they hide is read only once the verdict is written.

They share one model and so one reduced basis, whose training takes most of the time.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.loading import module_of
from calib.questions.explain import explain
from calib.results import Results
from calib.study import Study

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
    """Folder of results by a study's name, with the basis that an earlier one has trained."""
    root = tmp_path_factory.mktemp("vehicles")

    def make(name):
        kept, results = list(root.glob("*/basis_effects_*.npz"))[:1], Results.at(root, name)
        for basis in kept:
            shutil.copy(basis, results.path)
        return results

    return make


@pytest.fixture(scope="module")
def explained(blindly, results_of):
    """Each explanation once: the folder of its results."""
    done = {}

    def make(name):
        if name not in done:
            done[name] = blindly(name, results_of(name))
        return done[name]

    return make


@pytest.fixture(scope="module")
def unit_on_mounts(tmp_path_factory):
    """A study of a vehicle whose converter is a rigid body on four mounts, lower and of another box than assumed.

    Its mesh is finer, its mounts stand in the mesh foot by foot, and its parameters are drawn like those of the others.
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
    return Study.load(folder)


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
def test_strengths_are_found(explained, name):
    """Within a tenth of the truth, or within what the interval says where that is wider."""
    folder = explained(name)
    found, hidden = summary_of(folder)["chosen_values"], truth(name)["strengths"]
    effects = pd.read_csv(folder / "effects.csv").set_index("name")
    for effect, strength in hidden.items():
        row = effects.loc[effect]
        inside = name == "hidden_effect" and row["phi_low"] <= strength <= row["phi_high"]
        assert inside or found[effect] == pytest.approx(strength, rel=0.1)


@pytest.mark.parametrize("name", NAMED)
def test_withheld_data_are_predicted_better_and_to_the_noise(explained, name):
    errors = pd.read_csv(explained(name) / "errors.csv").set_index(["group", "stage"])
    rms, expected, p = errors["rms"], errors["expected"], errors["p"]
    assert rms["withheld_sensors", "after"] <= 1.10 * expected["withheld_sensors", "after"]
    assert p["withheld_modes", "after"] > 0.01
    for group in ("withheld_sensors", "withheld_modes", "left_out", "fit"):
        assert rms[group, "after"] < rms[group, "before"]


def test_what_is_in_no_library_is_pointed_at(explained):
    """The local change of the largest score is no farther than a wheelbase from the springs that were changed."""
    folder = explained("hidden_outside")
    assert truth("hidden_outside")["effects"] == ["stiff_rear_primary"]
    atoms = pd.read_csv(folder / "atoms.csv")
    best = atoms.loc[atoms["score"].abs().idxmax()]
    names = [f"stiffness of front bogie, primary springs rear {side}" for side in ("left", "right")]
    springs = atoms[atoms["atom"].isin(names)]
    assert len(springs) == 2 and (springs["x"] - best["x"]).abs().max() < 2.6


def test_understated_scatter_is_told_with_its_factor(explained):
    summary = summary_of(explained("hidden_noise"))
    assert truth("hidden_noise")["noise"] == 2.0 and 1.8 < summary["noise_scale"] < 2.2


def test_a_unit_that_rocks_on_its_mounts_is_named_with_its_sag(unit_on_mounts, results_of):
    results = results_of(unit_on_mounts.name)
    explain(unit_on_mounts, results)
    summary, effects = summary_of(results.path), pd.read_csv(results.path / "effects.csv").set_index("name")
    assert summary["verdict"] == "effect" and summary["credible_set"] == [HUNG]
    assert effects.loc[HUNG, "phi_low"] < SAG < effects.loc[HUNG, "phi_high"]
    assert summary["chosen_values"][HUNG] == pytest.approx(SAG, rel=0.1)


@pytest.mark.parametrize("name", VERDICTS)
def test_the_cost_the_basis_and_the_mesh_are_within_bounds(explained, name):
    summary = summary_of(explained(name))
    again = 115 * (summary["noise_scale"] != 1)  # a second decision, with a larger scatter
    assert 0 < summary["evaluations"] <= (225 if summary["begun_anew"] else 150) + again
    assert 0 < summary["basis_error"] <= 0.05
    assert 0 < summary["discretisation"] <= 1.0
