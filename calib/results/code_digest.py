"""Digest of calib's own code: of every file that a module imports, docstrings, comments and file names aside."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import json
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from calib.errors.own_code import CALIB
from calib.results.written import whole

_TOKENS = re.compile(
    r"""(?P<string>r?(?:"{3}(?:[^\\]|\\.)*?"{3}|'{3}(?:[^\\]|\\.)*?'{3}|"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'))"""
    r"""|(?P<comment>\#[^\n]*)|(?P<bracket>[][(){}])""",
    re.DOTALL,
)
_END = re.compile(r"[ ]*(?:#|\n|\Z)")
_LINE_ENDS = re.compile(r"[ ]*\n(?:[ ]*\n)*")
_FOR_TYPES = re.compile(r"^if TYPE_CHECKING:\n(?:[ ]+[^\n]*\n)+", re.MULTILINE)
_IMPORT = re.compile(
    r"^[ ]*(?:from (?P<source>calib\b[\w.]*|\.[\w.]*) import (?P<names>\([^)]*\)|[^\n]+)"
    r"|import (?P<module>calib\b[\w.]*)[^\n]*)\n",
    re.MULTILINE,
)
_WITHOUT_INFLUENCE = {"__init__.py", "results/version.py"}
"""Files that decide no result: the public names and the version."""


def code_digest(*modules: str, apart: Collection[str] = (), folder: Path = CALIB) -> str:
    """Digest of the code of modules and of all files of calib that they import, directly or through others.

    Docstrings, comments, empty lines and imports for types do not count, nor does the place of a file. Files are read,
    not imported.

    Parameters
    ----------
    modules : str
        Names of modules or packages, such as ``"calib.analyses.explain"``; of a package all files below it.
    apart : collection of str
        Modules that do not count, nor what they import.
    folder : Path
        Folder of calib.
    """
    return _digest(modules, frozenset(apart), folder, _state(folder))


@functools.lru_cache(maxsize=64)
def _digest(
    modules: tuple[str, ...], apart: frozenset[str], folder: Path, state: frozenset[tuple[str, int, int]]
) -> str:
    of_state, key = hashlib.sha256(repr(sorted(state)).encode()).hexdigest(), repr((modules, sorted(apart)))
    kept = _kept(folder, of_state)
    if found := kept.get(key):
        return found
    source = functools.cache(_source)
    digest = hashlib.sha256()
    for line in sorted(_line(source, *each) for each in imports_of(*modules, apart=apart, folder=folder).items()):
        digest.update(line.encode())
    found = digest.hexdigest()[:16]
    _keep(folder, {"state": of_state, **kept, key: found})
    return found


def _kept(folder: Path, state: str) -> dict[str, str]:
    """Digests that an earlier process has found of the present state; none without them."""
    try:
        known = json.loads(_beside_compiled(folder).read_bytes())
        return dict(known) if known["state"] == state else {}
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError):
        return {}


def _keep(folder: Path, digests: Mapping[str, str]) -> None:
    """Keep digests for later processes where Python may keep what it has compiled; they can be deleted at any time."""
    if sys.dont_write_bytecode:
        return
    with contextlib.suppress(OSError, NotImplementedError), whole(_beside_compiled(folder)) as draft:
        draft.write_text(json.dumps(digests), "utf-8")


def _beside_compiled(folder: Path) -> Path:
    """File of kept digests: beside compiled code, which Python too takes while time of change and size stay."""
    return Path(importlib.util.cache_from_source(folder / "__init__.py")).with_name("code_digest.json")


def _state(folder: Path) -> frozenset[tuple[str, int, int]]:
    """Path, time of change and size of every file of code: while they stay, so does each digest."""
    files = (os.path.join(place, name) for place, _, names in os.walk(folder) for name in names)
    stats = ((file, os.stat(file)) for file in files if file.endswith((".py", ".pyi")))
    return frozenset((file, stat.st_mtime_ns, stat.st_size) for file, stat in stats)


Names: TypeAlias = Mapping[tuple[str, str], Path]
"""Names that a file imports from calib, by module and name, each with the file that defines it."""


