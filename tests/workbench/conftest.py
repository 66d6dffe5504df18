"""A study that was compared, and a page of it without a browser."""

from __future__ import annotations

import contextlib
import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib.command import cli
from calib.command.example import write_example

TOKEN, PORT = "a-token-of-a-test", 8123
OWN = f"http://127.0.0.1:{PORT}"
testclient = pytest.importorskip("starlette.testclient", reason="the extra 'workbench' is not installed")


@pytest.fixture(scope="session")
def compared(tmp_path_factory: pytest.TempPathFactory, no_drawing: Any) -> Path:
    """A folder with the study ``mast``, the results of its comparison, and a file beside it that no page may show."""
    folder = tmp_path_factory.mktemp("compared")
    write_example(folder / "mast")
    (folder / "secret.csv").write_text("mode,1 (SECRET Hz)\nSECRET,1.0\n")
    with contextlib.chdir(folder), no_drawing(), contextlib.redirect_stdout(io.StringIO()):
        assert cli.execute(["compare", "mast"]) == 0
    return folder


@pytest.fixture
def here(compared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder, in which the test is."""
    shutil.copytree(compared, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


@pytest.fixture(scope="session")
def page_of() -> Callable[..., Any]:
    """Opens the page of a study or a folder, as a browser that has loaded it."""
    from calib.workbench.server import application

    def opened(path: Path, root: Path = Path("results")) -> Any:
        app = application(path, root, TOKEN, PORT)
        return testclient.TestClient(app, base_url=f"{OWN}/{TOKEN}/", headers={"origin": OWN})

    return opened


@pytest.fixture
def page(here: Path, page_of: Callable[..., Any]) -> Any:
    """The page of the study."""
    return page_of(Path("mast"))


@pytest.fixture
def key(page: Any) -> str:
    """The key of the study."""
    return str(page.get("studies").json()["studies"][0]["key"])
