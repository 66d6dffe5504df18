"""Generic effects: a model of matrices that brings no library is explained by what its own parts and points may be."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

import calib
from calib.command import cli
from calib.errors.errors import InputError
from calib.structure.effects.compositions import DISSIPATING, compositions, generic_effects
from tests.api.storeys import FLOORS, MASS, STIFF, chain, measured, posed, spring

HEAVY = {4: 300.0}


@pytest.fixture(scope="module")
def heavy_floor():
    return posed(mass=HEAVY).explain("generic", progress=False)


@pytest.mark.slow
def test_what_a_floor_weighs_more_is_named(heavy_floor):
    assert heavy_floor.verdict == "effect"
    (named,) = heavy_floor.named
    assert named.title == "Mass of floor 4"
    value = heavy_floor.table.set_index("name").loc[named.name, "magnitude"]
    assert value == pytest.approx(HEAVY[4] / MASS, rel=0.15)


@pytest.mark.slow
def test_the_answer_says_that_no_library_was_given_and_how_many_were_tested(heavy_floor):
    count = len(generic_effects(chain(), [measured()]))
    (note,) = [note for note in heavy_floor.explanation.notes if "No list of causes was given" in note]
    assert f" {count} " in note and heavy_floor.settings.libraries == ("generic",)


@pytest.mark.medium
def test_the_same_change_of_a_matrix_is_one_candidate():
    """A spring between two floors is the storey, a mass at a floor is the floor, the support is the first storey."""
    every = compositions(chain(), [measured()], {}).plain
    found = {effect.name for effect in generic_effects(chain(), [measured()])}
    left = [c for c in every if c.effect.name not in found]
    assert {"spring between", "damper between", "added mass", "soft support"} <= {c.kind for c in left}
    assert not any(c.kind in ("stiffness", "mass") for c in left)
    between = [c for c in every if c.kind == "spring between" and c.count == 1]
    assert {c.at for c in between if c in left} == {f"sensors {k}x and {k + 1}x" for k in range(1, FLOORS)}


def test_nothing_dissipates_where_the_model_has_no_damping():
    stiffness, mass = (sum(STIFF * spring(k) for k in range(1, FLOORS + 1)), MASS * np.eye(FLOORS))
    dofs = [(k, "x") for k in range(1, FLOORS + 1)]
    model = calib.StructuralModel.from_matrices(stiffness, mass, dofs=dofs)
    kinds = {c.kind for c in compositions(model, [measured()], {}).plain}
    elastic = {effect.name for effect in generic_effects(model, [measured()])}
    damping = {c.effect.name for c in compositions(model, [measured()], {}).plain if c.kind in DISSIPATING}
    assert "dissipation" in kinds and damping and not elastic & damping


def from_runs(**stiffness):
    """A chain whose matrices have the names that runs of a solver give them."""
    terms = {name: (STIFF * spring(k), by) for k, (name, by) in enumerate(stiffness.items(), start=1)}
    mass = {"constant": (MASS * np.eye(FLOORS), {}), "t": (MASS * np.eye(FLOORS), {"t": 1.0})}
    parameters = [calib.Parameter(name, 1.0, 0.5, 2.0) for name in ("E", "t")]
    dofs = [(k, "x") for k in range(1, FLOORS + 1)]
    return calib.StructuralModel.from_matrices(terms, mass, dofs=dofs, parameters=parameters)


def test_powers_of_a_thickness_are_its_parts_and_their_bending():
    """A power by itself, such as ``E t^2``, is no part of a structure that anybody could find wrong."""
    bent = {"E t": {"E": 1.0, "t": 1.0}, "E t^2": {"E": 1.0, "t": 2.0}, "E t^3": {"E": 1.0, "t": 3.0}}
    model = from_runs(**{"constant": {}, "E": {"E": 1.0}, **bent})
    found = {c.effect.title: c.builder.parts for c in compositions(model, [measured()], {}).plain if c.kind in (
        "stiffness", "mass", "section")}  # fmt: skip
    every = tuple(("stiffness", name) for name in bent)
    assert found == {
        "Stiffness of the parts that no parameter scales": (("stiffness", "constant"),),
        "Stiffness of the parts that E scales": (("stiffness", "E"),),
        "Stiffness of the parts of thickness t": every,
        "Stiffness of the parts of thickness t in bending": every[-1:],
        "Mass of the parts that no parameter scales": (("mass", "constant"),),
        "Mass of the parts of thickness t": (("mass", "t"),),
        "Section of the parts that no parameter scales": (("stiffness", "constant"), ("mass", "constant")),
        "Section of the parts of thickness t": (*every, ("mass", "t")),
    }


def test_matrices_with_names_of_their_own_keep_them():
    model = from_runs(walls={"E": 1.0}, floor={"t": 3.0})
    titles = {c.effect.title for c in compositions(model, [measured()], {}).plain}
    assert {"Stiffness of walls", "Stiffness of floor"} <= titles


@pytest.mark.medium
def test_names_that_are_taken_are_left_to_others():
    first = generic_effects(chain(), [measured()])
    taken = [name for effect in first for name in effect.names]
    assert not {e.name for e in generic_effects(chain(), [measured()], taken)} & set(taken)


def test_a_function_without_parts_has_none():
    space = calib.ParameterSpace((calib.Parameter("k", 1.0, 0.5, 2.0),))
    model = calib.FunctionModel("toy", space, lambda v: {f"r{n}": v["k"] * n for n in range(4)})
    test = calib.ResponseTest({f"r{n}": (1.0 * n, 0.1) for n in range(4)})
    with pytest.raises(InputError, match="no generic effects"):
        calib.Problem(model, test).explain("generic", progress=False)


def test_another_word_is_no_library():
    with pytest.raises(InputError, match="effects"):
        posed().explain("general", progress=False)


# -- in a folder -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def imported(tmp_path_factory) -> Path:
    """The study of an imported chain whose fourth floor is heavier than its matrices know; sensors have no places."""
    home = tmp_path_factory.mktemp("imported")
    k, m = 1.04 * STIFF * sum(spring(n) for n in range(1, FLOORS + 1)), MASS * np.eye(FLOORS)
    own = m.copy()
    own[3, 3] += HEAVY[4]
    squares, shapes = eigh(k, own)
    shapes, rng = shapes / np.abs(shapes).max(axis=0), np.random.default_rng(4)
    shapes = shapes + 0.005 * rng.standard_normal(shapes.shape)
    freq = np.sqrt(squares) / (2 * np.pi) * (1 + 5e-4 * rng.standard_normal(FLOORS))
    rows = range(FLOORS)
    (home / "modes.csv").write_text(
        "mode,freq,freq_kind,freq_std\n"
        + "".join(f"M{j + 1},{freq[j]:.6f},natural,{5e-4 * freq[j]:.6f}\n" for j in rows)
    )
    (home / "shapes.csv").write_text(
        "mode,node,direction,re,std\n"
        + "".join(f"M{j + 1},{i + 1},x,{shapes[i, j]:.5f},0.005\n" for i in rows for j in rows)
    )
    np.savez(home / "chain.npz", K=k / 1.04, M=m, dofs=[[n, 1] for n in range(1, FLOORS + 1)])
    (home / "places.csv").write_text("node,x,y,z\n" + "".join(f"{n},0,0,{3.0 * n}\n" for n in range(1, FLOORS + 1)))
    calib.import_matrices(
        home / "chain.npz", coordinates=home / "places.csv", measured=home / "modes.csv", shapes=home / "shapes.csv",
        to=home / "chain",
    )  # fmt: skip
    return home / "chain"


def test_an_imported_study_has_generic_effects_at_its_points_and_supports(imported):
    effects = calib.Study.load(imported, progress=False).effects
    assert any(e.title == "A mass at node 4" for e in effects)
    assert any("support near node 1" in e.title for e in effects)


@pytest.mark.slow
def test_an_imported_study_is_explained_and_extended_by_the_command(imported, tmp_path, capsys, undrawn):
    assert cli.execute(["explain", str(imported), "--results", str(tmp_path / "results")]) == 0
    said = capsys.readouterr().out
    assert "mass at node 4" in said and "No list of causes was given" in said
    study = calib.Study.load(imported, results=tmp_path / "results", progress=False)
    extended = study.extend(["added_mass_4"], tmp_path / "heavier")
    fitted = extended.calibrate().table.set_index("parameter")
    assert fitted.loc["added_mass_4", "value"] == pytest.approx(HEAVY[4], rel=0.1)
    assert "added_mass_4" not in {e.name for e in extended.effects}


def test_a_sensor_off_the_model_is_told_where_it_stands_and_not_under_effects(imported, tmp_path):
    study = tmp_path / "off"
    shutil.copytree(imported, study)
    rows = "".join(f"{n},0,0,{3.0 * n + 40.0 * (n == 4)}\n" for n in range(1, FLOORS + 1))
    (study / "sensors.csv").write_text("node,x,y,z\n" + rows)
    text = (study / "study.toml").read_text()
    (study / "study.toml").write_text(text.replace("[measurement]\n", '[measurement]\nsensors = "sensors.csv"\n'))
    with pytest.raises(InputError) as told:
        _ = calib.Study.load(study, progress=False).effects
    assert "sensor 4" in (told.value.place or "") and "effects" not in str(told.value)
    assert told.value.at is not None and str(told.value.at.file).endswith("sensors.csv")
