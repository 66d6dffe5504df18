"""An extended study among results: found again, replaced or kept aside, never half-written."""

import shutil
from pathlib import Path

import pytest

from calib.analyses.extend import EARLIER, extend_among, found_among, write_extension
from calib.results.written import LOG
from calib.study.study import LoadedStudy


def test_a_study_among_results_can_be_moved(rig, edited):
    Path("shared").mkdir()
    shutil.move("rig/measured.csv", "shared/measured.csv")
    edited(rig, '"measured.csv"', '"../shared/measured.csv"')
    Path("results/rig").mkdir(parents=True)
    made = extend_among(LoadedStudy.load(rig), ["top_cables"], Path("results/rig"))
    assert made.file == Path("results/rig/rig_extended/study.toml")
    assert found_among(LoadedStudy.load(rig), Path("results/rig")) == made.file
    Path("far/away").mkdir(parents=True)
    shutil.move("results/rig/rig_extended", "far/away/mine")
    new, old = LoadedStudy.load(Path("far/away/mine")), LoadedStudy.load(rig)
    assert new.measured.fingerprint == old.measured.fingerprint
    assert [str(path) for path in new.settings.base] == ["../../../rig", str(rig.resolve())]
    assert found_among(old, Path("results/rig")) is None


def test_least_squares_of_a_study_among_results_start_from_known_values(rig):
    Path("results").mkdir()
    study = LoadedStudy.load(rig)
    space = study.search_space
    known = {space.free_names[0]: space.lower[0], "top_cables": 0.1}
    made = extend_among(study, ["top_cables"], Path("results"), known)
    assert LoadedStudy.load(made.file).settings.calibration.begin_at == known


@pytest.mark.parametrize(
    ("keys", "method"),
    [('method = "genetic"', "gauss-newton"), ('method = "genetic"\nrefine = false', "genetic"), ("", "gauss-newton")],
)
def test_a_search_is_not_repeated_from_scratch(rig, keys, method):
    text = Path("rig/study.toml").read_text().partition("[calibration]")[0]
    Path("rig/study.toml").write_text(f"{text}\n[calibration]\n{keys}\n")
    study = LoadedStudy.load(rig)
    name = study.search_space.free_names[0]
    for folder, known in (("known", {name: study.search_space.values[name], "top_cables": 0.1}), ("new", {})):
        made = LoadedStudy.load(write_extension(study, ["top_cables"], Path(folder), known).file).settings.calibration
        assert made.method == (method if known else study.settings.calibration.method)
        assert made.begin_at == known and made.refine == study.settings.calibration.refine


@pytest.mark.medium
def test_an_identical_study_among_results_stays_and_a_changed_one_is_kept_aside(rig, tree):
    Path("results").mkdir()
    study, written = LoadedStudy.load(rig), Path("results/rig_extended")

    def there():
        return {p.name for p in Path("results").iterdir() if p.is_dir()}

    extend_among(study, ["top_cables"], Path("results"))
    Path(written, "results").mkdir()
    Path(written, "results/answer.csv").write_text("results of the user")
    first = tree(written)
    assert extend_among(study, ["top_cables"], Path("results")).aside is None
    assert tree(written) == first and there() == {"rig_extended"}
    (written / "notes.txt").write_text("changed by the user")
    changed = tree(written)
    aside = Path(f"results/rig_extended{EARLIER}")
    assert extend_among(study, ["low_cables"], Path("results")).aside == aside
    assert LoadedStudy.load(written).settings.with_effects == ("low_cables",) and "notes.txt" not in tree(written)
    assert tree(f"results/rig_extended{EARLIER}") == changed and there() == {"rig_extended", f"rig_extended{EARLIER}"}
    assert extend_among(study, ["top_cables"], Path("results")).aside is None
    assert LoadedStudy.load(written).settings.with_effects == ("top_cables",)
    assert tree(f"results/rig_extended{EARLIER}") == changed and there() == {"rig_extended", f"rig_extended{EARLIER}"}
    (written / "model_notes.txt").write_text("changed again")
    again = tree(written)
    extend_among(study, ["low_cables"], Path("results"))
    assert tree(f"results/rig_extended{EARLIER}") == changed and tree(f"results/rig_extended{EARLIER}2") == again


@pytest.mark.parametrize("place", ["sums/results/sums", "sums/answers/sums"])
def test_results_within_the_study_are_not_part_of_the_new_one(sums, place, tree):
    Path(place).mkdir(parents=True)
    Path(place, "summary.json").write_text("{}")
    made = extend_among(LoadedStudy.load(sums), ["bend"], Path(place))
    assert set(tree(made.file.parent)) == {"study.toml"}
    assert extend_among(LoadedStudy.load(sums), ["bend"], Path(place)).file == made.file
    assert {p.name for p in Path(place).iterdir()} == {"summary.json", "sums_extended", LOG}


@pytest.mark.parametrize("call", [1, 2])
def test_an_interrupt_while_replacing_leaves_a_whole_study_or_none(sums, monkeypatch, call, edited):
    Path("results").mkdir()
    extend_among(LoadedStudy.load(sums), ["bend"], Path("results"))
    edited(sums, "'sums'", "'other'")
    rename, calls = Path.rename, []

    def stopped(self, target):
        calls.append(target)
        if len(calls) == call:
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "rename", stopped)
        extend_among(LoadedStudy.load(sums), ["bend"], Path("results"))
    for folder in filter(Path.is_dir, Path("results").iterdir()):
        assert not folder.name.startswith(".") and LoadedStudy.load(folder).settings.with_effects == ("bend",)
    extend_among(LoadedStudy.load(sums), ["bend"], Path("results"))
    assert LoadedStudy.load(Path("results/sums_extended")).settings.title == "other + bend"
