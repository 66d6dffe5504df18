import numpy as np
import pytest

import calib
from calib.correlation.response.problem import response_dof
from calib.errors.errors import InputError
from calib.measurement.files.read import read_modes
from calib.measurement.responses import read_responses
from calib.problem.degrees_of_freedom import p_value, repeats_dof

VALUES = {"freq_1": 4.5, "freq_2": 13.4, "mass": 1200.0, "sag": 0.003, "zeta_1": 0.011}


def table(path, repeats, seed=0, change=lambda k, name, value: value):
    """A table with many repeats; ``change`` returns None for a response that a repeat lacks."""
    rng = np.random.default_rng(seed)
    lines = ["response,value,repeat"]
    kept = {name: [] for name in VALUES}
    for k in range(repeats):
        for name, value in VALUES.items():
            given = change(k, name, value * (1 + 0.01 * rng.normal()))
            if given is not None:
                kept[name].append(given)
                lines.append(f"{name},{given!r},run {k + 1}")
    path.write_text("\n".join(lines) + "\n")
    return kept


def test_units_reach_the_comparison(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("response,value,unit\nload,182,N\nratio,1.2,\n")
    measured = read_responses(path)
    assert str(measured).splitlines()[1].split() == ["response", "value", "std", "unit"]
    space = calib.ParameterSpace((calib.Parameter("k", 1.0, 0.5, 2.0),))
    model = calib.FunctionModel("beam", space, lambda v: {"load": 180 * v["k"], "ratio": v["k"]})
    compared = calib.Problem(model, calib.ResponseTest(measured)).compare()
    assert compared.table["unit"].tolist() == ["N", ""]


def test_each_response_is_the_mean_over_the_repeats_that_hold_it(tmp_path):
    path = tmp_path / "r.csv"
    kept = table(path, 6, change=lambda k, n, v: None if (k, n) in {(0, "mass"), (3, "sag"), (4, "sag")} else v)
    found = read_responses(path)
    assert list(found.targets)[:2] == ["freq_1", "freq_2"]
    for name, values in kept.items():
        mean, std = found.targets[name]
        assert mean == pytest.approx(np.mean(values))
        assert std == pytest.approx(np.std(values, ddof=1) / np.sqrt(len(values)))
        assert found.counts[name] == len(values)
    assert found.counts["mass"] == 5 and found.counts["sag"] == 4 and found.repeats == 4
    assert found.disagreements == ()
    assert len([note for note in found.notes if "of 6 repeats" in note]) == 2


def test_an_outlier_is_named_with_its_effect_on_the_mean(tmp_path):
    path = tmp_path / "r.csv"
    kept = table(path, 6, change=lambda k, n, v: 2 * v if (k, n) == (2, "mass") else v)
    robust, plain = (read_responses(path, p) for p in ("robust", "plain"))
    (one,) = robust.disagreements
    assert (one.kind, one.mode) == ("response", "mass") and one.repeat.endswith("run 3")
    assert one.left_out and not plain.disagreements[0].left_out
    assert robust.counts["mass"] == 5 and plain.counts["mass"] == 6
    clean = [v for k, v in enumerate(kept["mass"]) if k != 2]
    assert robust.targets["mass"][0] == one.mean_without == pytest.approx(np.mean(clean))
    assert plain.targets["mass"][0] == one.mean_with == pytest.approx(np.mean(kept["mass"]))
    assert one.std_with > 5 * one.std_without


@pytest.mark.medium
def test_a_far_value_is_found_among_those_of_its_own_kind(tmp_path):
    """Noise of 0.1 % in frequencies and 0.3 to 2 % in shapes: shapes do not determine the noise of a frequency."""
    path, runs, left_out = tmp_path / "r.csv", 20, 0
    truth = {f"freq_{k}": 4.5 * k for k in range(1, 6)} | {f"shape_{k}": 0.1 + 0.02 * k for k in range(25)}
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        std = {n: 0.001 if n.startswith("freq") else rng.uniform(0.003, 0.02) for n in truth}
        table = {n: v * (1 + std[n] * rng.normal(size=5)) for n, v in truth.items()}
        table["freq_2"][2] *= 1.05
        rows = [f"{n},{v!r},{k}" for n, values in table.items() for k, v in enumerate(values.tolist())]
        path.write_text("response,value,repeat\n" + "\n".join(rows) + "\n")
        found = read_responses(path)
        left_out += {d.mode for d in found.disagreements if d.left_out} == {"freq_2"}
        assert {n for n, count in found.counts.items() if count < 5} <= {"freq_2"}
    assert left_out >= 0.95 * runs


def test_without_repeats_the_table_is_as_it_stands(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("response,value,std\na,1,0.1\nb,2,\n")
    found = read_responses(path)
    assert dict(found.targets) == {"a": (1.0, 0.1), "b": (2.0, None)} and found.repeats is None
    path.write_text("response,value,std,repeat\na,1,0.1,x\na,1,0.1,x\n")
    with pytest.raises(InputError, match="line 3, column response"):
        read_responses(path)
    path.write_text("response,value,std,repeat\na,1,0.1,x\na,1,0.1,\n")
    with pytest.raises(InputError, match="line 3, column repeat"):
        read_responses(path)
    path.write_text("response,value,std,repeat\na,1,0.1,x\nb,2,0.3,x\nb,2,0.4,y\n")
    assert dict(read_responses(path).targets) == {"a": (1.0, 0.1), "b": (2.0, None)}


MODES = "mode,freq,freq_kind,repeat\na,10,natural,1\nb,20,natural,1\na,12,natural,2\nb,22,natural,2\na,11,natural,3\n"
SHAPES = "mode,node,direction,re,repeat\n" + "".join(
    f"{mode},{node},y,{value * factor},{label}\n"
    for label, factor, modes in ((1, 1.0, "ab"), (2, -2.0, "ab"), (3, 5.0, "a"))
    for mode in modes
    for node, value in enumerate((1.0, 2.0 if mode == "a" else -2.0, 0.5), start=1)
)


def test_many_repeats_in_one_table_of_modes_and_one_of_shapes(tmp_path):
    modes, shapes = tmp_path / "modes.csv", tmp_path / "shapes.csv"
    modes.write_text(MODES)
    shapes.write_text(SHAPES)
    found = read_modes([modes], shapes=[shapes])
    assert found.n_repeats == 3 and found.counts("freq").tolist() == [3, 2]
    np.testing.assert_allclose(found.natural_freq, [11, 21])
    np.testing.assert_allclose(found.freq_std, [1 / np.sqrt(3), 1.0])
    np.testing.assert_allclose(found.shapes, [[0.5, 0.5], [1, -1], [0.25, 0.25]])
    np.testing.assert_allclose(found.shape_std, 0.0, atol=1e-15)
    assert found.counts("shape").tolist() == [[3, 2]] * 3
    assert any("mode b" in note and "repeat 3" in note for note in found.notes)


def test_shapes_of_the_mean_go_with_repeated_modes(tmp_path):
    modes, shapes = tmp_path / "modes.csv", tmp_path / "shapes.csv"
    modes.write_text(MODES)
    shapes.write_text("mode,node,direction,re,std\na,1,y,1,0.1\na,2,y,2,0.1\nb,1,y,-4,0.1\nb,2,y,1,\n")
    found = read_modes([modes], shapes=[shapes])
    np.testing.assert_allclose(found.shapes, [[0.5, -1], [1, 0.25]])
    np.testing.assert_allclose(found.shape_std, [[0.05, 0.025], [0.05, np.nan]])


def test_tables_that_do_not_fit_together_are_refused(tmp_path):
    modes, shapes, more = (tmp_path / name for name in ("modes.csv", "shapes.csv", "more.csv"))
    modes.write_text(MODES)
    more.write_text("mode,freq,freq_kind\na,10,natural\n")
    shapes.write_text("mode,node,direction,re,repeat\na,1,y,1,9\n")
    with pytest.raises(InputError, match=r"shapes.csv, line 2, column repeat: unknown repeat '9'"):
        read_modes([modes], shapes=[shapes])
    with pytest.raises(InputError, match=r"more.csv|shapes.csv, line 2, column repeat"):
        read_modes([more], shapes=[shapes])
    with pytest.raises(InputError, match=r"modes.csv: it has a column 'repeat', but other files"):
        read_modes([more, modes])
    with pytest.raises(InputError, match="the tables hold 3"):
        read_modes([modes], repeats=2)


def test_few_repeats_are_pooled_over_the_responses_of_a_kind(tmp_path):
    path = tmp_path / "r.csv"
    lacking = {(0, "freq_2"), (1, "sag"), (2, "sag"), (3, "sag"), (4, "sag")}
    kept = table(path, 5, change=lambda k, n, v: None if (k, n) in lacking else 7.0 if n == "zeta_1" else v)
    read = read_responses(path, "plain")
    kinds = {name: "freq" if name.startswith("freq") else "other" for name in VALUES}
    found = read.pooled(kinds)
    a, b = (np.var(kept[n], ddof=1) / np.mean(kept[n]) ** 2 for n in ("freq_1", "freq_2"))
    common = (4 * a + 3 * b) / 7
    for name, n in (("freq_1", 5), ("freq_2", 4)):
        assert found.targets[name][1] == pytest.approx(np.mean(kept[name]) * np.sqrt(common / n))
    # Of the others only one varies: that of a single repeat stays unknown, and equal repeats take it.
    relative = read.targets["mass"][1] / read.targets["mass"][0]
    assert found.targets["mass"][1] == pytest.approx(read.targets["mass"][1])
    assert found.targets["sag"] == read.targets["sag"] and found.targets["sag"][1] is None
    assert found.targets["zeta_1"][1] == pytest.approx(7.0 * relative)
    assert {n: v for n, (v, _) in found.targets.items()} == {n: v for n, (v, _) in read.targets.items()}


def test_ten_repeats_and_values_within_their_standard_deviation_are_not_pooled(tmp_path):
    path = tmp_path / "r.csv"
    table(path, 10)
    read = read_responses(path)
    widened = read.pooled(dict.fromkeys(VALUES, "response"))
    for name, (value, std) in read.targets.items():
        assert widened.targets[name] == (value, pytest.approx(std * np.sqrt(9 / 7)))
    path.write_text("response,value,repeat\na,1,1\na,-1.2,2\nb,10,1\nb,10.1,2\nc,20,1\nc,20.1,2\n")
    read = read_responses(path)
    found = read.pooled(dict.fromkeys("abc", "response"))
    assert found.targets["a"] == read.targets["a"]
    assert found.targets["b"][1] / found.targets["b"][0] == pytest.approx(found.targets["c"][1] / found.targets["c"][0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("repeats", "count"), [(2, 8), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((5, 20), (10, 40)))]
)
def test_a_correct_model_is_rejected_as_often_as_the_level_says(tmp_path, repeats, count):
    """Simulated repeats of known true values: the rejection rate is that of the noise alone."""
    path, level, runs = tmp_path / "r.csv", 0.05, 300 if count < 40 else 60
    rng = np.random.default_rng(4)
    truth = np.linspace(5, 50, count)
    kinds = {f"r_{k}": "r" for k in range(count)}
    rejected = 0
    for _ in range(runs):
        values = truth * (1 + 0.01 * rng.normal(size=(repeats, count)))
        rows = [f"r_{k},{v!r},{i}" for i, own in enumerate(values.tolist()) for k, v in enumerate(own)]
        path.write_text("response,value,repeat\n" + "\n".join(rows) + "\n")
        found = read_responses(path, "plain").pooled(kinds)
        mean, std = np.array(list(found.targets.values())).T
        behind = repeats_dof(kinds.values(), found.pooled_repeats)["r"]
        rejected += bool(p_value(np.sum(((mean - truth) / std) ** 2), count, behind) < level)
    assert rejected / runs < level + 3 * np.sqrt(level * (1 - level) / runs)


@pytest.mark.slow
def test_a_claimed_accuracy_is_known_however_few_the_repeats(tmp_path):
    """Two repeats with noise of 0.1 % beside a claim of 1 %: five times the claim is a gross misfit."""
    path, count, truth = tmp_path / "r.csv", 4, np.array([5.0, 10.0, 20.0, 40.0])
    kinds = {f"r_{k}": "r" for k in range(count)}
    rng, p = np.random.default_rng(5), []
    for _ in range(400):
        values = truth * (1 + 0.01 * rng.normal(size=count)) * (1 + 0.001 * rng.normal(size=(2, count)))
        rows = [f"r_{k},{v!r},{i}" for i, own in enumerate(values.tolist()) for k, v in enumerate(own)]
        path.write_text("response,value,repeat\n" + "\n".join(rows) + "\n")
        found = read_responses(path, "plain").pooled(kinds).claiming(kinds, "1 %")
        (behind,) = response_dof(found.targets, found.pooled_repeats, found.shares).values()
        mean, std = np.array(list(found.targets.values())).T
        p.append(float(p_value(np.sum(((mean - truth) / std) ** 2), count, behind)))
        assert p_value(count * 3.5**2, count, behind) < 0.01 < p_value(count * 3.5**2, count, count)
    for level in (0.05, 0.5):
        assert np.mean(np.array(p) < level) == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / len(p)))
