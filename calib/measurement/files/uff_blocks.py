"""Datasets of a universal file as checked text, and their contents as read by pyuff."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyuff

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.execution.temporary import TemporaryFolder
from calib.measurement.files.uff_sets import pyuff_faults

_MARKER = b"    -1"
USED_KINDS = (15, 18, 55, 164, 781, 2411, 2412, 2414, 2420, 2435, 2452, 2467, 2477)
"""Dataset numbers whose text is kept."""
MODAL = (2, 3, 7)
"""Analysis types that are modes: normal, complex of first order, complex of second order."""
_LINE_END = re.compile(rb"\r\n|\r|\n")
_BINARY_HEAD = re.compile(rb" {4}58b[ \d]{12}([ \d]{11}\d)([ \d]{11}\d).*")
"""After byte order and kind of number: the number of text lines, and of bytes, that follow."""
_VALUE_BYTES = {2: (4, 1), 4: (8, 1), 5: (4, 2), 6: (8, 2)}
"""Bytes of a number, and numbers of a value, by the ordinate data type of record 7."""
_CLOSING = re.compile(rb"(?:\r\n|\r|\n)?( {4}-1[ ]*(?:\r|\n|\Z))")
_FORTRAN_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")
_ID_LINES = {55: range(5), 164: (0,), 2414: (1, *range(3, 8))}
"""Lines of free text in a dataset, from 0."""
_NUMBERS = re.compile(r"(?:[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)+", re.ASCII)
"""Numbers, between which a fixed width of columns may leave no blank."""


@dataclass(frozen=True)
class Dataset:
    """One dataset as text: its type, the line it starts on (from 1), and the lines after the type line.

    ``origin`` is the dataset of the file, where this one was converted from it.
    """

    kind: int
    line: int
    lines: tuple[str, ...]
    origin: Dataset | None = None

    def error(self, path: Path, problem: str, remedy: str) -> InputError:
        """An InputError that names file and line, and shows the first entry that is no number, if there is one."""
        return InputError(problem, place=f"{path}, line {self.line}", remedy=remedy, at=(self.origin or self)._at(path))

    def _at(self, path: Path) -> Place:
        for k, text in enumerate(self.lines):
            for entry in re.finditer(r"\S+", text):
                if k not in _ID_LINES.get(self.kind, ()) and not _NUMBERS.fullmatch(entry.group()):
                    return Place(str(path), self.line + 2 + k, text, entry.start() + 1, len(entry.group()))
        return Place(str(path), self.line + 1, f"{self.kind:6d}")


def read_blocks(path: Path, notes: list[str] | None = None) -> list[Dataset]:
    """Split a universal file into its datasets; words between them, which the format allows, go to the notes.

    The bytes of a binary function (dataset 58b) are skipped by the count in its header line, so that no byte among them
    is taken for the end of the dataset; where that count is absent or does not lead to a '-1' line, the end is searched
    for as in any other dataset.

    Raises InputError when the file is empty, is not a universal file, a dataset is not closed (a truncated file), or
    numbers stand outside of all datasets: there a '-1' line was lost.
    """
    try:
        data = path.read_bytes()
    except OSError as err:
        raise InputError(f"it cannot be read ({err.strerror})", place=path, remedy="check the path") from None
    if not data.strip():
        raise InputError("it is empty", place=path, remedy="export it again")
    lines = _Lines(data.rstrip(b"\x1a"))
    blocks: list[Dataset] = []
    begun: list[bytes] | None = None
    start = 0
    outside: list[Place] = []
    while not lines.ended:
        line = lines.take().rstrip()
        if line == _MARKER:
            if begun is not None:
                blocks.append(_block(path, start, begun))
            begun, start = ([], lines.number) if begun is None else (None, start)
        elif begun is not None:
            begun.append(line)
            if len(begun) == 1:
                lines.pass_binary(line)
        elif line:
            outside.append(Place(str(path), lines.number, _text(line)))
            if not _is_words(line):
                raise _outside(outside[-1])
    if outside and not (blocks or begun):
        raise _outside(outside[0])
    if begun is not None:
        raise InputError(
            "the dataset that starts here is not closed by a '-1' line: the file is truncated",
            place=Place(str(path), start, _MARKER.decode()),
            remedy="export it again",
        )
    if outside and notes is not None:
        count = "1 line" if len(outside) == 1 else f"{len(outside)} lines"
        notes.append(f"{path}, line {outside[0].line}: {count} of text outside the datasets skipped")
    return blocks


def _is_words(line: bytes) -> bool:
    """Whether a line outside of all datasets is text for people: neither numbers nor bytes of a lost dataset."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return text.expandtabs().isprintable() and not all(_NUMBERS.fullmatch(entry) for entry in text.split())


def _outside(place: Place) -> InputError:
    words = "text outside the datasets: this is no universal file, or a '-1' line was lost"
    return InputError(words, place=place, remedy="export it again")


