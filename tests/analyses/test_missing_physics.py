"""The benchmark of missing physics: frames, faults of the test, and its report on a few cases that are run here."""

import importlib
import json
import re
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[1] / "benchmarks"
NAMES = (
    "missing_physics", "rates", "rates_faults", "rates_frame", "rates_frame_frf", "rates_scenarios", "rates_subject",
    "rates_table",
)  # fmt: skip


@pytest.fixture(scope="module")
def bench():
    """The scripts of the benchmark, which import each other by name."""
    sys.path.insert(0, str(BENCH))
    try:
        yield {name: importlib.import_module(name) for name in NAMES}
    finally:
        sys.path.remove(str(BENCH))


@pytest.fixture(scope="module")
def worlds(bench, tmp_path_factory):
    """Frames without and with faults of their tests, on one basis."""
    folder = tmp_path_factory.mktemp("frame")
    subjects, faults = bench["rates_subject"], bench["rates_faults"]
    plain = bench["rates_frame"].FrameWorld(subjects.FRAME, folder, "test")
    faulty = faults.FaultyFrameWorld(subjects.FRAME_FAULT, folder, "test")
    faulty.__dict__["libraries"] = plain.libraries
    return plain, faulty


def scenario(world, name):
    return next(s for s in world.kinds if s.name == name)


@pytest.mark.medium
def test_the_finer_frame_is_the_same_structure(bench):
    of = bench["rates_frame"]
    coarse, fine = of.frame(of.COARSE).model(), of.frame(of.FINE).model()
    assert (coarse.n_dof, fine.n_dof) == (351, 1071)
    one, other = (m.modes(m.space.values, of.MODES).natural_freq for m in (coarse, fine))
    assert np.allclose(one, other, rtol=3e-4) and not np.allclose(one, other, rtol=1e-7)
    for model, masses in ((coarse, coarse.mass), (fine, fine.mass)):
        rigid = np.where(model.dofs.direction == 0, 1.0, 0.0)  # the whole frame moves in x by 1
        steel = of.DENSITY * (9 * of.HEIGHT * 78e-4 + 3 * sum(of.SPANS) * 54e-4)
        floors = sum(of.FLOORS.values()) * sum(of.SPANS)
        assert rigid @ (masses(model.space.si(model.space.values)) @ rigid) == pytest.approx(steel + floors)


@pytest.mark.slow
def test_effects_are_built_into_the_twin_otherwise_than_the_library_has_them(bench):
    """Nearly the same modes, but not exactly: an idealisation, no inverse crime."""
    of = bench["rates_frame"]
    base = of.frame(of.FINE).model()
    plain = base.modes(base.space.values, of.MODES).natural_freq
    for effect in of.frame_effects():
        values = {**base.space.values, effect.name: effect.plausible}
        really = of.built((effect.name,), values)
        listed = of.blind.extend(base, [effect])
        one = really.modes(base.space.values, of.MODES).natural_freq
        other = listed.modes(values, of.MODES).natural_freq
        change = np.abs(one / plain - 1).max()
        assert change > 1e-3, effect.name
        assert 1e-6 < np.abs(one / other - 1).max() < 0.6 * change, effect.name


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    ("name", "verdict", "named"),
    [
        ("nothing", "nothing_detectable", []), ("cut_beam/L", "effect", ["cut_beam"]),
        ("mass_moved/L", "effect", ["mass_moved"]), ("without/cut_beam/M", "none_explains", []),
    ],
)  # fmt: skip
def test_frames(worlds, name, verdict, named):
    world, _ = worlds
    row = world.run(scenario(world, name), 0)
    assert "error" not in row and "methods_error" not in row
    assert row["verdict"] == verdict and row["credible"] == named
    assert {"this search", "BIC", "OMP", "energy error"} <= set(row["methods"])


@pytest.mark.slow
def test_a_gain_is_told_as_a_fault_of_the_test(worlds):
    _, world = worlds
    row = world.run(scenario(world, "fault/gain"), 0)
    assert row["verdict"] == "measurement" and any("gain" in name for name in row["blamed"])
    assert row["methods"]["BIC with faults"]["verdict"] == "measurement"


KINDS = ("gain", "rotation", "cross-talk", "set-up factor", "place", "odd repeat", "none")
PAIRS = ("exchange", "axes", "far cross-talk", "mixed modes")


