"""Parts of pages that are made from the code when the documents are built.

A line ``<!-- made: NAME ARGUMENTS -->`` in a page is replaced by what the function of that name in `PARTS` returns.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from typer.main import get_command

import calib
from calib.analyses.provenance.state import every_rule
from calib.command.cli import app as command
from calib.modal_analysis import rules as identification
from calib.study.schema import schema

DOCS = Path(__file__).resolve().parents[1]
MARK = re.compile(r"^<!-- made: (.+?) -->$", re.MULTILINE)


def replaced(text: str) -> str:
    """A page with every made part in its place."""

    def part(found: re.Match[str]) -> str:
        name, *arguments = found.group(1).split()
        return PARTS[name](*arguments)

    return MARK.sub(part, text)


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    lines = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in (header, *rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


# -- keys of study.toml ------------------------------------------------------------------------------------------------


def keys() -> str:
    """Every key of ``study.toml``: type, default and description, from the JSON schema."""
    whole = schema()
    parts = [f"## At the top of the file\n\n{_key_table(whole, whole, {})}"]
    for name, node in whole["properties"].items():
        section, kind = _section(node, whole)
        if section is not None:
            heading = {"one": f"[{name}]", "each": f"[[{name}]]", "named": f"[{name}.NAME]"}[kind]
            own = section["properties"]
            # The keys of a test that are those of [measurement] are not told twice.
            known = whole["$defs"]["MeasurementSettings"]["properties"] if name == "tests" else {}
            words = f"{_sentence(section['description'])}\n\n"
            parts.append(f"## `{heading}`\n\n{words}{_key_table(section, whole, known)}")
            for key, below in own.items():
                inner, listed = _section(below, whole)
                at_the_top, _ = _section(whole["properties"].get(key, {}), whole)
                if inner is not None and inner is not at_the_top:
                    inner_heading = {"one": f"[{name}.{key}]", "each": f"[[{name}.{key}]]"}.get(
                        listed, f"[{name}.{key}.NAME]"
                    )
                    words = f"{_sentence(inner['description'])}\n\n"
                    parts.append(f"## `{inner_heading}`\n\n{words}{_key_table(inner, whole, {})}")
    return "\n".join(parts)


def _sentence(description: str) -> str:
    """The first sentence of a section's description, without the name that its heading tells."""
    words = description.split("\n\n")[0].replace("\n", " ").split(": ", 1)[-1]
    return _code(words[:1].upper() + words[1:])


def _code(words: str) -> str:
    return words.replace("``", "`")


def _key_table(section: dict[str, Any], whole: dict[str, Any], known: Iterable[str]) -> str:
    rows = []
    for key, node in section["properties"].items():
        if key in known:
            continue
        needed = key in section.get("required", ()) or (section is whole and key in ("title", "model"))
        default = "required" if needed else _default(node.get("default"))
        rows.append([f"`{key}`", _kind(node, whole), default, _code(node["description"])])
    return table(("key", "type", "default", "meaning"), rows)


def _default(value: Any) -> str:
    if value is None or value in ({}, [], ""):
        return "-"
    return "see below" if isinstance(value, dict) else f"`{json.dumps(value)}`"


def _section(node: dict[str, Any], whole: dict[str, Any]) -> tuple[dict[str, Any] | None, str]:
    """The section behind a key, if it is one: once, in a list, or by name."""
    for choice in node.get("anyOf", [node]):
        for at, kind in ((choice, "one"), (choice.get("items"), "each"), (choice.get("additionalProperties"), "named")):
            if isinstance(at, dict) and "$ref" in at:
                return whole["$defs"][at["$ref"].rsplit("/", 1)[1]], kind
    return None, ""


def _kind(node: dict[str, Any], whole: dict[str, Any]) -> str:
    """Type of a key in words."""
    section, kind = _section(node, whole)
    if section is not None:
        return {"one": "table", "each": "list of tables", "named": "table of tables"}[kind]
    kinds = [_kind(choice, whole) for choice in node.get("anyOf", ()) if choice.get("type") != "null"]
    if kinds:
        return " or ".join(dict.fromkeys(kinds))
    if "enum" in node or "const" in node:
        return ", ".join(f'`"{value}"`' for value in node.get("enum", [node.get("const")]))
    if node.get("type") == "array":
        if "prefixItems" in node:
            return f"list of {len(node['prefixItems'])} numbers"
        return f"list of {_kind(node['items'], whole)}s"
    names = {"string": "text", "integer": "integer", "number": "number", "boolean": "true or false", "object": "table"}
    bounds = [
        f"{sign} {node[bound]:,}" if isinstance(node[bound], int) else f"{sign} {node[bound]:g}"
        for bound, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if bound in node
    ]
    return " ".join([names[node["type"]], ", ".join(bounds)]).strip()


