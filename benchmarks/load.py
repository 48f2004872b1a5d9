"""The workbench under load: jobs, saves while another process holds the model, idle connections; how it answers."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from urllib.parse import urlsplit

from benchmarks.diagnosis import record
from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.workbench import resident_memory, serving
from gyrowheel import Model

JOBS = 200
SAVES = 20
CONNECTIONS = 300
SECONDS = 600.0  # for all of it
PLAN = """\
schema: 1
name: drag
hold_s: 1.3
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [3, 0], [0, 3]]}
  - {spin_rpm: 2500, tilt_deg: [[-3, 0], [0, -3]]}
  - {spin_rpm: 1500, tilt_deg: [[0, 0], [2, 2], [0, 3]]}
"""
_RECORDINGS = ("drag", "other")
_PAGES = ("/", "/state", "/found", "/help")
_PAUSE = 0.2  # s between two requests
_HELD = 2.0  # s for which another process holds the model
_HOLDS = """
import sys
from pathlib import Path
from gyrowheel_core.locks import changing
for line in sys.stdin:
    with changing(Path(sys.argv[1])):
        print("held", flush=True)
        sys.stdin.readline()
"""
_Job = tuple[str, dict[str, str]]
_FITTED: _Job = ("open", {"key": "0/other", "role": "fitted"})
_UNUSED: _Job = ("open", {"key": "0/other", "role": "not used to fit"})
#: The jobs, in turn, after one recording was opened to be fitted; the other one changes its use, which drops results.
_TURN: tuple[_Job, ...] = (_FITTED, ("compare", {}), _UNUSED, _FITTED, _UNUSED, ("diagnose", {}))


class _Client:
    """Asks the server; keeps the time of every answer [s] with its page, and what failed."""

    def __init__(self, url: str) -> None:
        found = urlsplit(url)
        self.address = str(found.hostname), int(found.port or 0)
        self.took: list[tuple[float, str]] = []
        self.failed: list[str] = []

    def ask(self, path: str, content: dict[str, str] | None = None) -> bytes:
        """Return the body of an answer to a GET or, with `content`, to a POST."""
        connection = http.client.HTTPConnection(*self.address, timeout=SECONDS)
        body = None if content is None else json.dumps(content)
        began = time.perf_counter()
        connection.request("POST" if body else "GET", path, body, {"Content-Type": "application/json"})
        answer = connection.getresponse()
        text = answer.read()
        self.took.append((time.perf_counter() - began, path))
        connection.close()
        if answer.status != 200:
            self.failed.append(f"{path}: {answer.status}: {text[:200].decode(errors='replace')}")
        return text

    def do(self, what: str, **content: str) -> None:
        """Begin a job and wait for its end."""
        end = time.monotonic() + SECONDS
        self.ask(f"/do/{what}", content)
        while (state := json.loads(self.ask("/state")))["job"] is not None:
            if time.monotonic() > end:
                raise MeasurementError(f"{what} does not end")
            time.sleep(_PAUSE)
        if state["trouble"] is not None:
            self.failed.append(f"{what}: {state['trouble']['sentence']}")


@contextlib.contextmanager
def _asked(client: _Client) -> Iterator[None]:
    """Request the pages in turn during a block."""
    over = threading.Event()

    def ask() -> None:
        for path in itertools.cycle(_PAGES):
            if over.wait(_PAUSE):
                break
            try:
                client.ask(path)
            except OSError as error:
                client.failed.append(f"{path}: {error}")

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextlib.contextmanager
def _held(model: Path) -> Iterator[Callable[[], None]]:
    """Provide a function that has another process hold a model for some seconds from now."""
    command = [sys.executable, "-c", _HOLDS, str(model)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        write, read = holder.stdin, holder.stdout

        def line() -> None:
            write.write("\n")
            write.flush()

        def hold() -> None:
            line()
            if read.readline() != "held\n":
                raise MeasurementError("no other process holds the model")
            threading.Timer(_HELD, line).start()

        yield hold


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Run all jobs and saves, with the connections open from a quarter of them on."""
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name, contextlib.ExitStack() as open_:
        folder = Path(name)
        for own in _RECORDINGS:
            record(folder / "runs" / own, PLAN, lambda done: None)
        model = folder / "model.yaml"
        Model("gyrowheel").save(model)
        command = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()", "workbench"]
        command += [str(folder / "runs"), "--model", str(model), "--port", "0"]
        process, lines = open_.enter_context(serving(command))
        client = _Client(lines.after("page: "))
        hold = open_.enter_context(_held(model))
        open_.enter_context(_asked(client))
        client.do("open", key="0/drag", role="fitted")
        began, saves, first = time.monotonic(), 0, float("nan")
        others: list[socket.socket] = []
        for jobs, (what, content) in enumerate(itertools.islice(itertools.cycle(_TURN), JOBS), 1):
            client.do(what, **content)
            if jobs % (JOBS // SAVES) == 0:
                if saves % 2:
                    hold()
                client.do("save", name="model.yaml")
                saves += 1
            if jobs == JOBS // 4:
                first = resident_memory(process.pid)
                for _ in range(CONNECTIONS):
                    others.append(open_.enter_context(socket.create_connection(client.address)))
            progress(jobs / JOBS)
            if (seconds := time.monotonic() - began) > SECONDS:
                break
        last = resident_memory(process.pid)
        Model.load(model)
    times = [took for took, _ in client.took]
    worst = max(client.took)
    return [
        Report(
            "Workbench under load",
            [
                Figure("jobs", jobs, "", bar=Bar(">=", JOBS)),
                Figure("saves", saves, "", bar=Bar(">=", SAVES)),
                Figure("idle connections", len(others), "", bar=Bar(">=", CONNECTIONS)),
                Figure("answers", len(times), ""),
                Figure("refused or failed", len(client.failed), "", bar=Bar("<=", 0)),
                Figure("answer, median", 1e3 * median(times), "ms"),
                Figure("answers later than a second", sum(took > 1.0 for took in times), ""),
                Figure("answer, worst", 1e3 * worst[0], "ms", bar=Bar("<", 1000.0)),
                Figure("memory after a quarter of the jobs", first, "GB"),
                Figure("memory at the end", last, "GB"),
                Figure("growth of memory", 100.0 * (last / first - 1.0), "%", bar=Bar("<", 10.0)),
            ],
            notes=[
                f"Opening, comparing and diagnosing recordings of some seconds, in {seconds:.0f} s; after each"
                f" {JOBS // SAVES} jobs the model is saved, each second time while another process holds it. Meanwhile"
                f" the page, its state, its results and its help are requested every {1e3 * _PAUSE:.0f} ms. The idle"
                f" connections are open from a quarter of the jobs on. Worst answer: {worst[1]}."
                f" Load average {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores.",
                *client.failed[:5],
            ],
        )
    ]