@pytest.mark.parametrize("fault", [*KINDS, *PAIRS])
def test_each_fault_changes_what_it_should(bench, worlds, fault):
    """Of the readings; a place and an odd repeat are made elsewhere."""
    _, world = worlds
    layout = world.specimen.layout
    shapes = np.random.default_rng(0).standard_normal((len(layout), 5))
    modes = {"A": 1.0, "B": 2.0, "C": 2.1, "D": 4.0, "E": 6.0}
    read, right = bench["rates_faults"].misread(fault, shapes, layout, np.random.default_rng(1), modes)
    touched = np.flatnonzero((read != shapes).any(axis=1))
    wanted = {"set-up factor": len(layout) // 3, "place": 0, "odd repeat": 0, "none": 0, "exchange": 2, "axes": 2,
              "mixed modes": len(layout)}  # fmt: skip
    assert len(touched) == wanted.get(fault, 1) and bool(right) == (fault in PAIRS)
    names = {layout[k].name for k in touched} if fault in ("exchange", "axes") else set()
    assert names <= set(right.replace(",", "").split())
    if fault == "mixed modes":
        assert right in ("share of mode B in mode C", "share of mode C in mode B")
        assert (read != shapes).any(axis=0).tolist() == [name == right[-1] for name in modes]
    if fault in ("gain", "set-up factor"):
        ratio = read[touched] / shapes[touched]
        assert np.allclose(ratio, ratio[0, 0]) and 0.04 < abs(ratio[0, 0] - 1) < 0.31


@pytest.mark.medium
def test_a_misplaced_sensor_and_an_odd_repeat_are_measured(worlds, monkeypatch):
    """The noise-free modes show the former; the standard deviations the latter."""
    _, world = worlds
    places = world._shifted(world.specimen.layout, np.random.default_rng(3))
    moved = [(a, b) for a, b in zip(world.specimen.layout, places, strict=True) if a != b]
    assert len(moved) == 1 and 0.1 < np.linalg.norm(np.subtract(moved[0][0].point, moved[0][1].point)) < 0.5
    place = scenario(world, "fault/place")
    off = world.measure(place, 0).clean.shapes
    with monkeypatch.context() as patch:
        patch.setattr(type(world), "_shifted", lambda self, layout, rng: layout)
        there = world.measure(place, 0).clean.shapes
    touched = np.abs(np.abs(off) - np.abs(there)).max(axis=1) > 1e-6
    assert 1 <= touched.sum() <= 1 + 8  # the shape's largest entry may be the one that is off
    odd, plain = (world.measure(scenario(world, f"fault/{name}"), 0).whole for name in ("odd repeat", "gain"))
    assert odd.freq_std.mean() > 2 * plain.freq_std.mean()
    assert world.specimen.layout is worlds[0].specimen.layout  # put back


@pytest.fixture(scope="module")
def by_frfs(bench, tmp_path_factory):
    """Damped frames under two shakers."""
    subject = bench["rates_subject"].FRAME_FRF
    return bench["rates_frame_frf"].FRFFrameWorld(subject, tmp_path_factory.mktemp("frf"), "test")


@pytest.mark.medium
def test_thirty_frames_by_frfs_are_a_round(by_frfs):
    groups = {group: sum(s.each for s in by_frfs.kinds if s.group == group) for group in ("nothing", "fault", "single")}
    assert groups == {"nothing": 6, "fault": 6, "single": 14} and sum(s.each for s in by_frfs.kinds) == 30


def test_every_force_has_a_sensor_at_its_drive_point(by_frfs):
    test = by_frfs._test
    assert len(test.references) == 2 and set(test.references) <= set(test.responses)


@pytest.mark.parametrize("kind", ["gain", "phase"])
def test_a_wrong_channel_is_read_by_its_functions_alone(bench, by_frfs, kind):
    made, test = bench["rates_frame_frf"], by_frfs._test
    for number in range(6):
        fault = made.Fault.drawn(kind, test, np.random.default_rng(number))
        factors = fault.factors(test)
        touched = np.abs(factors - 1) > 1e-12
        wrong = test.responses if fault.side == "response" else test.references
        assert touched.sum() == factors.size / len(wrong)
        (factor,) = np.unique(np.round(factors[touched], 12))
        size = abs(factor) if fault.side == "response" else 1 / abs(factor)
        angle = np.degrees(np.angle(factor)) * (1 if fault.side == "response" else -1)
        assert (size - 1, angle) == pytest.approx((fault.size, 0.0) if kind == "gain" else (0.0, fault.size), abs=1e-9)


