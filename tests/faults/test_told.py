"""What a command says about failed points and about output that it cannot write."""

import sys
from pathlib import Path

import pytest

import calib.__main__ as entry
from calib.command import cli, terminal

FAILING = """
def answer(values):
    if values["a"] > 2.5:
        raise ValueError("too soft")
    return {"y": values["a"] + values["b"], "z": values["a"]}
"""


@pytest.mark.medium
@pytest.mark.usefixtures("functions_in_this_process", "undrawn")
def test_a_calibration_tells_failed_points_without_a_request(plain, capsys):
    plain(FAILING)
    assert cli.execute(["calibrate", "plain", "--method", "genetic", "--workers", "1"]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "points failed" in line]
    assert len(told) == 1 and "too soft" in told[0]


class Full:
    """A stream on a full disk."""

    encoding = "utf-8"

    def isatty(self):
        return False

    def write(self, text):
        raise OSError(28, "No space left on device")

    def flush(self):
        pass

    def fileno(self):
        raise OSError("there is no file behind it")


@pytest.mark.usefixtures("functions_in_this_process", "undrawn")
def test_output_that_cannot_be_written_is_told_and_loses_no_result(plain, capsys, monkeypatch):
    plain(FAILING)
    monkeypatch.setattr(terminal._out, "lost", "")
    monkeypatch.setattr(sys, "stdout", Full())
    assert cli.execute(["compare", "plain"]) == 1
    told = capsys.readouterr().err
    assert "No space left on device" in told and told.count("\n") == 1
    assert Path("results/plain/comparison_before.csv").is_file() and not Path("calib-error.log").exists()


def test_streams_that_were_closed_lead_nowhere(monkeypatch):
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    entry._open_streams()
    opened = sys.stdin, sys.stdout, sys.stderr
    try:
        assert sys.stdin.read() == ""
        print("nobody hears this", file=sys.stdout), print("nor this", file=sys.stderr)
    finally:
        for stream in opened:
            stream.close()
