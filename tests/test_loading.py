"""Code of a study is always compiled from its file."""

import os
import sys

import pytest

from calib.study.loading import module_of


@pytest.mark.parametrize("kept", [True, False])
def test_an_edit_within_a_second_that_keeps_the_size_is_seen(tmp_path, monkeypatch, kept):
    """Python itself would go on with what it compiled before."""
    monkeypatch.setattr(sys, "dont_write_bytecode", not kept)
    file = tmp_path / "model.py"
    for number in (1, 2):
        file.write_text(f"def answer():\n    return {number}\n")
        os.utime(file, (1.0e9, 1.0e9))
        assert module_of(file).answer() == number
    assert [path.name for path in tmp_path.iterdir()] == ["model.py"]
