"""What changes while a page is open: told to every page within a second, and looked for only while one is open."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket, WebSocketDisconnect

from calib.workbench.runs import Commands
from calib.workbench.studies import Studies

EVERY = 0.5
"""Seconds between two looks."""
_QUIET = 1.0
"""The same where no command runs."""
_STUDIES_EVERY = 10
"""Looks after which studies are looked for anew."""


class Live:
    """Sockets of the open pages.

    Parameters
    ----------
    studies : Studies
    commands : Commands
    """

    def __init__(self, studies: Studies, commands: Commands):
        self._studies, self._commands = studies, commands
        self._pages: set[asyncio.Queue[str]] = set()
        self._task: asyncio.Task[None] | None = None
        self._known: dict[str, Any] = {}
        self._wake = asyncio.Event()

    def look(self) -> None:
        """Look now: something was changed by a page."""
        self._wake.set()

    async def serve(self, socket: WebSocket) -> None:
        """One page, until it is closed."""
        await socket.accept()
        waiting: asyncio.Queue[str] = asyncio.Queue(16)
        self._pages.add(waiting)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._watch())
        else:
            waiting.put_nowait(self._text)
        gone = asyncio.create_task(_until_gone(socket))
        try:
            while not gone.done():
                told = asyncio.create_task(waiting.get())
                await asyncio.wait({told, gone}, return_when=asyncio.FIRST_COMPLETED)
                if told.done():
                    await socket.send_text(told.result())
                else:
                    told.cancel()
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            gone.cancel()
            self._pages.discard(waiting)

    @property
    def _text(self) -> str:
        return json.dumps(self._known, default=str)

    async def _watch(self) -> None:
        """Look for changes while there are pages."""
        looks, known, running = 0, None, set[int]()
        while self._pages:
            if looks % _STUDIES_EVERY == 0 or self._wake.is_set():
                known = await run_in_threadpool(self._studies.all)
            looks += 1
            self._wake.clear()
            found = await run_in_threadpool(self._seen, known)
            if found != self._known:
                self._known = found
                for page in self._pages:
                    if page.full():  # a page that does not read gets the latest state alone
                        with contextlib.suppress(asyncio.QueueEmpty):
                            page.get_nowait()
                    page.put_nowait(self._text)
            before, running = running, _running(found)
            if running != before:  # a command that ends may have written a study
                looks = 0
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), EVERY if running else _QUIET)

    def _seen(self, known: Any) -> dict[str, Any]:
        """Of each study what changes with its results and with its ledger, and its commands."""
        return {
            "studies": {
                key: {
                    "results": hash(one.stamp()), "search": hash(_ledger_stamp(one)),
                    "runs": self._commands.listing(one),
                }
                for key, one in known.items()
            }
        }  # fmt: skip


def _running(found: dict[str, Any]) -> set[int]:
    """Processes of the commands that run."""
    return {run["pid"] for one in found["studies"].values() for run in one["runs"] if run["state"] == "running"}


def _ledger_stamp(study: Any) -> tuple[Any, ...]:
    found = []
    for path in (study.ledger, study.ledger.with_name(f"{study.ledger.name}-wal")):
        try:
            state = path.stat()
            found.append((state.st_mtime_ns, state.st_size))
        except OSError:
            found.append((0, 0))
    return tuple(found)


async def _until_gone(socket: WebSocket) -> None:
    """A page sends nothing: whatever comes is left aside until it closes."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.receive_text()
