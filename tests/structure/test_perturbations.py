"""Local perturbations against the changes they represent."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from calib.measurement.modal import Sensor
from calib.structure.affine import AffineMatrix, Monomial, SeriesLoss, Term, parameter
from calib.structure.effects.attach import hung_masses
from calib.structure.effects.extend import Addition, extend
from calib.structure.effects.perturbations import perturbations
from calib.structure.eigenproblem.derivatives import mode_derivatives
from calib.structure.model import Part
from calib.structure.rules import RULES

N = 20
POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 2.0, "k_ground": 30.0}
SENSORS = [Sensor(k, "x", (float(k), 0.0, 0.0)) for k in (1, 8, 13)]
TERMS = {
    "stiffness of upper": "k_upper",
    "stiffness of lower": "k_lower",
    "stiffness of rungs": "k_rung",
    "stiffness of ends": "k_ground",
    "damping of ends": "c_end",
    "mass of mass": "mass",
}


def named(found):
    return {a.effect.name: a for a in found}


def test_every_term_of_a_model_without_parts_and_two_for_every_sensor(ladder):
    found = perturbations(ladder(N), SENSORS, POINT, 1.0)
    names = [a.effect.name for a in found]
    at_sensors = [f"{w} at sensor {s.name}" for s in SENSORS for w in ("grounded spring", "added mass")]
    assert names == [*list(TERMS)[:4], "damping of ends", "mass of fixed", "mass of mass", *at_sensors]
    assert [a.sensor for a in found] == [""] * 7 + ["1x", "1x", "8x", "8x", "13x", "13x"]
    assert [a.kind for a in found[-4:]] == ["stiffness", "mass"] * 2
    assert all(a.effect.signed == (not a.sensor) and not a.effect.grid and not a.effect.nuisance for a in found)
    assert all(a.effect.part == ("" if a.sensor else a.effect.name) for a in found)
    assert named(found)["grounded spring at sensor 8x"].place == (8.0, 0.0, 0.0)
    assert named(found)["stiffness of ends"].place == pytest.approx((9.5, 0.0, 0.0))
    assert len(perturbations(ladder(N), [], POINT, 1.0)) == 7


def test_every_part_of_a_model_that_has_them(ladder):
    model = ladder(N)
    rung, other = (sp.csr_array(np.diag(np.eye(N)[k])) for k in (3, 5))
    parts = (
        Part("rung 1", "stiffness", rung, parameter("k_rung"), (1.0, 0.0, 0.0)),
        Part("rung 1", "mass", other, Monomial(0.3), (1.0, 0.0, 0.0)),
        Part("end", "damping", other, parameter("c_end", 2.0), (2.0, 0.0, 0.0)),
    )
    found = named(perturbations(replace(model, parts=parts), (), POINT, 1.0))
    assert list(found) == ["stiffness of rung 1", "mass of rung 1", "damping of end"]
    assert found["damping of end"].place == (2.0, 0.0, 0.0) and found["damping of end"].kind == "damping"
    wider = extend(model, [a.effect for a in found.values()])
    changes = {"stiffness of rung 1": 0.2, "mass of rung 1": 0.5, "damping of end": -0.5}
    after, before = wider.matrices({**POINT, **changes}), model.matrices(POINT)
    for a, b, expected in zip(after, before, (0.2 * 1100 * rung, -0.5 * 88 * other, 0.5 * 0.3 * other), strict=True):
        np.testing.assert_allclose((a - b).toarray(), expected.toarray(), atol=1e-9)


@pytest.mark.parametrize("name", TERMS)
def test_a_part_scaled_is_its_parameter_scaled(ladder, name):
    model = ladder(N)
    (perturbation,) = [a.effect for a in perturbations(model, (), POINT, 1.0) if a.effect.name == name]
    wider = extend(model, [perturbation])
    for factor in (0.8, 1.0, 1.7):
        found = wider.matrices({**POINT, name: factor - 1})
        expected = model.matrices({**POINT, TERMS[name]: factor * POINT[TERMS[name]]})
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a.toarray(), b.toarray(), rtol=1e-12, atol=1e-9)
    assert perturbation.plausible == RULES.relative and perturbation.magnitude.unit == "-"
    assert perturbation.magnitude.lower == (-1 if name.startswith("damping") else -0.9)


@pytest.mark.parametrize("name", TERMS)
def test_derivatives_by_a_part_are_those_by_its_parameter(ladder, name):
    model = ladder(N)
    wider = extend(model, [a.effect for a in perturbations(model, SENSORS, POINT, 1.0)])
    modes, base = wider.modes(POINT, 6), model.modes(POINT, 6)
    by_perturbation = mode_derivatives(wider, POINT, modes, [name], range(6))
    by_parameter = mode_derivatives(model, POINT, base, [TERMS[name]], range(6))
    scale = POINT[TERMS[name]]
    np.testing.assert_allclose(
        by_perturbation.eigenvalue[0],
        by_parameter.eigenvalue[0] * scale,
        rtol=1e-5,
        atol=1e-7 * np.abs(by_perturbation.eigenvalue).max(),
    )


@pytest.mark.parametrize("name", ["grounded spring at sensor 8x", "added mass at sensor 13x", "stiffness of lower"])
def test_derivatives_by_a_perturbation_are_differences(ladder, name):
    model = ladder(N)
    found = named(perturbations(model, SENSORS, POINT, 1.0))
    wider = extend(model, [a.effect for a in found.values()])
    modes = wider.modes(POINT, 6)
    slope = mode_derivatives(wider, POINT, modes, [name], range(6)).eigenvalue[0]
    half = 1e-3 * found[name].effect.plausible
    ends = []
    for sign in (1, -1):
        m = wider.modes({**POINT, name: sign * half}, 6)
        ends.append(2 * np.pi * (1j * m.damped_freq - m.damping_ratio * m.natural_freq))
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * half), slope, rtol=2e-3, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("grounded", [True, False])
def test_springs_and_masses_at_sensors_scale_with_local_stiffness_and_mass(ladder, grounded):
    model = ladder(N, grounded=grounded)
    point = {n: v for n, v in POINT.items() if n in model.space}
    found = named(perturbations(model, SENSORS, point, 0.7))
    k, _, m = (a.toarray() for a in model.matrices(point))
    flexible = np.linalg.inv(k + (2 * np.pi * 0.7) ** 2 * m)
    for sensor in SENSORS:
        spring, mass = (found[f"{w} at sensor {sensor.name}"].effect for w in ("grounded spring", "added mass"))
        assert spring.plausible == pytest.approx(RULES.local / flexible[sensor.node, sensor.node], rel=1e-9)
        assert mass.plausible == pytest.approx(RULES.heavy * m.sum())
        wider = extend(model, [spring, mass])
        after = wider.matrices({**point, spring.name: 5.0, mass.name: 0.3})
        there = np.outer(*[np.eye(N)[sensor.node]] * 2)
        np.testing.assert_allclose(after[0].toarray() - k, 5.0 * there, atol=1e-9)
        np.testing.assert_allclose(after[2].toarray() - m, 0.3 * there, atol=1e-12)


def test_only_the_mass_that_moves_in_a_sensors_direction_counts(ladder):
    model = ladder(N)
    direction = np.where(np.arange(N) < 5, 1, 0)
    half = replace(model, dofs=replace(model.dofs, direction=direction))
    found = named(perturbations(half, SENSORS[1:], POINT, 1.0))
    m = model.matrices(POINT)[2].toarray()
    assert found["added mass at sensor 8x"].effect.plausible == pytest.approx(RULES.heavy * m[5:, 5:].sum())


def test_at_magnitude_0_nothing_changes(ladder):
    model = ladder(N)
    wider = extend(model, [a.effect for a in perturbations(model, SENSORS, POINT, 1.0)])
    assert wider.n_dof == N
    for a, b in zip(wider.matrices(POINT), model.matrices(POINT), strict=True):
        np.testing.assert_array_equal(a.toarray(), b.toarray())


def test_they_can_be_added_to_a_model_with_more_degrees_of_freedom(ladder):
    """Perturbations of the base model are valid terms of an extended one."""
    model = ladder(N)
    hung = replace(
        perturbations(model, (), POINT, 1.0)[0].effect,
        name="hung",
        magnitude=replace(perturbations(model, (), POINT, 1.0)[0].effect.magnitude, name="hung", lower=0.0),
        build=lambda m: hung_masses([np.eye(N)[4]], "hung", "k_upper", 0.02),
    )
    longer = extend(model, [hung])
    every = [a.effect for a in perturbations(model, SENSORS, POINT, 1.0)]
    one, other = extend(longer, every), extend(model, [*every, hung])
    values = {**POINT, "hung": 0.4, "stiffness of rungs": 0.3, "added mass at sensor 8x": 0.2}
    for a, b in zip(one.matrices(values), other.matrices(values), strict=True):
        np.testing.assert_allclose(a.toarray(), b.toarray(), atol=1e-9)


def test_terms_whose_coefficient_is_not_a_monomial_are_skipped(ladder):
    model = ladder(N)
    loss = Term("loss", sp.csr_array(np.eye(N)), SeriesLoss(parameter("k_rung"), parameter("mass")))
    wider = replace(model, stiffness=AffineMatrix(N, (*model.stiffness.terms, loss)))
    assert "stiffness of loss" not in named(perturbations(wider, (), POINT, 1.0))
    assert isinstance(perturbations(wider, (), POINT, 1.0)[0].effect.build(model), Addition)
