"""Tasks shared with other processes: the same results, failures and order as in one, and nothing left behind."""

import gc
import multiprocessing
import os
import sys
import tempfile
import weakref
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calib.errors.errors import EvaluationError, InputError
from calib.execution import tasks, team, temporary
from calib.execution.tasks import each, in_this_process, shared_by
from calib.execution.team import Team

# Other processes import functions by name, so they live in a module of their own on the path.
MODULE = """
import os, time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from calib.errors.errors import EvaluationError
from calib.execution.tasks import each


def who(folder, item):
    # With a folder every process waits there until two have begun a task.
    if folder is not None:
        meet(folder)
    return os.getpid()


def meet(folder):
    (folder / str(os.getpid())).touch()
    until = time.monotonic() + 300.0  # a hang becomes a failure
    while len(list(folder.iterdir())) < 2:
        if time.monotonic() > until:
            raise TimeoutError
        time.sleep(0.005)


def product(shared, item):
    matrix, folder = shared
    if isinstance(folder, Path):
        meet(folder)
    return item, matrix @ matrix[:, item], matrix.flags.f_contiguous, matrix.flags.writeable


def threads(folder, item):
    meet(folder)
    np.linalg.inv(np.eye(3))
    return os.getpid(), max(one["num_threads"] for one in threadpool_info())


def fails(shared, item):
    if item in shared:
        raise EvaluationError(f"no convergence at {item}")
    return item


def dies_elsewhere(shared, item):
    home, folder = shared
    meet(folder)
    if os.getpid() != home:
        os._exit(3)
    return item


def fails_elsewhere(shared, item):
    home, folder = shared
    meet(folder)
    if os.getpid() != home:
        raise MemoryError
    return item


def nested(folder, item):
    meet(folder)
    return [os.getpid(), *each(who, None, range(6))]


class Unread:
    def __setstate__(self, state):
        raise ImportError("there is no such module there")

    def __getstate__(self):
        return {"some": "thing"}


def unread(shared, item):
    return item


def adder(size):
    return lambda item: item + size


def carries(shared, item):
    meet(shared[1])
    return item, os.getpid()


def calls(shared, item):
    function, folder = shared
    meet(folder)
    try:
        return function(item)
    except Exception:
        return None


def stops(home, item):
    if os.getpid() != home:
        time.sleep(600.0)  # it is ended with its process
    if item == 3:
        raise KeyboardInterrupt
    return item


now = [0.0]


def lasts(seconds, item):
    now[0] += seconds
    return item
"""


