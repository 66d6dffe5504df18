"""Terminal output of the command."""

import io
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.analyses import explain as explaining
from calib.analyses.screening import Screening
from calib.api.entries.entry import Rows, decimals
from calib.api.entries.explained import _predictions, _steps
from calib.command import cli, terminal
from calib.command.printing import printing
from calib.results.results import Results


def test_a_parameter_of_which_no_response_is_known_is_told_as_such(tmp_path, capsys):
    table = pd.DataFrame(
        [("a", "x", np.nan), ("a", "y", np.nan), ("b", "x", 0.25), ("b", "y", 0.75)],
        columns=["parameter", "response", "mu_star"],
    ).assign(trajectories=3, dropped=0)
    with printing("sensitivity") as listener:
        listener.sampled(None, Screening("morris", table, 12, ""), Results(tmp_path))
    first, second = (line.split() for line in capsys.readouterr().out.splitlines() if line[:2] in ("a ", "b "))
    assert first == ["b", "0.75", "y"] and second == "a no response: too few are known, or none changes".split()


@pytest.mark.parametrize(
    ("verdict", "names", "untold", "added"),
    [
        ("effect", ["guy"], ["guy"], "it: guy"),
        ("two_effects", ["guy", "lamp"], ["guy", "lamp"], "them: guy lamp"),
        ("two_effects", ["guy", "lamp"], ["guy", "lamp", "ice"], ""),
        ("indistinguishable", ["guy"], ["guy", "lamp"], ""),
    ],
)
def test_only_an_effect_without_a_competing_model_is_added(capsys, verdict, names, untold, added):
    chosen = SimpleNamespace(names=names)
    found = SimpleNamespace(verdict=verdict, chosen=chosen, equally_good=untold, mistakable=(), granted=())
    with printing("explain") as listener:
        listener.may_add(SimpleNamespace(file=Path("mast/study.toml")), found)
    them, _, which = added.partition(": ")
    told = f"Add {them} with: calib extend mast {which} --into FOLDER\n" if added else ""
    assert "".join(x for x in capsys.readouterr().out.splitlines(True) if x.strip()) == told


@pytest.mark.parametrize(
    ("verb", "test", "before"), [("sensitivity", "", 1), ("sensitivity", "empty", 0), ("run", "", 0)]
)
def test_the_answer_waits_for_no_figure(tmp_path, capsys, verb, test, before):
    """That of one of several tests, and that of a run, stand beside others."""
    study = SimpleNamespace(test=test)
    table = pd.DataFrame([("a", "x", 0.5)], columns=["parameter", "response", "mu_star"]).assign(
        trajectories=3, dropped=0
    )
    with printing(verb) as listener:
        listener.sampled(None, Screening("morris", table, 12, ""), Results(tmp_path))
        listener.to_draw(study, ("the calibration is older",), None)
        drawing = capsys.readouterr().out
        listener.drawn(study, [tmp_path / "morris.png"], None)
    after = capsys.readouterr().out
    for words in ("Found:", "Results:", "the calibration is older"):
        assert (drawing.count(words), after.count(words)) == (before, 1 - before)


def test_figures_that_a_column_has_no_room_for_are_told(tmp_path, capsys):
    study = SimpleNamespace(test="")
    with printing("report") as listener:
        listener.drawn(study, [tmp_path / "mac.png"], None)
        listener.drawn(study, [tmp_path / "mac.png"], None, ["mac", "model"])
    assert capsys.readouterr().out.count("not legible in a column: mac, model.") == 1


LABELS = ["Found:", "How sure:", "Next:", "Results:"]


@pytest.fixture
def wide(monkeypatch):
    """Function that sets the width of a terminal, and returns what is written to it."""

    def of(width):
        stream = io.StringIO()
        looks = {"highlight": False, "markup": False, "soft_wrap": True, "force_terminal": True, "color_system": None}
        console = terminal._Output(file=stream, width=width, **looks)
        monkeypatch.setattr(terminal, "_out", console)
        return stream

    return of


def plain(text):
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("verb", ["compare", "sensitivity", "calibrate", "explain"])
def test_an_answer_in_four_lines_comes_first_and_is_that_of_the_record(guyed, capsys, verb):
    more = [] if verb in ("compare", "explain") else ["--workers", "1"]
    assert cli.execute([verb, "mast", *more, *(["--quick"] if more else [])]) == 0
    title, *answer = capsys.readouterr().out.splitlines()[:5]
    assert title == f"A mast that may lack something: {verb}  [synthetic measurement]"
    assert [line[: terminal.LABEL].strip() for line in answer] == LABELS
    folder = Path("results/mast/quick" if more else "results/mast")
    stored = json.loads((folder / "record.json").read_text())["analyses"][verb]["answer"]
    assert [line[terminal.LABEL :] for line in answer[:3]] == [stored[key] for key in ("found", "sure", "then")]
    assert all(stored[key] for key in ("found", "sure", "then")) and Path(answer[3][terminal.LABEL :]).exists()


