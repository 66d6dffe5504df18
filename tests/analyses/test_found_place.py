"""A mass at any of five floors, and one that slides along a girder: found with its place, which counts as a choice."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.missing.effect_facts import places_sentence
from calib.missing.evidence import ln_evidence
from calib.structure.affine import parameter
from calib.structure.anywhere import at_one_of, sliding_mass
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition, extend

FLOORS = tuple(f"floor {k}" for k in range(1, 6))


def chain():
    """Five floors with a stiffness of each storey."""
    storeys, between = {}, np.diff(np.eye(6), axis=0)[:, 1:]
    for k in range(5):
        storeys[f"k{k + 1}"] = np.outer(between[k], between[k])
    parameters = [calib.Parameter(name, 2.0, 1.0, 4.0, "MN/m", prior_sd=0.1) for name in storeys]
    return calib.StructuralModel.from_matrices(
        storeys, 500.0 * np.eye(5), 40.0 * np.eye(5), dofs=[(k, "x") for k in range(1, 6)], parameters=parameters
    )


def floor_mass(on=(0, 1, 2, 3, 4)):
    def build(model):
        rows = np.eye(5)[list(on)]
        return at_one_of([Addition(mass=(outer_term("m", [r], parameter("extra")),)) for r in rows], "extra_place")

    place = calib.Parameter("extra_place", 1, 1, 5, integer=True, description="floor that carries it")
    return calib.Effect(
        "extra", "a mass on a floor", "No floor carries more than its own mass.", "Pallets.",
        calib.Parameter("extra", 0.0, 0.0, 500.0, "kg", prior_sd=50.0), build, (place,),
        tuple({"extra": 50.0, "extra_place": float(k)} for k in range(1, 6)), places=FLOORS,
        phrase="a mass on one of the floors",
    )  # fmt: skip


def ground_spring():
    return calib.Effect(
        "prop", "a contact at floor 2", "The building stands free.", "Debris.",
        calib.Parameter("prop", 0.0, 0.0, 5.0, "MN/m", prior_sd=0.2),
        lambda model: Addition(stiffness=(outer_term("prop", [np.eye(5)[1]], parameter("prop")),)),
    )  # fmt: skip


def girder():
    """A simply supported girder of eight beam elements, 1 m each; 100 kg/m."""
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], dtype=float)
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) * 100 / 420
    stiffness, mass = np.zeros((18, 18)), np.zeros((18, 18))
    for e in range(8):
        own = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        stiffness[own] += k
        mass[own] += m
    kept = [d for d in range(18) if d not in (0, 16)]
    dofs = [(d // 2 + 1, "z" if d % 2 == 0 else "ry") for d in kept]
    return calib.StructuralModel.from_matrices(
        {"EI": stiffness[np.ix_(kept, kept)]}, mass[np.ix_(kept, kept)], dofs=dofs,
        parameters=[calib.Parameter("EI", 5.0, 3.0, 8.0, "MNm2", prior_sd=0.3)],
    )  # fmt: skip


def deflection(position):
    """Deflection of the girder over its degrees of freedom, by the cubic shapes of an element."""
    e = min(int(position), 7)
    x = position - e
    row = np.zeros(18)
    row[2 * e : 2 * e + 4] = 1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2
    return np.delete(row, [0, 16])[None]


def load():
    return calib.Effect(
        "load", "a mass on the girder", "The girder carries itself only.", "A trolley.",
        calib.Parameter("load", 0.0, 0.0, 2000.0, "kg", prior_sd=100.0),
        lambda model: sliding_mass(deflection, "load", "load_at", (0.0, 8.0), 8),
        (calib.Parameter("load_at", 4.0, 0.0, 8.0, "m", prior_sd=4.0),),
        tuple({"load": 100.0, "load_at": x} for x in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)),
        phrase="a mass somewhere along the girder",
    )  # fmt: skip


def measured(model, values, sensors, seed=1, count=5, std=(0.002, 0.01)):
    """The first modes with noise, standard deviations stated."""
    rng, modes = np.random.default_rng(seed), model.modes(values, count)
    shapes = model.sensor_rows(sensors) @ modes.shapes.real
    shapes = shapes / np.abs(shapes).max(axis=0)
    freq, unknown = modes.natural_freq * (1 + std[0] * rng.standard_normal(count)), np.full(count, np.nan)
    return calib.ModalTest(calib.MeasuredModes(
        tuple(f"M{k + 1}" for k in range(count)), freq, freq, std[0] * freq, unknown, unknown, sensors=tuple(sensors),
        shapes=shapes + std[1] * rng.standard_normal(shapes.shape) + 0j, shape_std=np.full(shapes.shape, std[1]),
    ))  # fmt: skip


def explained_chain(size, place, rows=(0, 1, 2, 3, 4)):
    model, effect = chain(), floor_mass(rows)
    sensors = [Sensor(k, "x") for k in range(1, 6)]
    twin = extend(model, [effect])
    test = measured(twin, {"extra": size, "extra_place": place, "k2": 2.05}, sensors)
    return calib.Problem(model, test).explain([effect, ground_spring()], progress=False)


@pytest.fixture(scope="module")
def clear():
    return explained_chain(60.0, 4)


@pytest.mark.medium
def test_the_floor_is_found_with_the_mass(clear):
    assert clear.verdict == "effect" and [e.name for e in clear.named] == ["extra"]
    chosen = clear.explanation.explanation.chosen
    assert chosen.fit.values["extra_place"] == 4 and not chosen.implausible
    row = clear.table.set_index("name").loc["extra"]
    assert row["magnitude_low"] < 60.0 < row["magnitude_high"]
    table = clear.explanation.tables["found_places"]
    assert list(table["name"]) == list(FLOORS) and list(table.loc[table["credible"], "place"]) == [4]
    assert any(s.startswith("extra acts at floor 4, one of 5 places; the odds against") for s in clear.sentences)


@pytest.mark.medium
@pytest.mark.parametrize("place", [1, 5])
def test_the_first_and_the_last_place_are_no_limits(place):
    found = explained_chain(70.0, place)
    assert found.explanation.explanation.chosen.fit.values["extra_place"] == place
    assert not found.explanation.explanation.chosen.implausible


@pytest.mark.medium
def test_places_that_the_data_do_not_discriminate_are_all_credible():
    """Two of the places are the same floor."""
    found = explained_chain(60.0, 3, rows=(0, 1, 1, 3, 4))
    table = found.explanation.tables["found_places"]
    assert list(table.loc[table["credible"], "name"]) == ["floor 2", "floor 3"] and found.verdict == "effect"
    assert table.loc[1, "sum_of_squares"] == pytest.approx(table.loc[2, "sum_of_squares"], rel=1e-6)
    assert places_sentence(table).endswith(" explains about as well.")


@pytest.mark.medium
def test_places_count_in_the_evidence(clear):
    chosen = clear.explanation.explanation.chosen
    (effect,) = chosen.effects
    fixed = replace(effect, nuisance=(), grid=(), places=())
    assert ln_evidence(chosen.fit, (fixed,)) - chosen.ln_evidence == pytest.approx(np.log(5))
    scores = clear.explanation.explanation.base_adequacy.named
    assert scores.owners.count("extra") == 5  # each place is one of the tests of the family


@pytest.mark.medium
def test_a_mass_is_found_along_a_girder_between_its_nodes():
    model, effect = girder(), load()
    sensors = [Sensor(k, "z") for k in range(2, 9)]
    twin = extend(model, [effect])
    test = measured(twin, {"load": 120.0, "load_at": 2.64, "EI": 5.1}, sensors, count=5)
    found = calib.Problem(model, test).explain([effect], progress=False)
    fit = found.explanation.explanation.chosen.fit
    assert [e.name for e in found.named] == ["load"] and fit.values["load_at"] == pytest.approx(2.64, abs=0.15)
    assert any("load_at: about 2.6" in s and "95 %" in s for s in found.sentences)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"nuisance": (calib.Parameter("extra_place", 1, 1, 4, integer=True),)}, "nothing chooses among its 5 places"),
        ({"nuisance": (calib.Parameter("extra_place", 1, 1, 5),)}, "nothing chooses among its 5 places"),
        ({"grid": tuple({"extra": 50.0, "extra_place": float(k)} for k in (1, 2, 3, 5))}, "its grid lacks a place"),
    ],
)
def test_places_without_a_choice_are_refused(change, words):
    with pytest.raises(InputError, match=words):
        replace(floor_mass(), **change)
