import shutil
import tomllib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.study.schema import schema
from calib.study.study import LoadedStudy
from calib.study.study_text import read_settings


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz") / "mast"
    write_example(folder)
    return folder


def damaged(data, text: str) -> str:
    kind = data.draw(st.sampled_from(["cut", "drop", "swap", "insert", "number"]))
    lines = text.splitlines()
    code = [k for k, line in enumerate(lines) if line.split("#")[0].strip()]
    if kind == "cut":
        return text[: data.draw(st.integers(0, len(text)))]
    where = data.draw(st.sampled_from(code))
    if kind == "drop":
        return "\n".join(lines[:where] + lines[where + 1 :])
    if kind == "swap":
        other = data.draw(st.sampled_from(code))
        lines[where], lines[other] = lines[other], lines[where]
        return "\n".join(lines)
    if kind == "insert":
        at = data.draw(st.integers(0, len(text)))
        return text[:at] + data.draw(st.text(max_size=5)) + text[at:]
    digits = [k for k, c in enumerate(lines[where]) if c.isdigit()]
    if digits:
        at = data.draw(st.sampled_from(digits))
        new = data.draw(st.sampled_from(["nan", "-1", "1e400", "true", '"a"', "[]", "{}", "0"]))
        lines[where] = lines[where][:at] + new + lines[where][at + 1 :]
    return "\n".join(lines)


@pytest.mark.slow
@settings(max_examples=30, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_study_is_read_or_refused_in_one_sentence(example, data):
    original = (example / "study.toml").read_text("utf-8")
    copy = example.parent / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(example, copy)
    (copy / "study.toml").write_text(damaged(data, original), "utf-8")
    try:
        LoadedStudy.load(copy)
    except InputError as fault:
        assert str(copy) in str(fault)


@pytest.mark.medium
@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.binary(max_size=400))
def test_random_bytes_are_refused(tmp_path_factory, content):
    file = tmp_path_factory.mktemp("bytes") / "study.toml"
    file.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_settings(file)
    assert str(file) in str(caught.value)


def test_the_schema_knows_every_key_of_every_shipped_study_and_no_other():
    told = schema()

    def unknown(given, node, where=""):
        node = told["$defs"][node["$ref"].rsplit("/", 1)[1]] if "$ref" in node else node
        for choice in node.get("anyOf", ()):
            if (isinstance(given, dict) and ("$ref" in choice or choice.get("type") == "object")) or (
                isinstance(given, list) and choice.get("type") == "array"
            ):
                return unknown(given, choice, where)
        if isinstance(given, list):
            items = node.get("items", {})
            return [k for one in given for k in unknown(one, items, where)]
        if not isinstance(given, dict) or "properties" not in node:
            known = node.get("additionalProperties")
            parts = given.items() if isinstance(given, dict) and isinstance(known, dict) else ()
            return [k for name, one in parts for k in unknown(one, known, f"{where}.{name}")]
        own = [f"{where}.{k}" for k in given if k not in node["properties"]]
        return own + [
            k for n, one in given.items() if n in node["properties"]
            for k in unknown(one, node["properties"][n], f"{where}.{n}")
        ]  # fmt: skip

    files = sorted((Path(__file__).parents[1] / "studies").glob("*/study.toml"))
    assert len(files) > 8
    for file in files:
        given = tomllib.loads(file.read_text("utf-8"))
        assert unknown(given, told) == [], file
        assert any(set(one["required"]) <= set(given) for one in told["anyOf"]), file
    wrong = {"title": "a", "pairing": {"windows": 1}, "constraints": [{"nam": "a"}], "parameters": {"k": {"upper": 1}}}
    assert unknown(wrong, told) == [".pairing.windows", ".constraints.nam", ".parameters.k.upper"]


def test_a_folder_instead_of_a_file_is_told(tmp_path):
    (tmp_path / "study.toml").mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        LoadedStudy.load(Path(tmp_path))
