"""Every table that a run writes, and every column of it, is documented."""

import runpy
from pathlib import Path

import pytest

from calib import cli

ROOT = Path(__file__).resolve().parents[2]
LIST = runpy.run_path(str(Path(__file__).with_name("tables.py")))
missing, stale = LIST["missing"], LIST["stale"]
COMMANDS = {
    "example": [["new", "STUDY"], ["run", "STUDY", "--quick"]],
    "rig": [["calibrate", str(ROOT / "studies/four_storey_rig"), "--quick"]],
    "screened": [["sensitivity", str(ROOT / "studies/four_storey_rig"), "--quick", "--method", m] for m in
                 ("morris", "sobol")],
    "function": [["run", str(ROOT / "studies/five_mass_chain"), "--quick"]],
}  # fmt: skip


@pytest.mark.parametrize(
    "name", ["example", "screened", *(pytest.param(name, marks=pytest.mark.slow) for name in ("rig", "function"))]
)
def test_every_column_of_every_table_is_documented(undrawn, tmp_path, name):
    for command in COMMANDS[name]:
        command = [str(tmp_path / "study") if word == "STUDY" else word for word in command]
        where = [] if command[0] == "new" else ["--results", str(tmp_path / "results")]
        assert cli.execute([*command, *where]) == 0
    assert missing(tmp_path / "results") == {}
    assert name == "function" or stale(tmp_path / "results") == {}


def test_a_column_that_is_not_documented_is_found(tmp_path):
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "convergence.csv").write_text("case,generation,best,worst\nC1,1,0.5,0.7\n", "utf-8")
    (folder / "spare.csv").write_text("a\n1\n", "utf-8")
    (folder / "modes.csv").write_text("mode,damped_freq_before,damped\nA,1.0,2.0\n", "utf-8")
    assert missing(folder) == {
        "convergence.csv": ["worst"], "spare.csv": ["not documented at all"], "modes.csv": ["damped"],
    }  # fmt: skip
