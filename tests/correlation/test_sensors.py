"""Sensor faults that break the pairs needed to detect them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.command.example import write_example
from calib.correlation.modal.axes import TURNS
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.sensors import Corrections, suspicious_sensors
from calib.measurement.check import with_corrected_rows
from calib.measurement.modal import MeasuredModes, Sensor
from calib.study.study import LoadedStudy

STUDIES = Path(__file__).resolve().parents[2] / "studies"


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The problem of the example that ``calib new`` writes, at its nominal values."""
    folder = tmp_path_factory.mktemp("example") / "mast"
    write_example(folder)
    study = LoadedStudy.load(folder)
    return study.problem, study.model.space.values


def found_with(example, change):
    """Pairing and findings when the measured shapes are changed."""
    problem, values = example
    names = [s.name for s in problem.measured.sensors]
    shapes = change(problem.measured.shapes.copy(), names)
    changed = replace(problem, measured=replace(problem.measured, shapes=shapes))
    found = changed.compare(values)
    return found.pairing, [(f.kind, set(f.sensors)) for f in suspicious_sensors(changed, found)]


def inverted(*sensors):
    def change(shapes, names):
        shapes[[names.index(s) for s in sensors]] *= -1
        return shapes

    return change


def test_the_example_has_no_findings(example):
    pairing, findings = found_with(example, inverted())
    assert not len(pairing.unpaired_measured) and findings == []


@pytest.mark.parametrize("sensor", ["2x", "2z", "3x", "4x", "4z"])
def test_an_inverted_sensor_is_named_though_it_breaks_a_pair(example, sensor):
    assert found_with(example, inverted(sensor))[1] == [("flipped", {sensor})]


def test_the_pair_of_the_second_mode_is_indeed_broken(example):
    assert found_with(example, inverted("2x"))[0].unpaired_measured.tolist() == [2]


def test_exchanged_sensors_are_named_though_they_exchange_partners(example):
    def exchanged(shapes, names):
        a, b = names.index("1x"), names.index("4x")
        shapes[[a, b]] = shapes[[b, a]]
        return shapes

    pairing, findings = found_with(example, exchanged)
    assert pairing.model_index.tolist() == [3, 0, 1, 2] and findings == [("swapped", {"1x", "4x"})]


def test_a_dead_and_an_inverted_sensor_are_both_named(example):
    def change(shapes, names):
        shapes[names.index("3x")] = 0.0
        return inverted("2x")(shapes, names)

    pairing, findings = found_with(example, change)
    assert len(pairing.unpaired_measured)
    assert findings == [("dead", {"3x"}), ("flipped", {"2x"})]


def exchanged_axes(*nodes):
    def change(shapes, names):
        for node in nodes:
            a, b = names.index(f"{node}x"), names.index(f"{node}z")
            shapes[[a, b]] = shapes[[b, a]]
        return shapes

    return change


@pytest.mark.parametrize(("nodes", "kinds"), [((1, 2, 3, 4), ["axes"]), ((1, 3, 4), ["axes"]), ((2,), ["swapped"])])
def test_axes_exchanged_at_all_or_many_nodes_are_one_finding_and_at_one_node_an_exchange(example, nodes, kinds):
    findings = found_with(example, exchanged_axes(*nodes))[1]
    assert [kind for kind, _ in findings] == kinds
    assert findings[0][1] == {f"{node}{d}" for node in nodes for d in "xz"}


def test_a_turned_sensor_beside_exchanged_axes_is_told_too(example):
    def change(shapes, names):
        return inverted("4x")(exchanged_axes(1, 2, 3, 4)(shapes, names), names)

    assert [kind for kind, _ in found_with(example, change)[1]] == ["axes", "flipped"]


def compared_in(turn, directions="xyz"):
    """Eight nodes of a model with six modes in space, measured in turned axes with 5 % of noise."""
    rng, names = np.random.default_rng(2), [f"{k}{d}" for k in range(1, 9) for d in "xyz"]
    shapes = rng.normal(size=(8, 3, 6))
    own = [turn.of(d) for d in "xyz"]
    measured = np.stack([sign * shapes[:, "xyz".index(axis)] for axis, sign in own], axis=1).reshape(24, 6)
    measured = measured + 0.05 * rng.normal(size=(24, 6))
    kept = [k for k, name in enumerate(names) if name[-1] in directions]
    freq = np.arange(10.0, 16.0)
    fe = calib.modes(freq, shapes.reshape(24, 6), sensors=names)
    return calib.compare_modes(fe, calib.modes(freq, measured[kept], sensors=[names[k] for k in kept]))


@pytest.mark.medium
def test_every_turn_and_mirror_of_the_axes_is_told_with_its_axes():
    for turn in TURNS:
        (answer,) = compared_in(turn).by_test.values()
        if turn.signs == (-1, -1, -1) and turn.axes == ("x", "y", "z"):
            assert answer.sensor_findings == ()  # a MAC does not know the sign of a shape
            continue
        (finding,) = answer.sensor_findings
        changed = [(d, *turn.of(d)) for d in "xyz"]
        told = {d for d, axis, sign in changed if (d, sign) != (axis, 1)}
        opposite = {d for d, axis, sign in changed if (d, sign) != (axis, -1)}
        assert {name[-1] for name in finding.sensors} in (told, opposite) and finding.mac_after > 0.98
        assert answer.checks[-1] == "the axes of all sensors" and answer.doubts[-1].startswith("Check the axes: ")


