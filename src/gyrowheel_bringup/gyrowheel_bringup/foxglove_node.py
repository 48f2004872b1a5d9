"""The node ``foxglove``: shows the topics of the running bench in the viewer Foxglove.

Messages are passed on as bytes, at the time of the bench. Only clients of this computer are served, and no page of the
web: a `GuardedProxy` stands before the server of foxglove-sdk, which serves whoever connects.
Needs the package foxglove-sdk, which the extra ``foxglove`` installs.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import secrets
import threading
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import Any, Final

from gyrowheel_bringup.viewers import ROBOT_DESCRIPTION, robot_description
from gyrowheel_core import origin_guard, topics, wire
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.node import WARN, BenchNode, NodeStatus, Param, run_node
from gyrowheel_core.origin_guard import web_origins
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.columns import definition

HOST: Final = "127.0.0.1"
PORT: Final = 8765
_ANSWER: Final = 0.1  # time between two looks at what viewers ask for [s]
_BACKLOG: Final = 20_000  # messages kept for a slow viewer: a few seconds


def _hidden_host() -> str:
    """Return an address of the loopback interface that nobody guesses.

    A web page may try ports of 127.0.0.1; together with the port this address is one of 10¹¹.
    """
    return ".".join(map(str, (127, *(secrets.randbelow(254) + 1 for _ in range(3)))))


class FoxgloveNode(BenchNode):
    """Shows the topics of the bench in the viewer Foxglove."""

    NODE_NAME = "foxglove"
    PARAMETERS = (
        Param(
            "port",
            PORT,
            "Port on this computer that Foxglove connects to; 0: any free one",
            low=0,
            high=65535,
        ),
        Param(
            "origins",
            "",
            "Web pages that may read besides those of this computer, separated by spaces: https://app.foxglove.dev",
        ),
    )

    def configure(self) -> None:
        """Open the server and its channels."""
        try:
            import foxglove
            from foxglove.websocket import ChannelView, Client, ServerListener
        except ImportError:
            raise InputError(
                "foxglove-sdk is not installed; it comes with: pip install 'gyrowheel-bringup[foxglove]'"
            ) from None
        origins = web_origins(self.parameter("origins"))
        self._sink = foxglove.Context()
        # the last messages of latched topics, and the channels to which a viewer has just subscribed
        self._kept: dict[str, deque[bytes]] = {}
        self._asked_for: deque[str] = deque()
        asked_for = self._asked_for

        class Listener(ServerListener):
            """Notes what viewers ask for; called by a thread of the server."""

            def on_subscribe(self, client: Client, channel: ChannelView) -> None:
                asked_for.append(channel.topic)

        hidden = _hidden_host()
        self._server = foxglove.start_server(
            name=f"gyrowheel {self.namespace}".strip(),
            host=hidden,
            port=0,
            context=self._sink,
            message_backlog_size=_BACKLOG,
            server_listener=Listener(),
        )
        port = self.parameter("port")
        try:
            self._proxy = GuardedProxy(HOST, port, (hidden, self._server.port), origins)
        except OSError as error:
            self._server.stop()
            reason = error.strerror or one_line(error)
            raise InputError(f"parameter port: {port} cannot be opened on {HOST}: {reason}") from None
        self.address = f"ws://{HOST}:{self._proxy.port}"
        self._now = 0  # time of the bench [ns]
        self._passed = self._told = 0
        shown = [topic for topic in topics.TOPICS if topic not in (topics.TRUTH, topics.CLOCK)]
        self._channels = {topic: self._channel(foxglove, topic) for topic in (*shown, ROBOT_DESCRIPTION)}
        self._inputs = [self.subscription(topic, self._passer(topic), raw=True) for topic in shown]
        self._kept[ROBOT_DESCRIPTION.within(self.namespace)] = deque([wire.pack_text(robot_description())])
        self._answering = self.wall_timer(_ANSWER, self._show_latched)
        self.get_logger().info(f"open {self.address} in Foxglove")

    def cleanup(self) -> None:
        """Close the server and destroy the subscriptions."""
        self.destroy_timer(self._answering)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._proxy.close()
        self._server.stop()
        self._channels = {}

    def diagnose(self) -> NodeStatus:
        """Return the address and counts."""
        proxy = self._proxy
        values = {"address": self.address, "messages": self._passed, "refused_connections": proxy.refused}
        text = "showing" if self._passed else "waiting for messages"
        if proxy.refused > self._told:
            self._told = proxy.refused
            return NodeStatus(f"{text}; refused: {proxy.last_refusal}", values, WARN)
        return NodeStatus(text, values)

    def _channel(self, foxglove: Any, topic: Topic) -> Any:
        known = definition(topic.type_name)
        return foxglove.Channel(
            topic.within(self.namespace),
            schema=foxglove.Schema(name=topic.type_name, encoding="ros2msg", data=known.text.encode()),
            message_encoding="cdr",
            context=self._sink,
        )

    def _passer(self, topic: Topic) -> Callable[[bytes], None]:
        channel = self._channels[topic]
        timed = topic is topics.MEASUREMENT
        kept: deque[bytes] = deque(maxlen=topic.depth)
        if topic.latched:
            self._kept[topic.within(self.namespace)] = kept

        def take(data: bytes) -> None:
            if topic.latched:
                kept.append(data)
            if timed:
                try:
                    self._now = wire.stamp(data)
                except ValueError:  # from a node that is not of this bench
                    return
            self._passed += 1
            channel.log(data, log_time=self._now)

        return take

    def _show_latched(self) -> None:
        """Send latched messages again, to all viewers, where a viewer has subscribed since."""
        asked = set()
        while self._asked_for:
            asked.add(self._asked_for.popleft())
        for topic, channel in self._channels.items():
            name = topic.within(self.namespace)
            for data in self._kept.get(name, ()) if name in asked else ():
                channel.log(data, log_time=self._now)


def main() -> int:
    """Run the node."""
    return run_node(FoxgloveNode)


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
