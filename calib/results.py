"""The folder that holds a study's tables and figures; every file appears whole or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from calib.errors import InputError
from calib.table import guarded_table

_REMEDY = "choose another place with --results DIR, or free the folder"
DRAFT = ".part"
"""End of the name of every file or folder, figures too, that is being written."""
_ABANDONED = 600.0
"""Seconds after which nobody is writing a draft any more."""


@dataclass(frozen=True)
class Results:
    """One folder of results.

    Attributes
    ----------
    path : Path
    """

    path: Path

    @staticmethod
    def at(root: Path, study_name: str, part: str = "") -> Results:
        """Open (and make) ``root/study_name/part``; InputError when it cannot be written."""
        path = root / study_name / part if part else root / study_name
        try:
            path.mkdir(parents=True, exist_ok=True)
            _clear_drafts(path)
            with tempfile.NamedTemporaryFile(dir=path, prefix=".probe-", suffix=DRAFT):
                pass
        except OSError as fault:
            raise InputError(
                f"results cannot be written there ({fault.strerror})", place=path, remedy=_REMEDY
            ) from None
        return Results(path)

    def write_table(self, name: str, table: pd.DataFrame, index: bool = False) -> Path:
        """Write ``name.csv`` for `calib.table.read_table`; floats keep ten digits. InputError when it cannot be."""
        return self._write(f"{name}.csv", guarded_table(table).to_csv(index=index, float_format="%.10g"))

    def write_json(self, name: str, content: Mapping[str, Any]) -> Path:
        """Write ``name.json``; missing numbers become null. InputError when it cannot be written."""
        return self._write(f"{name}.json", json.dumps(_plain(content), indent=2, allow_nan=False) + "\n")

    def has(self, name: str) -> bool:
        """Whether a file of that name (with suffix) exists."""
        return (self.path / name).exists()

    def remove(self, *names: str) -> None:
        """Delete results that would no longer be true; InputError when one cannot be deleted."""
        for name in names:
            try:
                (self.path / name).unlink(missing_ok=True)
            except OSError as fault:
                raise InputError(
                    f"it is no longer true and cannot be deleted ({fault.strerror})",
                    place=self.path / name,
                    remedy=_REMEDY,
                ) from None

    def _write(self, name: str, text: str) -> Path:
        target, draft = self.path / name, self.path / f".{name}.{os.getpid()}{DRAFT}"
        try:
            draft.write_text(text, encoding="utf-8")
            os.replace(draft, target)
        except OSError as fault:
            raise InputError(f"it cannot be written ({fault.strerror})", place=target, remedy=_REMEDY) from None
        finally:  # also when interrupted
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
        return target


def _clear_drafts(folder: Path) -> None:
    """Delete what killed processes left half-written; a process at work needs no draft for that long."""
    for draft in folder.glob(f".*{DRAFT}"):
        with contextlib.suppress(OSError):
            if time.time() - draft.stat().st_mtime > _ABANDONED:
                shutil.rmtree(draft) if draft.is_dir() else draft.unlink()


def _plain(value: Any) -> Any:
    """Numbers as Python's own, NaN as None."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and value != value:
        return None
    return value
