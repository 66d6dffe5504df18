"""Modes from time records on the command line: tables that calib reads again, and what is refused."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.study.loading import module_of

pytest.importorskip("pyoma2", reason="needs pyOMA2: pip install calib[ambient]")

ROOT = Path(__file__).resolve().parents[2]
AMBIENT = module_of(ROOT / "tests/template/ambient_chain.py")
FRF = module_of(ROOT / "tests/template/frf_chain.py")
CHAIN = AMBIENT.chain()


def asked(*arguments):
    return cli.execute(["modes", *map(str, arguments)])


@pytest.mark.slow
def test_the_tables_are_a_measurement_that_calib_reads(tmp_path, capsys):
    paths = [
        AMBIENT.write_csv(tmp_path / f"record_{seed}.csv", AMBIENT.accelerations(CHAIN, 10_000, seed))
        for seed in (1, 2, 3)
    ]
    places = tmp_path / "sensors.csv"
    places.write_text("node,x,y,z\n" + "".join(f"{k},{k},0,0\n" for k in range(1, 5)), encoding="utf-8")
    into = tmp_path / "identified"
    assert asked(*paths, "--sensors", places, "--into", into, "--synthetic") == 0
    said = capsys.readouterr().out
    modes = calib.read_modes(
        into / "modes.csv", shapes=into / "shapes.csv", sensors=into / "sensors.csv", repeats=3, synthetic=True
    )
    np.testing.assert_allclose(modes.natural_freq, AMBIENT.modes(CHAIN)[0], rtol=5e-3)
    assert np.all(modes.freq_std > 0) and np.all(modes.damping_std > 0)
    assert [(s.name, s.point) for s in modes.sensors][2] == ("3x", (3.0, 0.0, 0.0))
    assert (into / "stabilisation.png").stat().st_size > 0
    assert "repeats = 3" in said and "synthetic = true" in said
    table = pd.read_csv(into / "identified.csv")
    assert all(f"{freq:.4f}" in said for freq in table["freq"][table["refused"].isna()])


@pytest.mark.parametrize(
    ("given", "word"),
    [(("--quantity", "accelerance"), "quantity"), (("--averages", "4"), "averages"), (("--band", "30", "2"), "band")],
)
def test_what_records_do_not_have_is_refused(tmp_path, capsys, given, word):
    path = AMBIENT.write_csv(tmp_path / "record.csv", AMBIENT.accelerations(CHAIN, 2000, 1))
    assert asked(path, *given, "--into", tmp_path / "identified") == 2
    said = capsys.readouterr().err
    assert word in said and "Traceback" not in said and not (tmp_path / "identified").exists()


@pytest.mark.medium
def test_short_and_mixed_files_are_refused(tmp_path, capsys):
    path = AMBIENT.write_csv(tmp_path / "record.csv", AMBIENT.accelerations(CHAIN, 2000, 1))
    assert asked(path, "--into", tmp_path / "identified") == 2
    assert "too few" in capsys.readouterr().err
    frfs = sorted(FRF.write_study(tmp_path / "chain").glob("repeat_*.uff"))
    assert asked(*frfs, path, "--into", tmp_path / "identified") == 2
    assert "mixed" in capsys.readouterr().err
