"""Every table that a run writes, and every column of it, is documented."""

import runpy
from pathlib import Path

import pytest

from calib import cli

ROOT = Path(__file__).resolve().parents[2]
LIST = runpy.run_path(str(Path(__file__).with_name("tables.py")))
documented, found, unknown = LIST["documented"], LIST["found"], LIST["unknown"]
COMMANDS = {
    "example": [["new", "STUDY"], ["run", "STUDY", "--quick"]],
    "rig": [["calibrate", str(ROOT / "studies/four_storey_rig"), "--quick"]],
    "screened": [["sensitivity", str(ROOT / "studies/four_storey_rig"), "--quick", "--method", m] for m in
                 ("morris", "sobol")],
    "function": [["run", str(ROOT / "studies/five_mass_chain"), "--quick"]],
    "bogie": [["run", str(ROOT / "studies/hidden_bogie"), "--quick"]],
}  # fmt: skip


def missing(results: Path) -> dict[str, list[str]]:
    """Files without a documented name, and columns that are not documented."""
    known, out = documented(), {}
    for file in sorted([*results.rglob("*.csv"), *results.rglob("*.json")]):
        if "_extended" in file.parent.name and not (file.parent / "record.json").exists():
            continue  # the extended study itself, not results
        out[file.name] = unknown(file, known[file.name]) if file.name in known else ["not documented at all"]
    assert len(out) > 1
    return {name: columns for name, columns in out.items() if columns}


def stale(results: Path) -> dict[str, list[str]]:
    """Documented columns that tables of modes do not have; those of scalar responses and of several tests apart."""
    known, other = (
        documented(),
        {"test", "response", "value", "std", "std_used", "measured", "model", "error", "error_in_std"},
    )
    out = {}
    for file in results.rglob("*.csv"):
        if file.name in known:
            columns = found(file)
            least = set(known[file.name]) - (other if file.name.startswith(("measured", "comparison")) else {"test"})
            out[file.name] = sorted(name for name in least if "<" not in name and name not in columns)
    return {name: columns for name, columns in out.items() if columns}


@pytest.mark.parametrize(
    "name", ["example", "rig", "screened", *(pytest.param(n, marks=pytest.mark.slow) for n in ("function", "bogie"))]
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
