"""The text of a study file and of its bases: read, merged and validated; every error names its line."""

from __future__ import annotations

import difflib
import os
import re
import shlex
import tomllib
from codecs import BOM_UTF8
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.errors.toml_places import Keys, Mark, keys_in_words, place_in
from calib.results.former_names import KEYS, MOVED
from calib.study.measurement_settings import LIBRARY, MODEL, NAME, RUNS
from calib.study.settings import StudySettings
from calib.study.solver_settings import EXECUTOR


def read_settings(file: Path) -> StudySettings:
    """Read and check a study file, with those it builds on; InputError names file, line, key and remedy."""
    layers = read_layers(file)
    try:
        return StudySettings.model_validate(_merged(layers))
    except ValidationError as fault:
        raise _explain(fault, layers) from None
    except RecursionError:
        raise InputError("it is nested too deeply", place=file) from None


@dataclass(frozen=True)
class Layer:
    """One file of a study, and its keys.

    Attributes
    ----------
    file : Path
    text : str
    data : dict
        Its keys; paths are converted to be relative to the folder of the study that builds on it.
    """

    file: Path
    text: str
    data: dict[str, Any]


def read_layers(file: Path) -> tuple[Layer, ...]:
    """A study's file, then the one it builds on, and so on; InputError where one cannot be read or builds on itself."""
    layers, folder = [_layer(file)], file.resolve().parent
    while (base := layers[-1].data.get("base")) is not None:
        last = layers[-1]
        bases = base if isinstance(base, list) else [base]
        if not bases or not all(isinstance(one, str) for one in bases):
            raise InputError(f"base = {base!r} is no path", place=place_of(layers[-1:], "base"))
        path = base_of(last.file, bases)
        if path is None:
            raise InputError(
                f"there is no study {' or '.join(map(repr, bases))} to build on", place=place_of(layers[-1:], "base"),
                remedy="base is a folder with a study.toml, relative to this study's",
            )  # fmt: skip
        if path.resolve() in [layer.file.resolve() for layer in layers]:
            raise InputError(
                "it builds on itself, by way of other studies or directly", place=place_of(layers[-1:], "base"),
                remedy="name another study as base",
            )  # fmt: skip
        layers.append(_layer(path))
    return tuple(replace(layer, data=_moved(layer.data, layer.file.resolve().parent, folder)) for layer in layers)


def base_of(file: Path, base: str | Sequence[str]) -> Path | None:
    """The file of the study that another one builds on, the first that exists; None without one."""
    for one in (base,) if isinstance(base, str) else base:
        path = file.resolve().parent / one
        path = path if path.suffix == ".toml" else path / "study.toml"
        if path.is_file():
            return path
    return None


def place_of(layers: Sequence[Layer], *keys: int | str, mark: Mark = "value") -> Place:
    """Place of a key or of its value, in the first file that has it.

    Otherwise that of the table or key above it in the first file that has one, or that file alone.
    """
    return find(layers, keys, mark)[0]


def find(layers: Sequence[Layer], keys: Keys, mark: Mark = "value") -> tuple[Place, bool]:
    """As `place_of`, and whether the key itself stands there."""
    above = None
    for layer in layers:
        place, exact = place_in(str(layer.file), layer.text, keys, mark)
        if place is not None and exact:
            return place, True
        above = above or place
    return above or Place(str(layers[0].file)), False


def _merged(layers: Sequence[Layer]) -> dict[str, Any]:
    """All keys, each from the first file that has it; tables are merged key by key."""
    out: dict[str, Any] = {}
    for layer in reversed(layers):
        own = layer.data if layer is layers[0] else {k: v for k, v in layer.data.items() if k != "base"}
        if "tests" in own:  # measurements are described in one way: that of the file above, held-out data included
            for key in _OF_ONE_TEST:
                out.pop(key, None)
        if "measurement" in own:
            out.pop("tests", None)
        out = _over(own, out)
    return out


def _over(upper: Mapping[str, Any], lower: Mapping[str, Any]) -> dict[str, Any]:
    both = {k for k in upper if isinstance(upper[k], dict) and isinstance(lower.get(k), dict)}
    return {**lower, **upper, **{k: _over(upper[k], lower[k]) for k in both}}