def imports_of(*modules: str, apart: Collection[str] = (), folder: Path = CALIB) -> dict[Path, Names]:
    """Files of modules and of all that they import, each with its own imports; see `code_digest`."""
    ignored = {_file(folder, name) for name in apart} | {folder / name for name in _WITHOUT_INFLUENCE}
    ahead = [file for name in modules for file in _below(_file(folder, name))]
    found: dict[Path, Names] = {}
    defining = functools.cache(_defining)
    while ahead:
        if (file := ahead.pop()) not in found and file not in ignored:
            names = {(module, name): defining(folder, module, name) for module, name in _source(file).imports}
            found[file] = {key: target for key, target in names.items() if target not in ignored}
            ahead += found[file].values()
    return found


def _line(source: Callable[[Path], _Source], file: Path, names: Names) -> str:
    """What counts of a file: its code, and of each name that it imports from calib the code that defines it."""
    own = sorted(f"{name} {source(target).digest}" for (_, name), target in names.items())
    return " ".join([source(file).digest, *own]) + "\n"


def _defining(folder: Path, module: str, name: str) -> Path:
    """File of a submodule of that name, of the module that a package takes the name from, or of the module itself."""
    file = _file(folder, module)
    if file.name != "__init__.py":
        return file
    if name and (own := _found(folder, f"{module}.{name}")):
        return own
    stub = file.with_suffix(".pyi")  # of a package that imports its modules on first use
    face = (stub if stub.is_file() else file).read_text("utf-8")
    sources = (source for source, known in _imports(face, module) if known == name and source != module)
    source = next(sources, None)
    return file if source is None else _defining(folder, source, name)


def _found(folder: Path, module: str) -> Path | None:
    path = folder.joinpath(*module.split(".")[1:])
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


def _file(folder: Path, module: str) -> Path:
    if (file := _found(folder, module)) is None:
        raise FileNotFoundError(f"there is no module {module} in {folder}")
    return file


def _below(file: Path) -> list[Path]:
    return list(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]


@dataclass(frozen=True)
class _Source:
    """A file's code without its imports from calib, as a digest, and these imports, by module and name."""

    digest: str
    imports: tuple[tuple[str, str], ...]


def _source(file: Path) -> _Source:
    state = file.stat()
    return _read(file, state.st_mtime_ns, state.st_size)


@functools.cache
def _read(file: Path, changed: int, size: int) -> _Source:
    code = _FOR_TYPES.sub("", _code(file.read_text("utf-8")))
    return _Source(hashlib.sha256(_IMPORT.sub("", code).encode()).hexdigest(), tuple(_imports(code)))


def _imports(code: str, package: str = "") -> Iterator[tuple[str, str]]:
    """Imports from calib in a text, as module and name; the name is empty for a whole module."""
    for match in _IMPORT.finditer(code):
        source = match["source"]
        if source is None:
            yield match["module"], ""
            continue
        module = f"{package}{source.rstrip('.')}" if source.startswith(".") else source
        for name in re.findall(r"(\w+)(?: as \w+)?", match["names"]):
            yield module, name


def _code(text: str) -> str:
    """A text of Python without docstrings, comments and empty lines.

    A docstring is here any statement that is nothing but a string.
    """
    parts, run, end, depth = [], "", 0, 0
    for match in _TOKENS.finditer(text):
        if match.lastgroup == "bracket":
            depth += 1 if match[0] in "([{" else -1
            continue
        run += text[end : match.start()]
        end = match.end()
        if match.lastgroup == "string" and (depth or not _is_statement(text, *match.span())):
            parts += [_LINE_ENDS.sub("\n", run), match[0]]
            run = ""
    return "".join([*parts, _LINE_ENDS.sub("\n", run + text[end:])])


def _is_statement(text: str, begin: int, end: int) -> bool:
    """Whether a string outside of brackets is all that stands on its lines."""
    line = text.rfind("\n", 0, begin) + 1
    continued = text[max(line - 2, 0) : line] == "\\\n"
    return not (text[line:begin].strip(" ") or continued) and _END.match(text, end) is not None
