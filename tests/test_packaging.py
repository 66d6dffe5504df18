"""The wheel holds calib alone, and a study finds the code that it names wherever calib comes from."""

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from calib.errors.errors import InputError
from calib.results.version import FALLBACK
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[1]
BUILD = (
    "import sys; from setuptools import build_meta; "
    "print(build_meta.build_wheel(sys.argv[1], {'--build-option': ['--quiet']}))"
)
MODEL = """\
from calib import FunctionModel, Parameter, ParameterSpace
from {package}.springs import deflection


def jack(value=1.0):
    return FunctionModel("jack", ParameterSpace([Parameter("k", value, 0.5, 2.0)]), deflection)
"""
SPRINGS = "def deflection(values):\n    return {'u': 1.0 / values['k']}\n"
STUDY = 'title = "Jack"\nmodel = "{package}.models:jack"\n\n[measurement]\nresponses = "u.csv"\n'
COMMAND = "import sys; from calib.command import cli; raise SystemExit(cli.execute(sys.argv[1:]))"
LOAD = """
from calib.study.study import LoadedStudy
model = LoadedStudy.load(sys.argv[1]).model
print(model.name, *model.space.names)
"""
# The study is loaded by a process of calib's own; a function of its package is sent to a process that has loaded none.
IN_WORKERS = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from calib.execution.evaluate import Evaluator
from calib.study.study import EvaluationSource, LoadedStudy

study = LoadedStudy.load(sys.argv[1])
with Evaluator(EvaluationSource.of(study, study.problem), 2) as evaluator:
    print(evaluator.evaluate([{"k": 2.0}])[0].responses["u"])
with ProcessPoolExecutor(1, get_context("spawn")) as pool:
    print(pool.submit(study.model.function, {"k": 2.0}).result()["u"])
"""
PACKAGE = "own_package_of_a_test"


def write_package(folder: Path, package: str = PACKAGE) -> None:
    (folder / package).mkdir(parents=True)
    (folder / package / "models.py").write_text(MODEL.format(package=package))
    (folder / package / "springs.py").write_text(SPRINGS)


def write_study(folder: Path, package: str = PACKAGE) -> Path:
    folder.mkdir(parents=True)
    (folder / "study.toml").write_text(STUDY.format(package=package))
    (folder / "u.csv").write_text("response,value,std\nu,0.8,0.01\n")
    return folder


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of the sources without git's files."""
    if importlib.util.find_spec("setuptools_scm") is None:
        pytest.skip("setuptools-scm is not installed")
    copy, out = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("wheel")
    ignored = shutil.ignore_patterns("__pycache__", "version.txt")
    for name in ("calib", "models"):
        shutil.copytree(ROOT / name, copy / name, ignore=ignored)
    for name in ("pyproject.toml", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, copy)
    command = [sys.executable, "-c", BUILD, str(out)]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (built,) = out.glob("*.whl")
    return built


@pytest.mark.medium
def test_a_wheel_holds_calib_alone(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {"calib", f"calib-{FALLBACK}.dist-info"}
    modules = {str(file.relative_to(ROOT)) for file in (ROOT / "calib").rglob("*.py")}
    assert modules <= set(names)
    assert {"calib/py.typed", "calib/template/study.toml", "calib/report/html/template/section/verdict.html.j2"} <= set(
        names
    )


@pytest.mark.slow
def test_a_wheel_knows_its_version_and_its_example_needs_nothing_else(wheel, tmp_path):
    """From the wheel alone: no models, and no clone of calib."""
    site = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(site)
    told = outside("import calib, importlib.util as u; print(calib.__file__, u.find_spec('models'))", tmp_path, site)
    assert told.stdout.split() == [str(site / "calib/__init__.py"), "None"]
    assert outside(COMMAND, tmp_path, site, "--version").stdout.strip() == f"calib {FALLBACK}"
    assert outside(COMMAND, tmp_path, site, "new", "mast").returncode == 0
    assert outside(LOAD, tmp_path, site, "mast").stdout.split() == ["mast", "E", "m_top", "K_base"]


def outside(code: str, folder: Path, calib_at: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run code in a folder by a process that has the installed libraries but no clone on its path."""
    libraries = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    without_site = f"import sys; sys.path += {libraries}\n"  # no file there adds a clone to the path
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    return subprocess.run(
        [sys.executable, "-S", "-c", without_site + code, *arguments],
        cwd=folder, env=environment | {"PYTHONPATH": str(calib_at), "PYTHONSAFEPATH": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture
def calib_alone(tmp_path) -> Path:
    """A folder that holds calib and nothing else."""
    folder = tmp_path / "calib alone"
    folder.mkdir()
    (folder / "calib").symlink_to(ROOT / "calib")
    return folder


@pytest.mark.medium
def test_a_study_of_the_clone_finds_the_models_from_elsewhere(calib_alone, tmp_path):
    done = outside(LOAD, tmp_path, calib_alone, str(ROOT / "studies/five_mass_chain"))
    assert done.returncode == 0, done.stderr
    assert "chain" in done.stdout


@pytest.mark.slow
def test_worker_processes_find_the_package_of_a_studys_project(calib_alone, tmp_path):
    project = tmp_path / "project"
    write_package(project)
    (project / "pyproject.toml").touch()
    study = write_study(project / "studies/jack")
    done = outside(IN_WORKERS, tmp_path, calib_alone, str(study))
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0.5", "0.5"]


def test_code_above_a_study_that_belongs_to_no_project_is_not_run(tmp_path):
    write_package(tmp_path)
    study = write_study(tmp_path / "jack")
    with pytest.raises(InputError) as caught:
        LoadedStudy.load(study)
    assert PACKAGE in caught.value.problem and "project" in (caught.value.remedy or "")
    write_package(study)
    assert LoadedStudy.load(study).model.name == "jack"


def test_a_studys_own_package_goes_before_that_of_its_project(tmp_path):
    write_package(tmp_path)
    (tmp_path / ".git").mkdir()
    study = write_study(tmp_path / "jack")
    write_package(study)
    file = study / PACKAGE / "models.py"
    file.write_text(file.read_text().replace('"jack",', '"nearer",'))
    assert LoadedStudy.load(study).model.name == "nearer"


def test_equal_names_in_two_projects_are_two_packages(tmp_path):
    path = list(sys.path)
    for name in ("one", "other", "one"):
        project = tmp_path / name
        if not project.exists():
            write_package(project)
            (project / "pyproject.toml").touch()
            file = project / PACKAGE / "models.py"
            file.write_text(file.read_text().replace('"jack",', f'"{name}",'))
            write_study(project / "jack")
        assert LoadedStudy.load(project / "jack").model.name == name
        assert [p for p in sys.path if p not in path] == [str(project)]


def test_a_module_belongs_to_the_project_of_the_file_that_names_it(tmp_path):
    project = tmp_path / "project"
    write_package(project)
    (project / "pyproject.toml").touch()
    write_study(project / "jack")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/study.toml").write_text('base = "../project/jack"\n')
    assert LoadedStudy.load(tmp_path / "mine").model.name == "jack"


def test_a_package_that_is_found_in_place_of_the_named_one_is_told(tmp_path):
    study = write_study(tmp_path / "jack", "email")
    with pytest.raises(InputError) as caught:
        LoadedStudy.load(study)
    assert "email.models" in caught.value.problem and str(Path(os.__file__).parent / "email") in caught.value.problem
