"""A damaged MATLAB file, which native code reads, is refused in a sentence, even where reading it ends a process."""

import signal

import numpy as np
import pytest
from scipy.io import savemat

from calib.errors.errors import InputError
from calib.execution.worker import EndedError, apart
from calib.measurement.files import matlab


@pytest.fixture
def path(tmp_path):
    savemat(tmp_path / "test.mat", {"f": np.arange(100.0), "words": "by hand"})
    return tmp_path / "test.mat"


@pytest.mark.medium
def test_another_process_reads_it(path):
    np.testing.assert_array_equal(np.ravel(matlab.matlab_variables(path, ("f",), "")["f"]), np.arange(100.0))


def test_a_reader_that_ends_is_no_end_of_ours(path, monkeypatch):
    def ended(read, *given):
        return apart(signal.raise_signal, signal.SIGKILL)

    monkeypatch.setattr(matlab, "apart", ended)
    with pytest.raises(InputError, match=f"signal {signal.SIGKILL:d}") as caught:
        matlab.matlab_variables(path, ("f",), "")
    assert str(path) in str(caught.value)


@pytest.mark.medium
def test_what_a_process_raises_is_raised_here():
    with pytest.raises(ValueError, match="'x'"):
        apart(int, "x")
    with pytest.raises(EndedError, match="exit code 3"):
        apart(exec, "import os; os._exit(3)")


@pytest.mark.parametrize("damage", [lambda whole: whole[:300], lambda whole: b"\0" * 128 + whole[128:]])
@pytest.mark.parametrize("version", ["5", "7.3"])
def test_a_cut_file_and_one_without_a_header_are_refused(path, damage, version, monkeypatch):
    if version == "7.3":
        with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
            file["f"] = np.arange(1000.0)
        head = b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\0\2IM"
        path.write_bytes(head + path.read_bytes()[128:])
    path.write_bytes(damage(path.read_bytes()))
    monkeypatch.setattr(matlab, "apart", lambda function, *given: function(*given))
    with pytest.raises(InputError, match=r"test\.mat"):
        matlab.matlab_variables(path, ("f",), "")
