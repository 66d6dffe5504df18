"""Places of keys and values in a TOML text, by their path: ``("calibration", "cases", 1, "seed")``."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

from calib.errors.place import Place

Keys = tuple[int | str, ...]
"""Path of a value: names of tables and keys, and positions in lists from 0."""
Mark = Literal["key", "value"]
_Span = tuple[int, int]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_BLANK = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_BASIC = re.compile(r'"(?:[^"\\\n]|\\.)*"')
_LITERAL = re.compile(r"'[^'\n]*'")
_LONG_BASIC = re.compile(r'"""(?:[^\\]|\\.)*?"""(?:"{0,2})', re.DOTALL)
_LONG_LITERAL = re.compile(r"'''.*?'''(?:'{0,2})", re.DOTALL)
_SCALAR = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:[^\s,\]}#]*|[^\s,\]}#]+")


def place_in(file: str, text: str, keys: Keys, mark: Mark = "value") -> tuple[Place | None, bool]:
    """Place of a key, or of its value, in a valid TOML text, and whether that key itself stands there.

    For a key that is not there it is the table or key above it that is; None where that is the whole file.
    """
    spans = _spans(text)
    for depth in range(len(keys), 0, -1):
        path = keys[:depth]
        exact = depth == len(keys)
        first, second = (spans.values, spans.keys) if exact and mark == "value" else (spans.keys, spans.values)
        span = first.get(path) or second.get(path) or (spans.implied.get(path) if exact else None)
        if span is not None:
            return _place(file, text, span), exact
    return None, False


def _place(file: str, text: str, span: _Span) -> Place:
    begin, end = span
    line = text.count("\n", 0, begin) + 1
    start = text.rfind("\n", 0, begin) + 1
    length = 1 if "\n" in text[begin:end] else end - begin  # of several lines the first bracket or quote
    return Place.in_lines(file, text.split("\n"), line, begin - start + 1, max(length, 1))


@dataclass
class _Spans:
    """First and last character of keys (headers of tables included) and of values, by their paths.

    ``implied`` holds tables that no header or key of their own names, such as ``a`` of ``[a.b]``.
    """

    keys: dict[Keys, _Span] = field(default_factory=dict)
    values: dict[Keys, _Span] = field(default_factory=dict)
    implied: dict[Keys, _Span] = field(default_factory=dict)


@lru_cache(maxsize=8)
def _spans(text: str) -> _Spans:
    return _Scanner(text).scan()


class _Scanner:
    """Walks over a TOML text that `tomllib` has accepted."""

    def __init__(self, text: str):
        self._text = text
        self._at = 0
        self._found = _Spans()
        self._counts: dict[Keys, int] = {}

    def scan(self) -> _Spans:
        """All places; those before the first character that is not understood."""
        table: Keys = ()
        while self._skip(_BLANK) < len(self._text):
            before = self._at
            if self._here("["):
                table = self._header()
            else:
                self._pair(table)
            if self._at == before:  # no TOML
                break
        return self._found

    def _header(self) -> Keys:
        begin, several = self._at, self._here("[[")
        self._at += 2 if several else 1
        path: Keys = ()
        names = self._names()
        for k, name in enumerate(names):
            if k:
                self._found.implied.setdefault(path, (begin, self._at))
            path = (*path, name)
            if path in self._counts and not (several and k == len(names) - 1):
                path = (*path, self._counts[path] - 1)
        self._skip(_SPACE)
        self._at += 2 if several else 1
        span = begin, self._at
        if several:
            number = self._counts.get(path, 0)
            self._counts[path] = number + 1
            self._found.keys.setdefault(path, span)
            path = (*path, number)
        self._found.keys.setdefault(path, span)
        return path

    def _pair(self, table: Keys) -> None:
        begin = self._at
        names = self._names()
        span = begin, self._at
        for k in range(1, len(names)):
            self._found.implied.setdefault((*table, *names[:k]), span)
        path = (*table, *names)
        self._found.keys.setdefault(path, span)
        self._skip(_SPACE)
        self._take("=")
        self._skip(_SPACE)
        self._value(path)

    def _names(self) -> Keys:
        """The parts of a key, of which one may be quoted and hold dots."""
        out: list[str] = []
        while True:
            self._skip(_SPACE)
            begin = self._at
            for kind in (_BARE, _BASIC, _LITERAL):
                if match := kind.match(self._text, self._at):
                    self._at = match.end()
                    break
            raw = self._text[begin : self._at]
            out.append(str(tomllib.loads(f"k = {raw}")["k"]) if raw[:1] in ("'", '"') else raw)
            end = self._at
            self._skip(_SPACE)
            if not self._take("."):
                self._at = end
                return tuple(out)

    def _value(self, path: Keys) -> None:
        begin = self._at
        if self._take("["):
            number = 0
            while self._skip(_BLANK) < len(self._text) and not self._take("]"):
                self._value((*path, number))
                number += 1
                self._skip(_BLANK)
                self._take(",")
        elif self._take("{"):
            while self._skip(_BLANK) < len(self._text) and not self._take("}"):
                self._pair(path)
                self._skip(_BLANK)
                self._take(",")
        else:
            for kind in (_LONG_BASIC, _LONG_LITERAL, _BASIC, _LITERAL, _SCALAR):
                if match := kind.match(self._text, self._at):
                    self._at = match.end()
                    break
            else:
                self._at = len(self._text)
        self._found.values.setdefault(path, (begin, self._at))

    def _here(self, what: str) -> bool:
        return self._text.startswith(what, self._at)

    def _take(self, what: str) -> bool:
        found = self._here(what)
        self._at += len(what) if found else 0
        return found

    def _skip(self, what: re.Pattern[str]) -> int:
        match = what.match(self._text, self._at)
        self._at = match.end() if match else self._at
        return self._at


def keys_in_words(keys: Sequence[int | str]) -> str:
    """A path as one writes it: ``calibration.cases[1].seed``."""
    out = ""
    for key in keys:
        out += f"[{key}]" if isinstance(key, int) else f".{key}" if out else key
    return out
