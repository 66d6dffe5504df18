"""Measured shapes on the whole model, and their mass-orthogonality."""

from dataclasses import replace

import numpy as np
import pytest

from calib.correlation.modal.expansion import deflections, expanded_shapes, orthogonality
from calib.correlation.modal.problem import ModalProblem
from calib.errors.errors import InputError
from calib.structure.expansion import static_expansion
from calib.structure.model import StructuralModel

FEW = ("1x", "1y", "3x", "4y", "6x", "6y")
"""Sensors that tell the four modes apart; the others are left out."""


@pytest.fixture
def case(build, twin):
    """A function that compares a chain with its own modes at six sensors, after a change to the measurement."""

    def make(change=lambda m: m, damped=False, **options):
        model: StructuralModel = build(damped=damped)
        measured = twin(model, model.space.values, **options)
        fewer = measured.without(sensors=[s.name for s in measured.sensors if s.name not in FEW])
        return ModalProblem(model, change(fewer), mode_count=8).compare(model.space.values)

    return make


def scaled(measured):
    return replace(measured, shapes=measured.shapes * np.array([2.0, -0.3, 5j, np.exp(0.7j)]))


@pytest.mark.parametrize("damped", [False, True])
def test_a_mode_of_the_model_is_recovered_in_scale_and_phase(case, damped):
    found = case(scaled, damped=damped)
    got = expanded_shapes(found)
    own = found.modes.shapes[:, found.pairing.model_index] * found.factors
    np.testing.assert_allclose(got.shapes, own, atol=1e-10)
    np.testing.assert_allclose(got.residual, 0.0, atol=1e-10)
    expected, table = found.deflection_table(), got.table()
    assert table[["mode", "point"]].equals(expected[["mode", "point"]])
    np.testing.assert_allclose(table[["u", "v", "w"]], expected[["u", "v", "w"]], atol=1e-10)


def test_a_mode_faces_the_same_way_whatever_sensors_are_left_out(case):
    """The largest entry of a shape, which decides its sign, may be at a sensor that is held out."""
    whole, turned = case(), 0
    for name in FEW:
        fewer = case(lambda m, name=name: m.without(sensors=[name]))
        wanted, got = fewer.deflection_table(), deflections(whole, fewer)
        for mode in fewer.measured.names:
            there, own = (table[table["mode"] == mode][["u", "v", "w"]].to_numpy() for table in (wanted, got))
            assert np.sum(there * own) > 0
            plain = whole.deflection_table(mode)[["u", "v", "w"]].to_numpy()
            turned += np.sum(there * plain) < 0
        assert deflections(whole, whole).equals(whole.deflection_table())
    assert turned  # else nothing was tested


def test_a_shape_identified_as_real_is_expanded_by_real_parts(case):
    """Real parts of the complex shapes fit it better than these themselves, and nothing imaginary is added."""
    found = case(damped=True, real=True)
    assert found.modes.is_complex
    got = expanded_shapes(found)
    seen, measured = found.sensor_shapes[:, found.pairing.model_index], found.measured.shapes
    left = measured - seen @ np.linalg.lstsq(seen, measured, rcond=None)[0]
    assert np.all(got.residual < 0.5 * np.linalg.norm(left, axis=0) / np.linalg.norm(measured, axis=0))
    assert not np.any(got.shapes.imag)


def test_the_static_expansion_keeps_the_sensors_and_more_modes_fit_them_better(case):
    noisy = {"noise": 0.05, "seed": 4}
    found = case(**noisy)
    rows = found.model.sensor_rows(found.measured.sensors)
    static = expanded_shapes(found, "static")
    np.testing.assert_allclose(rows @ static.shapes, found.measured.shapes, atol=1e-12)
    np.testing.assert_allclose(static.residual, 0.0, atol=1e-12)
    four, five = expanded_shapes(found).residual, expanded_shapes(found, modes=range(1, 6)).residual
    assert np.all(five < four) and np.all((four > 0.005) & (four < 0.2))
    # Independent oracle of one of them.
    basis = rows @ found.modes.shapes[:, :5]
    left = found.measured.shapes - basis @ np.linalg.lstsq(basis, found.measured.shapes, rcond=None)[0]
    np.testing.assert_allclose(five, np.linalg.norm(left, axis=0) / np.linalg.norm(found.measured.shapes, axis=0))