def _moved(data: dict[str, Any], own: Path, folder: Path) -> dict[str, Any]:
    """The same keys with every path relative to another folder."""
    if own == folder:
        return data

    def lead(path: Any) -> Any:
        if not isinstance(path, str) or Path(path).is_absolute():
            return path
        return Path(os.path.relpath(own / path, folder)).as_posix()

    def leads(paths: Any) -> Any:
        return [lead(path) for path in paths] if isinstance(paths, list) else lead(paths)

    def command(words: Any) -> Any:
        from calib.execution.process import is_beside  # few studies have a solver

        try:
            program, *more = shlex.split(words) if isinstance(words, str) else ("",)
        except ValueError:  # told where the model is made
            return words
        if not is_beside(program):
            return words
        path = lead(program)
        return shlex.join([path if "/" in path else f"./{path}", *more])

    def function(name: Any) -> Any:
        if str(name).endswith(RUNS):
            return lead(name)
        where, _, what = str(name).rpartition(":")
        return f"{lead(where)}:{what}" if where.endswith(".py") else name

    def table(section: Mapping[str, Any]) -> dict[str, Any]:
        out = dict(section)
        for key, value in section.items():
            if key in _PATHS:
                out[key] = leads(value)
            elif key == "start_population" and isinstance(value, str):
                out[key] = lead(value)
            elif key == "model" and isinstance(value, dict):
                out[key] = {**value, **{k: leads(value[k]) for k in _OF_SOLVER if k in value}}
                out[key] |= {k: command(value[k]) for k in ("command",) if k in value}
            elif key in _FUNCTIONS:
                out[key] = [function(v) for v in value] if isinstance(value, list) else function(value)
            elif key in _WITH_PATHS and isinstance(value, dict):
                out[key] = table(value)
            elif key == "tests" and isinstance(value, list):
                out[key] = [table(v) if isinstance(v, dict) else v for v in value]
        return out

    return table(data)


_OF_ONE_TEST = ("measurement", "held_out", "pairing")
"""Keys that describe the measurement of a study without ``[[tests]]``."""
_PATHS = ("files", "shapes", "sensors", "responses", "depends_on", "decks", "deck_files", "study")
_FUNCTIONS = ("model", "effects")
_WITH_PATHS = ("measurement", "adopted", "calibration")
_OF_SOLVER = ("template", "files")
"""Keys that hold paths, functions in files, tables with such keys, and lists of paths under ``[model]``."""


def _layer(file: Path) -> Layer:
    try:
        text = file.read_bytes().removeprefix(BOM_UTF8).decode("utf-8")  # some editors of Windows write one
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(
            "there is no such study file",
            place=file,
            remedy="name a folder that holds a study.toml, or make one with 'calib new'",
        ) from None
    except UnicodeDecodeError as fault:
        before = fault.object[: fault.start].decode("utf-8")
        lines = fault.object.decode("utf-8", errors="replace").split("\n")
        place = Place.in_lines(file, lines, before.count("\n") + 1, len(before) - before.rfind("\n"))
        words = f"it is not UTF-8 text (byte {fault.start})"
        raise InputError(words, place=place, remedy="save it as UTF-8") from None
    except OSError as fault:
        raise InputError(f"it cannot be read ({fault.strerror})", place=file) from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        place = _place_of_syntax(fault, file, text)
        raise InputError(f"it is not valid TOML: {fault}", place=place, remedy="mend that line") from None
    except RecursionError:
        raise InputError("it is nested too deeply", place=file) from None
    return Layer(file, text, data)


def _place_of_syntax(fault: tomllib.TOMLDecodeError, file: Path, text: str) -> Place:
    """The place that a syntax error states in its words."""
    lines = text.split("\n")
    if stated := re.search(r"\(at line (\d+), column (\d+)\)$", str(fault)):
        return Place.in_lines(file, lines, int(stated[1]), int(stated[2]))
    last = max((k for k, line in enumerate(lines, start=1) if line.strip()), default=1)
    return Place.in_lines(file, lines, last)


_EXPECTED: Mapping[str, tuple[str, str]] = {
    "int": ("an integer", "write a number such as 1"),
    "float": ("a number", "write one such as 12.5"),
    "bool": ("true or false", "write true or false, without quotes"),
    "string": ("text", "write it in quotes"),
    "tuple": ("a list", "write it in square brackets"),
    "model": ("a table", "write keys with values"),
    "dict": ("a table", "write names with values"),
}
"""What a value must be, by the first word of the kind of error that pydantic reports, and a remedy."""
_PATTERNS: Mapping[str, tuple[str, str]] = {
    MODEL: (
        "names no model",
        'write "file.py:function", "package.module:function" or a table of runs, "runs.csv"; a solver a table [model]',
    ),
    LIBRARY: ("names no function", 'write "file.py:function", "package.module:function" or "generic"'),
    NAME: ("is no name for files", "use letters, digits, - and _ only"),
    EXECUTOR: ("names nobody who evaluates", 'write "processes", "dask" or "dask://HOST:PORT"'),
}


