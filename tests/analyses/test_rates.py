"""A few runs of the blind test bench: named effects are present, and present visible effects are named.

`tests/benchmarks/rates.py` makes hundreds of runs. Each run has its own seed.
"""

import importlib
import sys
from itertools import islice
from pathlib import Path

import pytest

from calib.missing.rules import RULES
from calib.missing.settings import DEFAULT
from calib.structure.reduction.basis import Basis

# test_explain.py covers the same with a mast and a chain, tests/missing/test_explain.py with toy problems.
pytestmark = pytest.mark.slow
BENCH = Path(__file__).resolve().parents[1] / "benchmarks"
BEYOND = 40
"""Evaluations beyond the budget: of the fit that is running when it ends, and those that a verdict needs."""
NAMING = ("effect", "indistinguishable", "two_effects", "several_effects")


@pytest.fixture(scope="module")
def bench():
    """The scripts of the benchmark, which import each other by name."""
    sys.path.insert(0, str(BENCH))
    try:
        names = ("rates_scenarios", "rates_subject", "rates_world", "rates_table")
        yield {name: importlib.import_module(name) for name in names}
    finally:
        sys.path.remove(str(BENCH))


@pytest.fixture(scope="module")
def world(bench, blind_basis, tmp_path_factory):
    """The bogie with the blind studies' basis."""

    class Own(bench["rates_world"].World):
        def _basis(self, *_):
            return Basis.load(blind_basis)

    return Own(bench["rates_subject"].BOGIE, tmp_path_factory.mktemp("rates"), "test")


@pytest.fixture(scope="module")
def run(bench, world):
    """One run of a scenario by name, cached."""
    kinds = {s.name: s for s in bench["rates_scenarios"].scenarios(world.subject, world.study.candidates)}
    done = {}

    def make(name, number):
        if (name, number) not in done:
            done[name, number] = world.run(kinds[name], number)
        return done[name, number]

    return make


def no_wrong_name(row):
    assert row["outcome"] != "failed", row.get("error")
    assert row["outcome"] not in ("wrong", "extra", "mixed"), row
    assert set(row["credible"]) <= set(row["hidden"]) or row["outcome"] in ("right", "second")
    decisions = 1 + (row["noise_scale"] != 1)  # a second decision with a larger standard deviation
    parts = decisions * (1 + RULES.paired + RULES.stepped + RULES.beyond)
    parts += (RULES.anew + RULES.beyond) * row["begun_anew"]
    assert row["evaluations"] <= parts * DEFAULT.budget + BEYOND


@pytest.mark.parametrize("number", [0, 1])
def test_nothing_is_named_where_nothing_is_missing(run, number):
    row = run("nothing", number)
    no_wrong_name(row)
    assert row["verdict"] == "nothing_detectable" and row["credible"] == [] and row["hidden"] == []


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("weak_damper/M", 0),
        ("crossbar_mass/M", 0),
        pytest.param("brake_unit/M", 2, marks=pytest.mark.whole),
        ("brake_unit/L", 1),  # the base model converges elsewhere
        pytest.param("primary_uneven/L", 0, marks=pytest.mark.whole),
    ],
)
def test_a_visible_effect_is_named_with_its_magnitude(run, name, number):
    row = run(name, number)
    no_wrong_name(row)
    assert min(row["visible"]) >= 6
    assert row["outcome"] == "right" and row["verdict"] == "effect" and row["credible"] == [name.split("/")[0]]
    assert row["covers"] and 0.7 < row["magnitude_over_true"] < 1.4
    (rms_before, _), (rms_after, expected) = (row[f"held_out_sensors_{stage}"] for stage in ("before", "after"))
    assert rms_after < 1.3 * expected and rms_after < 1.05 * rms_before


@pytest.mark.parametrize(
    "name", ["outside/heavy_rear/L", pytest.param("without/weak_damper/L", marks=pytest.mark.whole)]
)
def test_an_effect_outside_the_library_is_not_misnamed(run, name):
    """A design that no effect describes, and an effect that was taken out of the library."""
    row = run(name, 0)
    no_wrong_name(row)
    assert min(row["visible"]) >= 6
    assert row["verdict"] in ("none_explains", "partial", "misfit_unlocated") and row["credible"] == []


def test_a_standard_deviation_stated_half_as_large_names_nothing(run):
    row = run("noise", 0)
    no_wrong_name(row)
    assert row["verdict"] in ("nothing_detectable", "noise_underestimated") and row["credible"] == []
    assert 1.5 < row["measured_scale"] < 2.5 or row["noise_scale"] > 1.5


def test_a_run_depends_only_on_its_number(bench, world, run):
    """The same scenario and number give the same measurement, another number a different one."""
    kinds = {s.name: s for s in bench["rates_scenarios"].scenarios(world.subject, world.study.candidates)}
    one, again, other = (world.measure(kinds["weak_damper/M"], k) for k in (0, 0, 1))
    assert one.values == again.values != other.values
    assert (one.whole.natural_freq == again.whole.natural_freq).all()
    assert (one.whole.natural_freq != other.whole.natural_freq).all()
    row = run("weak_damper/M", 0)
    assert row["magnitudes"] == {"weak_damper": one.values["weak_damper"]}


@pytest.mark.whole
def test_the_first_runs_of_the_plan_keep_the_required_rates(bench, world):
    """Too few runs to estimate a rate, enough to detect a defect."""
    runs = (
        (s, k) for s, k in bench["rates_scenarios"].plan(world.subject, world.study.candidates) if s.library == "own"
    )
    rows = [world.run(s, k) for s, k in islice(runs, 30)]
    assert not [row for row in rows if row["outcome"] == "failed"]
    for rate in bench["rates_table"].rates(rows):
        if rate.n:
            # Nearly twenty criteria are tested, some by a single run, which may be the allowed one in a hundred.
            assert bench["rates_table"].chance_of(rate) > 0.005, rate
    assert sum(bench["rates_table"].wrong(row) for row in rows) <= 2
