"""The folder of results: what cannot be done there is said in one sentence."""

import pytest

from calib.errors import InputError
from calib.results import Results


def test_what_cannot_be_deleted_is_told(tmp_path):
    results = Results.at(tmp_path, "study")
    (results.path / "old.json").write_text("{}")
    results.remove("old.json", "nothing.json")
    assert not results.has("old.json")
    (results.path / "old.json").mkdir()
    with pytest.raises(InputError, match=r"old\.json.*cannot be deleted"):
        results.remove("old.json")
