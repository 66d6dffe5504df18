"""Other methods of the benchmark: what they answer on toys whose truth is known, and how that is scored."""

import csv
import importlib
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.modal import MeasuredModes, Sensor
from calib.missing.decision import decide
from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition, extend
from calib.structure.effects.perturbations import perturbations
from calib.structure.effects.variants import Variants

pytestmark = pytest.mark.usefixtures("fewer_samples")
BENCH = Path(__file__).resolve().parents[1] / "benchmarks"
ALL = {"this search", "AICc", "BIC", "OMP", "LASSO"}


@pytest.fixture(scope="module")
def bench():
    """The scripts of the benchmark, which import each other by name."""
    sys.path.insert(0, str(BENCH))
    try:
        yield {name: importlib.import_module(name) for name in ("other_methods", "rates_table")}
    finally:
        sys.path.remove(str(BENCH))


@dataclass(frozen=True)
class Hidden:
    """The truth of a toy."""

    hidden: tuple[str, ...] = ()
    values: dict[str, float] = field(default_factory=dict)


def answers(bench, toy, truth, seed=1, noise=1.0):
    drawn = toy.drawn(np.random.default_rng(seed), truth, noise)
    found = decide(drawn)
    return found, bench["other_methods"].answers(found, drawn, Hidden(tuple(truth), truth))["methods"]


def test_all_methods_name_one_clear_effect(bench, toy):
    found, told = answers(bench, toy(), {"E3": 1.5})
    assert set(told) == ALL and found.verdict == "effect"
    for method, one in told.items():
        assert one == {"verdict": "effect", "best": ["E3"], "credible": ["E3"], "outcome": "right"}, method


def test_an_effect_that_is_in_no_library_is_named_wrongly(bench, toy):
    """Something else that looks alike: other methods have no answer but a name."""
    whole = toy().correlated("A0", "E1", 0.8)
    found, told = answers(bench, whole, {"A0": 2.0})
    assert not found.names_something
    for method in ALL - {"this search"}:
        assert "E1" in told[method]["credible"] and told[method]["outcome"] == "wrong", method
    assert told["this search"]["credible"] == [] and told["this search"]["outcome"] == found.verdict


@pytest.mark.medium
def test_pure_noise_is_often_told_as_an_effect_by_aicc(bench, toy):
    many = toy(effects=12)
    told = [answers(bench, many, {}, seed)[1] for seed in range(12)]
    alarms = {m: sum(one[m]["verdict"] != "nothing_detectable" for one in told) for m in ALL}
    assert alarms["this search"] <= 1 and alarms["AICc"] >= 3 and alarms["AICc"] >= alarms["BIC"]
    assert all(one[m]["outcome"] in ("nothing_detectable", "wrong") for one in told for m in ALL)


def test_collinear_effects_count_as_one(bench, toy):
    """Of two that the data cannot tell apart either name is right, as it is for the search."""
    alike = toy().correlated("E2", "E1", 0.9999)
    found, told = answers(bench, alike, {"E1": 1.5})
    assert {name for g in found.groups if g.others for name in g.names} == {"E1", "E2"}
    assert {one["outcome"] for one in told.values()} == {"right"}
    assert set(told["OMP"]["credible"]) <= {"E1", "E2"}


def test_an_effect_stands_for_its_group(bench):
    """E2 is collinear with E1, which leads the group and is hidden; E3 is another one."""
    stands, told = {"E1": "E1", "E2": "E1", "E3": "E3"}, bench["other_methods"]._Told
    assert told("effect", ["E2"], ["E2"]).row(stands, {"E1"})["outcome"] == "right"
    assert told("two_effects", ["E2"], ["E2", "E1"]).row(stands, {"E1"})["outcome"] == "right"
    assert told("two_effects", ["E2"], ["E2", "E3"]).row(stands, {"E1"})["outcome"] == "extra"
    assert told("indistinguishable", ["E3"], ["E3", "E2"]).row(stands, {"E1"})["outcome"] == "second"
    assert told("effect", ["E3"], ["E3"]).row(stands, {"E1"})["outcome"] == "wrong"


def test_two_effects_are_named_by_sparse_regression_and_in_part_by_criteria(bench, toy):
    _, told = answers(bench, toy(), {"E1": 2.0, "E4": 2.0})
    assert told["OMP"]["verdict"] == "two_effects" and set(told["OMP"]["credible"]) == {"E1", "E4"}
    assert told["OMP"]["outcome"] == "right"
    assert told["BIC"]["verdict"] == "effect" and told["BIC"]["outcome"] == "part"


def test_a_larger_standard_deviation_is_kept_from_other_methods(bench, toy):
    """The search repeats its decision with it; the others decide by the one that is stated."""
    found, told = answers(bench, toy(effects=12, modes=10), {}, seed=3, noise=2.0)
    assert found.noise_scale > 1.5 and found.verdict == "noise_underestimated"
    assert told["AICc"]["verdict"] != "nothing_detectable" and told["OMP"]["verdict"] != "nothing_detectable"


def test_a_fault_is_a_candidate_of_some(bench, toy, make_effect):
    """With faults among the candidates the fault is chosen; without them an effect like it."""
    plain = toy().correlated("F", "E1", 0.7)
    with_faults = type(plain)(**{**plain.__dict__, "faults": (make_effect("F", signed=True, of_measurement=True),)})
    _, told = answers(bench, with_faults, {"F": 2.0})
    assert set(told) == ALL | {f"{m} with faults" for m in ALL if m != "this search"}
    assert told["BIC with faults"]["verdict"] == "measurement" and told["BIC"]["outcome"] == "wrong"
    assert told["OMP with faults"]["verdict"] == "measurement" and told["OMP with faults"]["credible"] == []


