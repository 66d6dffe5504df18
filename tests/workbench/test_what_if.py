"""The model at values moved by hand is that of a comparison, with effects too, and its process can be trusted."""

import json
import shutil
import subprocess
import sys
import time
from base64 import b64decode
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.errors.errors import InputError
from calib.report.html import space
from calib.report.numbers import fixed
from calib.study.loading import module_of
from calib.workbench.evaluators import Evaluators
from calib.workbench.what_if import WhatIf, _slider

CHAIN, PLAIN = (
    module_of(Path(__file__).resolve().parents[1] / f"template/{name}.py") for name in ("frf_chain", "plain")
)
MAST = module_of(Path(__file__).resolve().parents[1] / "template/mast_effects.py")


def unpacked(numbers):
    return numbers["step"] * np.frombuffer(b64decode(numbers["numbers"]), "<i2")


def read(folder, part=""):
    return WhatIf.of(Path(folder) / "study.toml", Path("results"), part, "", lambda *told, **more: None)


@pytest.fixture
def what_if(here):
    return read("mast")


@pytest.fixture
def lacking(tmp_path, monkeypatch):
    """A mast that lacks a guy rope of 12 kN/m, with its list of effects."""
    MAST.write_study(tmp_path / "mast", {"guy": 12000.0})
    monkeypatch.chdir(tmp_path)
    return read("mast")


def test_nominal_values_give_the_comparison(what_if, here):
    found = what_if.at({"values": {}, "effects": []})
    compared = pd.read_csv(here / "results/mast/comparison_before.csv")
    mac = pd.read_csv(here / "results/mast/mac_before.csv").set_index("mode")
    np.testing.assert_allclose(found["mac"], mac.to_numpy(), rtol=1e-8)
    for row, known in zip(found["rows"], compared.to_dict("records"), strict=True):
        assert (row["name"], row["partner"]) == (known["mode"], known["model_mode"])
        assert row["model"] == fixed(known["natural_freq_model"], 2)
        assert row["error"] == pytest.approx(known["freq_error"], rel=1e-8, abs=1e-12)


def test_the_shape_is_the_one_that_the_comparison_draws(what_if, page, key):
    found = page.get(f"study/{key}/correlation").json()["correlation"]
    for mode in found["scene"]["stages"][0]["modes"]:
        moved = what_if.at({"values": {}, "effects": [], "mode": mode["name"]})["motion"]
        np.testing.assert_allclose(unpacked(moved), unpacked(mode["motion"]), atol=2 * moved["step"])
    assert "motion" not in what_if.at({"values": {}, "effects": [], "mode": "no mode"})


def test_parameters_and_effects_move_the_model(lacking):
    base, stiffer = (lacking.at({"values": values, "effects": []}) for values in ({}, {"E": 230.0}))
    assert float(stiffer["rows"][0]["model"]) > float(base["rows"][0]["model"])
    roped = lacking.at({"values": {"guy": 12000.0}, "effects": ["guy"]})
    assert roped["rms"] < 0.7 * base["rms"]
    none = lacking.at({"values": {"guy": 0.0}, "effects": ["guy"]})
    assert none["rms"] == pytest.approx(base["rms"], rel=1e-9)


def test_frfs_follow_function_by_function(tmp_path, monkeypatch):
    CHAIN.write_study(tmp_path / "chain", ground=CHAIN.HIDDEN)
    monkeypatch.chdir(tmp_path)
    what_if = read("chain")
    measured = {one["name"]: one for one in what_if.offered()["frfs"]}
    base = what_if.at({"values": CHAIN.TRUE, "effects": []})
    whole = what_if.at(
        {"values": {**CHAIN.TRUE, "ground_2": CHAIN.HIDDEN}, "effects": ["ground_2"], "function": "4x/1x"}
    )
    assert [row["name"] for row in base["rows"]] == list(measured) and whole["function"] == "4x/1x"
    assert whole["rms"] < 1.5 < base["rms"]
    own = measured["4x/1x"]
    lines = [int(np.argmin(np.abs(CHAIN.FREQ - freq))) for freq in own["freq"]]
    true = np.abs(CHAIN.truth(CHAIN.TRUE, ground=CHAIN.HIDDEN)[lines, CHAIN.RESPONSES.index(4), 0])
    np.testing.assert_allclose(whole["curve"], true, rtol=1e-4)
    assert np.median(np.abs(own["measured"] / true - 1)) < 0.2


