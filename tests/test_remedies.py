"""Keys of ``study.toml`` that remedies of errors name exist."""

import ast
import re
from inspect import signature
from pathlib import Path

import pytest
from pydantic import BaseModel

from calib import StructuralModel, compare_modes
from calib.study.runs import read_runs
from calib.study.settings import StudySettings

ROOT = Path(__file__).resolve().parent.parent
NAMED = (
    r"\b[a-z]{2,}(?:_[a-z0-9]+)+\b",  # two words joined are a key
    r"\b([A-Za-z_]+)\s*=(?!=)",  # what is set
    r"\bkeys? '([A-Za-z_]+)'",
    r"\bin '([A-Za-z_]+)'",
    r"\[(\w+)[.\]]",  # a section
)


def keys(section=StudySettings):
    """Every key of a section and of those below it."""
    found = set()
    for name, field in section.model_fields.items():
        found.add(name)
        below = [field.annotation]
        while below:
            kind = below.pop()
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= keys(kind)
            below += getattr(kind, "__args__", ())
    return found


def remedies(folder):
    """File and constant text of every remedy."""
    for file in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.keyword) and node.arg == "remedy":
                parts = (c.value for c in ast.walk(node.value) if isinstance(c, ast.Constant))
                yield file, " ".join(part for part in parts if isinstance(part, str))


def arguments(folder):
    """Names of the arguments of every function: options of the models."""
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef):
                yield from (a.arg for a in (*node.args.args, *node.args.kwonlyargs))


def named(text):
    return {name for pattern in NAMED for name in re.findall(pattern, re.sub(r"\bstudies/\w+", "", text))}


def test_what_names_a_key_is_seen():
    assert named("leave it out with held_out_sensors") == {"held_out_sensors"}
    assert named("set use = false under [reduction], or name it in 'selection'") == {"use", "reduction", "selection"}


@pytest.mark.parametrize("folder", ["calib", "models"])
def test_remedies_name_keys_that_exist(folder):
    options = [
        name for f in (StructuralModel.from_matrices, read_runs, compare_modes) for name in signature(f).parameters
    ]
    own = arguments("models") if folder == "models" else options
    known = keys() | set(own)
    told = list(remedies(folder))
    assert len(told) > 20 and {"model_options", "prior_sd", "mode_count", "freq_window", "parameters"} <= known
    wrong = [(str(file.relative_to(ROOT)), text) for file, text in told if not named(text) <= known]
    assert not wrong
