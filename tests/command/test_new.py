"""`calib new` writes a study that runs for each kind of model."""

import pytest

from calib.command import cli
from calib.command.example import KINDS, write_example
from calib.study.several import load


@pytest.mark.parametrize("kind", ["", *KINDS])
def test_every_kind_is_a_study_that_loads_and_says_that_it_is_computed(tmp_path, kind):
    written = write_example(tmp_path / "mine", kind)
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {path.name for path in written}
    study = load(tmp_path / "mine" / "study.toml")
    assert study.synthetic and "$" not in (tmp_path / "mine/study.toml").read_text("utf-8")


@pytest.mark.medium
@pytest.mark.parametrize("kind", KINDS)
def test_the_example_of_every_kind_is_calibrated_to_what_was_hidden(tmp_path, monkeypatch, undrawn, kind):
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["new", "mine", f"--{kind}"]) == 0
    assert cli.execute(["calibrate", "mine", "--workers", "1"]) == 0
    found = load(tmp_path / "mine/study.toml").model.space
    assert set(found.names) == {"k1", "k2", "k3"}
    lines = (tmp_path / "results/mine/verdicts.csv").read_text("utf-8").splitlines()
    rows = [dict(zip(lines[0].split(","), line.split(","), strict=False)) for line in lines[1:]]
    values = {row["parameter"]: float(row["value"]) for row in rows}
    for name, hidden in (("k1", 1.12), ("k2", 0.89), ("k3", 1.09)):
        assert values[name] == pytest.approx(hidden, rel=0.05)


def test_two_kinds_at_once_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["new", "mine", "--modes", "--table"]) == 2
    assert "--modes and --table exclude each other" in capsys.readouterr().err
    assert not (tmp_path / "mine").exists()
