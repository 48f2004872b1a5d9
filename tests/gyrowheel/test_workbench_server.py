"""The server of the workbench: whom it answers, and what it answers to requests."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tornado.httputil import HTTPHeaders

import gyrowheel as gw
from gyrowheel.workbench import server as workbench_server
from gyrowheel.workbench.derived import Channels
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Access, Server
from gyrowheel.workbench.session import Session
from gyrowheel_core.origin_guard import is_loopback

from .conftest import Wheel
from .helpers import Shell, ask


@pytest.fixture
def server(wheel: Wheel) -> Iterator[Server]:
    with Server(
        Session(Library([wheel.recording.parent]), gw.Model.load(wheel.model), wheel.model), port=0
    ) as own:
        yield own


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "bench.example:80"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://bench.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
    ],
    ids=str,
)
def test_pages_of_other_sites_are_refused(server: Server, headers: dict[str, str]) -> None:
    for path, content in (("/", None), ("/state", None), ("/events", None), ("/do/undo", {})):
        status, body = ask(server, path, content, **headers)
        assert status == 403
        assert set(json.loads(body)) == {"error"}


@pytest.mark.parametrize(
    ("address", "port", "host"),
    [
        ("127.0.0.2", 8080, "127.0.0.2:8080"),
        ("::1", 8080, "[::1]:8080"),
        ("[2001:DB8:0::1]", 8080, "[2001:db8::1]:8080"),
        ("Bench.Lab", 8080, "bench.lab:8080"),
        ("127.0.0.1", 80, "127.0.0.1"),
    ],
)
def test_host_names_of_the_server(address: str, port: int, host: str) -> None:
    own = Access.of(address, port)
    assert own.refusal(HTTPHeaders({"Host": host, "Origin": f"http://{host}"})) == ""
    assert own.refusal(HTTPHeaders({"Host": "bench.example:8080"})) != ""
    assert bool(own.token) != is_loopback(address)
    assert own.cookie != Access.of(address, port + 1).cookie  # a browser sends it to every port


@pytest.mark.parametrize("loopback", [False, True])
def test_a_token_is_required_unless_the_address_is_loopback(
    loopback: bool, wheel: Wheel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workbench_server, "is_loopback", lambda address: loopback)
    with Server(Session(Library([wheel.recording]), gw.Model()), port=0, token=loopback) as server:
        token = server.access.token
        assert len(token) > 20
        for path, content in (("/", None), ("/state", None), ("/signal?key=0/.", None), ("/do/undo", {})):
            assert ask(server, path, content)[0] == 401
            assert ask(server, path, content, Cookie=f"{server.access.cookie}=guess")[0] == 401
        assert ask(server, "/state", Cookie=f"{server.access.cookie}={token}")[0] == 200
        assert token not in server.url
    for address in ("0.0.0.0", "0", ""):  # however it is written
        with pytest.raises(gw.InputError, match="name one of this computer"):
            Server(Session(Library([wheel.recording]), gw.Model()), address, 0)


@pytest.mark.parametrize(
    ("action", "content", "words"),
    [
        ("open", {"key": "0/../../etc", "role": "fitted"}, "not in the chosen folders"),
        ("open", {"key": "0/drag", "role": "root"}, "role: 'root' is not allowed"),
        ("open", {"key": "0/drag"}, "role is missing"),
        ("open", ["0/drag"], "object of texts"),
        ("diagnose", {}, "none is open to fit"),
        ("add", {"what": "windage"}, "none is open to fit"),
        ("undo", {}, "nothing to undo"),
        ("redo", {}, "nothing to redo"),
        ("use", {"key": "0/drag", "from": "1", "until": "2", "use": "fitted"}, "is not open"),
        ("use", {"key": "0/drag", "from": "x", "until": "2", "use": "fitted"}, "from: 'x' is no number"),
        ("other", {"name": "../x.yaml"}, "none is open to fit"),
        ("use_all", {"key": "0/drag"}, "is not open"),
        ("add_all", {}, "nothing is diagnosed"),
        ("remove", {"what": "windage"}, "windage"),
        ("test", {"plan": "quick"}, "none is open to fit"),
        ("save", {"name": "../model.yaml"}, "name: '../model.yaml' is not allowed"),
        ("save", {"name": ".model.yaml"}, "is not allowed"),
        ("save", {"name": "a" * 300 + ".yaml"}, "is not allowed"),
        ("save", {"name": "測" * 60 + ".yaml"}, "is not allowed"),
        ("formula", {"text": "k*z\ud800"}, "are no text"),
        ("open", {"key": "\ud800", "role": "fitted"}, "are no text"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_bad_requests_are_refused_in_a_sentence(
    server: Server, action: str, content: Any, words: str
) -> None:
    status, body = ask(server, f"/do/{action}", content)
    assert status == 422
    sentence = json.loads(body)["error"]
    assert words in sentence
    assert 10 < len(sentence) < 1000
    assert server.session.version == 0


@pytest.mark.parametrize(
    "text",
    [
        "torque = -k*Omgea*z",
        "(" * 10_000 + "z" + ")" * 10_000,
        "__import__('os').system('true')",
        "k*z + Omega",
    ],
    ids=lambda text: text[:20],
)
def test_a_bad_formula_is_refused_before_it_is_added(server: Server, text: str) -> None:
    ask(server, "/do/open", {"key": "0/drag", "role": "fitted"})
    server.session.wait(240.0)
    status, body = ask(server, "/do/formula", {"text": text})
    assert status == 200
    assert set(json.loads(body)) == {"refused"}
    status, body = ask(server, "/do/add_formula", {"text": text})
    assert status == 422
    assert 10 < len(json.loads(body)["error"]) < 1000
    assert server.session.job is None


def test_large_requests_and_other_content_types_are_refused(server: Server) -> None:
    for path, kind in (("/do/open", "application/json"), ("/table?name=a.csv", "application/octet-stream")):
        connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=240.0)
        connection.putrequest("POST", path)
        connection.putheader("Content-Type", kind)
        connection.putheader("Content-Length", str(10**9))
        connection.endheaders()
        try:
            connection.send(b"x" * 65536)
            assert connection.getresponse().status == 400
        except (ConnectionError, http.client.HTTPException):
            pass  # hung up without reading it
    assert ask(server, "/state")[0] == 200
    assert ask(server, "/do/undo", {}, Content_Type="text/plain")[0] == 415
    for path in ("/files/../server.py", "/files/%2e%2e/server.py", "/files/workbench.html", "/do/quit"):
        assert ask(server, path, {} if path.startswith("/do") else None)[0] == 404


def test_signals_are_sent_unchanged(server: Server, wheel: Wheel) -> None:
    assert ask(server, "/signal?key=0/drag&from=0&until=1&points=100")[0] == 422  # not open
    ask(server, "/do/open", {"key": "0/drag", "role": "fitted"})
    server.session.wait(240.0)
    samples = gw.Recording.open(wheel.recording).measurement
    status, body = ask(server, "/signal?key=0/drag&from=2&until=2.01&points=1000")
    assert status == 200
    (count,) = np.frombuffer(body, "<f8", 1)
    n = int(count)
    times = np.frombuffer(body, "<f8", n, 8)
    first, second = (np.frombuffer(body, "<f4", n, 8 + 8 * n + 4 * n * k) for k in (0, 1))
    place = int(np.searchsorted(gw.Recording.open(wheel.recording).time, times[0]))
    assert times[0] <= 2.0 < 2.01 <= times[-1]
    assert np.allclose(first, np.degrees(samples["tilt_x"][place : place + n]), rtol=1e-6)
    assert np.allclose(second, np.degrees(samples["tilt_y"][place : place + n]), rtol=1e-6)
    for query in ("from=1&until=0", "from=nan&until=1", "from=x&until=1"):
        assert ask(server, f"/signal?key=0/drag&{query}&points=9")[0] == 422


def test_help_explains_and_every_effect_has_a_page(server: Server) -> None:
    status, body = ask(server, "/help")
    assert status == 200
    assert b"Omega" in body
    status, body = ask(server, "/help/effect/windage")
    assert status == 200
    assert b"windage" in body
    status, body = ask(server, "/help/effect/windge")
    assert status == 422
    assert "windage" in json.loads(body)["error"]


def test_a_job_can_be_ended(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    session = server.session
    ask(server, "/do/open", {"key": "0/drag", "role": "fitted"})
    session.wait(240.0)
    ended = threading.Event()

    def compare(*arguments: Any, **options: Any) -> Any:
        assert ended.wait(240.0)  # the work does not run ahead of what is asked here
        return gw.compare(*arguments, **options)

    monkeypatch.setattr("gyrowheel.workbench.session.compare", compare)
    ask(server, "/do/diagnose", {})
    assert ask(server, "/do/add", {"what": "windage"})[0] == 422  # one thing at a time
    ask(server, "/do/end", {})
    ended.set()
    session.wait(240.0)
    assert session.job is None
    assert session.trouble is not None
    assert session.trouble.sentence == "ended"
    assert session.step.diagnosis is None


def test_the_verb_refuses_bad_input(gyrowheel: Shell, tmp_path: Path, server: Server) -> None:
    for arguments, words in (
        ([tmp_path / "none"], "no such folder"),
        ([tmp_path, "--model", tmp_path / "m.yaml"], "m.yaml"),
        ([tmp_path, "--port", server.port], "cannot be used"),
        ([tmp_path, "--address", "0.0.0.0"], "name one of this computer"),
    ):
        result = gyrowheel("workbench", *arguments)
        assert result.code == 2
        assert words in result.err


def test_a_derived_channel_is_drawn_with_its_unit_and_the_residual_over_it(wheel: Wheel) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())
    session.open("0/drag", "fitted")
    session.wait(240.0)
    with Server(session, port=0) as server:

        def refusal(text: str) -> str:
            return str(json.loads(ask(server, "/do/derived", {"text": text})[1])["refused"])

        assert "their units differ" in refusal("V_x + t")
        assert "take re(...)" in refusal("z*V_x")
        assert "z_rate is not measured" in refusal("re(z_rate)")
        assert "column 5" in refusal("V_x*Omgea")
        assert json.loads(ask(server, "/do/derived", {"text": "V_x*i_motor"})[1]) == {"unit": "V·A"}
        text = "Omega^2*abs(z)"
        assert ask(server, "/do/derive", {"text": text})[0] == 200
        assert json.loads(ask(server, "/state")[1])["derived"] == [
            {"name": text, "title": f"{text}, rad³/s²"}
        ]
        rows = session.opened["0/drag"].recording.measurement
        expected = rows["spin_rate"] ** 2 * np.hypot(np.tan(rows["tilt_x"]), np.tan(rows["tilt_y"]))
        shown = json.loads(ask(server, "/sample?key=0/drag&time=1.0")[1])
        place = int(np.flatnonzero(rows["sequence"] == shown["sample"])[0])
        assert shown["values"][-1] == pytest.approx(expected[place])
        session.compare()
        session.wait(240.0)
        found = json.loads(ask(server, "/found")[1])
        w = found["windows"]
        assert found["variables"][-1]["variable"] == text
        time = session.opened["0/drag"].recording.time
        first = (time >= w["start"][0]) & (time < w["start"][0] + w["duration"][0])
        assert w["over"][text][0] == pytest.approx(expected[first].mean(), rel=1e-3)
        for k in range(5):
            answer = ask(server, "/do/derive", {"text": f"t*{k + 1}"})
        assert "4 are shown" in json.loads(answer[1])["error"]
        ask(server, "/do/underive", {"text": text})
        assert text not in json.loads(ask(server, "/found")[1])["windows"]["over"]


def test_a_derived_channel_that_is_removed_while_it_is_drawn_raises_nothing(wheel: Wheel) -> None:
    channels, recording, bench = Channels(), gw.Recording.open(wheel.recording), gw.Model().bench
    channels.add("V_x")
    own = next(iter(channels))
    before = channels.one(own, recording, bench).values
    channels.remove(own.text)
    assert channels.of(recording, bench) == {}
    np.testing.assert_array_equal(channels.one(own, recording, bench).values, before)