@pytest.mark.slow
def test_an_explanation_fits_on_one_screen_and_tells_all_on_request(guyed, wide, explanation, monkeypatch):
    out, answers = {}, []

    def once(*given, **more):  # what is printed is the subject, so that it is computed once
        answers[:] = answers or [compute(*given, **more)]
        return answers[0]

    compute = explaining.explain
    monkeypatch.setattr(explaining, "explain", once)
    for options in ((), ("--verbose",)):
        stream = wide(80)
        assert cli.execute(["explain", "mast", *options]) == 0
        out[options] = plain(stream.getvalue())
    brief, whole = out.values()
    assert len(brief.splitlines()) <= 55 < len(whole.splitlines())  # four effects are fitted, with what they move
    assert max(map(len, brief.splitlines())) <= 80
    words = " ".join(whole.split())
    assert all(" ".join(sentence.split()) in words for sentence in explanation()["sentences"])


@pytest.mark.parametrize("width", [40, 60, 80, 120, 200])
def test_no_word_of_a_table_is_cut(wide, width):
    heads = ("parameter", "a head of many words", "value", "remark")
    rows = [
        ("K_primary", "1.5", "557.5 kN/m", "std too large, rests on the prior"),
        ("m_girder_centre_of_the_rear", "12345.678", "67.228 kg/m", "no: on its limit " * 5),
        ("c", "", "", ""),
    ]
    stream = wide(width)
    terminal.tell_entries([Rows.of("", heads, rows, left=("remark",))], False)
    text = plain(stream.getvalue())
    told = text.split()
    for word in {word for row in rows for cell in row for word in cell.split()}:
        assert word in told or f"{word};" in told or f"{word}:" in told
    assert "…" not in text and "..." not in text
    assert max(map(len, text.splitlines())) <= max(width, len("parameter m_girder_centre_of_the_rear:"))


def test_long_text_is_wrapped_between_words_on_a_terminal_only(wide, capsys):
    text = "word " * 60 + "a_name_that_is_longer_than_the_whole_line_of_this_terminal_is"
    terminal.say(text)
    assert capsys.readouterr().out == f"{text}\n"
    stream = wide(40)
    terminal.labelled("Found", text)
    lines = plain(stream.getvalue()).splitlines()
    assert " ".join(lines).split() == ["Found:", *text.split()]
    assert all(line.startswith(" " * terminal.LABEL) for line in lines[1:])


@pytest.mark.medium
def test_what_was_found_is_told_even_if_a_later_step_fails(guyed, monkeypatch, capsys):
    monkeypatch.setattr("calib.analyses.sensitivity.sensitivity", lambda *given: 1 / 0)
    assert cli.execute(["run", "mast", "--workers", "1"]) == 1
    out = capsys.readouterr().out
    assert "A mast that may lack something: compare" in out and out.count("Found:") == 1


def test_a_number_that_rounds_to_zero_has_no_sign():
    assert [decimals(value, 1) for value in (-0.04, 0.04, -0.06, float("nan"))] == [
        "0.0",
        "0.0",
        "-0.1",
        "",
    ]


def test_colons_make_no_pictures(capsys):
    terminal.say("sensors 1:x:2 and [b]")
    terminal.complain("study:m:")
    out, err = capsys.readouterr()
    assert out == "sensors 1:x:2 and [b]\n" and err == "calib: study:m:\n"


# -- several effects ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("named", [True, False])
def test_every_step_of_a_search_for_several_effects_is_a_row(named):
    steps = pd.DataFrame({"step": [0, 1, 2], "effects": ["none", "a", "a + b"], "ln_bayes": [0.0, 12.25, 30.0]})
    wide = pd.DataFrame({"step": [0, 1, 2], "fit": [1.5, 1.2, 1.0], "left_out": [2.0, 1.4, 1.1]})
    errors = wide.melt("step", var_name="group", value_name="rms")
    tables = {"steps": steps, "steps_errors": errors}
    result = SimpleNamespace(tables=tables, explanation=SimpleNamespace(names_something=named))
    (rows,) = _steps(result)
    assert rows.when == ("always" if named else "verbose") and rows.heads[-2:] == ("used data", "data left out in turn")
    assert rows.rows[0] == ("0", "none", "0.0", "1.50", "2.00")
    assert rows.rows[1:] == (("1", "a", "12.2", "1.20", "1.40"), ("2", "a + b", "30.0", "1.00", "1.10"))
    assert _steps(SimpleNamespace(tables={}, explanation=None)) == []


# -- predictions of held-out data --------------------------------------------------------------------------------------


@pytest.mark.parametrize("of_tests", [{}, {"test": ["loaded"]}])
def test_predictions_are_counted_and_errors_alone_are_no_table(of_tests):
    numbers = {"rows": [2], "rms": [3.5], "expected": [1.1], "expected_unexplained": [1.3], "p_unexplained": [0.4]}
    errors = pd.DataFrame({**of_tests, "group": ["held_out_modes"], **numbers})
    inside = {"inside": [True, False], "inside_unexplained": [True, True]}
    predicted = pd.DataFrame({**{k: 2 * v for k, v in of_tests.items()}, "group": 2 * ["held_out_modes"], **inside})
    tables = {"unexplained_errors": errors}
    assert _predictions(SimpleNamespace(tables=tables)) == []
    (rows,) = _predictions(SimpleNamespace(tables={**tables, "unexplained_predictions": predicted}))
    ((data, *told),) = rows.rows
    assert told[:5] == ["1 of 2", "2 of 2", "3.50", "1.10", "1.30"] and ("loaded" in data) == bool(of_tests)
