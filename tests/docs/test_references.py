"""What pages and docstrings refer to is there: modules, names, attributes of classes, and files of Python."""

import importlib
import importlib.util
import inspect
import pkgutil
import re
from functools import cache
from pathlib import Path

import pytest

import calib

ROOT = Path(__file__).resolve().parents[2]
CODE = [*sorted((ROOT / "calib").rglob("*.py")), *sorted((ROOT / "models").rglob("*.py"))]
PAGES = [
    *(ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "findings/README.md")),
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts),
    *sorted((ROOT / "studies").glob("*/README.md")),
    ROOT / "tests/benchmarks/README.md",
]
DOTTED = re.compile(r"`~?((?:calib|models)(?:\.\w+)+)")
OF_CLASS = re.compile(r"`~?([A-Z]\w+)\.(\w+)")
PYTHON_FILE = re.compile(r"(?<![\w./<{])((?:\w+/)+\w+\.py)\b")
FORMER = re.compile(r"^\| .* \| `calib\.[\w.]+` \| `calib[\w.]*` \|$", re.MULTILINE)
"""A line of the table of former places."""
INVENTED = ("my_bogie/", "_proposed/", "tests/benchmarks/NAME", "analyses/VERB")
"""Beginnings of files that a page has its reader write, or that stand for any."""


def has(holder, name):
    if hasattr(holder, name):
        return True
    classes = holder.__mro__ if inspect.isclass(holder) else ()
    fields = getattr(holder, "model_fields", {})
    return name in fields or any(name in vars(one).get("__annotations__", {}) for one in classes)


@cache
def exists(dotted):
    parts = dotted.split(".")
    for n in range(len(parts), 0, -1):
        try:
            if importlib.util.find_spec(".".join(parts[:n])) is None:
                continue
        except (ImportError, AttributeError):  # below what is no package
            continue
        holder = importlib.import_module(".".join(parts[:n]))
        for name in parts[n:]:
            if not has(holder, name):
                return False
            holder = getattr(holder, name, None)
        return True
    return False


@cache
def classes():
    found = {}
    for module in pkgutil.walk_packages(calib.__path__, "calib."):
        if not module.name.endswith("__main__"):
            for name, one in vars(importlib.import_module(module.name)).items():
                if inspect.isclass(one):
                    found.setdefault(name, set()).add(one)
    return found


def broken(text, beside=ROOT):
    """References of a text that lead nowhere."""
    text = FORMER.sub("", text)
    lost = [name for name in DOTTED.findall(text) if not exists(name)]
    lost += [
        f"{kind}.{name}"
        for kind, name in OF_CLASS.findall(text)
        if kind in classes() and not any(has(one, name) for one in classes()[kind])
    ]
    folders = (ROOT, ROOT / "calib", ROOT / "docs", beside)
    for file in PYTHON_FILE.findall(text):
        if not file.startswith(INVENTED) and not any((folder / file).exists() for folder in folders):
            lost.append(file)
    return lost


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_refers_to_is_there(page):
    assert broken(page.read_text("utf-8"), page.parent) == []


def test_every_file_that_the_architecture_names_is_there():
    """It names many by their stem, such as ``study_text`` or ``report/parameters.draw_parameters``."""
    page = (ROOT / "ARCHITECTURE.md").read_text("utf-8")
    flows = page.split("## Two data flows")[1].split("## How to add")[0]
    there = {str(file.relative_to(ROOT / "calib").with_suffix("")) for file in (ROOT / "calib").rglob("*.py")}
    there |= {name.rpartition("/")[2] for name in there} | {path.name for path in (ROOT / "calib").iterdir()}
    named = re.findall(r"`([a-z_]+(?:/[a-z_]+)*)(?:\.[a-z_]+)?`(?<!\.csv`)", flows)
    assert len(named) > 15 and set(named) <= there
    files = {file.name for folder in ("calib", "models", "docs", "tests") for file in (ROOT / folder).rglob("*.py")}
    assert set(re.findall(r"(?<![\w/])(\w+\.py)\b", page)) - {"VERB.py"} <= files


@pytest.mark.medium
def test_what_a_docstring_refers_to_is_there():
    lost = {str(file.relative_to(ROOT)): broken(file.read_text("utf-8")) for file in CODE}
    assert {file: names for file, names in lost.items() if names} == {}


@pytest.mark.parametrize(
    "wrong", ["`calib.front.fit`", "`calib.Problem.solve`", "`Parameter.colour`", "calib/front/fit.py"]
)
def test_what_is_not_there_is_found(wrong):
    assert broken(f"as {wrong} says") == [wrong.strip("`")]
    assert broken("`calib.api.fit`, `calib.Problem.compare`, `Parameter.lower` and api/fit.py") == []
