"""The dependencies of ARCHITECTURE.md: which part may import which."""

import ast
import itertools
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import calib

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "ARCHITECTURE.md"

# From the bottom up: a part may import itself and anything of a lower rank.
RANKS = (
    {"place"},
    {"excerpt", "own_code", "csv_entries", "toml_places", "cell"},
    {"errors", "interrupt", "written", "neighbours", "version", "threads", "renamed", "stage", "answer"},
    {"given", "units", "on_limit", "mac", "degrees_of_freedom", "outcome", "table", "fingerprint", "tasks"},
    {"parameter"},
    {"space"},
    {"candidate"},
    {"effect", "fault", "differences", "measurement", "sampling", "worker", "named_values"},
    {"structure"},
    {"function", "modal_analysis"},
    {"correlation"},
    {"section", "evaluate", "results", "problem"},
    {"measurement_settings"},
    {"settings"},
    {"joint", "limits", "ledger", "loading", "executor", "team", "study_text"},
    {"study_file"},
    {"forward"},
    {"study"},
    {"several"},
    {"sensitivity", "inference"},
    {"missing"},
    {"analyses"},
    {"report"},
    {"terminal"},
    {"progress"},
    {"example", "front"},
    {"console"},
    {"cli"},
    {"__main__"},
)
RANK = {name: k for k, names in enumerate(RANKS) for name in names}
# Apart from ranks: searches know neither finite elements nor files, figures know tables only.
FORBIDDEN = {
    "inference": {"structure", "measurement", "correlation", "study", "settings", "ledger"},
    "sensitivity": {"structure", "measurement", "correlation", "study", "settings", "ledger"},
    "missing": {"structure", "measurement", "correlation", "study", "settings", "ledger"},
    "report": set(RANK) - {"errors", "table", "named_values", "written", "stage", "report"},
    "structure": {"correlation", "study", "inference", "sensitivity"},
}


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


def test_the_method_knows_no_structure_and_models_no_study():
    for _, file in parts():
        assert not any(name.split(".")[0] in ("models", "studies") for name in imports(file)), file
    for file in (ROOT / "models").rglob("*.py"):
        for name in imports(file):
            head = name.split(".")
            assert head[0] != "studies", file
            if head[0] == "calib" and len(head) > 1:
                assert head[1] in ("structure", "space", "errors", "function", "effect"), f"{file} imports {name}"


def test_only_the_report_imports_plotting_libraries():
    for part, file in parts():
        if part != "report":
            assert not {name.split(".")[0] for name in imports(file, run_only=True)} & {"matplotlib", "jinja2"}, file


def test_the_page_names_every_part_and_every_folder_on_one_page():
    """As files stand on one page: 1000 words are about that."""
    page = PAGE.read_text("utf-8")
    tree = page.split("```")[1]
    for part, file in parts():
        name = part if (ROOT / "calib" / part).is_dir() else f"{part}.py"
        assert file.name == "__init__.py" or re.search(rf"(?<![\w.]){re.escape(name)}", tree), name
    assert len(page.split()) <= 1000


def test_the_page_points_its_arrows_as_the_code_does():
    arrows = PAGE.read_text("utf-8").split("## Dependencies")[1].split("`cli`")[1].split("\n\n")[0]
    told = [re.findall(r"`(\w+)`", step) for step in f"`cli`{arrows}".split("→")]
    assert len(told) > 10
    for above, below in itertools.pairwise(told):
        assert min(RANK[name] for name in above) > max(RANK[name] for name in below), (above, below)


def test_every_file_says_what_it_holds():
    """The list of modules in the documents is made of these sentences."""
    for file in [*(ROOT / "calib").rglob("*.py"), *(ROOT / "models").rglob("*.py")]:
        words = (ast.get_docstring(tree_of(file)) or "").split("\n\n")[0]
        assert words and words.count("\n") < 2, f"{file}: {words}"


def test_the_version_is_told_once():
    told = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    assert told == calib.__version__
