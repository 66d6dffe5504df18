"""Generic effects: a model of matrices that brings no library is explained by what its own parts and points may be."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from scipy.linalg import eigh

import calib
from calib.command import cli
from calib.errors.errors import InputError
from calib.measurement.modal import MeasuredModes, Sensor
from calib.structure.effects.attach import part_of, parts_of, thicker_part
from calib.structure.effects.compositions import DISSIPATING, compositions, generic_effects
from calib.structure.effects.free_place import FreePlace, at_free_place, patch_about
from models.fem import thin_plate
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


@pytest.mark.slow
def test_far_more_than_its_plausible_size_is_not_drawn_down_to_it():
    found = posed(mass={4: 8 * MASS}).explain("generic", progress=False).explanation.effects
    row = found.set_index("name").loc["mass_floor_4"]
    assert row["magnitude_low"] < 8.0 < row["magnitude_high"] and row["plausible"] == 0.3
    # The tail of the prior is in proportion to its width.
    gain = row[["ln_bayes_third", "ln_bayes_triple"]] - row["ln_bayes"]
    np.testing.assert_allclose(gain.to_numpy(dtype=float), [-np.log(3), np.log(3)], atol=0.01)


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


# -- places between nodes ----------------------------------------------------------------------------------------------


def beam(elements: int, length: float = 6.0, hung: tuple[float, float] | None = None, rib: int | None = None):
    """A clamped steel beam along x that bends along z, 40 kg/m; a mass in kg at a place in m, and a rib at a node."""
    n, one = elements, length / elements
    bend = 2.1e11 * 8e-6 / one**3 * np.array([
        [12, -6 * one, -12, -6 * one], [-6 * one, 4 * one**2, 6 * one, 2 * one**2],
        [-12, 6 * one, 12, 6 * one], [-6 * one, 2 * one**2, 6 * one, 4 * one**2],
    ])  # fmt: skip
    own = 40.0 * one / 420 * np.array([
        [156, -22 * one, 54, 13 * one], [-22 * one, 4 * one**2, -13 * one, -3 * one**2],
        [54, -13 * one, 156, 22 * one], [13 * one, -3 * one**2, 22 * one, 4 * one**2],
    ])  # fmt: skip
    stiffness, mass = np.zeros((2 * n + 4, 2 * n + 4)), np.zeros((2 * n + 4, 2 * n + 4))
    for k in range(n):
        at = np.ix_(range(2 * k, 2 * k + 4), range(2 * k, 2 * k + 4))
        stiffness[at] += bend
        mass[at] += own
    if hung is not None:
        mass[2 * round(hung[0] / one), 2 * round(hung[0] / one)] += hung[1]
    stiffness[-2, -2] = stiffness[-1, -1] = mass[-2, -2] = mass[-1, -1] = 1e6
    if rib is not None:
        stiffness[2 * rib, -2] = stiffness[-2, 2 * rib] = -1e4
    points = [(k * one, 0.0, 0.0) for k in range(n + 1)] + [((rib or 0) * one, 1.0, 0.0)]
    dofs = [(k + 1, d, *point) for k, point in enumerate(points) for d in ("z", "ry")]
    kept = np.r_[2 : 2 * n + (2 if rib is None else 4)]
    at = np.ix_(kept, kept)
    table = pd.DataFrame([dofs[k] for k in kept], columns=["node", "direction", "x", "y", "z"])
    parameters = [calib.Parameter("E", 1.0, 0.7, 1.4, prior_sd=0.05)]
    return calib.StructuralModel.from_matrices(
        {"K": (stiffness[at], "E")}, {"M": mass[at]}, dofs=table, parameters=parameters, name="beam"
    )


def energy(model, effect_terms, shape, slope, **values):
    """Twice the kinetic energy of a motion w(x), by its values and slopes at the nodes; a rotation is minus a slope."""
    x = model.mesh.points[model.dofs.node, 0]
    motion = np.where(model.dofs.direction == 2, shape(x), -slope(x))
    return sum(t.coefficient(values) * float(motion @ (t.matrix @ motion)) for t in effect_terms)


def test_a_mass_at_a_free_place_moves_as_the_beam_does_there():
    model = beam(12)
    shape, slope = np.poly1d([0.3, -1.0, 0.4, 2.0]), np.poly1d([0.9, -2.0, 0.4])
    terms = at_free_place(model, "m", "mass", (3.0, 0.0, 0.0), (2,), 0.7).mass
    for offset in (0.0, 0.23, -0.61):
        assert energy(model, terms, shape, slope, m=2.5, m_x=offset) == pytest.approx(2.5 * shape(3.0 + offset) ** 2)


def test_a_free_place_ends_where_something_else_is_joined():
    free, ribbed = (
        patch_about(m, sp.csr_array(m.stiffness({"E": 1.0})), (3.0, 0.0, 0.0), 1.0) for m in (beam(12), beam(12, rib=7))
    )
    assert free is not None and free.axes == (0,) and free.ends[0] == pytest.approx((-1.0, 1.0))
    assert ribbed is not None and ribbed.ends[0] == pytest.approx((-1.0, 0.5))
    model = beam(12, rib=7)
    assert patch_about(model, sp.csr_array(model.stiffness({"E": 1.0})), (3.5, 0.0, 0.0), 1.0) is None


def test_a_free_place_on_a_plate_has_two_coordinates():
    """Exact for a motion of second order, wherever it lies between the nodes of an inclined plate."""
    n, side = 4, 0.25
    stiffness = thin_plate.stiffness(side, side, 0.01, 0.3)
    flat = [(i * side, j * side) for j in range(n + 1) for i in range(n + 1)]
    whole = np.zeros((3 * len(flat), 3 * len(flat)))
    for j in range(n):
        for i in range(n):
            nodes = [j * (n + 1) + i + k for k in (0, 1, n + 2, n + 1)]
            at = [3 * node + k for node in nodes for k in range(3)]
            whole[np.ix_(at, at)] += stiffness
    dofs = [(k + 1, d, x, y, 0.0) for k, (x, y) in enumerate(flat) for d in ("z", "rx", "ry")]
    table = pd.DataFrame(dofs, columns=["node", "direction", "x", "y", "z"])
    model = calib.StructuralModel.from_matrices(whole, np.eye(len(whole)), dofs=table)
    terms = at_free_place(model, "k", "stiffness", (0.5, 0.5, 0.0), (2,), 0.25).stiffness
    x, y = (model.mesh.points[model.dofs.node, k] for k in (0, 1))
    motion = np.choose(model.dofs.direction - 2, [1 + x + 2 * x * y - y**2, 2 * x - 2 * y, -(1 + 2 * y)])
    values = {"k": 3.0, "k_x": 0.13, "k_y": -0.07}
    energy = sum(t.coefficient(values) * float(motion @ (t.matrix @ motion)) for t in terms)
    assert energy == pytest.approx(3.0 * (1 + 0.63 + 2 * 0.63 * 0.43 - 0.43**2) ** 2)


def test_a_thickness_changes_stiffness_as_its_cube_and_mass_alike():
    model = chain()
    part = next(p.name for p in model.parts or parts_of(model) if p.kind == "stiffness")
    cubed = sum(t.coefficient(model.space.si({**model.space.values}) | {"t": -0.2}) * t.matrix for t in thicker_part(
        model, part, "t"))  # fmt: skip
    own = part_of(model, "stiffness", part)
    whole = own.coefficient(model.space.si(model.space.values)) * own.matrix
    assert np.allclose(cubed.toarray(), (0.8**3 - 1) * whole.toarray())


@pytest.mark.slow
def test_a_mass_between_the_points_of_the_candidates_is_named_where_it_is():
    """It hangs at 0.7 of an element from the nearest node; sensors are 1 m apart."""
    model, true, place = beam(12), beam(120, hung=(3.35, 12.0)), 3.35
    found, rng = true.modes({"E": 1.03}, 6), np.random.default_rng(1)
    sensors = tuple(Sensor(k, "z", (float(k - 1) / 2, 0.0, 0.0)) for k in range(3, 14, 2))
    rows = np.array([true.locator.row(s.point, 2)[0] for s in sensors])
    shapes = (rows @ found.shapes).real
    shapes = shapes / np.abs(shapes).max(axis=0) + 0.01 * rng.standard_normal((len(sensors), 6))
    freq = np.asarray(found.natural_freq) * (1 + 1e-3 * rng.standard_normal(6))
    modes = tuple(f"F{k + 1}" for k in range(6))
    measured = MeasuredModes(
        modes, freq, freq, 1e-3 * freq, np.full(6, 0.01), np.full(6, np.nan), sensors, shapes,
        np.full(shapes.shape, 0.01), 5, True,
    )  # fmt: skip
    why = calib.Problem(model, calib.ModalTest(measured, mode_count=8)).explain("generic", progress=False)
    assert why.verdict == "effect"
    (named,) = why.named
    fit = why.explanation.explanation.chosen.fit.values
    assert isinstance(named.build, FreePlace) and named.build.moved(fit)[0] == pytest.approx(place, abs=0.06)
    assert fit[named.name] == pytest.approx(12.0, rel=0.1)
    assert why.with_named().calibrate(progress=False).values[named.name] == pytest.approx(12.0, rel=0.1)


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


def test_points_bear_the_numbers_of_the_model_where_the_test_has_others(imported, tmp_path):
    study = tmp_path / "renumbered"
    shutil.copytree(imported, study)
    shapes = pd.read_csv(study / "shapes.csv")
    shapes.assign(node=shapes["node"] + 100).to_csv(study / "shapes.csv", index=False)
    places = "".join(f"{100 + n},0,0,{3.0 * n}\n" for n in range(1, FLOORS + 1))
    (study / "sensors.csv").write_text("node,x,y,z\n" + places)
    text = (study / "study.toml").read_text()
    (study / "study.toml").write_text(text.replace("[measurement]\n", '[measurement]\nsensors = "sensors.csv"\n'))
    effects = {e.name: e.title for e in calib.Study.load(study, progress=False).effects}
    assert effects["added_mass_4"] == "A mass at node 4 (104 in the test)"


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
