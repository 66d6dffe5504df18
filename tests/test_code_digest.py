"""Digest of calib's own code: what a module imports counts, and nothing that changes no result."""

import io
import shutil
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

from calib.analyses.provenance.state import WRITES, code_of
from calib.errors.own_code import CALIB
from calib.results import code_digest as digests
from calib.results.code_digest import code_digest, imports_of

FILES = {
    "__init__.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from calib.solve import modes as modes\n",
    "results/version.py": '__version__ = "1"\n',
    "explain.py": "import calib.results.version\nfrom calib import modes\nfrom calib.room import Basis\n",
    "solve.py": "from calib.room import cache\n\n\ndef modes():\n    return [1, \"# no comment\"]\n",
    "room/__init__.py": "from lazy_loader import attach_stub\n__getattr__, _, _ = attach_stub(__name__, __file__)\n",
    "room/__init__.pyi": "from . import cache\nfrom .basis import (\n    Basis as Basis,\n)\nfrom .other import A\n",
    "room/basis.py": '"""Bases."""\n\nLIMIT = 2.0\n"""Bytes."""\n\nclass Basis:\n    """A basis."""\n\n    size = 1\n',
    "room/cache.py": "KEPT = 1\n",
    "room/other.py": "class Other:\n    size = 3\n",
}  # fmt: skip


@pytest.fixture
def package(tmp_path):
    for name, text in FILES.items():
        (tmp_path / "calib" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "calib" / name).write_text(text)
    return tmp_path / "calib"


def digest(package: Path) -> str:
    return code_digest("calib.explain", folder=package)


def edited(package: Path, file: str, old: str, new: str) -> str:
    text = (package / file).read_text()
    assert old in text
    (package / file).write_text(text.replace(old, new))
    return digest(package)


def test_names_are_followed_to_the_files_that_define_them(package):
    """Through a package's own face, through one that imports its modules on first use, and to modules."""
    found = {file.relative_to(package).as_posix() for file in imports_of("calib.explain", folder=package)}
    assert found == {"explain.py", "solve.py", "room/basis.py", "room/cache.py"}
    apart = imports_of("calib.explain", apart=["calib.solve"], folder=package)
    assert {file.name for file in apart} == {"explain.py", "basis.py"}
    assert {file.name for file in imports_of("calib.room", folder=package)} == {
        "__init__.py", "basis.py", "cache.py", "other.py",
    }  # fmt: skip
    with pytest.raises(FileNotFoundError, match=r"calib\.nowhere"):
        code_digest("calib.nowhere", folder=package)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("room/basis.py", "2.0", "3.0"),
        ("solve.py", "# no comment", "# a comment"),
        ("solve.py", "    return", "    if True:\n        return"),
        ("room/cache.py", "KEPT = 1", "KEPT = 2"),
        ("explain.py", "from calib import modes", "from calib.room.other import modes"),
        ("room/__init__.pyi", "from .basis import (\n    Basis as Basis,\n)", "from .other import Basis"),
    ],
)
def test_code_that_may_change_a_result_changes_the_digest(package, file, old, new):
    before = digest(package)
    assert digest(package) == before != edited(package, file, old, new)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("room/basis.py", '"""A basis."""', '"""Another\n\n    description."""  # and a comment\n'),
        ("room/basis.py", '"""Bytes."""\n', "# bytes\n\n\n"),
        ("solve.py", "    return", "    # why\n\n    return"),
        ("room/other.py", "size = 3", "size = 4"),
        ("results/version.py", "1", "2"),
        (
            "explain.py",
            "import calib.results.version\n",
            "import calib.results.version\nif TYPE_CHECKING:\n    from calib import x\n",
        ),
    ],
)
def test_words_and_what_is_not_imported_leave_the_digest(package, file, old, new):
    before = digest(package)
    assert edited(package, file, old, new) == before


def test_a_file_that_moves_leaves_the_digest(package):
    before = digest(package)
    (package / "room/inner").mkdir()
    (package / "room/basis.py").rename(package / "room/inner/spaces.py")
    assert edited(package, "room/__init__.pyi", ".basis", ".inner.spaces") == before
    assert edited(package, "room/inner/spaces.py", "2.0", "3.0") != before