class _Lines:
    """Lines of a file one by one, as `bytes.splitlines` cuts them; binary parts are skipped."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0
        self.number = 0

    @property
    def ended(self) -> bool:
        return self._at >= len(self._data)

    def take(self) -> bytes:
        """The next line without its end."""
        found = _LINE_END.search(self._data, self._at)
        stop, after = (len(self._data),) * 2 if found is None else found.span()
        line = self._data[self._at : stop]
        self._at, self.number = after, self.number + 1
        return line

    def pass_binary(self, head: bytes) -> None:
        """Skip the bytes that a header of dataset 58b announces, if a '-1' line follows them.

        Some writers, pyuff 2.5 among them, count the bytes of the real parts alone: where the count in the first line
        leads to no '-1' line, that of the values in record 7 is tried.
        """
        found = _BINARY_HEAD.fullmatch(head)
        if found is None or not all(found.group(k).strip().isdigit() for k in (1, 2)):
            return
        at, number, texts = self._at, self.number, []
        for _ in range(min(int(found.group(1)), 100)):
            if self.ended:
                break
            texts.append(self.take())
        begin = self._at
        for count in (int(found.group(2)), *_bytes_of_values(texts)):
            # some writers end the bytes by a line end of its own
            behind = _CLOSING.match(self._data, min(begin + count, len(self._data)))
            if behind is not None:
                self._at = behind.start(1)
                self.number += len(self._data[begin : self._at].splitlines())
                return
        self._at, self.number = at, number


def _bytes_of_values(texts: Sequence[bytes]) -> list[int]:
    """Bytes of the values of a dataset 58b by its record 7, as one number; none where that cannot be read."""
    entries = texts[6].split() if len(texts) > 6 else []
    if len(entries) < 3 or not all(entry.isdigit() for entry in entries[:3]) or int(entries[0]) not in _VALUE_BYTES:
        return []
    size, parts = _VALUE_BYTES[int(entries[0])]
    return [int(entries[1]) * size * (parts if int(entries[2]) else parts + 1)]


def _block(path: Path, start: int, lines: Sequence[bytes]) -> Dataset:
    head = lines[0][:6].strip() if lines else b""
    if not head.isdigit() or int(head) == 0:
        place = Place(str(path), start + 1, _text(lines[0]) if lines else "")
        raise InputError("no dataset number follows the '-1' line", place=place, remedy="export it again")
    kind = int(head)
    # the other datasets are not read, and may be binary
    if kind not in USED_KINDS:
        return Dataset(kind, start, ())
    free = _ID_LINES.get(kind, ())
    texts = (_text(raw) for raw in lines[1:])
    # Fortran's double precision writes 1.0D+03
    read = (text if k in free else _FORTRAN_EXPONENT.sub("E", text) for k, text in enumerate(texts))
    return Dataset(kind, start, tuple(read))


def _text(raw: bytes) -> str:
    """Printable text of one line; exotic line breaks would otherwise split it for some readers and not for others."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return "".join(c if c.isprintable() else "?" for c in text)


def halves_of_six(path: Path, block: Dataset) -> list[Dataset]:
    """The block itself, or two (x, y, z and rx, ry, rz) for complex data of six components a node.

    pyuff cannot read six complex components. The second half has the kind -55 until the halves are joined.
    """
    if block.kind != 55 or len(block.lines) < 8:
        return [block]
    if block.lines[5][40:60].split() != ["5", "6"]:
        return [block]
    head, body = block.lines[:8], block.lines[8:]
    if len(body) % 3:
        raise block.error(path, "the dataset 55 that starts here has not three lines a node", "export it again")
    head = (*head[:5], head[5][:50] + f"{3:10d}", *head[6:])
    halves = []
    for kind, offset in ((55, 1), (-55, 2)):
        lines = [line for k in range(0, len(body), 3) for line in (body[k], body[k + offset])]
        halves.append(Dataset(kind, block.line, (*head, *lines), block.origin or block))
    return halves


def extract_sets(path: Path, blocks: Sequence[Dataset]) -> list[dict[str, Any]]:
    """Contents of the blocks, through pyuff.

    pyuff sees a cleaned copy: it silently drops an unclosed dataset, trips over lines padded to 80 columns, and takes
    any line that ends in -1 for the end of a dataset.
    """
    text = "".join(
        f"{-1:6d}\n{abs(b.kind):6d}\n" + "".join(line + "\n" for line in b.lines) + f"{-1:6d}\n" for b in blocks
    )
    sets: list[dict[str, Any]] = []

    def fault(words: str) -> InputError:
        block = blocks[len(sets)]
        what = f"the dataset {abs(block.kind)} that starts here cannot be read ({words})"
        return block.error(path, what, "export it again")

    with TemporaryFolder() as folder, pyuff_faults(fault):
        copy = folder / "copy.uff"
        copy.write_text(text, encoding="utf-8", newline="\n")
        reader = pyuff.UFF(str(copy))
        if [int(kind) for kind in reader.get_set_types()] != [abs(block.kind) for block in blocks]:
            raise ValueError("a line inside ends in -1")
        for at in range(len(blocks)):
            sets.append(dict(reader.read_sets(at)))
    return sets
