"""Modes from files of FRFs on the command line: tables that calib reads again, and what is refused."""

import contextlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
CHAIN = module_of(ROOT / "tests/template/frf_chain.py")
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
FREQ = WORLDS.freq_and_damping(WORLDS.roots(*CHAIN.by_hand(CHAIN.TRUE))[0][:3])[0]


@pytest.fixture
def chain(tmp_path):
    """Four universal files of the chain and the places of its nodes."""
    return CHAIN.write_study(tmp_path / "chain")


def asked(*arguments):
    return cli.execute(["modes", *map(str, arguments)])


@pytest.mark.slow
def test_the_tables_are_a_measurement_that_calib_reads(chain, tmp_path, capsys):
    into = tmp_path / "identified"
    sensors = chain / "sensors.csv"
    files = sorted(chain.glob("repeat_*.uff"))
    assert asked(*files, "--sensors", sensors, "--into", into, "--synthetic") == 0
    said = capsys.readouterr().out
    modes = calib.read_modes(
        into / "modes.csv", shapes=into / "shapes.csv", sensors=into / "sensors.csv", repeats=4, synthetic=True
    )
    np.testing.assert_allclose(modes.natural_freq, FREQ, rtol=1e-3)
    assert np.all(modes.freq_std > 0) and np.all(modes.damping_std > 0) and np.all(modes.shape_std >= 0)
    assert [(s.node, s.direction, s.point) for s in modes.sensors] == [
        (1, "x", (0.0, 0.0, 0.0)), (3, "x", (2.0, 0.0, 0.0)), (4, "x", (3.0, 0.0, 0.0)),
    ]  # fmt: skip
    assert (into / "stabilisation.png").stat().st_size > 0
    assert "repeats = 4" in said and "synthetic = true" in said
    # the numbers on the terminal are those of the table
    table = pd.read_csv(into / "identified.csv")
    assert all(f"{freq:.4f}" in said for freq in table["freq"])
    # again, in the same place
    assert asked(*files, "--sensors", sensors, "--into", into, "--synthetic", "--band", "2", "30") == 0
    assert len(pd.read_csv(into / "modes.csv")) == 2


@pytest.mark.slow
def test_a_refused_mode_is_kept_on_request_and_the_reason_travels(tmp_path, capsys):
    frfs, _ = WORLDS.pair_test(0.03, 0.1)
    path = tmp_path / "pair.csv"
    rows = [
        f"{f},{r.name},{e.name},{v.real},{v.imag}"
        for j, e in enumerate(frfs.references) for i, r in enumerate(frfs.responses)
        for f, v in zip(frfs.freq, frfs.values[:, i, j], strict=True)
    ]  # fmt: skip
    path.write_text("\n".join(["# unit: (m/s2)/N", "freq,response,reference,re,im", *rows]), encoding="utf-8")
    assert asked(path, "--synthetic", "--into", tmp_path / "none") == 2
    assert asked(path, "--synthetic", "--into", tmp_path / "none", "--accept", "14", "--accept", "7") == 2
    assert "7 Hz" in capsys.readouterr().err
    assert asked(path, "--synthetic", "--into", tmp_path / "out", "--accept", "14") == 0
    said, table = capsys.readouterr().out, pd.read_csv(tmp_path / "out/modes.csv")
    note = table["note"].dropna().iloc[0]
    again = calib.read_modes(tmp_path / "out/modes.csv", shapes=tmp_path / "out/shapes.csv", synthetic=True)
    assert any(note in one for one in again.notes) and "14" in said
    assert {"mpc", "mpd"} <= set(table.columns) and table["freq_std"].notna().all()


@pytest.mark.medium
def test_results_never_go_where_other_files_are(chain, capsys):
    before = sorted(chain.iterdir())
    assert asked(*chain.glob("repeat_*.uff"), "--into", chain) == 2
    assert sorted(chain.iterdir()) == before and "Error" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "word"),
    [(["none.uff"], "no such file"), (["--band", "30", "2"], "band"), (["--band", "2", "4"], "too few")],
)
def test_bad_input_is_one_sentence(chain, tmp_path, capsys, arguments, word):
    files = [] if arguments == ["none.uff"] else [chain / "repeat_1.uff"]
    with contextlib.chdir(tmp_path):
        assert asked(*files, *arguments, "--into", tmp_path / "identified") == 2
    said = capsys.readouterr().err
    assert word in said and "Traceback" not in said
    assert not (tmp_path / "identified").exists() and not (tmp_path / "calib-error.log").exists()


def test_a_damaged_file_is_refused_by_name(chain, tmp_path, capsys):
    path = chain / "repeat_2.uff"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3])
    assert asked(*sorted(chain.glob("repeat_*.uff")), "--into", tmp_path / "identified") == 2
    assert "repeat_2.uff" in capsys.readouterr().err
    assert not (tmp_path / "identified").exists()
