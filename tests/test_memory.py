"""Freed memory is given back to the machine."""

from pathlib import Path

import numpy as np
import pytest

from calib.execution import memory
from calib.execution.memory import FreedMemory, giving_back

STATUS = Path("/proc/self/status")


def resident():
    """Resident memory of this process, MB."""
    (line,) = (line for line in STATUS.read_text("utf-8").splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@pytest.mark.skipif(memory._trim() is None or not STATUS.exists(), reason="needs the GNU C library and /proc")
def test_what_lies_between_arrays_in_use_is_given_back():
    arrays = [np.ones(12_500) for _ in range(2000)]  # 200 MB in all, none large enough for pages of its own
    kept = arrays[::10]
    del arrays
    before = resident()
    assert FreedMemory().give_back() and before - resident() > 100
    assert all(array[-1] == 1.0 for array in kept)


def test_it_is_given_back_before_a_stage_and_seldom(monkeypatch):
    times, trimmed, told = iter([10.0, 10.5, 11.5]), [], []
    monkeypatch.setattr(memory, "_trim", lambda: trimmed.append)
    monkeypatch.setattr(memory.time, "monotonic", lambda: next(times))
    tell = giving_back(lambda *stage: told.append(stage))
    for stage in ("fitting", "", "testing", "leaving out"):
        tell(stage, 1, 2)
    assert [stage for stage, *_ in told] == ["fitting", "", "testing", "leaving out"] and told[0][1:3] == (1, 2)
    assert trimmed == [0, 0]  # not within a stage, and not half a second after the last time


def test_nothing_is_done_where_the_c_library_cannot(monkeypatch):
    monkeypatch.setattr(memory, "_trim", lambda: None)
    assert not FreedMemory().give_back()
