"""Training a reduced basis, and the file it is kept in."""

import dataclasses
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import calib
from calib.errors.errors import InputError, ToleranceError
from calib.execution.tasks import shared_by
from calib.results.written import LOG
from calib.structure.affine import AffineMatrix, Term
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.certificate import certificate, mode_errors
from calib.structure.reduction.mode_target import ModeTarget
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import basis_at, enrich_basis, space_filling_points, train_basis
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def trained(ladder):
    """A ladder and a basis for four of its modes, both immutable."""
    model = ladder()
    return model, train_basis(model, model.space, 4, seed=1, freq_max=np.inf)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grounded", "damped"),
    [
        (True, True),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((False, False), (True, False), (False, True))),
    ],
)
def test_a_trained_basis_keeps_its_tolerance_on_fresh_points(ladder, grounded, damped):
    model = ladder(200, damped=damped, grounded=grounded)
    basis = train_basis(model, model.space, 6, seed=3, tolerance=1e-5)
    reduced = ReducedModel(model, basis)
    assert reduced.n_dof < 90
    table, _ = certificate(reduced, space_filling_points(model.space, 15, np.random.default_rng(77)), 6)
    assert table["above_tolerance"].tolist() == [0, 0, 0]
    assert basis.table()["indicator"].iloc[-1] <= 0.5e-5


@pytest.mark.slow  # ladders cover the same in every run
def test_the_bogie_on_both_of_its_spaces():
    """The quick form of tests/benchmarks/reduced_basis.py."""
    study = LoadedStudy.load(ROOT / "studies" / "bogie")
    spaces = [study.search_space, study.sensitivity_space]
    basis = train_basis(study.model, spaces, 10, seed=1, freq_max=50.0)
    reduced = ReducedModel(study.model, basis)
    assert reduced.n_dof < 100 and all(basis.covers(space) for space in spaces)
    points = [p for space in spaces for p in space_filling_points(space, 8, np.random.default_rng(5))]
    table, errors = certificate(reduced, points, 10)
    assert table["quantity"].tolist() == ["eigenvalue", "shape", "missed"]
    assert table["max"].iloc[0] < 1e-5 and table["max"].iloc[1] < 1e-4 and table["max"].iloc[2] == 0
    actual = np.concatenate([e.eigenvalue for e in errors])
    assert len(actual) > 16 * 8
    estimate = np.concatenate([e.indicator for e in errors])
    large = actual > 2e-7
    assert large.any() and np.all(estimate[large] > 0.3 * actual[large])
    # Every position of the actuators, far from the samples of the basis.
    for left in range(2, 9):
        for lateral in (-1, 0, 1):
            values = {"pos_long_left": left, "pos_lat_right": lateral, "K_contact": 1500.0, "m_crossbar": 20.0}
            complete = study.model.space.complete(values)
            found = reduced.modes(complete, 10)
            assert np.max(reduced.indicator(complete, found)[found.natural_freq < 50], initial=0.0) < 1e-5


@pytest.mark.slow
def test_the_same_seed_gives_the_same_basis_and_another_does_not(trained):
    model, one = trained
    same, other = (train_basis(model, model.space, 4, seed=s, freq_max=np.inf) for s in (1, 2))
    assert one.digest == same.digest != other.digest
    assert np.array_equal(one.vectors, same.vectors)