# -- commands ----------------------------------------------------------------------------------------------------------


def commands() -> str:
    """Every command with its arguments and options, as ``calib COMMAND --help`` tells them."""
    whole: Any = get_command(command)
    parts = [whole.help + "\n", table(("option", "meaning"), _options(whole))]
    for name, one in whole.commands.items():
        places = [str(p.metavar or p.name).upper() for p in one.params if p.param_type_name == "argument"]
        usage = " ".join(["calib", name, *places])
        parts.append(f"## `calib {name}`\n\n{one.help}\n\n```text\n{usage} [OPTIONS]\n```\n")
        rows = list(_options(one))
        if rows:
            parts.append(table(("argument or option", "meaning"), rows))
    return "\n".join(parts)


def _options(one: Any) -> Iterator[list[str]]:
    for param in one.params:
        argument = param.param_type_name == "argument"
        if param.name in ("install_completion", "show_completion"):
            continue
        name = str(param.metavar or param.name).upper() if argument else ", ".join(param.opts)
        words = (param.help or "").replace("<", "\\<")
        kind = param.type_descriptor.annotation
        if isinstance(kind, type) and issubclass(kind, Enum):
            words += " Choices: " + ", ".join(f"`{choice.value}`" for choice in kind) + "."
        if not argument and isinstance(param.default, str | Path) and str(param.default):
            words += f" Default: `{getattr(param.default, 'value', param.default)}`."
        yield [f"`{name}`", words]


# -- tables of a results folder ----------------------------------------------------------------------------------------


def results() -> str:
    """Every table of a results folder with every column, from ``tables.toml``."""
    registry = tomllib.loads((DOCS / "tables.toml").read_text("utf-8"))
    parts = []
    for group in registry["group"]:
        parts.append(f"## {group['title']}\n")
        for one in group["table"]:
            parts.append(f"### `{one['file']}`\n\n{one['shows']}\n")
            columns = {**{name: registry["common"][name] for name in one.get("common", ())}, **one.get("columns", {})}
            parts.append(table(("column", "meaning"), ([f"`{name}`", words] for name, words in columns.items())))
    return "\n".join(parts)


# -- rules -------------------------------------------------------------------------------------------------------------


def rules() -> str:
    """Every constant of the rules that ``record.json`` holds: its value and its meaning, by the object it stands in."""
    parts = []
    for name, one in {**every_rule(), "calib modes": identification.RULES}.items():
        words = inspect.getdoc(type(one)) or ""
        meaning, first = _attributes(words), re.split(r"[;.]", words.split("\n")[0])[0]
        parts.append(f"## `{name}`\n\n{first} (`{type(one).__module__}.{type(one).__name__}`).\n")
        values = ((field.name, getattr(one, field.name)) for field in fields(one))
        parts.append(table(("rule", "value", "meaning"), ([f"`{n}`", _value(v), meaning[n]] for n, v in values)))
    return "\n".join(parts)


def _attributes(docstring: str) -> dict[str, str]:
    """Descriptions of the attributes of a class, from the section of its numpy-style docstring."""
    section = docstring.partition("Attributes\n----------\n")[2]
    out = {}
    for found in re.finditer(r"^(\S[^:\n]*) : .+\n((?:    .+(?:\n|$))+)", section, re.MULTILINE):
        for name in found.group(1).split(", "):
            out[name] = _code(" ".join(line.strip() for line in found.group(2).splitlines()))
    return out


def _value(value: Any) -> str:
    return ", ".join(f"{one:.7g}" for one in (value if isinstance(value, tuple) else (value,)))


# -- error rates -------------------------------------------------------------------------------------------------------


