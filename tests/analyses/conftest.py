"""Small studies that are analysed in well under a second, and the reduced basis that all blind studies share."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from calib.analyses.explain import explain
from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.missing.findings import ExplanationResult
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
CHAIN = ROOT / "studies/five_mass_chain"
HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')


@pytest.fixture(scope="session")
def mast() -> ModuleType:
    """See `tests/template/mast_effects.py`."""
    return module_of(ROOT / "tests/template/mast_effects.py")


@pytest.fixture(scope="session")
def edited() -> Callable[[Path, str, str], Path]:
    """Replaces words in the study file of a folder, and returns the folder."""

    def edit(folder: Path, old: str, new: str) -> Path:
        text = (folder / "study.toml").read_text()
        assert old in text, old
        (folder / "study.toml").write_text(text.replace(old, new))
        return folder

    return edit


@pytest.fixture(scope="session")
def guyed(
    mast: ModuleType, edited: Callable[[Path, str, str], Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[LoadedStudy, Results, ExplanationResult, list[str]]:
    """A mast with a guy rope that its model lacks, one mode and two sensors held out; last the reported progress."""
    folder = tmp_path_factory.mktemp("guyed")
    study = LoadedStudy.load(edited(mast.write_study(folder / "mast", {"guy": 12000.0}), *HELD))
    results, progress = Results.at(folder / "results", study.name), []
    return study, results, explain(study, results, lambda stage, *more: progress.append(stage)), progress


@pytest.fixture(scope="session")
def bare(mast: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> tuple[LoadedStudy, Results, ExplanationResult]:
    """A mast without a missing effect."""
    folder = tmp_path_factory.mktemp("bare")
    study = LoadedStudy.load(mast.write_study(folder / "mast"))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


@pytest.fixture(scope="session")
def chain(tmp_path_factory: pytest.TempPathFactory) -> tuple[LoadedStudy, Results, ExplanationResult]:
    """The five-mass chain, a function of scalar responses."""
    study = LoadedStudy.load(CHAIN)
    results = Results.at(tmp_path_factory.mktemp("chain"), study.name)
    return study, results, explain(study, results)


@pytest.fixture
def chain_folder(tmp_path: Path) -> Path:
    """A copy of the chain's study, to be edited."""
    return Path(shutil.copytree(CHAIN, tmp_path / "chain", ignore=shutil.ignore_patterns("__pycache__", "results")))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def rig(here: Path) -> Path:
    """A copy of the four-storey rig's study with a library of two effects."""
    shutil.copytree(ROOT / "studies/four_storey_rig", "rig", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "tests/template/rig_effects.py", "rig/effects.py")
    file = Path("rig/study.toml")
    file.write_text('effects = "effects.py:library"\n' + file.read_text("utf-8"), "utf-8")
    return Path("rig")


@pytest.fixture
def sums(here: Path) -> Path:
    """A study of the sum of two numbers, whose file has comments and a list of several lines."""
    return Path(shutil.copytree(ROOT / "tests/template/sums", "sums", ignore=shutil.ignore_patterns("__pycache__")))


@pytest.fixture(scope="session")
def tree() -> Callable[[str | Path], dict[str, bytes]]:
    """Every file of a folder with its content, without compiled Python."""

    def read(folder: str | Path) -> dict[str, bytes]:
        files = [p for p in Path(folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
        return {str(p.relative_to(folder)): p.read_bytes() for p in files}

    return read


@pytest.fixture(scope="session")
def twin_maker() -> ModuleType:
    """The generator of the blind studies."""
    return module_of(ROOT / "studies/hidden_bogie/make_twin.py")


@pytest.fixture(scope="session")
def blind_basis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The effect basis of the blind studies, which share one model: its training takes longest."""
    kept = Results.at(tmp_path_factory.mktemp("basis"), "hidden_bogie")
    modal_hypotheses(LoadedStudy.load(ROOT / "studies/hidden_bogie"), kept)
    (path,) = kept.path.glob("basis_effects_*.npz")
    return path


@pytest.fixture(scope="session")
def with_basis(blind_basis: Path) -> Callable[[Results], Results]:
    """Puts that basis into a folder."""

    def put(results: Results) -> Results:
        shutil.copy(blind_basis, results.path)
        return results

    return put


@pytest.fixture(scope="session")
def blindly() -> Callable[[str, Results], Path]:
    """Explains a study by name, asserts that no truth file is opened, and returns the folder of results."""
    opened: list[str] = []

    def watch(event: str, arguments: tuple[object, ...]) -> None:  # an audit hook cannot be removed
        if event == "open" and opened and "truth" in str(arguments[0]):
            opened.append(str(arguments[0]))

    sys.addaudithook(watch)

    def answer(name: str, results: Results) -> Path:
        opened.append("watching")
        try:
            explain(LoadedStudy.load(ROOT / "studies" / name), results)
            assert opened == ["watching"]
        finally:
            opened.clear()
        return results.path

    return answer
