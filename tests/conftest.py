"""What every test needs before numerical libraries are imported, and the independent codes some compare with."""

import contextlib
import gc
import itertools
import math
import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

# Small matrices are slower on several BLAS threads, and sums then depend on how many there are.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
os.environ["MPLBACKEND"] = "Agg"
# No test reads or fills the user's cache of reduced bases; this folder is for fixtures that several tests share.
os.environ["CALIB_CACHE"] = tempfile.mkdtemp(prefix="calib-cache-")

import opensees_code
import pytest
from hypothesis import settings

from calib.analyses.provenance import places
from calib.report.html.summary import page_summary
from calib.report.html.write import Page

# A busy machine makes any deadline fail; a submitted change must not fail by the luck of one draw.
settings.register_profile("calib", deadline=None, max_examples=20, derandomize=bool(os.environ.get("CI")))
settings.load_profile("calib")

# Tests run in as many processes as there are cores, and what one replaces is not replaced in another process: others
# share tasks only where a test asks for workers.
places.PATIENCE = math.inf

_NUMBERS = itertools.count()


def pytest_collection_finish() -> None:
    """What collected tests and imported libraries hold stays: the garbage collector need not look at it again.

    It is asked less often too: tables and figures are many small objects, and looking through them takes a tenth of the
    tests' time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a test marked ``mostly_slow``, all sets of parameters after the first few are slow tests."""
    seen: Counter[tuple[Path, str]] = Counter()
    for item in items:
        mark = item.get_closest_marker("mostly_slow")
        if mark is not None and isinstance(item, pytest.Function):
            own = item.path, item.originalname
            seen[own] += 1
            if seen[own] > mark.args[0]:
                item.add_marker(pytest.mark.slow)


@pytest.hookimpl(optionalhook=True)  # without pytest-xdist nobody asks
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give the tests of one folder to one process, so that what they share is made once."""
    if config.getvalue("dist") != "loadgroup":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class ByFolder(LoadScopeScheduling):
        """The group is told by the path: marks reach pytest-xdist in names, which not every pytest lets it change."""

        def _split_scope(self, nodeid: str) -> str:
            file = Path(nodeid.split("::", 1)[0])
            return str(file if file.parent.name == "tests" else file.parent)

    return ByFolder(config, log)


def pytest_unconfigure() -> None:
    """Delete the cache of shared fixtures."""
    shutil.rmtree(os.environ["CALIB_CACHE"], ignore_errors=True)


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every test has an empty cache of reduced bases of its own; the folder is made when something is kept."""
    folder = tmp_path_factory.getbasetemp() / f"cache-{next(_NUMBERS)}"
    monkeypatch.setenv("CALIB_CACHE", str(folder))
    return folder


_PROGRESS = re.compile(r"(compare|sensitivity|calibrate|explain|extend|report|before and after): .*\d")


@pytest.fixture(scope="session")
def one_sentence() -> Callable[[str], bool]:
    """Whether a command refused its input as it must: a sentence, and then at most lines of the user's file."""

    def refused(said: str) -> bool:
        lines = said.splitlines()
        while lines and _PROGRESS.match(lines[0]):  # a slow machine shows how far it came
            del lines[0]
        sentence, *shown = lines or [""]
        own = all(line.startswith("  ") for line in shown) and len(shown) <= 3
        return said.endswith("\n") and sentence.startswith("Error: ") and sentence.endswith(".") and own

    return refused


@pytest.fixture(scope="session")
def opensees() -> ModuleType:
    """OpenSees, an independent finite-element code; the test is skipped where it cannot be loaded."""
    try:
        return opensees_code.load()
    except ImportError as problem:
        pytest.skip(str(problem))


@pytest.fixture(scope="module")
def functions_in_this_process() -> Iterator[None]:
    """A study's own function runs where the test does, for the whole module that uses this.

    The command starts a child process for it, which imports everything anew; what that is for, the tests of faults and
    of the isolation see with the real thing.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.api.staged.isolated", lambda study: study)
        yield


@pytest.fixture(scope="session")
def without_pixels() -> Callable[[Any, str, Any], dict[str, bytes]]:
    """Gives the file of a figure without its pixels, which take longest."""
    return lambda figure, name, formats, *_: {"png": b"\x89PNG" + name.encode()}


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch, without_pixels: Callable[[Any, str, Any], dict[str, bytes]]) -> None:
    """Figures are made and their files written, but without pixels: for tests of the files."""
    monkeypatch.setattr("calib.report.figures.content", without_pixels)
    monkeypatch.setattr("calib.report.figures.svg_text", lambda figure, name: f"<svg><!-- {name} --></svg>")


def _unwritten(results: Any, *given: Any) -> Page:
    """Stands in for the writing of a report."""
    return Page(results.folder / "report.html", page_summary(results))


def _draw_nothing(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    patch.setattr("calib.report.html.write.write_report", _unwritten)


@contextlib.contextmanager
def _no_drawing() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        _draw_nothing(patch)
        yield


@pytest.fixture(scope="session")
def no_drawing() -> Callable[[], contextlib.AbstractContextManager[None]]:
    """Context in which no figures are drawn and no report is written, for fixtures of a module or session."""
    return _no_drawing


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures are drawn and no report is written, which take longest of all in a test of something else.

    By the patch of the test itself: two patches of one attribute that end in the wrong order would leave the inner one.
    """
    _draw_nothing(monkeypatch)