def _rates_table() -> Any:
    """The module of the benchmarks that reads counts."""
    bench = str(DOCS.parent / "tests/benchmarks")
    sys.path.insert(0, bench)
    try:
        return importlib.import_module("rates_table")
    finally:
        sys.path.remove(bench)


def methods(subject: str) -> str:
    """Counts of several methods on the same blind runs, with one-sided 95 % bounds."""
    found, rows, made = _rates_table(), {}, {}
    for method, rate, code, date in found.read_methods(DOCS / f"rates_{subject}_methods.csv"):
        cell = f"{rate.count} of {rate.n} ({'≥' if rate.at_least else '≤'} {100 * found.bound_of(rate):.0f} %)"
        made[f"{date}, code `{'`, `'.join(code.split())}`"] = None
        rows.setdefault(method, {})[f"{rate.hidden}: {rate.verdict}"] = cell
    header = list(dict.fromkeys(title for own in rows.values() for title in own))
    return table(
        ("method", *header), ([method, *(own.get(title, "") for title in header)] for method, own in rows.items())
    )


def rates(subject: str) -> str:
    """Counts of blind runs with their one-sided 95 % bounds (Clopper and Pearson 1934)."""
    found = _rates_table()
    rows, made = [], {}
    for rate, code, date in found.read(DOCS / f"rates_{subject}.csv"):
        sign = "≥" if rate.at_least else "≤"
        share = f"{100 * rate.count / rate.n:.1f} %"
        rows.append([rate.hidden, rate.verdict, f"{rate.count} of {rate.n}", share,
                     f"{sign} {100 * found.bound_of(rate):.1f} %", f"{sign} {100 * rate.required:.0f} %"])  # fmt: skip
        made[f"{date}, code `{'`, `'.join(code.split())}`"] = None
    header = ("hidden", "the answer", "runs", "share", "95 % bound", "required")
    return f"Runs of {'; '.join(made)}.\n\n{table(header, rows)}"


# -- modules -----------------------------------------------------------------------------------------------------------


def modules() -> str:
    """Every file of the code with the first sentence of its docstring, by folder."""
    parts = []
    for root in ("calib", "models"):
        files = sorted((DOCS.parent / root).rglob("*.py"))
        for folder in sorted({file.parent for file in files}):
            own = [file for file in files if file.parent == folder]
            words = {file.name: _first_paragraph(file) for file in own}
            parts.append(f"## `{folder.relative_to(DOCS.parent).as_posix()}/`\n\n{words.pop('__init__.py', '')}\n")
            parts.append(table(("file", "what it holds"), ([f"`{name}`", said] for name, said in words.items())))
    return "\n".join(parts)


def _first_paragraph(file: Path) -> str:
    words = ast.get_docstring(ast.parse(file.read_text("utf-8"))) or ""
    return _code(words.split("\n\n")[0].replace("\n", " "))


# -- Python interface --------------------------------------------------------------------------------------------------


def api() -> str:
    """Every public name, documented from its docstring."""
    parts = []
    for name in sorted(set(calib.__all__) - {"__version__"}, key=str.lower):
        target = getattr(calib, name)
        if isinstance(target, type):
            options = "" if issubclass(target, Exception) else "   :members:\n"
            parts.append(f"## {name}\n\n```{{eval-rst}}\n.. autoclass:: calib.{name}\n{options}```\n")
        else:
            parts.append(f"## {name}\n\n```{{eval-rst}}\n.. autofunction:: calib.{name}\n```\n")
    return "\n".join(parts)


PARTS: dict[str, Callable[..., str]] = {
    "keys": keys, "commands": commands, "tables": results, "rules": rules, "rates": rates, "methods": methods,
    "modules": modules, "api": api,
}  # fmt: skip


def setup(app: Sphinx) -> dict[str, bool]:
    """Replace the marks whenever a page is read."""

    def on_property(_: Sphinx, what: str, __: str, ___: object, ____: object, lines: list[str]) -> None:
        if what == "property" and lines:  # what stands before a colon would be read as its type
            lines[0] = lines[0].replace(": ", " – ")

    app.connect("autodoc-process-docstring", on_property, priority=400)

    def on_read(_: Sphinx, __: str, source: list[str]) -> None:
        source[0] = replaced(source[0])

    app.connect("source-read", on_read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
