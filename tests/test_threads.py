"""Numerical libraries use one thread within the context, and as many as before afterwards."""

from threadpoolctl import threadpool_info, threadpool_limits

from calib.execution.tasks import one_thread


def threads():
    return {library["num_threads"] for library in threadpool_info()}


def test_one_thread_as_often_as_it_is_asked_for_and_no_longer():
    with threadpool_limits(2):
        for _ in range(2):
            with one_thread():
                assert threads() == {1}
                with one_thread():
                    assert threads() == {1}
                assert threads() == {1}
            assert threads() == {2}
