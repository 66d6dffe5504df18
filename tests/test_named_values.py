import json

import pytest

from calib.errors.errors import InputError
from calib.results.json_file import ANY, read_json

KINDS = {"name": str, "size": float, "sure": bool, "words": [str], "cases": {ANY: {"misfit": float}}}


@pytest.fixture
def read(tmp_path):
    def of(text, required=()):
        path = tmp_path / "values.json"
        path.write_text(text)
        return read_json(path, KINDS, required)

    return of


def test_values_of_their_kinds_are_read_and_others_left_alone(read):
    told = {"name": "a", "size": 2, "sure": None, "words": ["b"], "cases": {"A1": {"misfit": None, "x": []}}, "y": [{}]}
    assert read(json.dumps(told), ["name"]) == told


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", "cannot be read"),
        ("{", "cannot be read"),
        ("[1]", "no named values"),
        ("{}", "'name' is missing"),
        ('{"name": 1}', "'name' is '1'"),
        ('{"name": "a", "size": "2"}', "'size'"),
        ('{"name": "a", "size": true}', "'size'"),
        ('{"name": "a", "sure": 1}', "'sure'"),
        ('{"name": "a", "words": null}', "'words'"),
        ('{"name": "a", "words": ["b", 2]}', "words[1]"),
        ('{"name": "a", "cases": []}', "'cases'"),
        ('{"name": "a", "cases": {"A1": {"misfit": [1]}}}', "cases.A1.misfit"),
        ("[" * 100_000, "cannot be read"),
    ],
)
def test_anything_else_is_refused_by_its_name(read, text, where):
    with pytest.raises(InputError) as caught:
        read(text, ["name"])
    assert where in str(caught.value) and "values.json" in str(caught.value)
