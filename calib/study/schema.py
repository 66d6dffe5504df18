"""JSON schema of ``study.toml``, with the text below each key in the classes of its sections."""

from __future__ import annotations

import ast
import inspect
import itertools
from collections.abc import Iterator
from typing import Any

from calib.study.measurement_settings import Section
from calib.study.settings import StudySettings


def schema() -> dict[str, Any]:
    """JSON schema of ``study.toml``, with which editors complete and check its keys."""
    keys = StudySettings.model_json_schema()
    sections = {StudySettings.__name__: keys, **keys["$defs"]}
    for section in _sections(Section):
        for name, text in _texts_below(section):
            for known in _sections(section):  # inherited keys have the text of the class that defines them
                if (key := sections.get(known.__name__, {}).get("properties", {}).get(name)) is not None:
                    key["description"] = text
    needed = keys.pop("required")
    either = [{"required": needed}, {"required": ["base"]}]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **keys, "anyOf": either}


def _sections(section: type[Section]) -> Iterator[type[Section]]:
    """A section's class, and every class derived from it."""
    yield section
    for derived in section.__subclasses__():
        yield from _sections(derived)


def _texts_below(section: type[Section]) -> Iterator[tuple[str, str]]:
    """Keys that a class defines itself, each with the text below it."""
    (body,) = (node.body for node in ast.parse(inspect.getsource(section)).body if isinstance(node, ast.ClassDef))
    for key, below in itertools.pairwise(body):
        match key, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, inspect.cleandoc(text)
