"""The command line run within the test, plans of a few seconds, requests, and messages."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from gyrowheel.cli.app import app
from gyrowheel.cli.console import run
from gyrowheel_core import wire

if TYPE_CHECKING:
    from gyrowheel.workbench.server import Server
    from gyrowheel.workbench.session import Session

#: A plan that shows drag: three speeds, some tilts.
DRAG_PLAN = """\
schema: 1
name: drag
hold_s: 1.3
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [3, 0], [0, 3]]}
  - {spin_rpm: 2500, tilt_deg: [[-3, 0], [0, -3]]}
  - {spin_rpm: 1500, tilt_deg: [[0, 0], [2, 2], [0, 3]]}
"""
#: The same states in another order, under another name.
OTHER_PLAN = """\
schema: 1
name: other
hold_s: 1.3
segments:
  - {spin_rpm: 3000, tilt_deg: [[0, 0], [2, -2]]}
  - {spin_rpm: 2000, tilt_deg: [[0, 0], [-3, 1]]}
"""
SHORT_PLAN = """\
schema: 1
name: short
hold_s: 0.3
segments:
  - {spin_rpm: 3000, tilt_deg: [[0, 0], [0.5, 0]]}
"""
TOO_FAST_PLAN = """\
schema: 1
name: too_fast
segments:
  - {spin_rpm: 9000, tilt_deg: [[0, 0]]}
"""


@dataclass(frozen=True)
class Result:
    """What a call of the command line gave."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What it wrote to stdout, read as JSON that has only finite numbers."""
        return json.loads(self.out, parse_constant=pytest.fail)


class Shell:
    """Calls the command line as `gyrowheel ...`, in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> Result:
        """Return what `gyrowheel` with these arguments gives."""
        self._capsys.readouterr()
        code = run(app, [str(argument) for argument in arguments])
        captured = self._capsys.readouterr()
        return Result(code, captured.out, captured.err)

    def good(self, *arguments: object) -> Result:
        """Return the same, and insist on success."""
        result = self(*arguments)
        assert result.code == 0, result.err
        return result


def write(path: Path, text: str) -> Path:
    """Write a text file and return its path."""
    path.write_text(text, encoding="utf-8")
    return path


def slow_bench(folder: Path) -> Path:
    """Write the file of the shipped bench at half its rate, whose nodes exchange half as many messages."""
    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text(encoding="utf-8")
    usual = "sample_period: {value: 5.0e-4"
    assert text.count(usual) == 1
    return write(folder / "slow.yaml", text.replace(usual, "sample_period: {value: 1.0e-3"))


def ask(server: Server, path: str, content: Any = None, **headers: str) -> tuple[int, bytes]:
    """Return status and body of an answer; with `content` of a POST."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=240.0)
    sent = {"Host": f"127.0.0.1:{server.port}", **{k.replace("_", "-"): v for k, v in headers.items()}}
    if content is not None:
        sent = {"Content-Type": "application/json"} | sent
    connection.request("GET" if content is None else "POST", path, json.dumps(content), sent)
    answer = connection.getresponse()
    return answer.status, answer.read()


def sample(stamp_ns: int, tilt_x: float) -> bytes:
    """Return a serialized measurement."""
    return wire.MEASUREMENT.pack(stamp_ns, 1, tilt_x, *[0.5] * 10)


def wait_until(session: Session, so: Callable[[], bool]) -> None:
    """Wait until something is so, at most four minutes."""
    changed = threading.Event()
    unwatch = session.watch(changed.set)
    for _ in range(1200):
        changed.clear()
        if so() or (changed.wait(0.2) and so()):
            unwatch()
            return
    raise AssertionError("it does not come")
