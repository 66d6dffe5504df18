"""The line of a file that an error names: what is shown of it, and where the mark stands."""

import pickle
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import EvaluationError, InputError, ToleranceError, raised_anew
from calib.errors.place import TAB, Place, excerpt


def columns(text: str) -> int:
    """Columns on a terminal, by the standard's tables."""
    return sum(
        0 if unicodedata.category(c) in ("Mn", "Me") else 2 if unicodedata.east_asian_width(c) in "WF" else 1
        for c in text
    )


def under_the_mark(shown: tuple[str, ...]) -> str:
    """The characters above the marks."""
    line, mark = shown[1], shown[2]
    begin, end = mark.index("^"), mark.rindex("^") + 1
    out, at = "", 0
    for c in line:
        if begin <= at < end:
            out += c
        at += columns(c)
    return out


def test_without_a_line_nothing_is_shown():
    assert excerpt(Place("a.csv")) == ()


def test_without_text_only_the_place_is_shown():
    assert excerpt(Place("a.csv", 7)) == ("  a.csv, line 7",)


def test_without_a_column_nothing_is_marked():
    assert excerpt(Place("a.csv", 7, "x,y")) == ("  a.csv, line 7", "  7 | x,y")


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("value = 3", "3"),
        ("\tvalue\t= 3", "3"),
        ("größe = 3", "3"),
        ("橋梁 = 3", "3"),
        ("e\u0301e\u0301 = 3", "3"),
        ("bell\x07 = 3", "3"),
        ("橋梁 = 3", "橋"),
        ("value = 3", "value"),
    ],
)
def test_the_mark_stands_under_what_is_wrong(text, wrong):
    shown = excerpt(Place("f", 12, text, text.index(wrong) + 1, len(wrong)))
    assert under_the_mark(shown) == wrong
    assert shown[1].startswith("  12 | ") and shown[2].startswith("     | ")
    assert "\t" not in shown[1] and "\x07" not in shown[1]


def test_tabs_end_at_every_fourth_column():
    assert excerpt(Place("f", 1, "ab\tc"))[1] == "  1 | ab" + " " * (TAB - 2) + "c"


def test_a_mark_behind_the_line():
    assert excerpt(Place("f", 1, "a,b", 4))[2] == "    |    ^"


@given(
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\r\n"), max_size=150),
    st.integers(1, 170),
    st.integers(1, 170),
    st.integers(40, 120),
)
def test_whatever_the_line_it_is_cut_around_the_mark(text, column, length, widest):
    shown = excerpt(Place("f", 12, text, column, length), widest)
    if not text.strip():
        assert len(shown) == 1
        return
    assert len(shown) == 3 and all("\n" not in line for line in shown)
    assert columns(shown[1]) <= widest and len(shown[2]) <= widest + 1
    if column <= len(text.rstrip()) and columns(text[column - 1]) and text[column - 1].isprintable():
        assert under_the_mark(shown).startswith(text[column - 1])


@pytest.mark.parametrize("letter", ["x", "橋"])
@pytest.mark.parametrize("before", [0, 40, 150, 400])
@pytest.mark.parametrize("behind", [0, 40, 400])
def test_a_long_line_is_cut_where_nothing_is_wrong(letter, before, behind):
    text = letter * before + "[5.0, 0.3]" + letter * behind
    shown = excerpt(Place("f", 12, text, before + 1, 10), 60)
    assert under_the_mark(shown) == "[5.0, 0.3]"
    assert columns(shown[1]) <= 60
    whole = shown[1].removeprefix("  12 | ")
    assert whole == text or "..." in (whole[:3], whole[-3:])


def test_files_below_the_current_directory_are_named_from_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert excerpt(Place(str(tmp_path / "a" / "b.py"), 1))[0] == "  a/b.py, line 1"
    assert excerpt(Place(str(tmp_path.parent / "b.py"), 1))[0] == f"  {tmp_path.parent / 'b.py'}, line 1"


# -- errors that carry a place -----------------------------------------------------------------------------------------

HERE = Place("data/a.csv", 3, "x,y", 3, 1, "column freq")


def test_an_error_with_a_place_tells_it_in_words_as_data_and_in_a_note():
    fault = InputError("it is wrong", place=HERE, remedy="mend it")
    assert (fault.place, fault.at) == ("data/a.csv, line 3, column freq", HERE)
    assert str(fault) == "data/a.csv, line 3, column freq: it is wrong; mend it."
    assert fault.sentence == "a.csv, column freq: it is wrong; mend it."
    assert fault.__notes__ == ["\n".join(excerpt(HERE))]


def test_another_line_may_be_shown_than_the_place_in_the_sentence():
    fault = InputError("it is wrong", place="effect bend", at=HERE)
    assert (fault.place, fault.at, fault.sentence) == ("effect bend", HERE, "effect bend: it is wrong.")


@pytest.mark.parametrize("kind", [InputError, ToleranceError])
@pytest.mark.parametrize("place", [None, "workers", Place("a.csv"), HERE])
@pytest.mark.parametrize("at", [None, Place("model.py", 4)])
def test_errors_survive_the_way_between_processes(kind, place, at):
    fault = kind("it is wrong", place=place, remedy="mend it", at=at)
    copy = pickle.loads(pickle.dumps(fault))
    assert type(copy) is kind and (str(copy), copy.sentence, copy.at) == (str(fault), fault.sentence, fault.at)
    assert getattr(copy, "__notes__", None) == getattr(fault, "__notes__", None)


def test_a_line_is_added_once():
    fault = InputError("a", place="effect bend")
    assert fault.with_line(None) is fault
    shown = fault.with_line(HERE)
    assert (shown.at, shown.place, str(shown)) == (HERE, "effect bend", str(fault))
    assert shown.with_line(Place("other.py", 1)) is shown


def test_failures_keep_their_place_between_processes_and_when_reworded():
    fault = EvaluationError("it failed", at=HERE)
    fault.add_note("a traceback")
    assert pickle.loads(pickle.dumps(fault)).at == HERE
    for copy in (raised_anew(fault), raised_anew(fault, "in other words")):
        assert copy.at == HERE and copy.__notes__ == ["a traceback"]
