"""A small study with a library of effects, in a current directory of its own, and the results of commands there."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib.command import cli
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def write_study() -> Callable[..., Path]:
    """See `tests/template/mast_effects.py`."""
    return module_of(ROOT / "tests/template/mast_effects.py").write_study


@pytest.fixture(scope="session")
def asked(without_pixels: Callable[[Any, str, Any], dict[str, bytes]]) -> Callable[..., str]:
    """Runs a command in a folder and returns its output; figures it draws are without pixels."""

    def ask(folder: Path, *arguments: str) -> str:
        with (
            contextlib.chdir(folder),
            contextlib.redirect_stdout(io.StringIO()) as said,
            pytest.MonkeyPatch.context() as patch,
        ):
            patch.setattr("calib.report.figures.content", without_pixels)
            patch.setattr("calib.report.figures.svg_text", lambda figure, name: f"<svg><!-- {name} --></svg>")
            assert cli.execute(list(arguments)) == 0
        return said.getvalue()

    return ask


@pytest.fixture
def drawn() -> None:
    """Requested by tests about figures."""


@pytest.fixture(autouse=True)
def undrawn_unless_asked_for(request: pytest.FixtureRequest) -> None:
    """Figures take longest, and most tests are not about them; shared folders have them already."""
    if "drawn" not in request.fixturenames:
        request.getfixturevalue("undrawn")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def guyed(here: Path, write_study: Callable[..., Path]) -> Path:
    """A mast with a guy rope that its model lacks, as ``mast`` in the current directory."""
    return write_study(Path("mast"), {"guy": 9000.0})


@pytest.fixture(scope="session")
def edit() -> Callable[[Path, str, str], None]:
    """Replaces words in the study file of a folder, once."""

    def edit(folder: Path, old: str, new: str) -> None:
        text = (folder / "study.toml").read_text()
        assert old in text
        (folder / "study.toml").write_text(text.replace(old, new, 1))

    return edit


@pytest.fixture(scope="session")
def explanation() -> Callable[..., dict[str, Any]]:
    """Content of ``explanation.json`` in the results of a study."""
    return lambda name="mast": json.loads(Path("results", name, "explanation.json").read_text())


@pytest.fixture(scope="session")
def files() -> Callable[[Path | str], dict[Path, bytes]]:
    """Every file below a folder with its content, but for what Python compiled."""

    def read(folder: Path | str) -> dict[Path, bytes]:
        found = [p for p in Path(folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
        return {p.relative_to(folder): p.read_bytes() for p in found}

    return read