def _explain(fault: ValidationError, layers: Sequence[Layer]) -> InputError:
    """The first error in one sentence, with its line; unknown keys come first: one may be the missing key misspelt."""
    first = min(fault.errors(), key=lambda error: error["type"] != "extra_forbidden")
    if first["type"] == "string_type" and isinstance(first.get("input"), list):  # a text or a list of them: in which
        inner = (e for e in fault.errors() if e["loc"][0] == first["loc"][0] and e is not first)
        first = next((e for e in inner if not isinstance(e.get("input"), list)), first)
    elif first["type"] == "string_type" and isinstance(first.get("input"), dict):  # a text or a table: in which
        first = next((e for e in fault.errors() if e["loc"][0] == first["loc"][0] and len(e["loc"]) > 2), first)
    kind, words = first["type"], first["msg"].removeprefix("Value error, ")
    below = getattr(first.get("ctx", {}).get("error"), "keys", ())
    keys = _written((*first["loc"], *below), _merged(layers), missing=kind == "missing")
    label = keys_in_words(keys) or "the file"
    place = place_of(layers, *keys, mark="key" if kind == "extra_forbidden" else "value")
    shown_value = repr(first.get("input"))
    shown_value = shown_value if len(shown_value) < 60 else shown_value[:57] + "..."
    if kind == "extra_forbidden":
        known = _known_keys(keys[:-1])
        if str(keys[-1]) in MOVED:
            return InputError(f"there is no key {label!r} any more", place=place, remedy=MOVED[str(keys[-1])])
        now = KEYS.get(str(keys[-1]))
        if now in known:
            return InputError(f"the key {label!r} is called {now!r} now", place=place, remedy=f"write {now}")
        if len(keys) > 1 and str(keys[-1]) in _known_keys(()):
            remedy = "put it above the first [table]: a line belongs to the table above it"
            return InputError(f"{keys[-1]!r} is no key of [{keys[0]}], but of the file", place=place, remedy=remedy)
        near = difflib.get_close_matches(str(keys[-1]), known, n=1, cutoff=0.5)
        return InputError(
            f"unknown key {label!r}" + (f" (did you mean {near[0]!r}?)" if near else ""),
            place=place,
            remedy=f"the keys known there are {', '.join(known)}" if known else None,
        )
    if kind == "missing":
        return InputError(f"{label!r} is missing", place=place, remedy="add it")
    if kind == "string_pattern_mismatch":
        problem, remedy = _PATTERNS[first["ctx"]["pattern"]]
        return InputError(f"{label} = {shown_value} {problem}", place=place, remedy=remedy)
    if kind == "value_error":
        return InputError(f"{label}: {words}", place=place)
    if (
        kind.partition("_")[2] in ("type", "parsing", "from_float")
        and (known_kind := kind.partition("_")[0]) in _EXPECTED
    ):
        expected, remedy = _EXPECTED[known_kind]
        beside = [e for e in fault.errors() if e["type"] == "literal_error" and e["loc"][:-1] == first["loc"][:-1]]
        expected = " or ".join([expected, *(e["ctx"]["expected"] for e in beside)])
        return InputError(f"{label} must be {expected}, not {shown_value}", place=place, remedy=remedy)
    return InputError(f"{label} = {shown_value} is not allowed: {words[:1].lower() + words[1:]}", place=place)


def _written(loc: Sequence[int | str], data: Any, missing: bool) -> Keys:
    """The keys of an error as the file has them, without pydantic's names of the alternatives of a type."""
    out: list[int | str] = []
    for key in loc:
        inside = key in data if isinstance(data, dict) else isinstance(data, list) and key in range(len(data))
        if inside:
            out.append(key)
            data = data[key]
    return (*out, loc[-1]) if missing else tuple(out)


def _known_keys(keys: tuple[int | str, ...]) -> list[str]:
    section: Any = StudySettings
    for key in keys:
        if isinstance(key, int) or not (isinstance(section, type) and issubclass(section, BaseModel)):
            continue
        field = section.model_fields.get(str(key))
        section = _section_of(field.annotation) if field is not None else section
    return list(section.model_fields) if isinstance(section, type) and issubclass(section, BaseModel) else []


def _section_of(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _section_of(part)
        if found is not None:
            return found
    return None
