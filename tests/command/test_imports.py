"""What the command imports before it has anything to compute."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "scipy", "pandas", "matplotlib", "pymoo", "SALib", "jinja2")
SCRIPT = """
import sys
from calib.command import cli
code = cli.execute(sys.argv[1:])
print("imported:", *sys.modules)
sys.exit(code)
"""


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["run", "--help"], ["frobnicate"]])
def test_nothing_that_computes_is_imported_to_tell_the_version_or_the_options(arguments):
    command = [sys.executable, "-c", SCRIPT, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == (2 if arguments == ["frobnicate"] else 0)
    imported = {name.split(".")[0] for name in done.stdout.rpartition("imported: ")[2].split()}
    assert "calib" in imported and not imported & set(HEAVY)


@pytest.mark.slow
def test_a_process_that_evaluates_a_study_imports_no_more_than_it_needs():
    command = [sys.executable, "-c", "import sys, calib.study.study; print(*sys.modules)"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    imported = set(done.stdout.split())
    assert "calib.study.study" in imported
    scipy = {f"scipy.{name}" for name in ("signal", "stats", "optimize", "special", "ndimage", "spatial")}
    assert not imported & {*scipy, "pandas", "pyuff", "matplotlib", "pymoo", "SALib", "jinja2"}
