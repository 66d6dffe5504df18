"""Text of decks with the files that they include, and the keyword lines of Abaqus and CalculiX."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from calib.errors.errors import InputError

_INCLUDE = re.compile(
    r"^[ \t]*\*[ \t]*INCLUDE[ \t]*,[ \t]*\n?[ \t]*INPUT[ \t]*=[ \t]*(?:\"([^\"\n]+)\"|([^,\n]+)).*$"
    r"|^INCLUDE[ \t]+(?:'([^']+)'|\"([^\"]+)\"|(\S+)).*$",
    re.IGNORECASE | re.MULTILINE,
)
"""``*INCLUDE, INPUT=name`` of Abaqus and CalculiX, ``INCLUDE 'name'`` of Nastran, whose name may take two lines."""
_DEEPEST = 20
"""Files within files; more include each other."""


def deck_text(file: Path) -> str:
    """Text of a deck in which the files that it includes stand at their places.

    Names are relative to the file that includes them, or to the deck.

    Raises
    ------
    InputError
        For a file that is not there, and for files that include each other.
    """
    if not file.is_file():
        raise InputError("there is no such file", place=file, remedy="check the path")
    return with_included(file, file.read_text("latin-1"))


def with_included(file: Path, text: str) -> str:
    """As `deck_text`, for a deck that was read."""
    return _expanded(text.replace("\r\n", "\n"), file, file.parent, 0)


def _expanded(text: str, file: Path, home: Path, depth: int) -> str:
    if "INCLUDE" not in text.upper():
        return text
    control = re.match(r"[\s\S]*?^[ \t]*CEND\b[\s\S]*?^[ \t]*BEGIN[ \t]+[^\n]*$", text, re.MULTILINE | re.IGNORECASE)
    if control is not None:  # of Nastran: how to solve, which names no node
        return control[0] + _expanded(text[control.end() :], file, home, depth)
    if depth > _DEEPEST:
        raise InputError("files include each other", place=file, remedy="let no file include one that includes it")

    def content(found: re.Match[str]) -> str:
        name = re.sub(r"\s*\n\s*", "", next(one for one in found.groups() if one)).strip()
        places = [file.parent / name, home / name]
        other = next((one for one in places if one.is_file()), None)
        if other is None:
            raise InputError(f"it includes {name}, which is not there", place=file, remedy=f"put it beside {file.name}")
        return _expanded(other.read_text("latin-1").replace("\r\n", "\n"), other, home, depth + 1)

    return _INCLUDE.sub(content, text)


def keyword_blocks(lines: Iterable[str]) -> Iterator[tuple[str, list[str]]]:
    """Keyword lines of Abaqus, in capitals and without blanks, each with its lines of data; comments are left out.

    A keyword line that ends with a comma goes on in the next one.
    """
    key, data, goes_on = "", list[str](), False
    for line in lines:
        bare = line.strip()
        if bare.startswith("**") or not bare:
            continue
        if goes_on:
            key += bare.upper().replace(" ", "")
        elif bare.startswith("*"):
            yield key, data
            key, data = bare.upper().replace(" ", ""), []
        else:
            data.append(bare)
            continue
        goes_on = key.endswith(",")
    yield key, data


def value_of(key: str, option: str) -> str:
    """What a keyword line states for an option; empty without it."""
    match = re.search(f",{option}=([^,]+)", key)
    return "" if match is None else match[1].strip('"')


def fields_between(line: str) -> list[str]:
    """What stands between the commas of a line of data, in capitals; empty where nothing does."""
    return [field.strip().upper() for field in line.split(",")]


def is_keyword(key: str, *names: str) -> bool:
    """Whether a keyword line is of one of these keywords, whatever its options."""
    return key.split(",", 1)[0] in names
