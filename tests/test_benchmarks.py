"""Benchmarks are run by hand: each must at least find what it imports."""

import importlib
import json
import shutil
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parent / "benchmarks"
SCRIPTS = sorted(file.stem for file in BENCH.glob("*.py"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_benchmark_can_be_imported(monkeypatch, name):
    monkeypatch.syspath_prepend(str(BENCH))
    assert importlib.import_module(name).__doc__
    assert sys.modules[name].__file__ == str(BENCH / f"{name}.py")


@pytest.fixture
def bench(monkeypatch):
    """Imports a benchmark by its name."""
    monkeypatch.syspath_prepend(str(BENCH))
    return importlib.import_module


@pytest.mark.slow
def test_what_lies_between_points_is_told_beside_another_kind_that_imitates_it(bench):
    """A stop between the sensors of a plate, which two springs between pairs of sensors imitate within the noise."""
    row = bench("generic_rates").run(1049, "")
    assert row["scenario"] == "stop" and row["verdict"] == "indistinguishable" and row["outcome"] == "second"
    assert any(name.startswith("spring_to_ground_near") for name in row["credible"])


def test_growth_tells_its_exponents_to_the_table_of_speeds(bench, monkeypatch, capsys):
    growth, speed = bench("growth"), bench("speed")

    def in_child(script, option, size, *more):
        cost = 3.0 * size**2.6  # with four times the degrees of freedom for a mesh twice as fine
        taken = {name: [2 * cost, cost] for name in growth.COLUMNS}
        return {"n_dof": 1000 * size**2, "vectors": 9, "error": 1e-5, "own_mb": 70.0 * size, "child_mb": 0.0, **taken}

    monkeypatch.setattr(growth, "in_child", in_child)
    monkeypatch.setattr(sys, "argv", ["growth.py", "--sizes", "1", "4", "--samples", "3"])
    growth.main()
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    found = {("after", "fine"): {key: speed.cell_of(value) for key, value in last.items()}}
    rows = {row[0]: row[1:] for row in speed.rows_of(found, ["fine"])}
    training = rows["124k degrees of freedom: training at 8 points (s)"]
    assert training[3:5] == (speed.short(6.0 * 4**2.6), speed.short(3.0 * 4**2.6))
    assert rows["124k degrees of freedom: peak memory of that (MB)"][3:5] == ("280", "")
    assert rows["exponent of its growth from 10k degrees of freedom"][:5] == ("1.3", "", "", "1.30", "1.30")


def test_every_row_has_a_group_that_is_measured_and_words_beside_numbers(bench):
    speed = bench("speed")
    assert {row.group for row in speed.ROWS} == set(speed.GROUPS)
    wanted = {row.name + row.group: row.wanted for row in speed.ROWS}
    assert wanted["secondsexplain_vehicle"] == "120" and wanted["effectseffects"] == "120"
    before, after = {"anew": "not installed", "one": (9.0, 8.0)}, {"anew": (4.0, 3.0), "one": (3.0, 2.0)}
    found = {("before", "calculix"): before, ("after", "calculix"): after}
    rows = {row[0]: row[2:] for row in speed.rows_of(found, ["calculix"])}
    assert rows["the same by CalculiX, which always reads and assembles (s)"] == (
        "not installed", "", "4.00", "3.00", "", ""
    )  # fmt: skip
    assert rows["of which CalculiX takes for a single mode (s)"] == ("9.00", "8.00", "3.00", "2.00", "3.00", "4.00")
    assert speed.least((3.0, 2.0), (2.5, 2.2)) == (2.5, 2.0)
    assert {len(row) + 2 for row in rows.values()} == {len(speed.COLUMNS)}


def test_an_option_of_the_model_is_written_into_a_study(bench, tmp_path):
    measures = bench("measures")
    for name, option, expected in (
        ("hidden_effect", "refine=4", {"seats": "rigid", "refine": 4}),
        ("hidden_bogie", "element_size=0.05", {"element_size": 0.05}),
    ):
        file = tmp_path / "study.toml"
        shutil.copy(BENCH.parents[1] / "studies" / name / "study.toml", file)
        before = tomllib.loads(file.read_text("utf-8"))
        measures.with_option(file, option)
        after = tomllib.loads(file.read_text("utf-8"))
        assert after.pop("model_options") == expected and after["explain"] == {}
        assert {**before, "explain": {}, "model_options": 0} == {**after, "model_options": 0}


def _run(number, verdict="effect", best=("guy",), scenario="guy", **more):
    return {"scenario": scenario, "number": number, "outcome": "named", "verdict": verdict, "best": list(best), **more}


def test_two_counts_are_compared_run_by_run(bench, capsys):
    """Failed runs and those of one count alone are left out; the order of names and of blamed data is none."""
    before = [
        _run(1), _run(2, best=("guy", "lamp")), _run(3, blamed=["1x", "2x"]), _run(4), _run(5) | {"outcome": "failed"},
        _run(1, "none_explains", (), "lamp"), _run(7),
    ]  # fmt: skip
    after = [
        _run(1), _run(2, best=("lamp", "guy")), _run(3, blamed=["2x", "1x"]), _run(4, "ambiguous"), _run(5),
        _run(1, "none_explains", (), "lamp"), _run(6), _run(7) | {"outcome": "failed"},
    ]  # fmt: skip
    bench("rates_beside").report_alike(after, before)
    assert capsys.readouterr().out.strip().splitlines() == [
        "5 runs are in both counts, 4 end alike", "- guy #4: effect guy -> ambiguous guy",
    ]  # fmt: skip


def test_a_datum_that_is_blamed_anew_is_another_answer(bench, capsys):
    bench("rates_beside").report_alike([_run(1, blamed=["1x"])], [_run(1)])
    assert capsys.readouterr().out.strip().splitlines()[1:] == ["- guy #1: effect guy -> effect guy 1x"]


def test_widths_of_two_ways_are_compared_where_both_name_the_effect(bench, capsys):
    def named(number, low, high, over=1.0, covers=True):
        return _run(number, interval=[low, high], magnitude_over_true=over, covers=covers)

    wide = [named(1, 0.0, 4.0), named(2, 1.0, 7.0), named(3, 0.0, 12.0), named(4, 0.0, 100.0), _run(5)]
    narrow = [named(1, 1.0, 3.0), named(2, 2.0, 4.0, 1.25, False), named(3, 0.0, 2.0, 0.9, False), named(5, 0.0, 1.0)]
    bench("rates_beside").report_widths({"joint": wide, "modes": narrow})
    assert capsys.readouterr().out.strip().splitlines() == [
        "width of intervals, joint over modes: median 3.0, n 3",
        "modes: intervals that miss the truth are off by 10.0% to 25.0%, n 2",
    ]


def test_without_intervals_no_widths_are_told(bench, capsys):
    bench("rates_beside").report_widths({"joint": [_run(1)], "modes": [_run(1)]})
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("kind", ["shells", "solids"])
def test_shells_and_solids_have_the_mass_and_the_energy_of_a_stretched_body(bench, kind):
    """A body of volume V that is stretched along x, and is free to contract, stores E strain^2 V / 2."""
    continua = bench("continua")
    of = getattr(continua, kind)(1500)
    model = {"shells": continua.roof, "solids": continua.block}[kind](1500)
    stiff, _, mass = model.matrices(dict.fromkeys(model.space.names, 2.0))
    elastic = stiff - model.matrices(dict.fromkeys(model.space.names, 1.0))[0]  # without the springs
    end = of.nodes[of.nodes[:, 0] == 0]
    chords = np.linalg.norm(np.diff(end[np.argsort(end[:, 1])], axis=0), axis=1)
    volume = 8 * chords.sum() * continua.THICKNESS if kind == "shells" else 2 * 1 * 0.5
    moved = np.zeros((len(of.nodes), mass.shape[0] // len(of.nodes)))
    moved[:, 0] = 1.0
    assert moved.ravel() @ mass @ moved.ravel() == pytest.approx(continua.DENSITY * volume)
    moved[:, :3] = 1e-3 * of.nodes * [1.0, -continua.POISSON, -continua.POISSON]
    energy = moved.ravel() @ elastic @ moved.ravel() / 2
    assert energy == pytest.approx(continua.YOUNG * 1e-6 * volume / 2)


@pytest.mark.slow
@pytest.mark.whole
def test_a_cluster_whose_workers_are_killed_has_the_table_of_one_process(bench, monkeypatch, capsys):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    monkeypatch.setattr(sys, "argv", ["cluster.py", "--points", "600", "--kill", "2"])
    bench("cluster").main()
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["killed"] >= 1 and found["differ"] == 0 and found["points"] == 600


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("distributed"), reason="the extra 'cluster' is not installed")
def test_blind_runs_of_a_cluster_are_those_of_this_process(bench, tmp_path):
    rates, subject = bench("rates"), bench("rates_subject").CHAIN
    for folder, executor in (("here", None), ("cluster", "dask")):
        rates.make(subject, tmp_path / folder, 1, 1, only="nothing", executor=executor)
    here, there = ([*rates.lines(tmp_path / folder / "runs.jsonl")] for folder in ("here", "cluster"))
    assert here[0]["verdict"] != "failed" and len(here) == len(there) == 1
    timeless = [{key: value for key, value in row.items() if "seconds" not in key} for row in (*here, *there)]
    assert json.dumps(timeless[0]) == json.dumps(timeless[1])
