"""Places of keys and values in TOML: what stands at them is what `tomllib` reads there."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.errors.toml_places import keys_in_words, place_in

TEXT = '''title = "t" # [no.header]
"quoted.key" = 'x]'
a.b.c = 1979-05-27 07:32:00
long = """
several "quoted" \\""" [x]
k = 3"""
literal = \'\'\'a'b\'\'\'
list = [ 1, # one
  [2, 3], {x = 1, y.z = [4]}, "]", ]
[t."d.e".f]
\tv = +inf
[[tests]]
name = "a"
[tests.set]
K = 1.5
[[tests.sub]]
q = 1
[[tests.sub]]
q = 2
[[tests]]
name = "b"
set = { K = 2 }
[[tests.sub]]
q = 3
[parameters.K]
value = 1
[parameters]
M = { limits = [1, 2] }
[empty]
'''
STUDIES = sorted((Path(__file__).parents[1] / "studies").glob("*/study.toml"))


def parts(value, path=()):
    """Every key and every entry of a list below a value, with its path."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in entries:
        yield (*path, key), one
        yield from parts(one, (*path, key))


def behind(text, place):
    """The text from a place to the end."""
    lines = text.split("\n")
    return "\n".join([lines[place.line - 1][place.column - 1 :], *lines[place.line :]])


def first_value(text):
    """The value with which a text begins."""
    for end in range(1, len(text) + 1):
        try:
            found = tomllib.loads(f"k = {text[:end]}")["k"]
        except tomllib.TOMLDecodeError:
            continue
        rest = text[end : end + 1]
        if rest in ("", ",", "]", "}", "\n", "\r", "#", "\t") or (
            rest == " " and not text[end:].lstrip()[:1].isdigit()
        ):
            return found
    raise AssertionError(text)


def check(text):
    data = tomllib.loads(text)
    for path, value in parts(data):
        place, exact = place_in("study.toml", text, path)
        assert exact and place.file == "study.toml", path
        there = behind(text, place)
        if isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
            # a header, a key that implies a table, or an inline value
            last = next(k for k in reversed(path) if isinstance(k, str))
            assert there.startswith(("[", "{")) or last in there.split("\n")[0].replace('"', ""), path
        else:
            found = first_value(there)
            assert found == value or repr(found) == repr(value), path


@pytest.mark.parametrize("text", [TEXT, TEXT.replace("\n", "\r\n"), *(f.read_text("utf-8") for f in STUDIES)])
def test_every_value_stands_at_its_place(text):
    check(text)


scalars = st.one_of(
    st.integers(-9, 9),
    st.booleans(),
    st.text("ab\"'\\#[]{}=,.\n\t é", max_size=6),
    st.floats(allow_nan=False, width=32),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab.' é", max_size=3), inner, max_size=3),
)


def written(value):
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in value)
        return f'"{escaped}"'
    if isinstance(value, list):
        return "[ " + ", # c ]\n ".join(map(written, value)) + "\n]" if value else "[]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{written(str(k))} = {written(v)}" for k, v in value.items()) + "}"
    return repr(value)


@pytest.mark.medium
@settings(max_examples=40, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(st.text("ab.' é", max_size=3), values, max_size=3), st.lists(values, max_size=3))
def test_any_value_is_found(top, rows):
    text = "".join(f"{written(k)} = {written(v)}\n" for k, v in top.items())
    text += "".join(f"[[rows]]\nvalue = {written(row)}\n" for row in rows)
    data = tomllib.loads(text)
    for path, value in parts(data):
        place, exact = place_in("f", text, path)
        assert exact
        if not isinstance(value, dict | list):
            assert first_value(behind(text, place)) == value


@pytest.mark.parametrize(
    ("keys", "line", "marked"),
    [
        (("title",), 1, '"t"'),
        (("parameters", "K"), 25, "[parameters.K]"),
        (("parameters", "K", "value"), 26, "1"),
        (("parameters", "M"), 28, "{ limits = [1, 2] }"),
        (("parameters", "M", "limits", 1), 28, "2"),
        (("tests", 1), 20, "[[tests]]"),
        (("tests", 0, "sub", 1, "q"), 19, "2"),
        (("tests", 1, "sub", 0, "q"), 24, "3"),
        (("tests", 1, "set", "K"), 22, "2"),
        (("a", "b"), 3, "a.b.c"),
        (("t", "d.e", "f", "v"), 11, "+inf"),
    ],
)
def test_marks(keys, line, marked):
    place, exact = place_in("f", TEXT, keys)
    assert exact and place.line == line
    assert place.text[place.column - 1 : place.column - 1 + place.length] == marked


@pytest.mark.parametrize(
    ("keys", "line"), [(("parameters", "M", "value"), 28), (("tests", 0, "held_out"), 12), (("nothing",), None)]
)
def test_a_key_that_is_not_there_has_the_place_of_its_table(keys, line):
    place, exact = place_in("f", TEXT, keys)
    assert not exact and (None if place is None else place.line) == line


def test_a_key_itself_can_be_marked():
    place, _ = place_in("f", TEXT, ("tests", 1, "set", "K"), "key")
    assert place.text[place.column - 1 :].startswith("K = 2")


def test_a_path_in_words():
    assert keys_in_words(("calibration", "cases", 1, "seed")) == "calibration.cases[1].seed"
