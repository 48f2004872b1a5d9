"""A proxy in front of a WebSocket server on this computer: it refuses pages of other web sites.

It reads the head of each connection, and passes on those that `gyrowheel_core.origin_guard` accepts.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import threading
from collections.abc import Collection, Sequence
from typing import Final

from gyrowheel_core import origin_guard

_HEAD: Final = 16_384  # longest head of a request [bytes]
_PATIENCE: Final = 5.0  # for the head of a request [s]
_MOST: Final = 64  # connections at the same time
_BLOCK: Final = 65_536  # [bytes]


def refusal(head: bytes, port: int, origins: Collection[str] = ()) -> str:
    """Return why a WebSocket request is refused; empty if it is accepted.

    Parameters
    ----------
    head : bytes
        Request line and headers, to the empty line that ends them.
    port : int
        Port of the server.
    origins : collection of str
        Accepted origins besides pages of this computer, in lower case.
    """
    lines = head.decode("latin-1").split("\r\n")
    fields: dict[str, list[str]] = {}
    for line in lines[1:]:
        if not line:
            continue
        name, colon, value = line.partition(":")
        if not colon or name != name.strip():  # also a folded line, in which a header could hide
            return "malformed header"
        fields.setdefault(name.lower(), []).append(value.strip())
    if (
        not re.fullmatch(r"GET \S+ HTTP/1\.1", lines[0])
        or fields.get("upgrade", [""])[0].lower() != "websocket"
    ):
        return "only WebSocket connections are served"
    return origin_guard.refusal(
        fields.get("host", []),
        fields.get("origin", []),
        names=origin_guard.host_names("localhost", port),
        allowed=(origin_guard.DESKTOP, *origins),
        local_pages=True,
    )


class GuardedProxy:
    """Listens in place of a server and passes on accepted connections; runs in its own thread.

    Parameters
    ----------
    host, port : str, int
        Where clients connect; port 0: any free one.
    server : (str, int)
        Where the server listens.
    origins : sequence of str
        Accepted web origins besides those of this computer (`gyrowheel_core.origin_guard.web_origins`).

    Attributes
    ----------
    port : int
        Where clients connect.
    refused : int
        Connections refused.
    last_refusal : str
        Why the last one was; empty without one.

    Raises
    ------
    OSError
        If the port cannot be opened.
    """

    def __init__(self, host: str, port: int, server: tuple[str, int], origins: Sequence[str] = ()) -> None:
        self._server, self._origins = server, tuple(origins)
        self.refused, self.last_refusal = 0, ""
        self._open: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        try:
            self._listening = self._loop.run_until_complete(
                asyncio.start_server(self._accept, host, port, limit=_HEAD)
            )
        except OSError:
            self._loop.close()
            raise
        self.port: int = self._listening.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="proxy", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End every connection."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result(10.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        self._listening.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._open.add(task)
        try:
            await self._serve(reader, writer)
        except (OSError, asyncio.IncompleteReadError, asyncio.CancelledError):  # it ended
            pass
        finally:
            self._open.discard(task)
            writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = b""
        if len(self._open) > _MOST:
            why = "too many connections"
        else:
            try:
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _PATIENCE)
                why = refusal(head, self.port, self._origins)
            except (TimeoutError, asyncio.LimitOverrunError):
                why = "the head of the request is too long, or does not come"
        if why:
            self.refused += 1
            self.last_refusal = why
            text = f"refused: {why}\n".encode("latin-1", errors="replace")
            writer.write(
                b"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nConnection: close\r\n"
                + f"Content-Length: {len(text)}\r\n\r\n".encode()
                + text
            )
            await writer.drain()
            return
        inner_reader, inner_writer = await asyncio.open_connection(*self._server)
        inner_writer.write(head)
        ways = [
            asyncio.ensure_future(_pass_on(reader, inner_writer)),
            asyncio.ensure_future(_pass_on(inner_reader, writer)),
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            inner_writer.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(_BLOCK):
            writer.write(data)
            await writer.drain()  # a client that does not read is not waited for in memory
