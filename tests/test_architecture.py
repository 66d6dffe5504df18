"""The dependencies of ARCHITECTURE.md: which part may import which."""

import ast
import itertools
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import calib
from calib.results.version import FALLBACK

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "ARCHITECTURE.md"

# From the bottom up: a room may import itself and anything of a lower rank.
RANKS = (
    {"errors"},
    {"execution"},
    {"results"},
    {"problem"},
    {"measurement"},
    {"structure", "imports"},
    {"modal_analysis"},
    {"correlation"},
    {"inference", "sensitivity"},
    {"missing"},
    {"experiment"},
    {"study"},
    {"hypotheses"},
    {"analyses"},
    {"report"},
    {"api"},
    {"workbench"},
    {"command"},
    {"__main__"},
)
RANK = {name: k for k, names in enumerate(RANKS) for name in names}
# Apart from ranks: searches know neither finite elements nor files, figures know tables only.
FORBIDDEN = {
    "inference": {"structure", "measurement", "correlation", "study"},
    "sensitivity": {"structure", "measurement", "correlation", "study"},
    "missing": {"structure", "measurement", "correlation", "study"},
    "report": set(RANK) - {"errors", "execution", "results", "report"},
    "structure": {"correlation", "study", "inference", "sensitivity"},
}
# What models and libraries of effects may import, so that everything below may move.
FACES = {"calib", "calib.structure"}
ROOMS = 21
"""Folders at the first level: more are hard to keep in mind."""


@cache  # every file is looked at by each test
def tree_of(file: Path) -> ast.Module:
    return ast.parse(file.read_text("utf-8"))


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """A statement and all below it; expressions, which hold most of the nodes and no import, are passed over."""
    yield node
    for field in ("body", "handlers", "orelse", "finalbody", "cases"):
        for below in getattr(node, field, ()):
            yield from statements(below)


