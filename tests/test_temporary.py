"""Temporary folders: what killed processes leave behind is deleted, and nothing else."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from calib.execution import temporary
from calib.execution.temporary import LOCK, TemporaryFolder, clear_abandoned
from calib.results.results import Results

ROOT = Path(__file__).resolve().parent.parent
KILLED = """\
import os, signal
from calib.execution.temporary import TemporaryFolder

folder = TemporaryFolder()
(folder.path / "large").write_bytes(bytes(1000))
print(folder.path, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    """The system's place for temporary files."""
    there = tmp_path / "tmp"
    there.mkdir()
    monkeypatch.setenv("TMPDIR", str(there))
    monkeypatch.setattr(tempfile, "tempdir", str(there))
    return there


@pytest.fixture
def abandoned(place):
    run = subprocess.run(
        [sys.executable, "-c", KILLED], env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    left = Path(run.stdout.strip())
    assert left.parent == place and (left / "large").is_file(), run.stderr
    return left


def test_a_folder_ends_with_its_block(place):
    with TemporaryFolder() as path:
        (path / "content").write_text("words")
        assert path.parent == place
    assert not any(place.iterdir())


def test_what_a_killed_process_left_is_deleted(abandoned, place):
    clear_abandoned()
    assert not any(place.iterdir())


def test_the_next_run_of_any_study_deletes_it(abandoned, place, tmp_path):
    Results.at(tmp_path / "results", "a_study")
    assert not any(place.iterdir())


def test_what_is_in_use_stays(place):
    with TemporaryFolder() as path:
        clear_abandoned()
        assert (path / LOCK).is_file()


def test_folders_of_others_stay(abandoned, place, monkeypatch):
    """Of another program, of another host, of another user, and of a process that is just making its own."""
    (place / "tmp_of_another").mkdir()
    elsewhere = abandoned.rename(place / f"calib_another-host_{abandoned.name[-8:]}")
    making = place / f"{temporary._MARK}making"
    making.mkdir()
    clear_abandoned()
    assert sorted(place.iterdir()) == sorted([place / "tmp_of_another", elsewhere, making])
    elsewhere.rename(abandoned)
    monkeypatch.setattr(temporary.os, "getuid", lambda: os.stat(place).st_uid + 1)
    clear_abandoned()
    assert abandoned.is_dir()


def test_a_folder_without_a_lock_is_deleted_when_it_is_old(place):
    making = place / f"{temporary._MARK}making"
    making.mkdir()
    os.utime(making, (0, 0))
    clear_abandoned()
    assert not making.exists()


def test_a_link_is_not_followed(place, tmp_path):
    (kept := tmp_path / "kept").mkdir()
    os.utime(kept, (0, 0))
    (place / f"{temporary._MARK}link").symlink_to(kept)
    clear_abandoned()
    assert kept.is_dir()
