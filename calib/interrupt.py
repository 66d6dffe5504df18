"""The keyboard's interrupt, once: a hand that presses twice must not break into the leaving it has asked for."""

from __future__ import annotations

import os
import signal
import time
from types import FrameType

CODE = 130
"""Exit code of an interrupted command, as shells have it."""
WORDS = "interrupted; the same command again completes it"
PATIENCE = 5.0
"""Seconds a command has for leaving; an interrupt after them ends the process where it stands."""


def once() -> None:
    """From here to the end of the process the first interrupt raises KeyboardInterrupt, and later ones are the same.

    A leaving that takes longer than `PATIENCE` is ended by the next interrupt; worker processes end with this one.
    Where interrupts are already handled in another way, or ignored, nothing changes.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    first: list[float] = []

    def handle(number: int, frame: FrameType | None) -> None:
        if not first:
            first.append(time.monotonic())
            raise KeyboardInterrupt
        if time.monotonic() - first[0] > PATIENCE:
            os.write(2, f"calib: {WORDS}\n".encode())
            os._exit(CODE)

    signal.signal(signal.SIGINT, handle)
