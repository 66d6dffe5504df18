"""Springs, dampers, masses and supports of a model are found where they are, with the parameters that scale them."""

import numpy as np
import pandas as pd
import pytest

from calib.correlation.mesh_error import places_table
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel
from calib.structure.places import ModelPlace
from models.four_storey_rig import four_storey_rig
from models.railway.rig import bogie_on_rig
from models.solar_panel import solar_panel

LINK = np.array([[1.0, -1.0], [-1.0, 1.0]])


def chain(n, **parameters):
    """Masses along x on springs in a row; the first one is a parameter, and so is the second mass."""
    k = np.zeros((n, n))
    for j in range(1, n):
        k[j - 1 : j + 1, j - 1 : j + 1] += LINK
    own, heavy = np.zeros((n, n)), np.zeros((n, n))
    own[0, 0] = heavy[1, 1] = 1.0
    dofs = pd.DataFrame({"node": range(1, n + 1), "direction": "x", "x": np.arange(float(n)), "y": 0.0, "z": 0.0})
    given = {"k": Parameter("k", 1e4, 1e3, 1e5, "N/m"), "m": Parameter("m", 1.0, 0.5, 2.0, "kg")}
    return StructuralModel.from_matrices(
        stiffness={"k": own, "rest": 1e4 * k}, mass={"m": heavy, "even": np.eye(n)}, dofs=dofs,
        parameters=given.values(),
    )  # fmt: skip


def test_a_grounded_spring_and_a_mass_are_placed_at_their_nodes():
    places = {p.parameters: p for p in chain(4).places if p.parameters}
    assert places[("k",)].form == "spring" and places[("k",)].place == (0.0, 0.0, 0.0)
    assert places[("m",)].form == "mass" and places[("m",)].place == (1.0, 0.0, 0.0)


def test_nodes_that_nothing_connects_are_places_of_their_own():
    model = chain(40)
    ends = np.zeros((40, 40))
    ends[0, 0] = ends[39, 39] = 1.0
    both = StructuralModel.from_matrices(
        stiffness={"k": ends, "rest": model.stiffness.terms[1].matrix.toarray()}, mass=np.eye(40),
        dofs=pd.DataFrame({"node": range(40), "direction": "x", "x": np.arange(40.0), "y": 0.0, "z": 0.0}),
        parameters=[Parameter("k", 1e4, 1e3, 1e5, "N/m")],
    )  # fmt: skip
    assert [p.place[0] for p in both.places if p.parameters == ("k",)] == [0.0, 39.0]


def test_without_coordinates_there_is_no_place():
    model = StructuralModel.from_matrices(
        stiffness={"k": LINK}, mass=np.eye(2), dofs=[(1, "x"), (2, "x")], parameters=[Parameter("k", 1e4, 1e3, 1e5)]
    )
    assert model.places == ()


def test_beams_without_motions_in_their_plane_are_no_springs():
    """Bending and torsion alone give a beam the rank of a spring in space, and a clamped one half the motions."""
    places = [p for p in solar_panel().places if p.name.startswith("beam")]
    assert {p.parameters for p in places} == {(f"E_beam_{k}",) for k in (17, 18, 19, 20)}
    assert {p.form for p in places} == {"part"}


@pytest.mark.medium
def test_every_parameter_of_the_bogie_has_its_places():
    model = bogie_on_rig()
    places = [p for p in model.places if p.parameters]
    assert {name for p in places for name in p.parameters} == set(model.space.names)
    forms = {name: {p.form for p in places if name in p.parameters} for name in model.space.names}
    assert forms["K_primary"] == {"spring"} and forms["c_primary"] == {"damper"} and forms["m_axle"] == {"part"}
    rods = np.array([p.place for p in places if p.parameters == ("K_rod_upper",)])
    np.testing.assert_allclose(np.abs(rods), np.tile([1.45, 0.63, 1.05], (4, 1)), atol=1e-9)
    wheels = [p for p in model.places if p.form == "mass" and p.name.startswith("wheel")]
    assert len(wheels) == 4 and not any(p.parameters for p in wheels)


def test_springs_and_dampers_have_the_direction_in_which_they_act():
    places = bogie_on_rig().places
    ways = {p.name: np.abs(p.direction) for p in places if p.form in ("spring", "damper")}
    np.testing.assert_allclose(ways["primary springs front left"], [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(ways["primary springs front left, x"], [1, 0, 0], atol=1e-9)
    rod = [ways[name] for name in ways if name.startswith("upper rod")]
    assert len(rod) == 4 and all(way[2] < 1e-9 and 0.1 < way[1] / way[0] < 1.0 for way in rod)
    assert all(np.isnan(p.direction).all() for p in places if p.form in ("mass", "support", "part"))
    ball = StructuralModel.from_matrices(
        stiffness={"k": np.eye(3)}, mass=np.eye(3), parameters=[Parameter("k", 1e4, 1e3, 1e5)],
        dofs=pd.DataFrame({"node": [1, 1, 1], "direction": ["x", "y", "z"], "x": 0.0, "y": 0.0, "z": 0.0}),
    )  # fmt: skip
    assert np.isnan(ball.places[0].direction).all()  # in all of them
    skew = np.array([[0.36, 0.48], [0.48, 0.64]])
    held = StructuralModel.from_matrices(
        stiffness={"k": skew, "rest": np.eye(2)}, mass=np.eye(2), parameters=[Parameter("k", 1e4, 1e3, 1e5)],
        dofs=pd.DataFrame({"node": [1, 1], "direction": ["x", "y"], "x": 0.0, "y": 0.0, "z": 0.0}),
    )  # fmt: skip
    np.testing.assert_allclose(np.abs(held.places[0].direction), [0.6, 0.8, 0.0], atol=1e-9)


def test_a_shaft_of_rotations_alone_has_no_supports():
    shaft = StructuralModel.from_matrices(
        stiffness={"k": LINK}, mass=np.eye(2), parameters=[Parameter("k", 1e4, 1e3, 1e5)],
        dofs=pd.DataFrame({"node": [1, 2], "direction": "rx", "x": [0.0, 1.0], "y": 0.0, "z": 0.0}),
    )  # fmt: skip
    assert [(p.form, p.place) for p in shaft.places] == [("spring", (0.5, 0.0, 0.0))]


def test_a_support_holds_all_translations():
    (support,) = [p for p in four_storey_rig().places if p.form == "support"]
    assert support.parameters == () and support.place[1] == 0.0


def test_names_with_spaces_stay_apart_in_the_table():
    model = chain(4)
    place = ModelPlace("spring", "spring", "stiffness", ("K of rod", "pos of rod"), (0.0, 1.0, 2.0))
    table = places_table([place, *model.places])
    assert table["parameters"].iloc[0].split("; ") == ["K of rod", "pos of rod"]
    assert table[["x", "y", "z"]].iloc[0].tolist() == [0.0, 1.0, 2.0] and len(table) == 1 + len(model.places)
