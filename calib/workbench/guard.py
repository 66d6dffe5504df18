"""Who may ask the server of the live page: its own page alone, known by the token in the address."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Mapping
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST = 65_536
"""Bytes of a request's body."""
PATIENCE = 5.0
"""Seconds in which a body must have arrived."""
_READING = ("GET", "HEAD")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
"""What the page may load: no script but the server's own files. Figures bear their styles in attributes."""
_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class Guard:
    """Refuses every request that does not come from the page itself.

    The first part of the path must be the token, the host one of this computer's own names, and the origin, which
    browsers state with every change and every socket, that of the page.

    Parameters
    ----------
    app : ASGI application
        Receives what passes; its paths follow the token.
    token : str
    port : int
    """

    def __init__(self, app: ASGIApp, token: str, port: int):
        self._app, self._token = app, token
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, socket or start of the server."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refused = self._refused(scope, headers)
        if scope["type"] == "websocket":
            if refused is not None:
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": refused[1]})
                return
            await self._app(self._within(scope), receive, send)
            return
        body = b""
        if refused is None and scope["method"] not in _READING:
            try:
                body = await asyncio.wait_for(_body(receive, headers), PATIENCE)
            except TimeoutError:
                refused = 408, "the request did not arrive in time"
            except OverflowError:
                refused = 413, f"a request has at most {LARGEST} bytes"
        sender = _with_headers(send)
        if refused is not None:
            status, words = refused
            await PlainTextResponse(f"{words}\n", status, {"connection": "close"})(scope, receive, sender)
            return
        await self._app(self._within(scope), _replayed(body, receive), sender)

    def _within(self, scope: Scope) -> Scope:
        return {**scope, "root_path": f"/{self._token}"}

    def _refused(self, scope: Scope, headers: Mapping[str, str]) -> tuple[int, str] | None:
        """Status and reason for a request that is not the page's; None for one that is."""
        if headers.get("host", "") not in self._hosts:
            return 421, "this server answers to its own name alone"
        first = scope["path"].split("/", 2)[1:2]
        if not first or not hmac.compare_digest(first[0].encode("utf-8", "replace"), self._token.encode()):
            return 403, "the address lacks the token that 'calib open' has printed"
        changes = scope["type"] == "websocket" or scope["method"] not in _READING
        origin = headers.get("origin")
        if (origin is None and changes) or (origin is not None and origin not in self._origins):
            return 403, "another page asks"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403, "another page asks"
        if scope["type"] == "http" and changes:
            if scope["method"] != "POST":
                return 405, "the method is not allowed"
            if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
                return 415, "a request is JSON"
        return None

    @property
    def _origins(self) -> set[str]:
        return {f"http://{host}" for host in self._hosts}


async def _body(receive: Receive, headers: Mapping[str, str]) -> bytes:
    """The whole body; OverflowError for one that is too long."""
    stated = headers.get("content-length", "0")
    if not stated.isdigit() or int(stated) > LARGEST:
        raise OverflowError
    parts = bytearray()
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return bytes(parts)
        parts += message.get("body", b"")
        if len(parts) > LARGEST:
            raise OverflowError
        if not message.get("more_body", False):
            return bytes(parts)


def _replayed(body: bytes, receive: Receive) -> Receive:
    """The body as one message, then what follows."""
    waiting: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def again() -> Message:
        return waiting.pop() if waiting else await receive()

    return again


def _with_headers(send: Send) -> Send:
    """Adds the headers of safety, each unless the answer has its own."""

    async def sender(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers: Any = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sender