def test_a_module_that_becomes_a_folder_is_found_there(package):
    before = digest(package)
    (package / "solve").mkdir()
    (package / "solve.py").rename(package / "solve/__init__.py")
    assert digest(package) == before
    assert edited(package, "solve/__init__.py", "return [1", "return [2") != before


def test_later_processes_take_digests_that_are_kept_until_a_file_changes(package, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (package / "__pycache__").mkdir()
    before, files = digest(package), digests.imports_of
    digests._digest.cache_clear()
    monkeypatch.setattr(digests, "imports_of", lambda *_, **__: pytest.fail("found again"))
    assert digest(package) == before
    monkeypatch.setattr(digests, "imports_of", files)
    assert edited(package, "solve.py", "return [1", "return [2") != before
    digests._digest.cache_clear()
    for damaged in ("", "[]", "{}", '{"state": 1}'):
        next((package / "__pycache__").glob("code_digest.json")).write_text(damaged)
        assert edited(package, "solve.py", "return [2", "return [2") != before


def tokens(text: str) -> list[str]:
    """Tokens of a text without comments, line ends, and strings that are statements of their own."""
    out, first = [], True
    held: str | None = None
    blank = {tokenize.NL, tokenize.COMMENT, tokenize.INDENT, tokenize.DEDENT}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in blank:
            continue
        if token.type == tokenize.NEWLINE:
            first, held = True, None
            continue
        if held is not None:
            out.append(held)
            held = None
        if first and token.type == tokenize.STRING:
            held = token.string
        else:
            out.append(token.string)
        first = False
    return out


@pytest.mark.parametrize("analysis", WRITES)
def test_every_analysis_names_files_that_are_there(analysis):
    assert len(code_of(analysis)) == 16


@pytest.mark.medium
def test_of_every_file_all_code_counts_and_nothing_else():
    """The digest reads texts by a pattern, which is faster; Python's own tokens say the same."""
    for file in sorted(CALIB.rglob("*.py"))[::4]:
        text = file.read_text("utf-8")
        code = digests._code(text)
        assert tokens(code) == tokens(text), file
        assert not any(t.type == tokenize.COMMENT for t in tokenize.generate_tokens(io.StringIO(code).readline)), file


# -- what a user's function holds of calib ----------------------------------------------------------------------------

HELD = """
import calib
from calib.results.fingerprint import digest_of
from calib.structure.effects.perturbations import scaling_by_function
PARAMETER = calib.Parameter("a", 2.0, 1.0, 3.0)
def closed(parameter, helper, kind):
    def answer(values):
        return {"y": values["a"] * parameter.value + 1.0, "z": helper, "k": kind}
    return answer
print(digest_of(closed(PARAMETER, scaling_by_function, calib.ParameterSpace)))
"""


@pytest.mark.slow
def test_a_function_that_holds_objects_of_calib_counts_by_its_own_code(tmp_path):
    """Neither other code of calib nor another place of its files makes stored points of a user's function invalid."""
    shutil.copytree(CALIB, tmp_path / "calib", ignore=shutil.ignore_patterns("__pycache__"))

    def fingerprint(script: str = HELD) -> str:
        (tmp_path / "script.py").write_text(script)
        ran = subprocess.run(
            [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=True,
            env={"PYTHONPATH": str(tmp_path)},
        )  # fmt: skip
        return ran.stdout

    before = fingerprint()
    for name in ("problem/parameter.py", "structure/effects/perturbations.py", "problem/space.py"):
        file = tmp_path / "calib" / name
        file.write_text(file.read_text() + "\nLATER = 1\n")
    perturbations = tmp_path / "calib/structure/effects/perturbations.py"
    perturbations.rename(perturbations.with_name("elsewhere.py"))
    moved = HELD.replace("structure.effects.perturbations", "structure.effects.elsewhere")
    perturbations.write_text("from calib.structure.effects.elsewhere import *  # noqa: F403\n")
    # The script's own text is part of the function's code, so the import that moved is kept as it was.
    assert fingerprint() == before
    assert fingerprint(moved) != before
    assert fingerprint(HELD.replace("+ 1.0", "+ 2.0")) != before
    assert fingerprint(HELD.replace('"a", 2.0', '"a", 2.5')) != before