@pytest.mark.slow  # a user's function runs in a process of its own
def test_numbers_follow_too(tmp_path, monkeypatch):
    function = "def answer(v):\n    return {'y': v['a'] + v['b'], 'z': v['a'] * v['b']}"
    PLAIN.write(tmp_path / "plain", function, "", y=(4.4, 0.1), z=(4.0, 0.5))
    monkeypatch.chdir(tmp_path)
    found = read("plain").at({"values": {"a": 2.5, "b": 2.0}, "effects": []})
    assert [(row["name"], row["model"], row["error_words"]) for row in found["rows"]] == [
        ("y", "4.500", "+1.0"),
        ("z", "5", "+2.0"),
    ]
    assert found["rms"] == pytest.approx(np.sqrt((1.0 + 4.0) / 2))


def test_sliders_span_the_limits_of_the_search_and_a_plausible_effect(lacking):
    offered = lacking.offered()
    spans = {one["name"]: (one["lower"], one["upper"], one["free"]) for one in offered["parameters"]}
    assert spans["K_base"] == (0.2, 8.0, True)
    (slider,) = next(one["sliders"] for one in offered["effects"] if one["name"] == "guy")
    assert (slider["lower"], slider["upper"]) == (0.0, 4 * 5e3)
    assert [(one["words"], one["effects"]) for one in offered["starts"]] == [("Nominal values", [])]
    for limits in ((-10.0, -1.0), (-40.0, 0.0), (-10.0, 2.0)):
        slider = _slider(calib.Parameter("preload", limits[0], *limits))
        assert (slider["lower"], slider["upper"]) == limits


def test_the_motion_of_a_mesh_is_packed_as_the_viewer_reads_it(what_if, here):
    moves = pd.DataFrame({"point": what_if.motion._mesh.points["point"], "u": 0.5, "v": 0.0, "w": -1.0})
    packed = what_if.motion.packed(moves)
    assert packed == space.packed_numbers(np.tile([0.5, 0.0, -1.0], (len(moves), 1)))
    assert what_if.motion.packed(moves.iloc[:0]) is None


# -- its process -------------------------------------------------------------------------------------------------------


def ready(evaluators, *arguments):
    while "stage" in (evaluator := evaluators.of(*arguments)).state:  # one that nobody asks would end
        time.sleep(0.05)
    return evaluator


@pytest.mark.slow
def test_the_page_asks_a_process_of_its_own(page, key, here):
    while "stage" in (state := page.get(f"study/{key}/what-if").json()):
        time.sleep(0.05)
    assert state["ready"]["at"]["kind"] == "modes"
    found = page.post(f"study/{key}/evaluate", json={"values": {"E": 215.0}, "effects": []}).json()
    assert found["rows"][0]["error"] != state["ready"]["at"]["rows"][0]["error"]
    wrong = page.post(f"study/{key}/evaluate", json={"values": {}, "effects": ["no effect"]})
    assert wrong.status_code == 409 and "no effect" in wrong.json()["fault"]
    assert page.post(f"study/{key}/evaluate", json={"values": {"E": "much"}}).status_code == 409
    again = page.post(f"study/{key}/evaluate", json={"values": {"E": 215.0}, "effects": []}).json()
    assert again == found


@pytest.mark.slow
def test_a_study_that_has_changed_is_read_again_and_a_wrong_one_is_told(here):
    evaluators, file, place = Evaluators(), Path("mast/study.toml"), ("mast", "", "")
    arguments = str(file), "results", "", ""
    first = ready(evaluators, place, arguments, 1)
    assert "ready" in first.state and evaluators.of(place, arguments, 1) is first is evaluators.ready(place)
    file.write_text(file.read_text().replace("model.py:mast", "model.py:nothing"))
    second = ready(evaluators, place, arguments, 2)
    assert second is not first and "nothing" in second.state["fault"]
    assert evaluators.of(place, arguments, 2) is second  # it is not tried again for ever
    with pytest.raises(InputError, match="being read"):
        evaluators.ready(place)


@pytest.mark.slow
def test_what_a_model_prints_is_no_answer_and_the_process_ends_with_its_server(here):
    code = Path("mast/model.py")
    code.write_text(code.read_text() + '\nprint("hello")\n')
    command = [sys.executable, "-m", "calib.workbench.what_if", "mast/study.toml", "results", "", ""]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    lines = [json.loads(process.stdout.readline())]
    while "stage" in lines[-1]:
        lines.append(json.loads(process.stdout.readline()))
    assert "ready" in lines[-1]
    process.stdin.close()
    assert process.wait(30) == 0 and b"hello" in process.stderr.read()


@pytest.mark.slow
def test_nothing_is_written_into_the_results(page, key, here):
    shutil.rmtree("results")
    while "stage" in page.get(f"study/{key}/what-if").json():
        time.sleep(0.05)
    assert not Path("results").exists()
