"""`calib.look` and ``calib look``: files of any kind without a model, the same answer from both doors."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

import calib
import calib.api.look
from calib.command import cli
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ROOT / "studies"
BEAM = module_of(ROOT / "tests/template/hammer_beam.py")


@pytest.fixture(scope="module")
def mast(tmp_path_factory):
    return write_example(tmp_path_factory.mktemp("look") / "mast")[0].parent


def frf_table(path, gamma=0.99, scale=1.0):
    freq = np.linspace(4.0, 8.0, 81)
    values = scale / (5.0**2 - freq**2 + 0.1j * freq)
    rows = [
        f"{f},{name},1z,{v.real},{v.imag},{gamma}"
        for name, own in (("1z", values), ("2z", 0.4 * values)) for f, v in zip(freq, own, strict=True)
    ]  # fmt: skip
    path.write_text("\n".join(["freq,response,reference,re,im,coherence", *rows]))


@pytest.mark.medium
def test_modes_with_shapes_and_places_are_told_apart_by_their_content(mast, tmp_path, capsys):
    files = [mast / "sensors.csv", mast / "shapes.csv", mast / "modes.csv"]  # in any order
    found = calib.look(files)
    assert found.modes.names == ("B1x", "B1z", "B2x", "B2z") and found.frfs is None
    assert found.table["kind"].eq("mode").all() and found.table["what"].tolist() == list(found.modes.names)
    assert found.tables["nodes"]["y"].tolist() == [1.5, 3.0, 4.5, 6.0]
    assert "Modes: 4 at 8 sensors" in str(found)
    assert cli.execute(["look", *map(str, files), "--into", str(tmp_path / "seen")]) == 0
    said = capsys.readouterr().out
    for sentence in found.sentences:
        assert " ".join(sentence.split()) in " ".join(said.split())
    written = pd.read_csv(tmp_path / "seen/look.csv")
    assert written["freq"].to_numpy() == pytest.approx(found.table["freq"].to_numpy())
    assert (tmp_path / "seen/look.png").stat().st_size > 10_000


@pytest.mark.medium
def test_repeats_in_universal_files_have_a_comac_with_the_first():
    files = sorted((STUDIES / "hidden_bogie/measured").glob("*.uff"))[:3]
    found = calib.look(files)
    assert found.modes.n_repeats == 3
    table = found.tables["comac_repeats"]
    assert len(table) == len(found.modes.sensors) and table["comac"].between(0.0, 1.0).all()
    assert {len(ax.patches) > 0 or len(ax.images) > 0 or len(ax.lines) > 0 for ax in found.figure().axes} <= {
        True,
        False,
    }
    titles = [ax.get_title(loc="left") for ax in found.figure().axes]
    assert any("CoMAC" in title for title in titles) and any("Auto-MAC" in title for title in titles)


def test_frfs_tell_band_resolution_unit_resonances_and_low_coherence(tmp_path):
    frf_table(tmp_path / "good.csv")
    found = calib.look(tmp_path / "good.csv", unit="m/N")
    said = " ".join(found.sentences)
    assert "receptance in m/N" in said and "81 lines from 4 to 8 Hz, 0.05 Hz apart" in said
    assert "Resonances: 1, at 5 Hz" in said
    assert found.table["coherence"].to_numpy() == pytest.approx(0.99)
    assert found.doubts == ()
    frf_table(tmp_path / "bad.csv", gamma=0.5)
    bad = calib.look(tmp_path / "bad.csv", unit="m/N")
    assert any("1z/1z (0.50)" in words for words in bad.doubts)


def test_odd_data_are_told(mast, tmp_path):
    folder = tmp_path / "twice"
    shutil.copytree(mast, folder)
    shapes = (folder / "shapes.csv").read_text().splitlines()
    by_mode = {line.split(",")[0]: [] for line in shapes[1:]}
    for line in shapes[1:]:
        by_mode[line.split(",")[0]].append(line.split(",")[1:])
    by_mode["B2x"] = by_mode["B1x"]
    rows = [",".join([mode, *cells]) for mode, own in by_mode.items() for cells in own]
    (folder / "shapes.csv").write_text("\n".join([shapes[0], *rows]))
    found = calib.look([folder / "modes.csv", folder / "shapes.csv"])
    assert any("B1x and B2x" in words for words in found.doubts)


def test_records_and_frfs_side_by_side(tmp_path):
    rng = np.random.default_rng(3)
    rows = [f"{k / 100:.2f},{a:.6g},{b:.6g}" for k, (a, b) in enumerate(rng.normal(size=(1200, 2)))]
    (tmp_path / "wind.csv").write_text("\n".join(["time,1z,2z", *rows]))
    frf_table(tmp_path / "hammer.csv")
    found = calib.look([tmp_path / "wind.csv", tmp_path / "hammer.csv"], unit=None, quantity="accelerance")
    assert found.table["kind"].tolist() == ["function", "function", "sensor", "sensor"]
    assert len(found.records) == 1 and "12 s in all" in " ".join(found.sentences)


def test_what_cannot_be_looked_at_is_refused(mast, tmp_path, capsys):
    with pytest.raises(InputError, match="no modes, FRFs or records"):
        calib.look(mast / "sensors.csv")
    with pytest.raises(InputError, match="no such file"):
        calib.look(tmp_path / "none.csv")
    with pytest.raises(InputError, match="second table of places"):
        calib.look([mast / "modes.csv", mast / "sensors.csv"], sensors=mast / "sensors.csv")
    assert cli.execute(["look", str(tmp_path / "none.csv")]) == 2
    assert "no such file" in capsys.readouterr().err


def test_hammer_records_are_seen_as_their_frfs_and_what_does_not_count_is_told(tmp_path):
    files = BEAM.session(tmp_path, 3)
    double = BEAM.write(tmp_path / "double.csv", BEAM.record([(0.05, 100.0), (0.11, 40.0)], 7))
    found = calib.look([*files, double])
    assert found.records == () and found.frfs.n_repeats == 3
    assert found.tables["functions"]["coherence"].notna().all()
    assert any("double.csv" in words and "double hit" in words for words in found.doubts)


@pytest.mark.slow
def test_matlab_files_are_seen_by_the_names_of_their_variables(tmp_path, capsys, monkeypatch):
    shapes = np.array([[0.3, -0.7], [1.0, 1.0]])
    savemat(tmp_path / "modes.mat", {"f": [1.7, 10.7], "zeta": [0.004, 0.005], "Phi": shapes})
    freq = np.linspace(4.0, 8.0, 81)
    savemat(tmp_path / "frfs.mat", {"f": freq, "H": 1 / (25.0 - freq**2 + 0.1j * freq)})
    names = {"freq": "f", "damping": "zeta", "shapes": "Phi"}
    found = calib.look(tmp_path / "modes.mat", variables=names, channels=["1x", "2x"])
    assert found.tables["auto_mac"].shape[0] == 2 and found.frfs is None
    seen = calib.look(tmp_path / "frfs.mat", variables={"freq": "f", "frf": "H"}, channels=["1z/1z"], unit="m/N")
    assert seen.modes is None and seen.table["peak_freq"].item() == pytest.approx(5.0)
    monkeypatch.setattr(calib.api.look.Look, "save", lambda *_: ())  # drawn above
    command = ["look", str(tmp_path / "modes.mat")]
    assert cli.execute([*command, "--variables", "freq=f,damping=zeta,shapes=Phi", "--channels", "1x,2x"]) == 0
    assert "2 at 2 sensors" in capsys.readouterr().out
    assert cli.execute(command) == 2
    assert "--variables freq=f" in " ".join(capsys.readouterr().err.split())


def test_set_ups_keep_the_coherence_of_their_files(tmp_path):
    frf_table(tmp_path / "one.csv")
    frf_table(tmp_path / "two.csv", gamma=0.9)
    own = (tmp_path / "two.csv").read_text().replace(",2z,", ",3z,")
    (tmp_path / "two.csv").write_text(own)
    found = calib.look([tmp_path / "one.csv", tmp_path / "two.csv"], unit="m/N")
    seen = found.tables["functions"].set_index("function")["coherence"]
    assert seen["2z/1z"] == pytest.approx(0.99) and seen["3z/1z"] == pytest.approx(0.9)
    assert seen["1z/1z"] == pytest.approx(0.9)  # of a shared function the lower one
