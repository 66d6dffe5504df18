"""Damaged tables and records are read or refused in one sentence: dozens of them, hundreds in the slow suite.

`tests/benchmarks/damaged_tables.py` has ten thousand.
"""

import importlib
import json
import random
import sys
from pathlib import Path

import pytest

from calib.errors.errors import InputError
from calib.report.figures import Figures
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.report.html.write import SECTIONS, Contents, section

BENCH = Path(__file__).resolve().parents[2] / "benchmarks"
VALUES = ("x", 7, -1.5, None, True, [], {}, [1], ["a"], {"a": 1}, [[]])


@pytest.fixture(scope="module")
def damaged_tables():
    """The script of the benchmark."""
    sys.path.insert(0, str(BENCH))
    try:
        yield importlib.import_module("damaged_tables")
    finally:
        sys.path.remove(str(BENCH))


@pytest.mark.medium
@pytest.mark.parametrize("trials", [20, pytest.param(400, marks=pytest.mark.slow)])
def test_damaged_tables_are_read_or_refused(damaged_tables, everything, scalar, unrendered, tmp_path, trials):
    studies = [(home.parent.parent / home.name, home) for home in (everything, scalar)]
    studies[1] = (scalar.parent.parent / "chain", scalar)
    bench = damaged_tables.Bench(tmp_path, *studies)
    found = [bench.damage(number)[0] for number in range(trials)]
    assert set(found) == {"read", "refused"} and min(found.count("read"), found.count("refused")) > trials / 5


def changed(value, rng):
    """Named values, one of which, at any depth, has another type."""
    if isinstance(value, dict) and value and rng.random() < 0.8:
        key = rng.choice(sorted(value))
        return {**value, key: changed(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.5:
        return [changed(value[0], rng), *value[1:]]
    return rng.choice(VALUES)


def reader(name):
    """Function of the results that makes a section of the page."""
    return lambda results: section(name, results, Contents(lambda figure: 1))


def reads(part, results, name):
    """Whether a part of the page reads that file, which `StudyResults` then caches."""
    part(results)
    return name in vars(results)


@pytest.mark.medium
@pytest.mark.parametrize("trials", [4, pytest.param(48, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", ["summary", *(pytest.param(name, marks=pytest.mark.slow) for name in ("record", "explanation"))]
)
def test_values_of_another_type_are_read_or_refused(folder, name, trials):
    path = folder / f"{name}.json"
    whole = json.loads(path.read_text())
    for table in ("mesh_points", "deflection_after"):  # the slowest figures, which read no such value
        (folder / f"{table}.csv").unlink()
    readers = [
        part
        for part in (page_summary, *(reader(name) for name in SECTIONS))
        if reads(part, StudyResults(folder, "Whole", True), name)
    ]
    assert len(readers) >= 2
    refused = 0
    for number in range(trials):
        path.write_text(json.dumps(changed(whole, random.Random(f"{name} {number}"))))
        results = StudyResults(folder, "Damaged", True)
        try:
            for part in readers:
                part(results)
        except InputError as fault:
            assert path.name in str(fault) and "\n" not in str(fault)
            refused += 1
    assert refused > trials / 8 or trials < 8  # of few, none may concern what is read


def test_a_duplicate_row_is_refused_with_its_line(folder):
    path = folder / "parameters.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[-1], ""]))
    with pytest.raises(InputError, match=rf"parameters\.csv, line {len(lines) + 1}"):
        Figures(folder, "Damaged", True).save()
