"""Effect of Ctrl-C, the first time and again."""

import contextlib
import os
import queue
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from calib.command import cli
from calib.execution import interrupt

ROOT = Path(__file__).resolve().parent.parent

CHILD = """\
import signal, time
from calib.execution import interrupt

def hand(times=1, sign=signal.SIGINT):
    for _ in range(times):
        signal.raise_signal(sign)

def say(words):
    print(words, flush=True)

def alarm():
    signal.raise_signal(signal.SIGALRM)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
interrupt.PATIENCE = {patience}
{timer}
interrupt.once()
try:
{work}
except KeyboardInterrupt:
    say("leaving")
{leaving}
"""
BY_HAND = """\
interrupt.LOOK = -1.0  # the time until the next check is always over
timers = []
signal.setitimer = lambda *given: timers.append(given)
"""
"""The test itself rings when time would have passed: nothing depends on how fast the process is."""
AT_ONCE, NEVER = -1.0, 3600.0
"""When the patience with a leaving ends."""
TIMED = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="the system has no timer that interrupts")


def child(patience, *leaving, work=("hand()", "say('nothing was raised')"), timer=BY_HAND):
    """Exit code, output and complaints of a process that is interrupted at work, and of what it does while leaving."""
    work, leaving = ("\n".join("    " + line for line in lines) for lines in (work, leaving))
    script = CHILD.format(patience=patience, timer=timer, work=work, leaving=leaving)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    return run.returncode, run.stdout, run.stderr


@pytest.fixture
def handled():
    """Sets the process' handler for the time of a test."""
    before = {sign: signal.getsignal(sign) for sign in (signal.SIGINT, *interrupt.END_REQUESTS)}
    yield lambda handler: signal.signal(signal.SIGINT, handler)
    for sign, handler in before.items():
        signal.signal(sign, handler)


def test_installing_the_handler_twice_is_installing_it_once(handled):
    handled(signal.default_int_handler)
    interrupt.once()
    first = signal.getsignal(signal.SIGINT)
    interrupt.once()
    assert signal.getsignal(signal.SIGINT) is first is not signal.default_int_handler


@pytest.mark.parametrize("own", [signal.SIG_IGN, signal.SIG_DFL, lambda *given: None], ids=["ignored", "system", "own"])
def test_another_handler_is_left_alone(handled, own):
    handled(own)
    interrupt.once()
    assert signal.getsignal(signal.SIGINT) is own


@pytest.mark.parametrize("sign", interrupt.END_REQUESTS)
def test_a_request_to_end_is_an_interrupt_also_where_the_keyboard_is_ignored(handled, sign):
    """As in the background of a shell."""
    handled(signal.SIG_IGN)
    signal.signal(sign, signal.SIG_DFL)
    interrupt.once()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert signal.getsignal(sign) == interrupt._press.interrupt


@pytest.mark.parametrize("sign", ["signal.SIGINT", "signal.SIGTERM"])
def test_the_first_interrupt_is_raised_and_later_ones_are_ignored(sign):
    code, out, err = child(NEVER, f"hand(5, {sign})", "say('left in order')", work=[f"hand(1, {sign})"])
    assert (code, out, err) == (0, "leaving\nleft in order\n", "")


def test_a_leaving_that_takes_too_long_is_ended_by_the_next_interrupt():
    code, out, err = child(AT_ONCE, "say('still here')", "hand()", "say('never said')")
    assert (code, out, err) == (130, "leaving\nstill here\n", f"calib: {interrupt.WORDS}\n")
    assert interrupt.CODE == 130 and interrupt.WORDS == "interrupted; the same command again completes it"


@TIMED
def test_nothing_but_an_interrupt_ends_a_leaving_that_takes_long():
    code, out, err = child(AT_ONCE, "alarm()", "say('left in order')", "alarm()", "interrupt.command_over()", "alarm()")
    assert (code, out, err) == (0, "leaving\nleft in order\n", "")


THREAD = ("import os, threading", "def never_ends():", "    {first}", "    threading.Event().wait()",
          "threading.Thread(target=never_ends).start()", "say('the answer')", "interrupt.leave(3)")  # fmt: skip


