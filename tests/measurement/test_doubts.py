"""Measured data that contradict themselves, and copies that pass for repeats."""

import numpy as np
import pytest

import calib
from calib.errors.errors import InputError
from calib.measurement.doubts import doubts_of
from calib.measurement.files.read import read_modes
from calib.measurement.files.read_frf import read_frfs
from calib.measurement.files.uff import write_uff

SHAPES = np.array([[0.4, 1.0], [0.8, -0.7], [1.0, 0.3]])
SENSORS = ["1x", "2x", "3x"]


def modes(**changed):
    return calib.modes([8.0, 27.0], SHAPES, **({"sensors": SENSORS} | changed))


def placed(*points):
    return [calib.Sensor(k + 1, "x", point) for k, point in enumerate(points)]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"damping": [0.8, 0.9]}, "look like percent: 0.8 to 0.9 in all 2 modes"),
        ({"damping": [0.001, 0.002], "damping_std": [0.01, 0.02]}, "damping and damping_std are exchanged"),
        ({"shape_std": 1e9}, "exceed the largest entry"),
        ({"shape_std": [[0.0, 0.02], [0.02, 0.02], [0.02, 0.02]]}, "entry 1x of mode 1 is 0"),
        ({"sensors": placed(*[(1.0, 2.0, 3.0)] * 3)}, "3 measured nodes are at the same place"),
    ],
)
def test_what_contradicts_itself_is_told(changed, words):
    (said,) = doubts_of(modes(**changed))
    assert words in said


def test_doubtful_values_are_checked_before_anything_is_fitted():
    k = 1e6 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    model = calib.StructuralModel.from_matrices(
        {"k": k}, 100.0 * np.eye(3), dofs=[(n, "x") for n in (1, 2, 3)],
        parameters=[calib.Parameter("k", 1.0, 0.5, 2.0)],
    )  # fmt: skip
    found = calib.Problem(model, calib.ModalTest(modes(damping=[0.8, 0.9]))).compare()
    assert "measured modes" in found.lines["Next"] and "look like percent" in str(found)
    sound = calib.Problem(model, calib.ModalTest(modes())).compare()
    assert "measured modes, whose" not in sound.lines["Next"]


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"damping": [0.01, 0.3], "damping_std": [0.02, 0.01], "shape_std": 0.02},
        {"shape_std": [[0.02, 0.0], [0.02, 0.02], [0.0, 0.02]]},  # of the entries to which the shapes are scaled
        {"sensors": placed((0.0, 0, 0), (1.0, 0, 0), (1.0, 0, 0))},
    ],
)
def test_sound_modes_raise_no_doubt(changed):
    assert doubts_of(modes(**changed)) == ()


def test_exchanged_columns_of_shapes_are_told(tmp_path):
    table, shapes = tmp_path / "m.csv", tmp_path / "s.csv"
    table.write_text("mode,freq,freq_kind\na,8,natural\n")
    lines = [f"a,{n},x,{re},{im},{std}" for n, re, im, std in ((1, 0.4, 0.02, 0), (2, 0.8, 0.03, 0), (3, 1.0, 0.02, 0))]
    shapes.write_text("\n".join(["mode,node,direction,re,im,std", *lines]))
    assert "im and std are exchanged" in doubts_of(read_modes(table, shapes=shapes))[0]
    shapes.write_text("mode,node,direction,re,im,std\na,1,x,0.4,0.02,-0.01\n")
    with pytest.raises(InputError, match="im and std are exchanged"):
        read_modes(table, shapes=shapes)


def test_copies_of_a_file_are_no_repeats(tmp_path):
    text = "mode,freq,freq_kind\na,8.1234,natural\nb,27.5,natural\n"
    for name, content in (("1.csv", text), ("2.csv", text.replace("8.1234", "8.2")), ("3.csv", text)):
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=r"3\.csv: it has the content of .*1\.csv: a copy is no repeat"):
        read_modes(str(tmp_path / "*.csv"))
    assert read_modes([tmp_path / "1.csv", tmp_path / "2.csv"]).n_repeats == 2


def test_shapes_that_are_the_same_to_the_last_digit_are_a_copy_whatever_the_text(tmp_path):
    table, shapes = tmp_path / "m.csv", tmp_path / "s.csv"
    table.write_text("mode,freq,freq_kind,repeat\na,8.1,natural,1\na,8.1,natural,2\n")
    lines = ["mode,node,direction,re,repeat", "a,1,x,0.5,1", "a,2,x,1,1", "a,1,x,0.50,2", "a,2,x,1,2"]
    shapes.write_text("\n".join(lines))
    with pytest.raises(InputError, match="repeat 2: it holds the same modes"):
        read_modes(table, shapes=shapes)
    shapes.write_text("\n".join(lines).replace("0.50", "0.51"))
    assert read_modes(table, shapes=shapes).n_repeats == 2


def test_a_copy_in_another_order_of_modes_and_sensors_is_no_repeat(tmp_path):
    freq, shapes = np.array([8.1, 27.4]), np.array([[0.5, 1.0], [1.0, -0.4]])
    sensors = [calib.Sensor(k, "x", (float(k), 0.0, 0.0)) for k in (1, 2)]
    for name, modes in (("one", [0, 1]), ("two", [1, 0])):
        write_uff(tmp_path / f"{name}.uff", names=["a", "b"], natural_freq=freq[modes], damping_ratio=np.full(2, 0.01),
                  sensors=sensors[:: 1 if name == "one" else -1],
                  shapes=shapes[:: 1 if name == "one" else -1, modes])  # fmt: skip
    with pytest.raises(InputError, match="a copy is no repeat"):
        read_modes([tmp_path / "one.uff", tmp_path / "two.uff"])


