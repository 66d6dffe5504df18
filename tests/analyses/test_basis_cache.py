"""The cache of reduced bases: shared by studies, exact, safe when several runs use it, and harmless when damaged."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.analyses.reduction import reduction_of
from calib.command import cli
from calib.correlation import basis as requirements
from calib.correlation.basis import BasisRequirements
from calib.errors.errors import InputError
from calib.hypotheses.library import local_perturbations
from calib.results.results import Results
from calib.structure.reduction import cache as cached
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.cache import BasisCache, basis_cache, basis_key, kept_basis, using
from calib.structure.reduction.effect_basis import weight_key
from calib.study.study import LoadedStudy

KEY = "0123456789abcdef"


@pytest.fixture
def trainings(monkeypatch):
    """A basis pays for a small model; the trainings for a search and for effects."""
    counts = []
    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", 10)
    for name in ("train", "effect_basis"):
        original = getattr(requirements, name)

        def counted(*given, _name=name, _do=original, **options):
            counts.append(_name)
            return _do(*given, **options)

        monkeypatch.setattr(requirements, name, counted)
    return counts


def basis(key=KEY, size=3, seed=1):
    vectors = np.random.default_rng(seed).standard_normal((8, size))
    ends = np.zeros(2)
    return Basis(
        vectors, "m", ("a", "b"), ends, ends, ends + 1, 0.0, 4, np.inf, 0.95, 1e-5,
        np.zeros((0, 2)), np.zeros((0, 4)), seed, key=key,
    )  # fmt: skip


def faster(measured, factor):
    """The same measurement at other frequencies: another structure of the same kind."""
    return replace(measured, natural_freq=measured.natural_freq * factor)


@pytest.mark.slow
def test_siblings_train_once_and_get_the_same_basis_to_the_last_bit(mast, tmp_path, trainings):
    found = []
    for number, seed in enumerate((1, 7)):
        study = LoadedStudy.load(mast.write_study(tmp_path / f"mast_{number}", seed=seed))
        measured = faster(study.problem.measured, 1.0 + 0.07 * number)
        study = replace(study, problem=replace(study.problem, measured=measured))
        home = Results.at(tmp_path / "results", study.name)
        found.append(modal_hypotheses(study, home)[0].variants.basis)
        assert reduction_of(study, home).basis.version == 1
    assert trainings == ["train", "effect_basis"]  # by the first; the second finds both
    assert found[0].digest == found[1].digest
    shutil.rmtree(basis_cache().folder)
    shutil.rmtree(tmp_path / "results")
    assert modal_hypotheses(study, Results.at(tmp_path / "results", "mast"))[0].variants.basis.digest == found[0].digest
    assert len(trainings) == 4  # trained anew, with the other measurement: the same digits


def test_no_measured_frequency_enters_the_weights_of_local_perturbations(mast, tmp_path):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    values, measured = study.search_space.values, study.problem.measured
    one, other = (local_perturbations(study.model, [faster(measured, f)], values) for f in (1.0, 3.0))
    assert [p.effect.plausible for p in one] != [p.effect.plausible for p in other]
    assert [weight_key(p) for p in one] == [weight_key(p) for p in other]


@pytest.mark.parametrize("change", ["value", "limit", "constraint", "seed", "count", "sensor", "model"])
def test_everything_a_basis_depends_on_is_in_its_key(mast, tmp_path, change):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    model, space = study.model, study.search_space
    wanted = BasisRequirements.of(study.problem, 1e-5, 1)
    before = wanted.key(model, space)
    name = space.free_names[0]
    if change == "value":
        space = space.replace(name, value=0.5 * (space[name].value + space[name].upper))
    elif change == "limit":
        space = space.replace(name, upper=0.5 * (space[name].value + space[name].upper))
    elif change == "constraint":
        from calib.problem.space import LinearConstraint

        low = LinearConstraint("low", ((name, 1.0),), -1e9, space[name].upper)
        space = replace(space, constraints=(low,))
    elif change == "seed":
        wanted = replace(wanted, seed=2)
    elif change == "count":
        wanted = BasisRequirements.of(replace(study.problem, mode_count=study.problem.mode_count + 1), 1e-5, 1)
    elif change == "sensor":
        at = [
            local_perturbations(model, [m], space.values) for m in (study.measured, study.measured.without((), ("3x",)))
        ]
        assert [weight_key(p) for p in at[0]] != [weight_key(p) for p in at[1]]
        return
    else:
        model = replace(model, mass=model.mass.__class__(model.n_dof, model.mass.terms[:1]))
    assert wanted.key(model, space) != before
    prior = space.replace(name, prior_sd=0.1 * (space[name].upper - space[name].lower))
    assert wanted.key(model, prior) == wanted.key(model, space)


def test_a_basis_comes_back_as_it_was_kept(tmp_path):
    cache = BasisCache(tmp_path / "cache")
    assert cache.find(KEY) is None and cache.files == [] and cache.size == 0
    kept = basis()
    cache.keep(kept)
    assert cache.find(KEY).digest == kept.digest
    assert cache.size == sum(p.stat().st_size for p in (tmp_path / "cache").iterdir())


def test_a_file_under_another_key_is_no_answer(tmp_path):
    cache = BasisCache(tmp_path)
    cache.keep(basis())
    other = "f" * 16
    cache.files[0].rename(tmp_path / f"basis_{other}.npz")
    with using(tmp_path) as notes:
        assert cache.find(other) is None
    assert len(notes) == 1 and other in notes[0]


def test_an_equal_basis_of_other_code_keeps_what_a_ledger_knows_of_it(tmp_path):
    """Else a changed line of calib would empty every ledger."""
    path = tmp_path / "basis_v1.npz"
    first = basis("f" * 16)
    first.save(path)
    with using(tmp_path / "cache"):
        assert kept_basis(path, KEY, lambda: basis()).digest == first.digest
        assert Basis.load(path).key == first.key
        other = kept_basis(path, "e" * 16, lambda: basis(seed=2))  # not equal: the present one replaces it
    assert other.digest != first.digest and Basis.load(path).digest == other.digest


def test_runs_that_write_one_key_at_once_leave_one_whole_file(tmp_path):
    cache, kept = BasisCache(tmp_path), basis(size=400)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: (cache.keep(kept), cache.find(KEY))[1], range(12)))
    assert {one.digest for one in found} == {kept.digest}
    assert [p.name for p in tmp_path.iterdir()] == [f"basis_{KEY}.npz"]


def test_the_bases_unused_for_longest_leave_when_the_cache_is_full(tmp_path, monkeypatch):
    cache, keys = BasisCache(tmp_path), [f"{k:016x}" for k in range(4)]
    for age, key in zip((400, 300, 200), keys, strict=False):
        cache.keep(basis(key))
        os.utime(tmp_path / f"basis_{key}.npz", (1e9 - age, 1e9 - age))
    own = tmp_path / "basis_of_mine.npz"
    own.write_bytes(b"x" * 10_000)
    assert cache.find(keys[0]) is not None  # used just now
    monkeypatch.setattr(cached, "LIMIT", 2.5 * cache.size / 3)
    cache.keep(basis(keys[3]))
    assert [p.stem[-16:] for p in cache.files] == [keys[0], keys[2], keys[3]] and own.exists()


def test_a_cache_that_cannot_be_written_changes_no_result(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv(cached.VARIABLE, str(tmp_path / "file"))
    with using(None) as notes:
        found = kept_basis(None, KEY, lambda: basis(""))
    assert found.key == KEY and len(notes) == 1
    with pytest.raises(InputError, match="cannot be written"), using(tmp_path / "file" / "inside"):
        pass


def test_the_folder_is_that_named_last(tmp_path, monkeypatch):
    assert basis_cache().folder.parent != tmp_path
    monkeypatch.setenv(cached.VARIABLE, str(tmp_path / "a"))
    assert basis_cache().folder == tmp_path / "a"
    with using(tmp_path / "b"):
        assert basis_cache().folder == tmp_path / "b"
    assert basis_cache().folder == tmp_path / "a"
    monkeypatch.delenv(cached.VARIABLE)
    monkeypatch.setattr(cached.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "c"))
    assert basis_cache().folder == tmp_path / "c" / "calib"
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert basis_cache().folder == tmp_path / "home" / ".cache" / "calib"


def test_another_code_or_library_asks_for_another_key(mast, tmp_path, monkeypatch):
    model = LoadedStudy.load(mast.write_study(tmp_path / "mast")).model
    before = basis_key(model, 1)
    assert basis_key(model, 1) == before != basis_key(model, 2)
    for change in ((cached.np, "__version__", "0"), (cached, "metis", lambda: "0")):
        with monkeypatch.context() as changed:
            changed.setattr(*change)
            cached._code.cache_clear()
            assert basis_key(model, 1) != before
    cached._code.cache_clear()


@pytest.mark.slow
def test_the_command_keeps_bases_where_it_is_asked_to(mast, tmp_path, trainings, capsys, undrawn):
    study, there = mast.write_study(tmp_path / "mast"), tmp_path / "bases"
    asked = ["explain", str(study), "--cache", str(there), "--results"]
    assert cli.execute([*asked, str(tmp_path / "one"), "-v"]) == 0
    assert f"1, {BasisCache(there).size / 1e6:.1f} MB: {there}" in " ".join(capsys.readouterr().out.split())
    assert cli.execute([*asked, str(tmp_path / "two")]) == 0
    assert trainings == ["effect_basis"]  # about the fit, which least squares have made
    one, two = ((tmp_path / name / "mast/effects.csv").read_bytes() for name in ("one", "two"))
    assert one == two
