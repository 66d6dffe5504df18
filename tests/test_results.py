"""The results folder: failures are reported in one sentence."""

import hashlib

import pytest

from calib.errors.errors import InputError
from calib.results.results import OWNER, Results
from calib.results.written import KEPT, LOG, is_own, noting_kept


def test_what_cannot_be_deleted_is_told(tmp_path):
    results = Results.at(tmp_path, "study")
    (results.path / "old.json").write_text("{}")
    results.remove("old.json", "nothing.json")
    assert not results.has("old.json")
    (results.path / "old.json").mkdir()
    with pytest.raises(InputError, match=r"old\.json.*cannot be deleted"):
        results.remove("old.json")


def test_only_what_was_written_here_is_replaced_or_deleted(tmp_path):
    results = Results.at(tmp_path, "study")
    with noting_kept() as none:
        results.write_json("answer", {"a": 1})
        results.write_json("answer", {"a": 2})
    assert not none
    with noting_kept() as kept:
        for content in ("{}", "[]"):
            (results.path / "answer.json").write_text(content)
            results.write_json("answer", {"a": 1})
        (results.path / "other.json").write_text("other")
        results.remove("answer.json", "other.json")
    assert not results.has("answer.json") and not results.has("other.json")
    found = {path.name: path.read_text() for path in kept}
    assert found == {"answer_kept.json": "{}", "answer_kept2.json": "[]", "other_kept.json": "other"}
    assert set(kept) == set(results.path.glob(f"*{KEPT}*"))
    (results.path / "answer.json").write_text("later")
    results.remove("answer.json")
    assert len(kept) == 3


def test_a_log_with_a_torn_line_loses_nothing_more(tmp_path):
    results = Results.at(tmp_path, "study")
    results.write_json("answer", {"a": 1})
    with (results.path / LOG).open("ab") as log:
        log.write(b"0123456789abc\xff")
    results.write_json("second", {"a": 2})
    assert is_own(results.path / "answer.json") and is_own(results.path / "second.json")


def test_a_folder_without_a_log_is_not_taken(tmp_path):
    Results.at(tmp_path, "study", "quick").write_json("answer", {})
    assert Results.at(tmp_path, "study", "quick").has("answer.json")
    for file in (tmp_path / "study/quick").iterdir():
        file.unlink()
    (tmp_path / "study/quick/mine.csv").write_text("mine")
    with pytest.raises(InputError, match=r"mine\.csv"):
        Results.at(tmp_path, "study", "quick")
    assert {p.name for p in (tmp_path / "study/quick").iterdir()} == {"mine.csv"}


def test_whose_results_they_are(tmp_path):
    first, second = tmp_path / "a/mast/study.toml", tmp_path / "b/mast/study.toml"
    results = Results.at(tmp_path / "results", "mast")
    assert results.belongs_to(first) and results.belongs_to(second) and not list(results.path.iterdir())
    Results(results.path, (results.path, first)).write_json("answer", {})
    assert results.belongs_to(first) and not results.belongs_to(second)
    with pytest.raises(InputError, match=OWNER):
        results.check_owner(second)
    with pytest.raises(InputError, match="within the results"):
        Results(results.path / "inner").check_owner(second)
    (tmp_path / "away").mkdir()
    (tmp_path / "results").rename(tmp_path / "away/results")
    moved = Results(tmp_path / "away/results/mast")
    assert moved.belongs_to(tmp_path / "away/a/mast/study.toml") and moved.belongs_to(first)
    assert not moved.belongs_to(tmp_path / "away/mast/study.toml")
    for damaged in ("{", '{"study": "x"}', "[]"):
        (moved.path / OWNER).write_text(damaged)
        with pytest.raises(InputError, match=OWNER):
            moved.check_owner(first)


def test_a_file_written_again_unchanged_stands_in_the_log_once(tmp_path):
    for _ in range(3):
        Results(tmp_path).write_json("same", {"a": 1})
    (line,) = (tmp_path / LOG).read_text("utf-8").splitlines()
    assert line == f"{hashlib.sha256((tmp_path / 'same.json').read_bytes()).hexdigest()}  same.json"
