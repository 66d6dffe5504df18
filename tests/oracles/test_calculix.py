"""Decks for CalculiX: a closed box on springs vibrates there as here.

CalculiX makes solids of shells, which are stiffer on coarse meshes: on half as fine a mesh its walls vibrate up to
20 % faster, on this one within 2 %.
"""

import numpy as np
import pytest
import scipy.sparse as sp
from calculix import COMMAND, MISSING, Deck, number, run

from calib.structure.eigenproblem.solve import solve_modes
from models.fem.discrete import PointMass, Spring, mass_matrix, spring_matrix
from models.fem.member import Member
from models.fem.panel import sheet_panel
from models.fem.section import Section
from models.fem.sheet import Sheet
from models.fem.structure import Structure

pytestmark = pytest.mark.oracle

SHEET = Sheet(4e-3, 70e9, 0.33, 2700.0, rmi=25.0)
BAR = Section(2e-3, 8e-7, 3e-7, 9e-7, shear_coefficient=5 / 6)
X, Y, Z = 2.4, 1.0, 1.2
XS, YS, ZS = np.linspace(0, X, 7).tolist(), [0, Y / 2, Y], [0, Z / 3, 2 * Z / 3, Z]
CORNERS = tuple((x, 0.0, z) for x in (0.0, X) for z in (0.0, Z))
STIFFNESS, MASS, PLACE = 1e5, 30.0, (X / 2, Y, 0.0)


def box() -> Structure:
    """Six walls, four bars along its edges."""
    round_it = [*((0, z) for z in ZS), (Y / 2, Z), *((Y, z) for z in reversed(ZS)), (Y / 2, 0), (0, 0)]
    panels = [sheet_panel("box", "walls", SHEET, XS, round_it, refinement=2)]
    for x in (0.0, X):
        panels.append(sheet_panel("box", "walls", SHEET, YS, [(x, z) for z in ZS], direction=1, refinement=2))
    bars = (Member("box", "bar", BAR, (0.0, y, z), (X, y, z), X / 24) for y in (0.0, Y) for z in (0.0, Z))
    return Structure(tuple(bars), panels=tuple(panels))


def own_frequencies(structure: Structure, count: int) -> np.ndarray:
    shells, (stiff, heavy) = structure.shells(), structure.beams()
    springs = [Spring(("box", c), None, np.eye(3)[d].tolist(), weight=STIFFNESS) for c in CORNERS for d in range(3)]
    masses = [PointMass(("box", PLACE), MASS)]
    k = shells.stiffness + stiff + spring_matrix(structure, springs)
    m = shells.mass + shells.rotary + heavy + mass_matrix(structure, masses)
    return solve_modes(sp.csc_array(k), None, sp.csc_array(m), count).natural_freq


def deck_of(structure: Structure) -> Deck:
    deck = Deck()
    for point in structure.points:
        deck.node(point)
    deck.shells(structure.corners + 1, SHEET)
    deck.beams(structure.ends + 1, BAR, (0.0, 1.0, 0.0))
    for corner in CORNERS:
        for direction in range(3):
            deck.spring(STIFFNESS, structure.node("box", corner) + 1, None, direction)
    deck.mass(structure.node("box", PLACE) + 1, PLACE, MASS)
    return deck


def test_numbers_are_written_with_a_point_and_two_digits_of_exponent():
    assert [number(v) for v in (1e7, -0.5, 0)] == ["1.000000E+07", "-5.000000E-01", "0.000000E+00"]


@pytest.mark.medium
def test_a_box_on_springs_vibrates_alike(tmp_path):
    if COMMAND is None:
        pytest.skip(MISSING)
    structure, count = box(), 12
    answer = run(deck_of(structure).text(count), tmp_path)
    own = own_frequencies(structure, count)
    assert len(answer.natural_freq) == count and answer.equations > structure.n_full
    np.testing.assert_allclose(answer.natural_freq[:6], own[:6], rtol=1e-3)  # as a rigid body: mass and its place
    np.testing.assert_allclose(answer.natural_freq[6:], own[6:], rtol=0.02)  # walls and bars


def test_what_calculix_refuses_is_told(tmp_path):
    if COMMAND is None:
        pytest.skip(MISSING)
    deck = Deck()
    deck.shells([(1, 2, 3, 4)], SHEET)
    with pytest.raises(RuntimeError, match="CalculiX failed"):
        run(deck.text(3), tmp_path)
