"""The code blocks of a page, and how each is run.

A page's blocks run in order in one temporary folder that holds the project's ``studies``, Python blocks in one
namespace.

- ``python``: run.
- Any language with a first line ``# file: PATH``: written to that file.
- ``toml`` with a first line ``# in STUDY``: merged onto that study's keys, tables key by key, and validated;
  ``# in STUDY without KEY, KEY`` leaves out keys of the study first. Other ``toml`` is a whole study.
- ``sh``: every line is a command. ``calib`` runs in this process, with ``--quick`` where there is such an option;
  ``make`` must name a target, ``python FILE`` a script that takes ``--help``; ``pip install`` what this project is.
- ``text``: output, not run. ``{...}``: a directive of Sphinx. Nothing else is allowed.

A page that takes longer than some seconds has a line ``<!-- blocks: slow -->``.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.command import cli
from calib.command.example import write_example
from calib.study.settings import StudySettings

ROOT = Path(__file__).resolve().parents[2]
FENCE = re.compile(
    r"^(?P<mark>`{3,}|:{3,})(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=mark)[ \t]*$", re.MULTILINE | re.DOTALL
)
QUICK = ("run", "sensitivity", "calibrate")
SLOW = "<!-- blocks: slow -->"


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, text, and the line of its first mark."""

    language: str
    text: str
    line: int

    def marked(self, word: str) -> str | None:
        """What follows ``# WORD`` in the first line, if it begins so."""
        first = self.text.split("\n", 1)[0]
        found = re.fullmatch(rf"# {word} (.+)", first)
        return found.group(1) if found else None


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page."""
    text = page.read_text("utf-8")
    assert text.count("\n```") + text.startswith("```") == 2 * len(FENCE.findall(text)), f"an open fence in {page}"
    return [
        Block(found["language"].strip(), found["text"], text[: found.start()].count("\n") + 1)
        for found in FENCE.finditer(text)
    ]


def run_page(page: Path, folder: Path) -> dict[str, Any]:
    """Run the blocks of a page in a folder, which must be the working one; returns the Python names."""
    os.symlink(ROOT / "studies", folder / "studies")
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks(page):
        place = f"{page.name}, line {block.line}"
        file = block.marked("file:")
        if file is not None:
            path = folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, "utf-8")
        elif block.language == "python":
            exec(compile("\n" * block.line + block.text, page.name, "exec"), names)
        elif block.language == "toml":
            validate(block, folder)
        elif block.language == "sh":
            for line in block.text.splitlines():
                run_line(line, place)
        else:
            assert block.language == "text" or block.language.startswith("{"), (
                f"{place}: {block.language or 'no language'}"
            )
    return names


def validate(block: Block, folder: Path) -> StudySettings:
    """Settings of a whole study, or of the part merged onto the study that it names."""
    own, part = tomllib.loads(block.text), block.marked("in")
    if part is None:
        return StudySettings.model_validate(own)
    study, _, without = part.partition(" without ")
    file = folder / study / "study.toml"
    if not file.exists():  # the reader's own, begun by `calib new`
        write_example(file.parent)
    whole = tomllib.loads(file.read_text("utf-8"))
    for key in without.split(", ") if without else ():
        del whole[key]
    return StudySettings.model_validate(merged(whole, own))


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Two nested mappings, the second over the first."""
    out = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = merged(out[key], value) if both else value
    return out


def run_line(line: str, place: str) -> None:
    """Run a line of a shell block."""
    words = shlex.split(line, comments=True)
    if not words:
        return
    command, *rest = words
    if command == "calib":
        quick = ["--quick"] if rest[0] in QUICK and "--quick" not in rest else []
        workers = ["--workers", "1"] if rest[0] in QUICK and "--workers" not in rest else []
        assert cli.execute([*rest, *quick, *workers]) == 0, f"{place}: {line}"
    elif command == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
        assert rest and set(rest) <= set(targets), f"{place}: {line}"
    elif command == "python":
        script = [sys.executable, str(ROOT / rest[0]), "--help"]
        shown = subprocess.run(script, capture_output=True, text=True, cwd=ROOT, check=True).stdout
        for option in (word for word in rest[1:] if word.startswith("--")):
            assert option in shown, f"{place}: {rest[0]} has no {option}"
    elif command == "pip":
        assert rest == ["install", "-e", "."] and (ROOT / "pyproject.toml").is_file(), f"{place}: {line}"
    elif command == "cp":
        assert rest[0] == "-r" and len(rest) == 3, f"{place}: {line}"
        shutil.copytree(rest[1], rest[2])
    else:
        raise AssertionError(f"{place}: nothing runs {command!r}")
