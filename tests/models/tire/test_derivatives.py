"""Derivatives that the tire returns: those of differences of solved equilibria."""

import pytest

from calib.structure import relative_change, slope_entry
from models.tire.effects import tire_effects
from models.tire.model import parameters, tire_on_ground
from models.tire.parts import PARTS

GIVEN = {"n_meridian": 15, "n_hoop": 12, "deflections": (6.0, 12.0), "loads": (700.0,), "orders": (0, 2)}
ALL = {p.name: p for p in (*parameters(), *(q for e in tire_effects() for q in e.parameters))}
ALL |= {part.parameter: relative_change(part) for part in PARTS}
UNUSED = dict.fromkeys([*(e.name for e in tire_effects()), *(part.parameter for part in PARTS)], 0.0)
"""Magnitudes by which derivatives are wanted."""
EXTENDED = {"belt": 0.4, "belt_angle": 20.0, "tread_compliance": 1.0, "soft_bead": 0.3, "thin_sidewall": 0.1}


def at(values):
    return {p.name: p.value for p in parameters()} | values


@pytest.fixture(scope="module", params=[{}, EXTENDED], ids=["base", "extended"])
def found(request):
    values = at(UNUSED | request.param)
    return values, tire_on_ground(**GIVEN).function(values)


@pytest.mark.mostly_slow(3)
@pytest.mark.parametrize(
    "name",
    [
        *("pressure", "crown_angle", "E_cord", "t_ply", "density", "cord_fraction"),
        *("belt", "tread_layer", "tread_compliance", "soft_bead", "thin_sidewall", "halpin_tsai", "crown_mass"),
        *("uncoupled", "dead_pressure"),
        *(part.parameter for part in PARTS),
    ],
)
def test_derivatives_are_those_of_solved_points(found, name):
    """All but the tread's, whose layer moves the neutral axis: its second derivative spoils one-sided differences."""
    values, out = found
    p, middle = ALL[name], values.get(name, 0.0)
    h = 2e-5 * (p.upper - p.lower)
    points = [middle - h, middle + h] if p.lower < middle else [middle, middle + h, middle + 2 * h]
    weights = [-0.5, 0.5] if p.lower < middle else [-1.5, 2.0, -0.5]
    solve = tire_on_ground(**GIVEN, derivatives=False).function
    solved = [solve(values | {name: x}) for x in points]
    names = [key for key in out if slope_entry(key, name) in out]
    assert {
        "growth_crown",
        "growth_width",
        "load_12",
        "stiffness_12",
        "patch_length_6",
        "bulge_12",
        "radius_at_700",
        "freq_2",
    } <= set(names)
    for key in names:
        difference = sum(w * one[key] for w, one in zip(weights, solved, strict=True)) / h
        scale = max(abs(difference), 1e-3 * abs(out[key]) / (p.upper - p.lower))
        assert out[slope_entry(key, name)] == pytest.approx(difference, abs=1e-3 * scale), key


@pytest.mark.medium
def test_derivatives_exist_for_what_is_among_the_values(found):
    values, out = found
    assert (slope_entry("load_12", "belt_angle") in out) == ("belt_angle" in values)
    assert all(slope_entry("load_12", name) in out for name in UNUSED)
    assert slope_entry("load_12", "crown_radius") not in out
    few = tire_on_ground(**GIVEN).function(at({"belt": 0.0}))
    assert {name for name in ALL if slope_entry("load_12", name) in few} == {
        *("pressure", "crown_angle", "E_cord", "E_rubber", "t_ply", "cord_fraction", "density", "belt")
    }