def test_the_model_s_own_modes_are_orthonormal_by_serep(case):
    got = orthogonality(case(scaled), "SEREP")
    np.testing.assert_allclose(got.cross, np.eye(4), atol=1e-10)
    np.testing.assert_allclose(got.own, np.eye(4), atol=1e-10)
    np.testing.assert_allclose(got.tam_error, 0.0, atol=1e-10)
    np.testing.assert_allclose(got.imaginary, 0.0, atol=1e-10)


@pytest.mark.parametrize("by", ["static", "SEREP"])
def test_scale_and_phase_of_a_measured_shape_do_not_matter(case, by):
    noisy = {"damped": True, "noise": 0.05, "seed": 2}
    a, b = orthogonality(case(**noisy), by), orthogonality(case(scaled, **noisy), by)
    for name in ("cross", "own", "imaginary", "tam_error"):
        np.testing.assert_allclose(getattr(b, name), getattr(a, name), atol=1e-9)
    assert a.imaginary.min() > 0.01
    # Nor do those of a shape of the model.
    found = case(**noisy)
    turned = replace(found.modes, shapes=found.modes.shapes * np.exp(1j * np.arange(8.0)) * 3.0)
    np.testing.assert_allclose(orthogonality(replace(found, modes=turned), by).cross, a.cross, atol=1e-9)


def test_it_is_the_product_with_the_condensed_mass(case):
    """T = Phi_test^T M_TAM Phi_model of the textbook, at the sensors alone."""
    found = case(noise=0.05, seed=4, real=True)
    k, _, m = found.model.matrices(found.values)
    rows = found.model.sensor_rows(found.measured.sensors)
    tam = static_expansion(k, m, rows).mass(m)

    def unit(shapes):
        return shapes / np.sqrt(np.einsum("ij,ij->j", shapes, tam @ shapes))

    test = unit(found.measured.shapes.real)
    model = unit(rows @ found.modes.shapes[:, found.pairing.model_index])
    got = orthogonality(found)
    assert got.by == "static" and got.instead == ""
    np.testing.assert_allclose(got.cross, np.abs(test.T @ tam @ model), atol=1e-12)
    np.testing.assert_allclose(got.own, np.abs(test.T @ tam @ test), atol=1e-12)
    phi = found.modes.shapes[:, found.pairing.model_index]
    wrong = static_expansion(k, m, rows).transformation @ (rows @ phi) - phi
    np.testing.assert_allclose(got.tam_error, np.sqrt(np.einsum("ij,ij->j", wrong, m @ wrong)), rtol=1e-9)
    assert np.all(got.tam_error > 0.01)


def test_a_sensor_without_a_value_is_left_out_of_its_mode_only(case):
    def lose(measured):
        shapes = measured.shapes.copy()
        shapes[2, 1] = np.nan
        return replace(measured, shapes=shapes)

    whole, part = case(noise=0.02, seed=1), case(lose, noise=0.02, seed=1)
    one, other = expanded_shapes(whole), expanded_shapes(part)
    kept = [0, 2, 3]
    np.testing.assert_array_equal(other.shapes[:, kept], one.shapes[:, kept])
    assert np.all(np.isfinite(other.shapes)) and not np.allclose(other.shapes[:, 1], one.shapes[:, 1])
    got = orthogonality(part)
    assert np.all(np.isfinite(got.cross)) and np.all(np.diagonal(got.cross) > 0.9)


