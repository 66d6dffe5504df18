"""Older pictures that a newer run replaces, and those that it leaves."""

import pytest

from calib.api.figures import _replaced
from calib.report.style import write


@pytest.fixture
def folder(tmp_path):
    """Pictures by calib, and one that somebody else has put there."""
    for name in ("modes_before", "modes_after_1", "modes_after_2", "mac", "anthill_a_b"):
        write({"png": name.encode()}, tmp_path / name)
    (tmp_path / "mac_1.png").write_bytes(b"of the user")
    return tmp_path


@pytest.mark.parametrize(
    ("drawn", "everything", "gone"),
    [
        (["modes_before_1", "modes_before_2", "mac"], False, {"modes_before"}),
        (["modes_after", "mac"], False, {"modes_after_1", "modes_after_2"}),
        (["modes_after_1", "mac"], False, {"modes_after_2"}),
        (["modes_before", "modes_after_1", "modes_after_2", "mac"], False, set()),
        (["mac"], True, {"modes_before", "modes_after_1", "modes_after_2", "anthill_a_b"}),
    ],
)
def test_one_picture_and_several_of_a_subject_replace_each_other(folder, drawn, everything, gone):
    figures = [path for name in drawn for path in write({"png": b"new"}, folder / name)]
    assert set(_replaced(folder, figures, everything)) == {f"{name}.png" for name in gone}
