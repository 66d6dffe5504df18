"""Edits of a study's file: pairs, held-out data and signs; comments are kept, each is shown first and can be undone."""

from __future__ import annotations

import difflib
import hashlib
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from calib.errors.errors import InputError
from calib.results.written import whole
from calib.study.study_file import StudyFile
from calib.study.study_text import read_settings

_FLIPPED = -2.0
"""Gain of a channel with the wrong sign, less 1: it is taken out of the measurement as it is read."""
_KEPT = 50
"""Edits that can be undone."""


class Edits:
    """Edits of the files of several studies, the latest last."""

    def __init__(self) -> None:
        self._made: dict[Path, list[tuple[str, str, str]]] = {}
        self._lock = threading.Lock()

    def shown(self, study: StudyFile, edit: Mapping[str, Any]) -> dict[str, Any]:
        """What an edit would change: ``words, diff, digest`` of the file that it is based on; nothing is written."""
        text, new, words = _edited(study, edit)
        return {"words": words, "diff": _diff(text, new), "digest": _digest(text)}

    def make(self, study: StudyFile, edit: Mapping[str, Any], digest: str) -> dict[str, Any]:
        """Make an edit that was shown; InputError where the file has changed since, or would be wrong."""
        with self._lock:
            text, new, words = _edited(study, edit)
            _require(study.file, text, digest)
            _write(study.file, new)
            self._made.setdefault(study.file, []).append((text, new, words))
            del self._made[study.file][:-_KEPT]
        return {"words": words, "diff": _diff(text, new), "undo": words}

    def undo(self, study: StudyFile) -> dict[str, Any]:
        """Take the latest edit back; InputError where the file was changed in another way since."""
        with self._lock:
            made = self._made.get(study.file, [])
            if not made:
                raise InputError("nothing was changed from this page", place=study.file)
            before, after, words = made[-1]
            _require(study.file, _text(study.file), _digest(after))
            _write(study.file, before)
            made.pop()
        return {"words": f"Taken back: {words}", "undo": self.last(study)}

    def last(self, study: StudyFile) -> str:
        """The latest edit that can be undone, in words; empty without."""
        made = self._made.get(study.file, [])
        return made[-1][2] if made else ""


def _edited(study: StudyFile, edit: Mapping[str, Any]) -> tuple[str, str, str]:
    """The file's text, the same with an edit, and the edit in words."""
    text = _text(study.file)
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as fault:
        raise InputError(f"it is no TOML ({fault})", place=study.file) from None
    where: Any = document
    if study.part is not None:
        if "tests" not in document:
            raise InputError(
                "its tests stand in the study that it builds on", place=study.file, remedy="edit that file"
            )
        where = document["tests"][study.part.index]
    make = _EDITS.get(str(edit.get("what")))
    name = edit.get("name")
    if make is None or not isinstance(name, str) or not name or len(name) > 200:
        raise InputError("there is no such edit", place="edit")
    words = make(study, document if make is _start else where, name, edit.get("value"))
    return text, tomlkit.dumps(document), words


def _pair(study: StudyFile, where: Any, name: str, value: Any) -> str:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise InputError(f"{value!r:.20} is no number of a model mode", place="pair")
    _within(_within(where, "pairing"), "override")[name] = value
    return f"Pair {name} with model mode {value}"


def _unpair(study: StudyFile, where: Any, name: str, value: Any) -> str:
    own = where.get("pairing", {}).get("override", {})
    if name not in own:
        raise InputError(
            f"no pair of {name} is stated in this file", place=study.file, remedy="calib pairs it by itself"
        )
    del own[name]
    return f"Pair {name} automatically again"


def _hold_out(kind: str) -> Callable[[StudyFile, Any, str, Any], str]:
    def make(study: StudyFile, where: Any, name: str, value: Any) -> str:
        held = list(getattr(study.settings.held_out, kind))
        thing = kind.removesuffix("s")
        new = [one for one in held if one != name] if name in held else [*held, name]
        table = _within(where, "held_out")
        table[kind] = _like(table.get(kind), new)
        return f"Use {thing} {name} again" if name in held else f"Hold out {thing} {name}"

    return make


def _flip(study: StudyFile, where: Any, name: str, value: Any) -> str:
    table = where if study.part is not None else _within(where, "measurement")
    own, key = _within(table, "corrected"), f"gain of sensor {name}"
    if key in own and float(own[key]) == _FLIPPED:
        del own[key]
        return f"Take the sign of sensor {name} as measured"
    own[key] = _FLIPPED
    return f"Flip the sign of sensor {name}"


def _start(study: StudyFile, where: Any, name: str, value: Any) -> str:
    """Where least squares begin too, besides the end of each search: values by name, or the number of a design."""
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        _within(where, "calibration")["begin_at"] = f"design {value}"
        return f"Begin least squares at design {value}"
    if not isinstance(value, Mapping) or not value or not all(isinstance(own, int | float) for own in value.values()):
        raise InputError("a start has a number for each parameter", place="start")
    start = tomlkit.inline_table()
    start.update({str(key): own for key, own in value.items()})
    _within(where, "calibration")["begin_at"] = start
    return f"Begin least squares at {name}"


_EDITS: Mapping[str, Callable[[StudyFile, Any, str, Any], str]] = {
    "pair": _pair, "unpair": _unpair, "mode": _hold_out("modes"), "sensor": _hold_out("sensors"), "flip": _flip,
    "start": _start,
}  # fmt: skip


def _within(table: Any, key: str) -> Any:
    """A table within another, made where there is none: inline within a table, of its own in the document."""
    if key not in table:
        table[key] = tomlkit.table() if isinstance(table, tomlkit.TOMLDocument) else tomlkit.inline_table()
    return table[key]


def _like(known: Any, values: list[str]) -> Any:
    """A list that keeps comments of the one before it."""
    if known is None:
        return values
    for one in [one for one in known if one not in values]:
        known.remove(one)
    for one in values:
        if one not in known:
            known.append(one)
    return known


def _text(file: Path) -> str:
    try:
        return file.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(f"it cannot be read ({fault})", place=file) from None


def _require(file: Path, text: str, digest: str) -> None:
    if _digest(text) != digest:
        remedy = "look at the change again: nothing was overwritten"
        raise InputError("it was changed in an editor meanwhile", place=file, remedy=remedy)


def _write(file: Path, text: str) -> None:
    """Replace the file where its new content is a valid study."""
    try:
        with whole(file) as draft:
            draft.write_bytes(text.encode("utf-8"))
            read_settings(draft)
    except InputError as fault:
        raise InputError(fault.problem, place=file, remedy=fault.remedy or "the file stays as it was") from None
    except OSError as fault:
        raise InputError(f"it cannot be written ({fault.strerror})", place=file) from None


def _diff(old: str, new: str) -> list[str]:
    lines = difflib.unified_diff(old.splitlines(), new.splitlines(), lineterm="", n=2)
    return [line for line in lines if not line.startswith(("---", "+++"))]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