@pytest.mark.medium
def test_a_basis_cannot_be_changed(trained):
    _, basis = trained
    for name in ("vectors", "samples", "checks", "reference", "lower", "upper"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(basis, name)[...] = 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        basis.version = 2


@pytest.mark.medium
def test_samples_take_every_position_and_keep_the_constraints(trained):
    model, basis = trained
    place = basis.samples[:, basis.names.index("place")]
    assert set(place) == {1.0, 2.0, 3.0, 4.0, 5.0}
    points = space_filling_points(model.space, 40, np.random.default_rng(0))
    sums = np.array([p["k_upper"] + p["k_lower"] for p in points])
    assert np.all((sums >= 35) & (sums <= 90)) and np.ptp(sums) > 30
    counts = np.unique([p["place"] for p in points], return_counts=True)[1]
    assert counts.tolist() == [8] * 5
    assert {p["k_ground"] for p in points} == {30.0}


@pytest.mark.medium
def test_enriching_gives_a_next_version_that_meets_the_tolerance_there(ladder):
    model = ladder(200)
    narrow = model.space.keep(["k_upper", "k_lower"])
    basis = train_basis(model, narrow, 6, seed=1, tolerance=1e-6)
    assert not basis.covers(model.space) and basis.covers(narrow)
    outside = model.space.complete({"k_upper": 30.0, "k_lower": 28.0, "k_rung": 0.6, "mass": 2.0, "place": 1.0})
    assert mode_errors(ReducedModel(model, basis), outside, 6).worst > 1e-6
    grown = enrich_basis(model, basis, [outside])
    assert grown.version == 2 and grown.size > basis.size
    assert np.array_equal(grown.vectors[:, : basis.size], basis.vectors)
    assert mode_errors(ReducedModel(model, grown), outside, 6).worst < 1e-6


def test_what_a_stiffened_part_lacks_is_added_though_it_hardly_moves_the_reference():
    """A small mass on a spring that grows fiftyfold: its motion has little energy at the reference, much there."""
    one, other, tie = np.diag([1.0, 0.0]), np.diag([0.0, 1.0]), 0.01 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    spring = calib.Parameter("spring", 1.0, 0.5, 50.0, "N/m")
    model = calib.StructuralModel.from_matrices(
        {"spring": other, "fixed": one + tie}, np.diag([1.0, 0.01]), dofs=[(1, "x"), (2, "x")], parameters=[spring]
    )
    target, stiff = ModeTarget(1, np.inf, 0.95, 1e-3), {"spring": 50.0}
    basis = basis_at(model, model.space, target, model.space.values)
    assert basis.size == 1 and mode_errors(ReducedModel(model, basis), stiff, 1).worst > 1e-3
    grown = enrich_basis(model, basis, [stiff], target, verified=0)
    assert mode_errors(ReducedModel(model, grown), stiff, 1).worst < 1e-3


@pytest.mark.slow
def test_fresh_points_enrich_a_basis_of_few_samples(ladder):
    model = ladder(200, damped=False)
    basis = train_basis(model, model.space, 6, seed=2, tolerance=1e-6, samples=5)
    table = basis.table()
    assert table["round"].max() > 1 and len(basis.samples) > 5 and np.all(np.diff(table["size"]) >= 0)
    last = table[table["round"] == table["round"].max()]
    assert last["indicator"].max() <= 0.5e-6 and last["error"].notna().sum() == 6
    assert last["error"].max() <= 1e-6
    first = table[table["round"] == 1]
    assert first["indicator"].iloc[0] > 0.5e-6 or first["indicator"].max() > 0.5e-6


def test_a_missed_copy_of_a_repeated_mode_is_reported(ladder):
    model = ladder(damped=False)
    squares = 1e3 * np.array([1.0, 4.0, 4.0, 9.0, 16.0, *range(20, 75)])
    uncoupled = dataclasses.replace(
        model,
        stiffness=AffineMatrix(60, (Term("all", sp.csr_array(np.diag(squares))),)),
        mass=AffineMatrix(60, (Term("all", sp.csr_array(np.eye(60))),)),
    )
    basis = train_basis(uncoupled, model.space, 4, seed=1)
    assert mode_errors(ReducedModel(uncoupled, basis), {}, 4).worst < 1e-9
    blind = dataclasses.replace(basis, vectors=np.eye(60)[:, [0, 1, 3, 4, 5]])
    assert mode_errors(ReducedModel(uncoupled, blind), {}, 4).missed.tolist() in (
        [False, False, True, False],
        [False, True, False, False],
    )


@pytest.mark.medium
def test_a_missed_mode_is_reported(ladder):
    """The indicator of a basis without a mode is small everywhere; only the full model reveals it."""
    model = ladder(damped=False)
    basis = train_basis(model, model.space, 6, seed=1)
    values = model.space.complete({})
    modes = model.modes(values, 40)
    kept = np.delete(modes.shapes, 2, axis=1)
    blind = dataclasses.replace(basis, vectors=np.linalg.qr(kept)[0])
    reduced = ReducedModel(model, blind)
    assert np.max(reduced.indicator(values, reduced.modes(values, 6))) < 1e-9
    errors = mode_errors(reduced, values, 6)
    assert errors.missed.tolist() == [False, False, True, False, False, False] and errors.worst == np.inf
    table, _ = certificate(reduced, [values], 6)
    assert table.set_index("quantity").loc["missed", "max"] == 1


@pytest.mark.slow
def test_a_tolerance_that_is_not_reached_is_reported_with_the_error(ladder):
    model = ladder()
    with pytest.raises(ToleranceError, match="raise the tolerance") as fault:
        train_basis(model, model.space, 3, seed=1, tolerance=1e-15)
    reached, limit = (float(n) for n in re.findall(r"\d\.\de-\d+", fault.value.problem)[-2:])
    assert "indicator" not in fault.value.problem or reached > limit == 5e-16


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 0}, "number of modes is 0"),
        ({"tolerance": 0.0}, "tolerance is 0"),
        ({"spaces": []}, "no parameter space"),
    ],
)
def test_invalid_training_input_is_refused(ladder, options, words):
    model = ladder()
    arguments = {"spaces": model.space, "count": 3, "seed": 1, **options}
    with pytest.raises(InputError, match=words):
        train_basis(model, **arguments)


