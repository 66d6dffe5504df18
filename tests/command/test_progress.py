"""How far a command is: bars on a terminal, sparse lines elsewhere, and the stages that the analyses tell."""

import io
import re
from contextlib import nullcontext

import pytest
from rich.console import Console

from calib.api import progress
from calib.api.listener import Listener
from calib.api.study import Study
from calib.execution.stage import with_prefix


class Clock:
    """A clock that is moved by hand."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def lines(monkeypatch):
    """Sparse lines by a clock of our own, and what they have written."""
    stream, clock = io.StringIO(), Clock()
    console = Console(file=stream, width=80, soft_wrap=True)
    monkeypatch.setattr(progress, "error_stream", lambda: console)
    return progress._Lines("calibrate", progress.error_stream().print, progress.SPARSE, clock), clock, stream


def test_lines_are_sparse_and_without_control_characters(lines):
    tell, clock, stream = lines
    for done in range(101):
        tell("sampling", done, 100)
        clock.now += 0.5
    told = stream.getvalue().splitlines()
    assert len(told) == int(100 * 0.5 / progress.SPARSE)
    for line in told:
        done = int(re.search(r"(\d+)/100", line).group(1))
        assert line.isprintable() and line.startswith("calibrate: sampling")
        left = progress.remaining_time(0.5 * done, done, 100)
        assert line.endswith(f", {left} left" if left else "/100") and bool(left) == (done < 99)


def test_a_short_command_tells_nothing_where_there_is_no_terminal(lines):
    tell, clock, stream = lines
    for done in range(10):
        tell("solving the model", done, 10)
        clock.now += 0.9
    assert stream.getvalue() == ""


def test_a_stage_that_goes_on_keeps_its_name_and_a_shared_whole_its_pace():
    clock = Clock()
    pace = progress._Pace("explain", clock)
    assert pace.tell("fitting A", 0, 100, float("nan"))
    clock.now += 10
    assert not pace.tell("", 20, 100, float("nan")) and "fitting A 20/100" in pace.words and pace.remaining == "40 s"
    clock.now += 10
    assert pace.tell("fitting B", 40, 100, float("nan")) and "fitting B 40/100" in pace.words
    assert pace.remaining == "30 s"
    clock.now += 10
    assert pace.tell("what to measure next", 0, 10, float("nan")) and pace.remaining == ""


@pytest.mark.parametrize(
    ("elapsed", "done", "total", "left"),
    [
        (10, 5, 10, "10 s"),
        (10, 0, 10, ""),
        (1, 5, 10, ""),
        (60, 1, 11, "10 min"),
        (3600, 1, 4, "3 h"),
        (10, 10, 10, ""),
    ],
)
def test_the_time_left_follows_from_the_average_speed(elapsed, done, total, left):
    assert progress.remaining_time(elapsed, done, total) == left


@pytest.mark.parametrize("width", [60, 80, 120])
def test_bars_fit_the_terminal(monkeypatch, width):
    """Nothing is cut: a long stage wraps between its words."""
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=width, legacy_windows=False)
    monkeypatch.setattr(progress, "error_stream", lambda: console)
    stage = "fitting an effect with a name of very many words that does not end on one line of a terminal"
    with progress.bars("explain") as tell:
        tell(stage, 3, 7)
        lines = console.render_lines(tell.bar.get_renderable(), pad=False)
        text = "\n".join("".join(segment.text for segment in line) for line in lines)
    assert all(len(line) <= width for line in text.splitlines()) and "…" not in text
    assert set(stage.split()) <= set(text.split())


class Recorder(Listener):
    """Keeps every stage with its count."""

    def __init__(self):
        self.told = []

    def progress(self):
        return nullcontext(lambda stage, done=0, total=0, best=0: self.told.append((stage, done, total)))


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("method", ["genetic", "gauss-newton"])
def test_every_part_of_a_calibration_tells_how_far_it_is(guyed, edit, undrawn, method):
    edit(guyed, "[calibration]", "[calibration]\npopulation = 10\ngenerations = 5")
    listener = Recorder()
    Study.load("mast", workers=1, quick=True, listener=listener).calibrate(method=method)
    stages = [stage for stage, _, _ in listener.told]
    order = list(dict.fromkeys(stages))
    wanted = ["A1, genetic search", "A1, least squares", "A1, checking at full order"]
    wanted = wanted if method == "genetic" else wanted[1:2]
    assert [s for s in order if s in wanted] == wanted
    assert order[0] == "solving the model"
    assert order[-2:] == ["leave-one-out and validation errors", "intervals with the misfit"]
    assert all(0 <= done <= total for _, done, total in listener.told if total)
    shares = [done for stage, done, total in listener.told if stage == "A1, least squares" and total == 1]
    assert len(shares) > 3 and max(shares) > 0.5


@pytest.mark.slow
def test_an_explanation_tells_the_part_of_its_budget_and_of_its_samples(guyed, undrawn):
    listener = Recorder()
    Study.load("mast", workers=1, listener=listener).explain()
    fits = [(done, total) for stage, done, total in listener.told if stage.startswith("fitting ") or not stage]
    assert fits and all(0 <= done <= total for done, total in fits)
    anew = [k for k in range(1, len(fits)) if fits[k][0] < fits[k - 1][0]]
    assert len(anew) <= 4 and fits[-1][0] > 0  # a decision is made again on a basis that its fits had left
    samples = [done for stage, done, total in listener.told if stage == "what to measure next" and total]
    assert samples == list(range(len(samples))) and len(samples) >= 10


def test_a_part_tells_its_stages_under_its_name():
    told = []
    tell = with_prefix(lambda stage, *more: told.append(stage), "GB1")
    tell("least squares", 0.5, 1)
    tell("", 0.6, 1)
    assert told == ["GB1, least squares", ""]


def test_a_name_in_brackets_is_shown_as_it_is(monkeypatch):
    """Names of effects, tests and cases are the user's own, and no markup."""
    stream, stage = io.StringIO(), "fitting a spring [kN/m] [x] [/b]"
    console = Console(file=stream, force_terminal=True, width=100)
    monkeypatch.setattr(progress, "error_stream", lambda: console)
    with progress.bars("explain") as tell:
        tell(stage, 1, 4)
    assert f"explain: {stage} 1/4" in stream.getvalue()
