"""A small study for questions that take well under a second, and the reduced basis that all blind studies share."""

import importlib.util
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from calib.questions.library import modal_hypotheses
from calib.results import Results
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]


def script(path: Path) -> ModuleType:
    """A file that is no module of a package."""
    spec = importlib.util.spec_from_file_location(f"{path.parent.name}_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def mast() -> ModuleType:
    """See `tests/template/mast_effects.py`."""
    return script(ROOT / "tests/template/mast_effects.py")


@pytest.fixture(scope="session")
def twin_maker() -> ModuleType:
    """The generator of the blind studies."""
    return script(ROOT / "studies/hidden_bogie/make_twin.py")


@pytest.fixture(scope="session")
def with_basis(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Results], Results]:
    """Puts the effect basis of the blind studies into a folder: they have one model, and it takes longest of all."""
    kept = Results.at(tmp_path_factory.mktemp("basis"), "hidden_bogie")
    modal_hypotheses(Study.load(ROOT / "studies/hidden_bogie"), kept)
    (path,) = kept.path.glob("basis_effects_*.npz")

    def put(results: Results) -> Results:
        shutil.copy(path, results.path)
        return results

    return put