def test_a_thread_that_never_ends_keeps_no_process():
    work = [line.format(first="pass") for line in THREAD]
    assert child(0.0, work=work) == (3, "the answer\n", f"calib: {interrupt.LEFT_RUNNING}\n")


@pytest.mark.medium
def test_a_process_that_is_only_slow_to_end_has_left_nothing_running():
    """As on a busy machine: the words would send a user to look for a fault of the model."""
    work = ("import atexit", "atexit.register(lambda: (time.sleep(1.5), say('all closed')))", "say('the answer')")
    found = child(1.0, work=(*work, "interrupt.leave(3)", "raise SystemExit(3)"))
    assert found == (3, "the answer\nall closed\n", "")


def test_a_daemon_thread_keeps_no_process_and_is_not_told():
    work = [line.format(first="pass").replace("never_ends)", "never_ends, daemon=True)") for line in THREAD]
    work[-1] = "interrupt.leave(0)"
    assert child(1.0, work=work) == (0, "the answer\n", "")


def test_an_interrupt_after_the_answer_ends_the_process():
    # When the main part is over; again, since Python misses a signal just before it begins to wait for a thread.
    first = "threading.main_thread().join()\n    while not time.sleep(0.01): os.kill(os.getpid(), signal.SIGINT)"
    assert child(NEVER, work=[part for line in THREAD for part in line.format(first=first).split("\n")]) == (
        3,
        "the answer\n",
        "",
    )


DEAF = (
    "import sys",
    "sys.unraisablehook = lambda given: None",
    "class Deaf:",
    "    def __del__(self):",  # what this raises cannot reach anybody
    "        hand()",
    "Deaf()",
)


@TIMED
def test_an_interrupt_that_is_swallowed_is_raised_again():
    work = (*DEAF, "say('going on')", "alarm()", "say('nobody noticed')")
    leaving = ("alarm()", "say('in order')", "interrupt.command_over()", "alarm()", "hand()", "say(timers)")
    code, out, err = child(NEVER, *leaving, work=work)
    timers = [(0, -1.0, -1.0)] * 2 + [(0, 0.0)]  # set for each time it is raised, and no more when all is over
    assert (code, out, err) == (0, f"going on\nleaving\nin order\n{timers}\n", "")


@TIMED
def test_a_timer_notices_an_interrupt_that_is_swallowed():
    work = (*DEAF, "time.sleep(300.0)", "say('nobody noticed')")
    code, out, _ = child(NEVER, "say('in order')", "interrupt.command_over()", work=work, timer="")
    assert (code, out) == (0, "leaving\nin order\n")


@TIMED
def test_an_interrupt_that_became_another_error_is_on_its_way():
    code, out, err = child(
        NEVER,
        "try:",
        "    raise SystemExit(7) from None",
        "finally:",
        "    alarm()",
        "    say('in order')",
        "    interrupt.command_over()",
    )
    assert (code, out, err) == (7, "leaving\nin order\n", "")


def test_an_interrupt_that_compiled_code_turned_into_another_error_ends_as_one(handled, monkeypatch, capsys):
    """A conversion in a library answers an interrupted call with an error of its own."""

    def app(**given):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise ValueError("an invalid matrix")

    monkeypatch.setattr(cli, "app", app)
    monkeypatch.setattr(interrupt, "_press", interrupt._Press())  # no other test sees the interrupt
    handled(signal.default_int_handler)
    interrupt.once()
    assert cli.execute([]) == interrupt.CODE and interrupt.WORDS in capsys.readouterr().err


def test_an_interrupt_waits_for_what_must_not_be_left_half_done():
    work = ("with interrupt.held():", "    hand(2)", "    say('whole')", "say('nobody noticed')")
    assert child(NEVER, "say('in order')", work=work) == (0, "whole\nleaving\nin order\n", "")


def test_a_wait_for_a_result_ends_now_and_then_so_that_python_sees_an_interrupt():
    """Between its last look and the wait itself a signal wakes nobody: it would be seen with the next result."""
    waited = []

    class Late(queue.SimpleQueue):
        def get(self, block=True, timeout=None):
            waited.append(timeout)
            if len(waited) < 3:
                raise queue.Empty
            return "done"

    assert interrupt.next_of(Late()) == "done"
    assert waited == [interrupt.SEEN] * 3 and 0 < interrupt.SEEN <= 1
