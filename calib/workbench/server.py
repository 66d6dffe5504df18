"""The server of the live page: on this computer alone, until it is interrupted."""

from __future__ import annotations

import contextlib
import secrets
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors.errors import InputError

if TYPE_CHECKING:
    from starlette.types import ASGIApp

EXTRA = "pip install 'calib[workbench]'"
LOOPBACK = "127.0.0.1"
_AT_ONCE = 64
"""Connections that are served at a time."""
_LAST = 2
"""Seconds in which open connections end when the server does."""


def application(path: Path, root: Path, token: str, port: int) -> ASGIApp:
    """The guarded application of the live page.

    Parameters
    ----------
    path : Path
        A study, or a folder with studies.
    root : Path
        Parent of the folders of their results.
    token : str
        First part of every address.
    port : int

    Raises
    ------
    InputError
        Without the packages that it needs, or where there is no such study or folder.
    """
    try:
        from calib.workbench.app import Workbench
        from calib.workbench.guard import Guard
    except ModuleNotFoundError as fault:
        if fault.name not in ("starlette", "uvicorn", "websockets", "anyio"):
            raise
        raise InputError(f"the live page needs {fault.name}", place="calib open", remedy=EXTRA) from None
    from calib.workbench.studies import Studies

    studies = Studies(path, root)
    if not studies.is_study and not path.is_dir():
        raise InputError(
            "there is no such folder", place=path, remedy="name a study, or write an example with: calib new FOLDER"
        )
    return Guard(Workbench(studies).app, token, port)


def serve(path: Path, root: Path, port: int, browser: bool, say: Callable[[str], None]) -> None:
    """Serve the live page until the command is interrupted; commands that it has started go on.

    Parameters
    ----------
    path, root
        See `application`.
    port : int
        0 for any that is free.
    browser : bool
        Whether to open the page in the browser.
    say : callable
        Prints a line.
    """
    with contextlib.closing(_listening(port)) as ears:
        token, own = secrets.token_urlsafe(24), int(ears.getsockname()[1])
        app = application(path, root, token, own)
        try:
            import uvicorn
            import websockets  # noqa: F401  # which uvicorn imports when a page connects
        except ModuleNotFoundError as fault:
            raise InputError(f"the live page needs {fault.name}", place="calib open", remedy=EXTRA) from None
        address = f"http://{LOOPBACK}:{own}/{token}/"
        say(f"The page is at {address}")
        say("It answers on this computer alone. Ctrl-C ends the server; commands that it has started go on.")
        server = uvicorn.Server(
            uvicorn.Config(
                app, log_level="critical", lifespan="off", access_log=False, server_header=False,
                ws="websockets-sansio", limit_concurrency=_AT_ONCE, timeout_graceful_shutdown=_LAST,
                h11_max_incomplete_event_size=16_384, ws_max_size=4096,
            )
        )  # fmt: skip
        if browser:
            webbrowser.open(address)
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[ears])
        say("The server has ended.")


def _listening(port: int) -> socket.socket:
    """A socket of this computer alone; InputError for a port that is taken."""
    # Only where the protocol is named does asyncio send at once; else each answer waits some 40 ms for the page.
    ears = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        ears.bind((LOOPBACK, port))
        ears.listen(_AT_ONCE)  # whoever reads the address may ask at once
    except OSError as fault:
        ears.close()
        raise InputError(f"{port} cannot be used ({fault.strerror})", place="--port", remedy="choose another") from None
    return ears
