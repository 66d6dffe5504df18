"""The store of what tasks share: contents come back as they were, and no file of an earlier one is left."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.execution.outcome import NotSent, attempt
from calib.execution.shared_store import SharedStore, can_be_sent, read


@pytest.fixture
def store():
    store = SharedStore()
    yield store
    store.close()


def arrays(store):
    return {path.name for path in store.file("").parent.glob("*.npy")}


def test_the_same_array_is_written_once_and_a_dropped_one_is_deleted(store):
    first, second = np.ones((90, 90)), np.full((90, 90), 2.0)
    files = []
    for matrix in (first, first, second):
        store.written([matrix, matrix])
        files.append(arrays(store))
    assert files[0] == files[1] and files[1] & files[2] == set() and len(files[2]) == 1


def test_files_of_a_content_that_could_not_be_written_are_deleted(store, monkeypatch):
    first = store.written(kept := np.ones((90, 90)))
    before = arrays(store)

    def full(path, content, allow_pickle):
        path.touch()
        raise OSError(28, "no space left")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(OSError, match="space"):
        store.written([kept, np.full((90, 90), 2.0)])
    assert arrays(store) == before and np.array_equal(read(first), kept)


def test_parts_of_one_array_are_stored_once_whatever_their_strides(store):
    whole = np.random.default_rng(2).standard_normal((120, 110))
    for part in (whole[:100, :100], whole[5:105, 3:103], whole[::-1][:100, :100].T):
        found = read(store.written({"part": part}))["part"]
        assert found.tobytes() == part.tobytes() and found.strides == part.strides
        assert len(arrays(store)) == 1


def test_a_function_that_cannot_be_sent_is_no_failed_point(store):
    assert can_be_sent(arrays) and not can_be_sent(lambda: 0)
    sent = read(store.written(SimpleNamespace(here=lambda values: {"a": 1.0}, there=np.linalg.norm)))
    assert sent.there is np.linalg.norm
    with pytest.raises(NotSent, match="lambda"):
        attempt(sent.here, {})