@cache
def imports(file: Path, run_only: bool = False) -> set[str]:
    """What a file imports; where asked for without what it imports for types only."""
    found = set()
    tree = tree_of(file)
    typed = [n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING" and run_only]
    for node in (node for part in tree.body if part not in typed for node in statements(part)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def parts() -> list[tuple[str, Path]]:
    files = sorted((ROOT / "calib").rglob("*.py"))
    assert len(files) > 20
    return [(f.relative_to(ROOT / "calib").parts[0].removesuffix(".py"), f) for f in files]


def used_parts(file: Path) -> set[str]:
    return {name.split(".")[1] for name in imports(file) if name.startswith("calib.") and name.split(".")[1] in RANK}


def test_every_part_has_a_rank():
    assert {part for part, _ in parts()} - {"__init__", "template"} <= set(RANK)


def test_imports_point_down():
    for part, file in parts():
        if part != "__init__":
            for other in used_parts(file) - {part}:
                assert RANK[other] < RANK[part], f"{file.name} ({part}) imports {other}"


def test_forbidden_imports():
    for part, file in parts():
        crossed = used_parts(file) & FORBIDDEN.get(part, set())
        assert not crossed, f"{file} imports {crossed}"


@pytest.mark.medium
def test_the_method_knows_no_structure_and_models_no_study():
    for _, file in parts():
        assert not any(name.split(".")[0] in ("models", "studies") for name in imports(file)), file
    for file in (ROOT / "models").rglob("*.py"):
        for name in imports(file):
            assert name.split(".")[0] != "studies", file


def users_files() -> list[Path]:
    """Models, and what studies name as a model, as effects or as hidden causes; makers of twins are not among them."""
    makers = (
        "make_twin.py",
        "article.py",
        "article_figures.py",
        "blind_twin.py",
        "frf_twin.py",
        "figure_set.py",
        "outside.py",
    )
    studies = [file for file in (ROOT / "studies").rglob("*.py") if file.name not in makers]
    return [*(ROOT / "models").rglob("*.py"), *studies, *(ROOT / "calib" / "template").rglob("*.py")]


@pytest.mark.medium
def test_models_and_effects_import_the_public_faces_alone():
    files = users_files()
    assert len(files) > 60
    for file in files:
        for node in ast.walk(tree_of(file)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "calib":
                assert node.module in FACES, f"{file} imports {node.module}"
            elif isinstance(node, ast.Import):
                assert not any(alias.name.startswith("calib.") for alias in node.names), file


def test_documents_and_generated_code_import_the_public_faces_alone():
    pages = [*(ROOT / "docs").glob("*.md"), ROOT / "README.md", *(ROOT / "studies").rglob("*.md")]
    found = [(page, m) for page in pages for m in re.findall(r"from (calib[\w.]*) import", page.read_text("utf-8"))]
    assert len(found) > 5
    own = ROOT / "calib" / "hypotheses" / "proposals" / "code.py"
    found += [(own, m) for m in re.findall(r'"from (calib[\w.]*) import', own.read_text("utf-8"))]
    for page, module in found:
        assert module in FACES, f"{page} imports {module}"


def test_no_public_name_hides_a_module():
    """`calib.structure.NAME` is the name or the module of that name, whichever was imported first."""
    import calib.structure

    modules = {path.stem for path in (ROOT / "calib" / "structure").iterdir()}
    assert not modules & set(calib.structure.__all__)
    assert all(hasattr(calib.structure, name) for name in calib.structure.__all__)


def test_the_first_level_is_a_few_rooms():
    level = {path for path in (ROOT / "calib").iterdir() if path.name != "__pycache__"}
    folders = {path.name for path in level if path.is_dir()}
    assert len(folders) <= ROOMS
    assert folders - {"template"} <= set(RANK)
    assert {path.name for path in level if path.suffix == ".py"} == {"__init__.py", "__main__.py"}


def test_only_the_report_imports_plotting_libraries():
    for part, file in parts():
        if part != "report":
            assert "matplotlib" not in {name.split(".")[0] for name in imports(file, run_only=True)}, file


def test_the_page_names_every_part_and_every_folder_on_one_page():
    """As files stand on one page: 1000 words are about that."""
    page = PAGE.read_text("utf-8")
    tree = page.split("```")[1]
    for part, file in parts():
        name = part if (ROOT / "calib" / part).is_dir() else f"{part}.py"
        assert file.name == "__init__.py" or re.search(rf"(?<![\w.]){re.escape(name)}", tree), name
    assert len(page.split()) <= 1000


def test_the_page_points_its_arrows_as_the_code_does():
    arrows = PAGE.read_text("utf-8").split("## Dependencies")[1].split("`command`")[1].split("\n\n")[0]
    told = [re.findall(r"`(\w+)`", step) for step in f"`command`{arrows}".split("→")]
    assert len(told) > 10
    for above, below in itertools.pairwise(told):
        assert min(RANK[name] for name in above) > max(RANK[name] for name in below), (above, below)


ENTRIES = {"main"}
"""What every program has."""


@pytest.mark.medium
def test_a_public_name_is_defined_in_one_file():
    """Whoever searches for a name finds its definition, and no other."""
    places: dict[str, set[Path]] = {}
    for _, file in parts():
        for node in tree_of(file).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, set()).add(file)
    assert len(places) > 1000
    assert {name for name, files in places.items() if len(files) > 1} <= ENTRIES


@pytest.mark.medium
def test_every_file_says_what_it_holds():
    """The list of modules in the documents is made of these sentences."""
    for file in [*(ROOT / "calib").rglob("*.py"), *(ROOT / "models").rglob("*.py")]:
        words = (ast.get_docstring(tree_of(file)) or "").split("\n\n")[0]
        assert words and words.count("\n") < 2, f"{file}: {words}"


def test_the_version_of_a_clone_is_the_fallback_of_a_build():
    told = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools_scm"]
    assert told["fallback_version"] == FALLBACK
    written = ROOT / told["version_file"]
    assert calib.__version__ == (written.read_text("ascii").strip() if written.exists() else FALLBACK)