@pytest.mark.medium
def test_a_file_gives_back_the_same_basis(trained, tmp_path):
    model, basis = trained
    basis.save(tmp_path / "basis.npz")
    assert {f.name for f in tmp_path.iterdir()} == {"basis.npz", LOG}
    again = Basis.load(tmp_path / "basis.npz")
    assert again.digest == basis.digest and np.array_equal(again.vectors, basis.vectors)
    for field in (one for one in dataclasses.fields(Basis) if one.init):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(basis, field.name))
    assert ReducedModel(model, again).fingerprint == ReducedModel(model, basis).fingerprint


def test_damaged_and_foreign_files_are_refused(trained, tmp_path):
    _, basis = trained
    path = tmp_path / "basis.npz"
    with pytest.raises(InputError, match="no such file"):
        Basis.load(path)
    basis.save(path)
    whole = path.read_bytes()
    for cut in (0, 100, len(whole) // 2, len(whole) - 30):
        path.write_bytes(whole[:cut])
        with pytest.raises(InputError, match="not a readable reduced basis"):
            Basis.load(path)
    path.write_bytes(whole)
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file}
    vectors = arrays["vectors"].copy()
    vectors[3, 1] += 1e-12
    np.savez(path, **{**arrays, "vectors": vectors})
    with pytest.raises(InputError, match="digest differs"):
        Basis.load(path)
    np.savez(path, **{**arrays, "header": np.array('{"format": "something else"}')})
    with pytest.raises(InputError, match="not a reduced basis of this version"):
        Basis.load(path)
    with pytest.raises(InputError, match="cannot be written"):
        basis.save(tmp_path / "nowhere" / "basis.npz")


@pytest.mark.slow
def test_a_basis_is_the_same_whoever_shares_its_training(trained, monkeypatch):
    """The one process takes a part of the tasks, the other the rest; both see the same arrays."""
    model, basis = trained
    done = []

    def forgetful(function, shared, items, told):
        copies = [pickle.loads(pickle.dumps((shared, item))) for item in items]  # as another process gets them
        done.append(len(items))
        return [function(*copy) for copy in reversed(copies)][::-1]

    with shared_by(forgetful):
        again = train_basis(model, model.space, 4, seed=1, freq_max=np.inf)
    assert again.digest == basis.digest and again.checks.tobytes() == basis.checks.tobytes()
    assert done[:2] == [4, 4] and sum(done) > len(basis.samples)
