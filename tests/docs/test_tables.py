"""Every table that a run writes, and every column of it, is documented."""

import runpy
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli

ROOT = Path(__file__).resolve().parents[2]
LIST, FRFS = (runpy.run_path(str(Path(__file__).with_name(f"{name}.py"))) for name in ("tables", "frf_study"))
missing, stale = LIST["missing"], LIST["stale"]
COMMANDS = {
    "example": [["new", "STUDY"], ["run", "STUDY", "--quick"]],
    "rig": [["calibrate", str(ROOT / "studies/four_storey_rig"), "--quick"]],
    "screened": [["sensitivity", str(ROOT / "studies/four_storey_rig"), "--quick", "--method", m] for m in
                 ("morris", "sobol")],
    "function": [["run", str(ROOT / "studies/five_mass_chain"), "--quick"]],
}  # fmt: skip


@pytest.mark.medium
@pytest.mark.parametrize(
    "name", ["screened", *(pytest.param(name, marks=pytest.mark.slow) for name in ("example", "rig", "function"))]
)
def test_every_column_of_every_table_is_documented(undrawn, tmp_path, name):
    for command in COMMANDS[name]:
        command = [str(tmp_path / "study") if word == "STUDY" else word for word in command]
        where = [] if command[0] == "new" else ["--results", str(tmp_path / "results")]
        assert cli.execute([*command, *where]) == 0
    assert missing(tmp_path / "results") == {}
    assert name == "function" or stale(tmp_path / "results") == {}


@pytest.mark.slow
def test_every_column_of_every_table_of_frfs_is_documented_and_there(undrawn, tmp_path):
    FRFS["write"](tmp_path / "chain")
    results = tmp_path / "results"
    assert cli.execute(["run", str(tmp_path / "chain"), "--quick", "--workers", "1", "--results", str(results)]) == 0
    known, out = LIST["documented"](), results / "chain/quick"
    assert missing(results) == {}
    for name in ("frf", "frf_lines"):
        for stage in ("before", "after", "added"):
            assert LIST["found"](out / f"{name}_{stage}.csv") == known[f"{name}_{stage}.csv"]
    assert LIST["found"](out / "frf_misfit.csv") == known["frf_misfit.csv"]
    for name in ("measured", "comparison_before", "comparison_after", "comparison_added"):
        lacking = set(known[f"{name}.csv"]) - set(LIST["found"](out / f"{name}.csv"))
        assert not lacking & LIST["OF_FRFS"]
    groups = pd.read_csv(out / "errors.csv")["group"]
    assert set(groups) == {"fit", "left_out", "held_out_sensors", "held_out_references", "held_out_bands"}
    assert all(f"`{group}`" in LIST["common"]("group") for group in groups)


def test_a_column_that_is_not_documented_is_found(tmp_path):
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "convergence.csv").write_text("case,generation,best,worst\nC1,1,0.5,0.7\n", "utf-8")
    (folder / "spare.csv").write_text("a\n1\n", "utf-8")
    (folder / "modes.csv").write_text("mode,freq_before,damped\nA,1.0,2.0\n", "utf-8")
    assert missing(folder) == {
        "convergence.csv": ["worst"], "spare.csv": ["not documented at all"], "modes.csv": ["damped"],
    }  # fmt: skip
