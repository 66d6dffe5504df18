"""Benchmarks are run by hand: each must at least find what it imports."""

import importlib
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parent / "benchmarks"
SCRIPTS = sorted(file.stem for file in BENCH.glob("*.py"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_benchmark_can_be_imported(monkeypatch, name):
    monkeypatch.syspath_prepend(str(BENCH))
    assert importlib.import_module(name).__doc__
    assert sys.modules[name].__file__ == str(BENCH / f"{name}.py")
