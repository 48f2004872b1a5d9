"""The running bench in Foxglove: what viewers are shown, and that no page of the web is shown anything."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from gyrowheel.simulation.api import record_simulation
from gyrowheel_bringup.foxglove_node import GuardedProxy, refusal
from gyrowheel_bringup.viewers import robot_description
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.origin_guard import web_origins
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

from ..domains import next_domain
from .helpers import SHORT_PLAN

PORT = 8765
PROTOCOL = ["foxglove.sdk.v1"]
#: What pages of other sites send, the last two after they have let their name point to this computer.
STRANGERS = [
    {"Origin": "https://example.com"},
    {"Origin": "http://127.0.0.1.example.com"},
    {"Origin": "http://localhost@example.com"},
    {"Origin": "null"},
    {"Origin": ""},
    {"Host": "example.com:{port}"},
    {"Host": "example.com:{port}", "Origin": "http://example.com:{port}"},
]
#: What viewers on this computer send: no page at all, a page from the disk, a page served here.
VIEWERS = [{}, {"Origin": "file://"}, {"Origin": "http://localhost:8080"}, {"Host": "localhost:{port}"}]


def request(headers: dict[str, str], *more: str) -> bytes:
    fields = {"Host": f"127.0.0.1:{PORT}", "Upgrade": "websocket"} | headers
    lines = [f"{name}: {value}".format(port=PORT) for name, value in fields.items()]
    return "\r\n".join(["GET / HTTP/1.1", *lines, *more, "", ""]).encode()


@pytest.mark.parametrize("headers", VIEWERS)
def test_viewers_of_this_computer_pass(headers: dict[str, str]) -> None:
    assert refusal(request(headers), PORT) == ""


@pytest.mark.parametrize("headers", STRANGERS)
def test_pages_of_other_sites_do_not_pass(headers: dict[str, str]) -> None:
    assert refusal(request(headers), PORT)


def test_requests_that_hide_a_header_do_not_pass() -> None:
    assert (
        refusal(request({}, "Host: example.com"), PORT)
        == f"host 127.0.0.1:{PORT}, example.com: not a name of this server"
    )
    assert (
        refusal(request({}, "Origin: file://", "Origin: https://example.com"), PORT) == "more than one origin"
    )
    assert refusal(request({}, " Origin: https://example.com"), PORT) == "malformed header"
    assert refusal(request({}, "Origin : https://example.com"), PORT) == "malformed header"
    assert refusal(request({"Host": "127.0.0.1:80"}), PORT).startswith("host 127.0.0.1:80")
    assert refusal(request({"Upgrade": "h2c"}), PORT) == "only WebSocket connections are served"
    assert refusal(request({}).replace(b"GET", b"POST"), PORT) == "only WebSocket connections are served"


def test_a_site_that_is_named_may_read() -> None:
    head = request({"Origin": "https://app.foxglove.dev"})
    assert refusal(head, PORT) == "origin https://app.foxglove.dev: a page of another site"
    assert refusal(head, PORT, web_origins("https://App.foxglove.dev, http://other:80")) == ""
    for wrong in ("*", "app.foxglove.dev", "https://app.foxglove.dev/", "https://", "file://"):
        with pytest.raises(InputError, match=r"^origin: .*; allowed: http"):
            web_origins(wrong)


@given(st.text(alphabet="abclohst127.0:/@[]# \\", max_size=30))
def test_no_other_origin_passes(text: str) -> None:
    """Whatever passes has, as a browser reads it, a host of this computer."""
    from urllib.parse import urlsplit

    origin = f"http://{text}"
    if refusal(request({"Origin": origin}), PORT) == "":
        assert urlsplit(origin).hostname in ("127.0.0.1", "localhost", "::1")


def test_the_proxy_ends_requests_that_do_not_end() -> None:
    """A head without end is cut; whoever is refused learns why; the server behind sees none of it."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        proxy = GuardedProxy("127.0.0.1", 0, server.getsockname())
        try:
            for sent in (
                b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 20_000,
                b"GET / HTTP/1.1\r\nHost: example.com\r\n\r\n",
            ):
                with socket.create_connection(("127.0.0.1", proxy.port), timeout=120.0) as client:
                    client.sendall(sent)
                    assert client.recv(4096).startswith(b"HTTP/1.1 403 ")
            assert proxy.refused == 2
            server.setblocking(False)
            with pytest.raises(BlockingIOError):
                server.accept()
        finally:
            proxy.close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", proxy.port), timeout=120.0)