def test_a_mode_with_too_few_sensors_is_empty_and_says_why(case):
    def lose(measured):
        shapes = measured.shapes.copy()
        shapes[3:, 2] = np.nan
        return replace(measured, shapes=shapes)

    found = case(lose)
    got, cross = expanded_shapes(found), orthogonality(found, "SEREP")
    assert list(got.refused) == list(cross.refused) == ["M3"] and "4 modes are to be fitted to 3" in got.refused["M3"]
    assert np.isnan(got.residual[2]) and "M3" not in set(got.table()["mode"])
    assert np.isnan(cross.cross[2]).all() and np.isnan(cross.own[2]).all() and np.isnan(cross.own[:, 2]).all()
    assert np.isfinite(np.delete(cross.cross, 2, axis=0)).all()
    # Of two modes only, the three sensors suffice.
    assert not expanded_shapes(found, modes=(1, 2)).refused


def test_an_unpaired_mode_has_a_row_and_no_column(case):
    found = case()
    index = found.pairing.model_index.copy()
    index[1] = -1
    got = orthogonality(replace(found, pairing=replace(found.pairing, model_index=index)))
    table = got.cross_table()
    assert table.shape == (4, 2 + 3) and table["model_mode"].isna().tolist() == [False, True, False, False]
    assert [head.split(" ")[0] for head in table.columns[2:]] == [str(j + 1) for j in index if j >= 0]
    assert np.isnan(got.tam_error[1]) and got.self_table().columns.tolist() == ["mode", "M1", "M2", "M3", "M4"]


def test_the_sentence_counts_what_the_tables_show(case):
    got = orthogonality(case(noise=0.2, seed=5))
    off, shown = ~np.eye(4, dtype=bool), np.round(got.cross, 2)  # as it is read: 0.898 is 0.90
    pairs, leaks = (np.diagonal(shown) >= 0.9).sum(), (shown[off] > 0.1).sum()
    assert f"{pairs} of 4 pairs reach 0.9, and {leaks} of 12 other entries" in got.sentence and leaks
    assert f"{(np.round(got.own, 2)[off] > 0.1).sum() // 2} of 6 entries" in got.sentence
    assert f"the largest is {got.own[off].max():.2f} (" in got.sentence


def test_serep_replaces_static_where_sensors_repeat_each_other(case):
    def doubled(measured):
        twice = [*range(len(measured.sensors)), 0]
        sensors = [measured.sensors[k] for k in twice]
        sensors[-1] = replace(sensors[-1], node=99)
        return replace(
            measured, sensors=tuple(sensors), shapes=measured.shapes[twice], shape_std=measured.shape_std[twice]
        )

    found = case(doubled)
    got = orthogonality(found)
    assert got.by == "SEREP" and "follows from" in got.instead and ("99x" in got.instead or "1x" in got.instead)
    np.testing.assert_allclose(got.cross, np.eye(4), atol=1e-10)
    with pytest.raises(InputError, match="follows from"):
        orthogonality(found, "static")


def test_what_cannot_be_expanded_is_refused_in_a_sentence(case, build, twin):
    found = case()
    for arguments, words in (
        ({"by": "craig"}, "static or SEREP"),
        ({"modes": (1, 9)}, "from 1 to 8"),
        ({"modes": (2, 2)}, "different numbers"),
        ({"modes": range(1, 8)}, "7 modes are to be fitted to 6 sensors"),
    ):
        with pytest.raises(InputError, match=words):
            expanded_shapes(found, **arguments)
    model = build()
    frequencies = ModalProblem(model, twin(model, {}, shapes=False), mode_count=8).compare({})
    with pytest.raises(InputError, match="no shapes"):
        expanded_shapes(frequencies)
    none = replace(found, pairing=replace(found.pairing, model_index=np.full(4, -1)))
    for refused in (expanded_shapes, orthogonality):
        with pytest.raises(InputError, match=r"0 modes|no measured mode is paired"):
            refused(none)