@pytest.mark.medium
def test_a_wrong_channel_is_a_candidate_and_no_parameter(by_frfs):
    kind = scenario(by_frfs, "fault/gain")
    measured = by_frfs.measure(kind, 0)
    asked = by_frfs.hypotheses(kind, measured)
    assert measured.fault.name in {fault.name for fault in asked.faults}
    free = set(asked.space.free_names)
    assert measured.fault.name not in free and any("frequency_at" in name for name in free)
    ratio = np.abs(measured.whole.values / measured.clean.values)
    names = [s.name for s in measured.whole.responses]
    own = names.index(measured.fault.channel.name)
    assert np.median(ratio[:, own]) == pytest.approx(1 + measured.fault.size, abs=0.01)
    assert np.median(np.delete(ratio, own, axis=1)) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("row", "right"),
    [
        ({"group": "nothing", "verdict": "nothing_detectable"}, True),
        ({"group": "nothing", "verdict": "none_explains"}, False),
        ({"group": "fault", "verdict": "measurement", "blamed": ["gain_1x"], "fault": "gain_1x"}, True),
        ({"group": "fault", "verdict": "measurement", "blamed": ["gain_2x"], "fault": "gain_1x"}, False),
        ({"group": "fault", "verdict": "effect", "blamed": [], "fault": "gain_1x", "credible": ["brace"]}, False),
        ({"group": "single", "verdict": "effect", "outcome": "right", "credible": ["brace"], "visible": [9]}, True),
        (
            {"group": "single", "verdict": "partial", "outcome": "partial", "visible": [9], "nearly": {"right": True}},
            True,
        ),
        ({"group": "single", "verdict": "nothing_detectable", "outcome": "nothing_detectable", "visible": [9]}, False),
        ({"group": "single", "verdict": "nothing_detectable", "outcome": "nothing_detectable", "visible": [2]}, True),
        ({"group": "outside", "verdict": "none_explains", "outcome": "none_explains", "visible": [9]}, True),
        ({"group": "outside", "verdict": "effect", "outcome": "wrong", "credible": ["brace"], "visible": [9]}, False),
        ({"group": "outside", "verdict": "failed", "outcome": "failed"}, False),
    ],
)
def test_what_counts_as_told_rightly(bench, row, right):
    assert bench["rates_frame_frf"].told_rightly({"credible": [], **row}) is right


@pytest.mark.slow
def test_a_channel_of_frfs_is_told_as_wrong(by_frfs):
    row = by_frfs.run(scenario(by_frfs, "fault/gain"), 0)
    assert row["verdict"] == "measurement" and row["blamed"] == [row["fault"]] and row["told_rightly"]


def test_the_plan_has_a_thousand_cases_of_every_subject(bench):
    plan = bench["missing_physics"].PLAN
    assert sum(plan.values()) >= 1000
    assert set(plan) - {"tire"} <= set(bench["rates_subject"].SUBJECTS)
    assert all(9 <= plan[name] / plan[f"{name}_fault"] <= 11 for name in ("bogie", "frame"))
    chain = bench["rates"].ChainWorld(bench["rates_subject"].CHAIN, Path(), "test")
    first = list(islice(bench["rates_scenarios"].rounds(chain.kinds), plan["chain"]))
    assert 0.08 < sum(s.group == "fault" for s, _ in first) / len(first) < 0.15


@pytest.mark.slow
def test_run_goes_on_where_it_stopped_and_report_counts(bench, tmp_path, capsys):
    """Four chains in two goes; every count of the table is that of the file."""
    physics = bench["missing_physics"]
    physics.run({"chain": 2}, tmp_path, 1)
    first = (tmp_path / "chain/runs.jsonl").read_text("utf-8")
    physics.run({"chain": 4}, tmp_path, 1)
    text = (tmp_path / "chain/runs.jsonl").read_text("utf-8")
    rows = [json.loads(line) for line in text.splitlines()]
    assert text.startswith(first) and len(rows) == 4 and "2 of 4 runs to make" in capsys.readouterr().out
    assert len({(row["scenario"], row["number"]) for row in rows}) == 4

    broken = rows[0] | {"number": 99, "verdict": "failed", "outcome": "failed", "group": "single"}
    del broken["methods"]
    with (tmp_path / "chain/runs.jsonl").open("a", encoding="utf-8") as out:
        out.write(json.dumps(broken) + "\n")
    found = physics.found(tmp_path)
    assert list(found) == ["chain"]
    physics.report(found, tmp_path / "all.csv")
    shown = capsys.readouterr().out
    assert "4 cases; broken: chain 1" in shown
    single = [row for row in rows if row["group"] == "single"]
    seen = [row for row in single if min(row["visible"]) >= 6]
    right = sum(row["outcome"] == "right" for row in seen)
    (line,) = re.findall(r"^chain  .*$", shown, re.MULTILINE)
    assert len(seen) > 0 and line.split()[1] == f"{right}/{len(seen)}"
    assert "wanted >= 95 %" in shown and "AICc" in shown
    kept = {(rate.hidden, rate.verdict): rate for rate, _, _ in bench["rates_table"].read(tmp_path / "all.csv")}
    assert kept["one effect, expected score 6 or more", "names it rightly"][-2:] == (right, len(seen))
    methods = bench["rates_table"].read_methods(tmp_path / "all_methods.csv")
    assert {"this search", "AICc", "BIC"} <= {method for method, *_ in methods}


def test_nothing_run_is_said(bench, tmp_path, capsys):
    bench["missing_physics"].report(bench["missing_physics"].found(tmp_path))
    assert capsys.readouterr().out == "no runs yet\n"
