"""Points that failed for a while, such as those without a licence, are evaluated once more on request."""

from pathlib import Path

import pytest

from calib import Study
from calib.command import cli

LICENCE = """
from pathlib import Path

def answer(values):
    with open("asked", "a") as stream:
        stream.write(f"{values['a']!r}\\\\n")
    if values["a"] > 2.5 and not Path("licence").exists():
        raise RuntimeError("no LICENSE")
    if values["a"] > 2.9:
        raise RuntimeError("buckled")
    return {"y": values["a"] + values["b"], "z": values["a"]}
""".replace("\\\\", "\\")
ASKED = "[sensitivity]\nsamples = 40\n"

pytestmark = pytest.mark.usefixtures("functions_in_this_process", "undrawn")


@pytest.fixture
def sampled(tmp_path, monkeypatch, capsys):
    """A study of which some samples failed; what the command said."""
    from tests.template import plain

    monkeypatch.chdir(tmp_path)
    plain.write(Path("plain"), LICENCE, ASKED, y=(3.0, 0.1), z=(1.0, 0.1))
    assert cli.execute(["sensitivity", "plain", "--workers", "1"]) == 0
    return capsys.readouterr().out


def asked() -> list[float]:
    found = [float(line) for line in Path("asked").read_text().split()]
    Path("asked").unlink()
    return found


@pytest.mark.medium
def test_failed_points_alone_are_evaluated_again(sampled, capsys):
    assert "points failed" in sampled and "calib again plain" in sampled
    failed = [a for a in asked() if a > 2.5]
    assert cli.execute(["sensitivity", "plain", "--workers", "1"]) == 0
    assert not [a for a in asked() if a > 2.5]  # a failure is final
    Path("licence").touch()
    capsys.readouterr()
    assert cli.execute(["again", "plain", "--workers", "1"]) == 0
    told = capsys.readouterr().out
    buckled = [a for a in failed if a > 2.9]
    assert sorted(asked()) == sorted(failed) and buckled
    assert f"{len(failed)} points" in told and f"{len(buckled)} failed again" in told and "buckled" in told
    assert cli.execute(["sensitivity", "plain", "--workers", "1"]) == 0
    assert f"{len(buckled)} of 40 points failed" in capsys.readouterr().out
    assert not [a for a in asked() if a > 2.5]  # what was found is used


@pytest.mark.medium
def test_the_same_from_python(sampled):
    Path("licence").touch()
    found = Study.load("plain").again()
    assert found.points > found.failed > 0 and "buckled" in str(found)
    assert Study.load("plain").again().points == found.failed


@pytest.mark.medium
def test_nothing_has_failed(sampled, capsys):
    text = Path("plain/model.py").read_text()
    Path("plain/model.py").write_text(text.replace('values["a"] > 2.5', "False"))
    assert cli.execute(["again", "plain"]) == 0
    assert "No point" in capsys.readouterr().out