def test_criteria(bench):
    other = bench["other_methods"]
    assert other.aicc(10.0, 3, 50) == pytest.approx(10 + 6 + 24 / 46) and other.aicc(10.0, 3, 4) == math.inf
    assert other.bic(10.0, 3, 50) == pytest.approx(10 + 3 * math.log(50))


def test_sparse_regression_keeps_the_side_of_a_magnitude(bench):
    """Orthonormal columns: the LASSO and the pursuit choose those whose square exceeds ln n."""
    z = np.array([5.0, -6.0, 1.0, -4.0])
    signed = np.array([False, False, True, True])
    for method in (bench["other_methods"].pursuit, bench["other_methods"].lasso):
        assert method(np.eye(4), z, signed, 100) == [0, 3]
        assert method(np.eye(4), 0.3 * z, signed, 100) == []


# -- largest energy error ----------------------------------------------------------------------------------------------

SIZE = 8


def spring(k):
    """Unit stiffness of one spring between mass k - 1 (the ground for k = 0) and k."""
    out = np.zeros((SIZE, SIZE))
    ends = [k] if k == 0 else [k - 1, k]
    out[np.ix_(ends, ends)] = 1.0 if k == 0 else [[1, -1], [-1, 1]]
    return out


@pytest.fixture(scope="module")
def rods():
    """Masses in a row on springs of 50 kN/m, and effects that soften one of them."""
    stiffness = {f"spring {k}": (5e4 * spring(k), "k") for k in range(SIZE)}
    model = calib.StructuralModel.from_matrices(
        stiffness, np.eye(SIZE), dofs=[(k + 1, "x") for k in range(SIZE)],
        parameters=[calib.Parameter("k", 1.0, 0.5, 2.0, "-", prior_sd=0.1)],
    )  # fmt: skip

    def soft(k):
        def build(base):
            term = Term(f"soft_{k}", base.stiffness.terms[k].matrix, Monomial(-1.0, ((f"soft_{k}", 1.0),)))
            return Addition(stiffness=(term,))

        magnitude = calib.Parameter(f"soft_{k}", 0.0, 0.0, 0.8, prior_sd=0.2)
        return calib.Effect(f"soft_{k}", f"soft spring {k}", "it is not", "a crack", magnitude, build)

    return model, tuple(soft(k) for k in (2, 5))


@pytest.mark.parametrize(("hidden", "named"), [("soft_2", ["soft_2"]), ("soft_5", ["soft_5"]), ("", [])])
def test_the_largest_energy_error_is_at_the_soft_spring(bench, rods, hidden, named):
    model, library = rods
    true = extend(model, library)
    modes = true.modes({hidden: 0.4} if hidden else {}, 5)
    sensors = tuple(Sensor(k + 1, "x") for k in range(SIZE))
    shapes = modes.shapes / np.abs(modes.shapes).max(axis=0)
    measured = MeasuredModes(
        tuple(f"M{k}" for k in range(5)), modes.natural_freq, modes.natural_freq, 0.002 * modes.natural_freq,
        np.full(5, np.nan), np.full(5, np.nan), sensors, shapes, np.full(shapes.shape, 0.01), 5, True,
    )  # fmt: skip
    local = tuple(p.effect for p in perturbations(model, (), model.space.values, 1.0))
    pair = ModalResidual(ModalProblem(model, measured, mode_count=8))
    hypotheses = ModelHypotheses(pair, Variants(model, library, local), model.space)
    found = decide(hypotheses)
    told = bench["other_methods"].answers(found, hypotheses, Hidden((hidden,) if hidden else ()))["methods"]
    assert told["energy error"]["credible"] == named
    assert told["energy error"]["outcome"] == ("right" if hidden else "nothing_detectable")
    if hidden:
        of = bench["other_methods"].residual_energies
        energies = of(hypotheses, found.base.fit.values, [e for e in local if e.name.startswith("stiffness")])
        assert f"spring {hidden[-1]}" in max(energies, key=energies.get)


# -- the table ---------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_the_table_counts_every_method_by_the_same_rule(bench, toy, tmp_path, capsys):
    rows = []
    for seed in range(3):
        for group, truth in (("single", {"E3": 1.5}), ("nothing", {})):
            found, told = answers(bench, toy(effects=12), truth, seed)
            rows.append({
                "code": "c", "group": group, "scenario": group, "visible": [9.0] if truth else [], "outcome": "",
                "verdict": found.verdict, "methods": told, "methods_code": "m",
            })  # fmt: skip
    rows.append(rows[0] | {"methods_code": "older"})
    rows.append(rows.pop(0))  # the latest line is of the latest code
    table = bench["rates_table"]
    file = table.methods_file(tmp_path / "rates_toy.csv")
    table.report_methods(rows, file, "2026-11-27")
    shown = capsys.readouterr().out
    with file.open(newline="") as text:
        counts = {
            (r["method"], r["hidden"], r["verdict"]): (int(r["count"]), int(r["n"])) for r in csv.DictReader(text)
        }
    assert file.name == "rates_toy_methods.csv" and {m for m, *_ in counts} == ALL
    assert counts["this search", "one effect, expected score 6 or more", "names it rightly"] == (3, 3)
    alarms = sum(r["methods"]["AICc"]["verdict"] != "nothing_detectable" for r in rows if r["group"] == "nothing")
    assert counts["AICc", "nothing", "says that something is missing"] == (alarms, 3)
    assert "(6 runs)" in shown and f"{alarms} of 3" in shown