def test_a_frequency_that_never_varies_is_told(tmp_path):
    table = tmp_path / "m.csv"
    lines = [f"a,8.3,natural,{k}\nb,{27 + 0.01 * k**2},natural,{k}" for k in range(10)]
    table.write_text("\n".join(["mode,freq,freq_kind,repeat", *lines]))
    (said,) = doubts_of(read_modes(table))
    assert "mode a (8.3 Hz)" in said and "mode b" not in said


# -- lines of FRFs -----------------------------------------------------------------------------------------------------

FREQ = np.arange(0.5, 20.5, 0.5)


def receptance(k):
    return 1.0 / (k - (2 * np.pi * FREQ) ** 2 + 8j * FREQ)


def write(path, functions, freq=FREQ):
    lines = [
        f"{f!r},{name},1x,{v.real!r},{v.imag!r}"
        for name, values in functions.items() for f, v in zip(freq.tolist(), values.tolist(), strict=True)
    ]  # fmt: skip
    path.write_text("\n".join(["# unit: m/N", "freq,response,reference,re,im", *lines]))
    return path


def repeats(folder, hurt=lambda functions, r: None, count=3):
    paths = []
    for r in range(count):
        rng = np.random.default_rng(r)
        noise = [1 + 0.01 * (rng.normal(size=len(FREQ)) + 1j * rng.normal(size=len(FREQ))) for _ in range(2)]
        functions = {"1x": receptance(3000) * noise[0], "2x": receptance(2000) * noise[1]}
        hurt(functions, r)
        paths.append(write(folder / f"r{r}.csv", functions))
    return read_frfs(paths, synthetic=True)


def test_a_line_that_is_exactly_zero_was_not_measured(tmp_path):
    clean = repeats(tmp_path)

    def zero(functions, r):
        functions["1x"][7] = 0
        functions["2x"][7] = 0

    found = repeats(tmp_path, zero)
    assert np.isnan(found.values[7]).all() and np.isfinite(np.delete(found.values, 7, axis=0)).all()
    np.testing.assert_allclose(np.delete(found.std, 7, 0), np.delete(clean.std, 7, 0), rtol=0.1)
    assert any("1x/1x, 2x/1x: exactly 0 at 4 Hz" in said for said in doubts_of(found))


def test_a_zero_in_one_repeat_leaves_the_others(tmp_path):
    clean = repeats(tmp_path)

    def zero(functions, r):
        if r == 0:
            functions["2x"][7] = 0

    found = repeats(tmp_path, zero)
    last = repeats(tmp_path, lambda f, r: None, 3)
    two = [read_frfs(tmp_path / f"r{r}.csv").values[7, 1, 0] for r in (1, 2)]
    np.testing.assert_allclose(found.values[7, 1, 0], np.mean(two), rtol=1e-9)
    np.testing.assert_allclose(found.std[7, 1, 0], clean.std[7, 1, 0] * np.sqrt(3 / 2), rtol=0.1)
    np.testing.assert_array_equal(found.values[:, 0], last.values[:, 0])


@pytest.mark.parametrize("value", [3e-4, 2e-4 - 1e-4j])
def test_a_line_on_which_all_repeats_agree_is_left_out_and_named(tmp_path, value):
    clean = repeats(tmp_path)

    def hold(functions, r):
        functions["2x"][7] = value

    found = repeats(tmp_path, hold)
    assert np.isnan(found.values[7, 1, 0]) and np.isfinite(found.values[7, 0, 0])
    np.testing.assert_allclose(np.delete(found.std, 7, 0), np.delete(clean.std, 7, 0), rtol=0.1)
    (said,) = doubts_of(found)
    assert "2x/1x" in said and "4 Hz" in said and "held or clipped" in said


def test_a_copy_among_the_repeats_is_refused_and_so_is_a_frozen_function(tmp_path):
    paths = [write(tmp_path / f"{k}.csv", {"1x": receptance(3000) * (1 + 0.1 * (k % 2))}) for k in range(3)]
    with pytest.raises(InputError, match="a copy is no repeat"):
        read_frfs(paths)
    paths[2].write_text("# another comment\n" + paths[2].read_text())
    with pytest.raises(InputError, match=r"same functions as .*0\.csv"):
        read_frfs(paths)
    frozen = [write(tmp_path / f"{k}.csv", {"1x": receptance(3000), "2x": (k + 1) * receptance(2000)}) for k in (0, 1)]
    with pytest.raises(InputError, match="1x/1x agree to the last digit on every line"):
        read_frfs(frozen)


def test_lines_may_be_left_out_where_nothing_was_measured(tmp_path):
    """Of one function, and of all functions of one repeat: the remedy for a line without a value."""
    whole = {"1x": receptance(3000), "2x": receptance(2000)}
    one = write(tmp_path / "a.csv", whole)
    text = one.read_text().splitlines()
    one.write_text("\n".join(line for line in text if not line.startswith("3.0,2x")))
    found = read_frfs(one)
    assert np.isnan(found.values[5, 1, 0]) and np.isfinite(found.values[5, 0, 0]) and len(found.freq) == len(FREQ)
    other = tmp_path / "b.csv"
    lines = write(other, {name: 1.1 * values for name, values in whole.items()}).read_text().splitlines()
    other.write_text("\n".join(line for line in lines if not line.startswith("5.0,")))
    both = read_frfs([one, other])
    np.testing.assert_array_equal(both.freq, FREQ)
    np.testing.assert_allclose(both.values[9, 0, 0], found.values[9, 0, 0])
    cells = next(line for line in text if line.startswith("3.0,2x"))
    one.write_text("\n".join(text).replace(cells, "3.0,2x,1x,nan,0"))
    with pytest.raises(InputError, match="leave the line out"):
        read_frfs(one)