async def connect(port: int, headers: dict[str, str]) -> WebSocketClientConnection:
    filled = {name: value.format(port=port) for name, value in headers.items()}
    return await websocket_connect(
        HTTPRequest(f"ws://127.0.0.1:{port}", headers=filled, connect_timeout=120.0), subprotocols=PROTOCOL
    )


async def knock(port: int) -> None:
    """Connect as every viewer and as every stranger."""
    for headers in VIEWERS:
        connection = await connect(port, headers)
        first = await connection.read_message()
        assert json.loads(first or "")["name"] == "gyrowheel"
        connection.close()
    for headers in STRANGERS:
        with pytest.raises(HTTPClientError) as refused:
            await connect(port, headers)
        assert refused.value.code == 403


async def watch(
    port: int, *, samples: int = 500
) -> tuple[dict[int, str], dict[str, list[tuple[int, bytes]]]]:
    """Return the channels that a viewer is offered, and what it hears on them until there is enough."""
    connection = await connect(port, {})
    channels: dict[int, str] = {}
    heard: dict[str, list[tuple[int, bytes]]] = {}
    latched = {topics.BENCH.name, topics.ENVIRONMENT.name, "/robot_description"}
    while len(heard.get(topics.MEASUREMENT.name, ())) <= samples or not latched <= set(heard):
        message = await connection.read_message()
        assert message is not None, "the server has closed the connection"
        if isinstance(message, str):
            content: dict[str, Any] = json.loads(message)
            if content["op"] == "advertise":
                channels |= {c["id"]: c["topic"] for c in content["channels"]}
                assert {c["encoding"] for c in content["channels"]} == {"cdr"}
                asked = [{"id": number, "channelId": number} for number in channels]
                await connection.write_message(json.dumps({"op": "subscribe", "subscriptions": asked}))
        elif message[0] == 1:
            number, stamp = struct.unpack_from("<IQ", message, 1)
            heard.setdefault(channels[number], []).append((stamp, message[13:]))
    connection.close()
    return channels, heard


@pytest.mark.graph
def test_foxglove_is_shown_a_replay_and_other_sites_nothing(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    from gyrowheel_bringup.foxglove_process import foxglove
    from gyrowheel_bringup.graph import find_executable

    plan = Plan.load(SHORT_PLAN)
    record_simulation(tmp_path / "run", Bench.load(), Scenario.nominal(), plan)
    domain = str(next_domain())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", domain)
        with foxglove(0) as address:
            port = int(address.rpartition(":")[2])
            assert address == f"ws://127.0.0.1:{port}"
            with pytest.raises(InputError, match=f"parameter port: {port} cannot be opened"), foxglove(port):
                pass
            asyncio.run(knock(port))
            replay = subprocess.Popen(
                [
                    str(find_executable("gyrowheel_recording", "replay_node")),
                    "--ros-args", "-p", f"directory:={tmp_path / 'run'}", "-p", "wait_for_subscribers:=1",
                ],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )  # fmt: skip
            try:
                channels, heard = asyncio.run(asyncio.wait_for(watch(port), 300.0))
                # who comes later is shown what is latched, also when nothing more comes
                _, late = asyncio.run(asyncio.wait_for(watch(port, samples=-1), 300.0))
            finally:
                replay.send_signal(signal.SIGINT)
                replay.wait(120.0)
    assert topics.TRUTH.name not in channels.values()
    for latched in (topics.BENCH, topics.ENVIRONMENT):
        assert late[latched.name][0][1] == heard[latched.name][0][1]
    samples = heard[topics.MEASUREMENT.name]
    numbers = [wire.MEASUREMENT.unpack(data)[1] for _, data in samples]
    assert numbers == list(range(numbers[0], numbers[0] + len(samples)))
    assert all(stamp == wire.stamp(data) for stamp, data in samples)
    assert wire.unpack_text(heard["/robot_description"][0][1]) == robot_description()