@pytest.fixture(scope="module")
def module(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tasks")
    (folder / "team_tasks.py").write_text(MODULE, "utf-8")
    sys.path.insert(0, str(folder))
    import team_tasks

    yield team_tasks
    sys.path.remove(str(folder))


@pytest.fixture(scope="module", autouse=True)
def every_call_is_shared():
    """However fast these tasks are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(team, "_WORTH", 0.0)
        yield


@pytest.fixture
def meeting(tmp_path):
    """An empty folder in which two processes meet, see the tasks."""
    return new(tmp_path)


def new(folder):
    return Path(tempfile.mkdtemp(dir=folder))


def ready(one, module, folder):
    """The team, once another process does tasks."""
    assert len(set(one(module.who, new(folder), range(12)))) >= 2
    return one


@pytest.fixture(scope="module")
def two(module, tmp_path_factory):
    with Team(2) as one:
        yield ready(one, module, tmp_path_factory.mktemp("meeting"))


def test_results_are_those_of_one_process_in_the_order_of_the_items(two, module, meeting):
    matrix = np.asfortranarray(np.random.default_rng(1).standard_normal((90, 90)))
    told = []
    own = in_this_process(module.product, (matrix, None), range(30))
    both = two(module.product, (matrix, meeting), range(30), told.append)
    assert two.shares
    for (k, mine, *order), (j, theirs, *other) in zip(own, both, strict=True):
        assert k == j and order == other == [True, True]
        assert mine.tobytes() == theirs.tobytes()
    assert len(told) < 30  # the other process has done some
    assert told[0] == 0 and sorted(told) == told and told[-1] < 30


@pytest.mark.medium
def test_what_a_call_shared_is_not_kept_in_memory_and_a_new_array_is_never_taken_for_it(two, module):
    for value in (1.0, 2.0, 3.0):  # CPython gives a new array the number of one that has gone
        matrix = np.full((90, 90), value)
        gone = weakref.ref(matrix)
        found = two(module.product, (matrix, 0), range(40))
        assert all(column[0] == 90 * value**2 for _, column, *_ in found)
        del matrix
        gc.collect()
        assert gone() is None
        assert len(list(two._store.file("").parent.glob("*.npy"))) == 1


def test_libraries_use_one_thread_in_every_process(two, module, meeting):
    found = two(module.threads, meeting, range(12))
    assert len({pid for pid, _ in found}) == 2
    assert {count for _, count in found} == {1}


@pytest.mark.parametrize("failing", [{0}, {19}, {4, 15}, {18, 3}])
def test_the_first_failure_in_order_is_raised(two, module, failing):
    with pytest.raises(EvaluationError, match=f"at {min(failing)}$"):
        two(module.fails, failing, range(20))
    assert two(module.fails, (), range(20)) == list(range(20))


def test_what_cannot_be_sent_is_done_here(module):
    with Team(2) as one:
        assert one(lambda shared, item: item + shared, 1, range(5)) == [1, 2, 3, 4, 5]
        assert not one.shares


@pytest.mark.medium
def test_what_cannot_be_sent_prevents_no_other_tasks_from_being_shared(module, meeting):
    with Team(2) as one:
        one(lambda shared, item: item, None, range(5))
        ready(one, module, meeting)
        assert one(module.unread, module.Unread(), range(9)) == list(range(9))
        assert one.shares
        ready(one, module, meeting)


def test_a_function_that_cannot_be_sent_stays_here_and_what_holds_it_is_sent(two, module, meeting):
    found = two(module.carries, (module.adder(2), meeting), range(6))
    assert [item for item, _ in found] == list(range(6)) and len({who for _, who in found}) == 2


@pytest.mark.medium
def test_a_task_that_calls_a_function_that_could_not_be_sent_is_done_here(module, meeting):
    with Team(2) as one:
        ready(one, module, new(meeting))
        assert one(module.calls, (module.adder(2), new(meeting)), range(6)) == [2, 3, 4, 5, 6, 7]
        assert module.calls in one._unsent and one.shares


def test_tasks_within_a_task_are_done_by_its_process(two, module, meeting):
    with shared_by(two):
        found = two(module.nested, meeting, range(6))
    assert len({row[0] for row in found}) == 2
    assert all(set(row) == {row[0]} for row in found)


@pytest.mark.medium
def test_what_fails_or_dies_elsewhere_is_done_here(module, meeting):
    with Team(2) as one:
        ready(one, module, meeting)
        assert one(module.fails_elsewhere, (os.getpid(), new(meeting)), range(20)) == list(range(20))
        assert one.shares
        last = new(meeting)
        assert one(module.dies_elsewhere, (os.getpid(), last), range(20)) == list(range(20))
        assert not one.shares
        assert one(module.dies_elsewhere, (os.getpid(), last), range(3)) == [0, 1, 2]


@pytest.mark.medium
def test_no_process_and_no_file_is_left_after_an_interrupt(module, meeting):
    before = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt), Team(3) as one:
        ready(one, module, meeting)
        others, folder = set(multiprocessing.active_children()) - before, one._store.file("").parent
        assert len(others) == 2 and folder.is_dir()
        one(module.stops, os.getpid(), range(40))
    assert not folder.exists()
    assert not any(process.is_alive() for process in others)
    assert not others & set(multiprocessing.active_children())


@pytest.fixture
def timed(module, monkeypatch):
    """Tasks that last as long as they say, by a clock of their own."""
    monkeypatch.setattr(team, "time", SimpleNamespace(perf_counter=lambda: module.now[0]))
    monkeypatch.setattr(team, "_WORTH", 0.3)
    return module


def test_others_are_started_when_they_pay_off(timed):
    with Team(2, patience=0.5) as one:
        one(timed.lasts, 0.05, range(2))
        assert one._pool is None
        one(timed.lasts, 0.05, range(10))
        one(timed.lasts, 0.05, range(10))
        assert one._pool is not None
    told = []
    with Team(2, patience=0.5) as one:  # the first task shows that the others take long enough
        assert one(timed.lasts, 0.05, range(60), told.append) == list(range(60))
        assert one._pool is not None
    assert told[0] == 0 and sorted(told) == told and told[-1] < 60
    with Team(2) as one:
        one._seconds[timed.lasts] = 1e-4
        one(timed.lasts, 1e-4, range(5))
        assert one._pool is None
        one(timed.fails, (), [1])
        assert one._pool is None


def test_calls_of_two_tasks_are_shared_too_once_they_took_long(timed):
    with Team(2, patience=0.5) as one:
        for _ in range(2):
            one(timed.lasts, 0.2, range(2))
            assert one._pool is None
        one(timed.lasts, 0.2, range(2))
        assert one._pool is not None


def test_calls_that_are_not_worth_sending_start_no_process_however_many_they_are(timed):
    with Team(2, patience=0.2) as one:
        for _ in range(50):
            one(timed.lasts, 0.05, range(2))
        assert one._pool is None
        one(timed.lasts, 0.2, range(2))
        one(timed.who, None, range(9))  # after long ones, tasks of a function that nobody knows: the first one shows
        assert one._pool is None
        one(timed.lasts, 0.2, range(2))
        assert one._pool is not None


@pytest.mark.parametrize("fault", ["folder", "process", "second process"])
def test_where_no_other_process_can_be_started_all_is_done_here(module, monkeypatch, fault):
    class Full(team.ProcessPoolExecutor):
        asked = 0

        def submit(self, *given):
            Full.asked += 1
            if fault == "process" or Full.asked > 3:
                raise BlockingIOError("Resource temporarily unavailable")
            return super().submit(*given)

    def no_space(**given):
        raise OSError("No space left on device")

    if fault == "folder":
        monkeypatch.setattr(temporary.tempfile, "TemporaryDirectory", no_space)
    monkeypatch.setattr(team, "ProcessPoolExecutor", Full)
    with Team(2) as one:
        assert one(module.who, None, range(8)) == [os.getpid()] * 8
        assert not one.shares
        assert one(module.who, None, range(8)) == [os.getpid()] * 8


def test_more_tasks_than_the_board_has_places(two, module, monkeypatch):
    monkeypatch.setattr(team, "_MOST", 8)
    told = []
    assert two(module.fails, (), range(20), told.append) == list(range(20))
    assert sorted(told) == told and all(0 <= number < 20 for number in told)  # the other process may take them all


@pytest.mark.medium
def test_tasks_are_shared_while_a_context_lasts():
    seen = []

    def share(function, shared, items, told=tasks.unreported):
        seen.append(len(items))
        return in_this_process(function, shared, items, told)

    with shared_by(share):
        assert each(pow, 2, [1, 2]) == [2, 4]
    assert each(pow, 2, [3]) == [8]
    assert seen == [2]


@pytest.mark.medium
def test_workers_below_one_are_refused():
    with pytest.raises(InputError, match="0 workers"):
        Team(0)