def test_an_axis_that_has_the_name_of_another_is_told_of_sensors_of_one_axis():
    (answer,) = compared_in(TURNS[[t.axes for t in TURNS].index(("y", "x", "z"))], "x").by_test.values()
    assert [f.kind for f in answer.sensor_findings] == ["axes"] and "x is y of the model" in answer.doubts[-1]


@pytest.mark.slow
def test_a_mode_that_the_model_lacks_gives_no_findings(example):
    """An unpaired mode that the model lacks is a model error, not a sensor fault."""
    rng = np.random.default_rng(3)

    def foreign(shapes, names):
        shapes[:, 2] = rng.normal(size=len(names))
        return shapes

    for _ in range(40):
        assert found_with(example, foreign)[1] == []


@pytest.mark.medium
@pytest.mark.parametrize("name", ["bogie", pytest.param("hidden_bogie", marks=pytest.mark.slow)])
def test_the_shipped_measurements_have_no_findings(name):
    study = LoadedStudy.load(STUDIES / name)
    found = study.problem.compare(study.model.space.values)
    assert suspicious_sensors(study.problem, found) == ()


@pytest.mark.slow
def test_unrelated_shapes_give_hardly_any_findings(build):
    model, rng, accused = build(), np.random.default_rng(4), 0
    sensors = tuple(Sensor(k + 1, d, (float(k), 0.0, 0.0)) for k in range(3) for d in "xy")
    freq = model.modes(model.space.values, 5).natural_freq
    nothing = np.full(5, np.nan)
    for _ in range(40):
        shapes = rng.normal(size=(6, 5)).astype(complex)
        shapes /= np.abs(shapes).max(axis=0)
        measured = MeasuredModes(
            ("a", "b", "c", "d", "e"), freq, freq, nothing, nothing, nothing, sensors, shapes, np.full((6, 5), np.nan)
        )
        problem = ModalProblem(model, measured, mode_count=8)
        accused += bool(suspicious_sensors(problem, problem.compare(model.space.values)))
    assert accused <= 1


def _small_case(rng, kind):
    """Measured and model shapes, shares and threshold; ``kind`` says what is unusual."""
    n_sensors, n_measured, n_model = rng.integers(5, 12), rng.integers(1, 5), rng.integers(4, 8)
    model = rng.normal(size=(n_sensors, n_model))
    if kind == "complex":
        model = model + 1j * rng.normal(size=model.shape)
    shapes = model[:, rng.permutation(n_model)[:n_measured]] + rng.choice([0.02, 0.5]) * rng.normal(
        size=(n_sensors, n_measured)
    )
    shapes = shapes.astype(complex)
    swapped = rng.choice(n_sensors, 2, replace=False)
    shapes[swapped] = shapes[swapped[::-1]]
    shapes[rng.integers(n_sensors)] *= -1
    if kind == "missing":
        shapes[rng.random(shapes.shape) < 0.2] = np.nan
    shares = rng.uniform(0.3, 1.0, (n_measured, n_model)) if kind == "energies" else np.ones((n_measured, n_model))
    return shapes, model, shares, float(rng.choice([0.0, 0.3]))


@pytest.mark.parametrize("kind", ["real", "complex", "missing", "energies"])
def test_the_best_corrections_are_those_of_a_search_through_all(kind):
    rng = np.random.default_rng(7)
    for _ in range(15):
        shapes, model, shares, threshold = _small_case(rng, kind)
        everywhere = np.flatnonzero(np.isfinite(shapes).any(axis=1))
        seen = np.isfinite(shapes)

        def emac(rows, shapes=shapes, seen=seen, model=model, shares=shares, threshold=threshold):
            a = with_corrected_rows(np.where(seen, shapes, 0.0), [rows])
            size = (np.abs(a) ** 2).sum(axis=0)[:, None] * (seen.T.astype(float) @ np.abs(model) ** 2)
            best = np.max(shares * np.abs(a.conj().T @ model) ** 2 / np.where(size > 0, size, 1.0), axis=1)
            return best[best >= threshold].sum()

        rows = [(int(i),) for i in everywhere] + [(int(i), int(j)) for i in everywhere for j in everywhere if i < j]
        wanted = sorted(rows, key=lambda one: (-round(emac(one), 12), one))[:6]
        found = Corrections.of(shapes, model, shares, threshold).best(everywhere, 6)
        assert np.allclose([emac(one) for one in found], [emac(one) for one in wanted], rtol=1e-12, atol=0)
        assert sorted(found) == sorted(set(found))


def test_few_pairs_of_sensors_are_summed_over_all_modes(monkeypatch):
    rng, summed = np.random.default_rng(8), []
    model = np.linalg.qr(rng.normal(size=(60, 12)))[0]
    shapes = (model[:, :8] + 0.005 * rng.normal(size=(60, 8))).astype(complex)
    monkeypatch.setattr(Corrections, "value", lambda *given, own=Corrections.value: summed.append(1) or own(*given))
    Corrections.of(shapes, model, np.ones((8, 12)), 0.3).best(np.arange(60), 12)
    assert len(summed) < 60 + 60  # 60 rows turned round, and few of the 1,770 pairs
